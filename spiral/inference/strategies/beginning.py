"""The beginning of a study by the likelihood: the model as it is, and its candidates laid out."""

from __future__ import annotations

from dataclasses import replace

from spiral.engine.likelihood.fit import informed
from spiral.inference.evidence.assembly import Assembly, check_candidates, compiled_with, offers
from spiral.inference.evidence.comparison import refined
from spiral.inference.evidence.fit_state import begin
from spiral.inference.identifiability.held import held_said
from spiral.inference.identifiability.parameters import components
from spiral.inference.likelihood.between import with_likely_inputs
from spiral.inference.likelihood.fitting import LikelihoodFit, expected_states, explains
from spiral.inference.likelihood.identify import untold
from spiral.inference.likelihood.ladder import pruned
from spiral.inference.likelihood.shapes import from_other_values, with_own_shapes
from spiral.inference.likelihood.starts import best_fit
from spiral.inference.problem import Problem, Progress
from spiral.inference.strategies.admission import finished, settled_on
from spiral.inference.strategies.base import Begun
from spiral.inference.strategies.other_noise import counted


def begin_study(problem: Problem, progress: Progress) -> Begun:
    """The model as it is, most likely with the noise that its record wants.

    Parameters that the record cannot tell from others are held at their given values: along a flat
    combination the likelihood is the same, whatever value one of them has. Where none is given the
    study ends there, unless much acts at random beside the fit: then candidates are tried first.
    """
    groups: tuple[tuple[str, ...], ...] = ()
    held: tuple[str, ...] = ()
    while True:
        bare, found = _fitted(problem, progress)
        ties, model = untold(found), problem.model
        groups = components([set(g) for g in (*groups, *ties.groups)])
        given = next((k for k in ties.parts if model.values.get(k)), None)
        if given is None:  # nothing is tied, or nobody said how large any of it is
            break
        progress(f"holding {given}, which the record cannot tell from others")
        held = (*held, given)
        problem = replace(problem, model=replace(model, fixed=(*model.fixed, given)))
    sure = explains(found)  # what is tied in a fit gone astray need not be tied in the record
    begun = replace(
        _begun(bare, found, progress), refused=bool(ties) and sure,
        doubtful=bool(ties) and not sure, groups=groups,
    )  # fmt: skip
    if ties or not held:
        return begun
    details = {**begun.details, "tied": {"parameters": list(held), "groups": list(groups)}}
    notes = (*begun.comparison.notes, held_said(details))
    return replace(begun, comparison=replace(begun.comparison, notes=notes), details=details)


def _fitted(problem: Problem, progress: Progress) -> tuple[Assembly, LikelihoodFit]:
    """The model compiled as it is, and its most likely values and noise."""
    progress("compiling the model")
    settings = replace(problem.settings, phase_knot=0.0)  # the filter tracks the phase itself
    problem = replace(problem, settings=settings)
    check_candidates(problem)
    bare = compiled_with(problem, (), 1)
    state = replace(begin(bare, problem.model.labels), corrected=False)
    bare = refined(bare, state)
    found = best_fit(bare, state, progress)
    for effect in problem.model.effects:
        keys = tuple(k for k in problem.scaled if k.rsplit(".", 1)[0] == effect.label)
        found = from_other_values(bare, found, effect, keys)
        found = with_own_shapes(bare, found, effect, keys)
    found = finished(bare, found, progress)
    if not problem.candidates:
        bare, found = counted(bare, found, progress) or (bare, found)
        run = with_likely_inputs(bare, found, progress)
        found = found if run is found else finished(bare, pruned(bare, run, progress), progress)
    return bare, replace(found, estimate=informed(found.estimate))


def _begun(bare: Assembly, found: LikelihoodFit, progress: Progress) -> Begun:
    """A fit compared with the test records, its candidates laid out."""
    settled = settled_on(bare, found, progress)
    fitted = replace(bare.problem, model=settled.comparison.model)
    expected = expected_states(found)
    variants, left_out, _ = offers(fitted, bare.later, expected)
    assembly = replace(
        bare, offered=tuple(variants), left_out=left_out, bare=True, expected=expected
    )
    return Begun(assembly, settled.standing, settled.comparison, settled.details)
