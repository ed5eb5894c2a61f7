"""Searches on stretches of long records, whose outcome the whole records then judge."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from spiral.engine.likelihood.predict import predict_readings
from spiral.inference.evidence.assembly import Assembly, with_records
from spiral.inference.evidence.enlarge import reorder_starts, reorder_states
from spiral.inference.evidence.excerpt import Excerpt, Stretch, representative_stretches
from spiral.inference.evidence.fit_state import FitState
from spiral.inference.likelihood.fitting import (
    WARM,
    LikelihoodFit,
    fit_by_likelihood,
    per_record_parameters,
    prepare_filter_tasks,
)
from spiral.inference.likelihood.needless_noise import noise_penalty
from spiral.types.record import Array

Search = Callable[[Assembly, LikelihoodFit], LikelihoodFit]
"""A search that takes a fit further, in a study and in its terms."""


def excerpt_study(
    assembly: Assembly, state: FitState, fit: LikelihoodFit | None = None
) -> tuple[Assembly, FitState] | None:
    """The study of an excerpt and the state in its terms; nothing where there is none.

    Each stretch begins where the filter of ``fit`` was, the state's fit if it is left out; where
    nothing is fitted yet, as any record. Parameters of single records (a phase's origin) are not
    told by stretches of these.
    """
    if assembly.excerpt is not None or per_record_parameters(assembly, state):
        return None
    stretches = representative_stretches(assembly.study.series)
    if not stretches:
        return None
    if fit is None and state.noise is not None:
        fit = fit_by_likelihood(assembly, state, steps=0)
    tasks = prepare_filter_tasks(assembly, state) if fit is None else fit.estimate.prepared
    whole = assembly.problem.records
    records = tuple(
        whole[r].stretch(first, last, f"{whole[r].name}[{first}:{last}]")
        for r, first, last in stretches
    )
    kept = Excerpt(
        assembly.problem, assembly.study.series, assembly.expected, stretches,
        tuple(task for task, _ in tasks), assembly.study.compiled.traced.states,
        state.starts, state.spreads,
    )  # fmt: skip
    part = replace(
        with_records(assembly, records, assembly.study.series[0].substeps),
        problem=replace(assembly.problem, records=records),
        expected=tuple(assembly.expected[r][first:last] for r, first, last in stretches)
        if assembly.expected else (),
        excerpt=kept,
    )  # fmt: skip
    rows = [s.record for s in stretches]
    begun = replace(
        state, values=state.values[rows], starts=_initial_states(fit, stretches),
        spreads=None,
    )  # fmt: skip
    return part, begun


def _initial_states(
    fit: LikelihoodFit | None, stretches: tuple[Stretch, ...]
) -> tuple[Array, ...] | None:
    """Where the filter of a fit expects all states at the beginning of each stretch."""
    if fit is None:
        return None
    expected = {}
    for r in {s.record for s in stretches}:
        task, settings = fit.estimate.prepared[r]
        run = predict_readings(task, settings, fit.estimate.noise, keep=True)
        expected[r] = run.expected[:, : len(task.states)]
    begins = tuple(expected[s.record][s.first] for s in stretches)
    return begins if np.all(np.isfinite(begins)) else None


def whole_study(assembly: Assembly) -> Assembly:
    """The study of the whole records, with what that of an excerpt is compiled of."""
    kept = assembly.excerpt
    if kept is None:
        return assembly
    return replace(
        assembly, problem=kept.problem, study=replace(assembly.study, series=kept.series),
        expected=kept.expected, excerpt=None,
    )  # fmt: skip


def whole_state(assembly: Assembly, state: FitState) -> FitState:
    """A state in terms of an excerpt's study, in those of the whole records."""
    kept = assembly.excerpt
    if kept is None:
        return state
    rows = [
        next((k for k, s in enumerate(kept.stretches) if s.record == r), 0)
        for r in range(len(kept.series))
    ]
    traced = assembly.study.compiled.traced
    return replace(
        state, values=state.values[rows],
        starts=reorder_starts(kept.starts, kept.states, traced, kept.series),
        spreads=reorder_states(kept.spreads, kept.states, traced.states, np.nan),
    )  # fmt: skip


def excerpt_fit(assembly: Assembly, fit: LikelihoodFit) -> tuple[Assembly, LikelihoodFit] | None:
    """The study of an excerpt and a fit's model fitted to it; nothing where there is none."""
    made = excerpt_study(assembly, fit.state, fit) if fit.estimate.finite else None
    if made is None:
        return None
    part, state = made
    again = fit_by_likelihood(part, state, fit.estimate.noise, steps=WARM, rough=True)
    return (part, again) if again.estimate.finite else None


def search_on_excerpt(
    assembly: Assembly, fit: LikelihoodFit, search: Search, slower: Search | None = None
) -> LikelihoodFit:
    """What a search finds on an excerpt, fitted to the whole records, if that is likelier there.

    Each number that its noise has more costs Schwarz's penalty. ``slower`` then looks on the whole
    records for what stretches are too short to show. Records of which there is no excerpt are
    searched themselves.
    """
    made = excerpt_fit(assembly, fit)
    if made is None:
        return search(assembly, fit)
    part, begun = made
    result = search(part, begun)
    if result is not begun and result.estimate.finite:
        state, noise = whole_state(part, result.state), result.estimate.noise
        again = fit_by_likelihood(assembly, state, noise, rough=True, like=fit.estimate.prepared)
        fit = again if _is_worth_more(again, fit) else fit
    return fit if slower is None else slower(assembly, fit)


def _is_worth_more(one: LikelihoodFit, other: LikelihoodFit) -> bool:
    """Whether a fit is likelier than another, its additional noise paid for."""
    price = noise_penalty(one.estimate.noise, other.estimate.noise, other.estimate.prepared)
    return one.estimate.finite and one.log_likelihood - price > other.log_likelihood
