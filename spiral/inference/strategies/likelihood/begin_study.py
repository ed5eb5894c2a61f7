"""Begin a study of ``strategy=likelihood``: fit the seed, list the candidates."""

from __future__ import annotations

from dataclasses import replace

from spiral.engine.likelihood.fit import add_standard_errors
from spiral.inference.evidence.assembly import (
    Assembly,
    build_variants,
    check_candidates,
    compile_assembly,
)
from spiral.inference.evidence.comparison import refine_substeps
from spiral.inference.evidence.fit_state import initial_fit_state
from spiral.inference.identifiability.richness import merge_overlapping_groups
from spiral.inference.identifiability.undetermined import are_effects_tied, describe_held_parameters
from spiral.inference.likelihood.fitting import (
    LikelihoodFit,
    is_random_force_small,
    predicted_states,
)
from spiral.inference.likelihood.interpolation import (
    held_inputs,
    restore_declared_interpolation,
    select_input_interpolation,
)
from spiral.inference.likelihood.needless_noise import drop_needless_noise
from spiral.inference.likelihood.outliers import fit_without_outliers
from spiral.inference.likelihood.record_noise import fit_with_own_noise_levels
from spiral.inference.likelihood.shapes import refit_effect_shapes, refit_from_other_shapes
from spiral.inference.likelihood.tied_parameters import find_parameter_ties
from spiral.inference.problem import Problem, Progress
from spiral.inference.strategies.base import StartedStudy
from spiral.inference.strategies.likelihood.other_noise import fit_with_noise_growth
from spiral.inference.strategies.likelihood.whole_fit import compare_likelihood_fit, finish_fit
from spiral.types.label import owner_of

_FLAT = (
    10.0  # relative standard error from which a combination counts as flat with any effect added
)


def begin_study(problem: Problem, progress: Progress) -> StartedStudy:
    """The study with its seed fitted, by the noise model that the likelihood selects.

    Parameters that the record cannot tell from others are held at their given values: along a
    flat combination the likelihood is the same, whatever value one of them has. They stay held
    until an effect is admitted beside which the record tells them. Parameters of one
    owner of which none is given are held at fitted values where nothing short of another record
    would tell them; where whole effects look alike the study ends there, unless much acts at
    random beside the fit: then candidates are tried first.
    """
    groups: tuple[tuple[str, ...], ...] = ()
    held: tuple[str, ...] = ()
    fitted: dict[str, float] = {}
    while True:
        bare, fit = _fit_seed(problem, held, progress)
        problem = replace(problem, records=bare.problem.records, test=bare.problem.test)
        ties, model = find_parameter_ties(fit), problem.model
        groups = merge_overlapping_groups([set(g) for g in (*groups, *ties.groups)])
        hold = next((k for k in ties.parts if model.values.get(k)), None)
        flat = ties.error > _FLAT and not are_effects_tied(ties.groups)
        if hold is None and flat and is_random_force_small(fit):
            hold = ties.parts[0]
            fitted[hold] = float(fit.estimate.values[hold])
        if hold is None:  # nothing is tied, or nobody said how large any of it is
            break
        progress(f"holding {hold}, which the record cannot tell from others")
        held = (*held, hold)
        problem = replace(problem, model=replace(model, values={**model.values, **fitted}))
    # what is tied in a fit gone astray need not be tied in the record
    sure = is_random_force_small(fit)
    begun = replace(
        _lay_out_candidates(bare, fit, progress), refused=bool(ties) and sure,
        doubtful=bool(ties) and not sure, groups=groups,
    )  # fmt: skip
    if ties or not held:
        return begun
    tied = {"parameters": list(held), "groups": list(groups), "fitted": fitted}
    details = {**begun.details, "tied": tied}
    notes = (*begun.comparison.notes, describe_held_parameters(details))
    return replace(begun, comparison=replace(begun.comparison, notes=notes), details=details)


def _fit_seed(
    problem: Problem, held: tuple[str, ...], progress: Progress
) -> tuple[Assembly, LikelihoodFit]:
    """The seed compiled without candidates, and its maximum-likelihood fit, some values held."""
    progress("compiling the model")
    settings = replace(problem.settings, phase_knot=0.0)  # the filter tracks the phase itself
    problem = replace(problem, settings=settings)
    check_candidates(problem)
    bare = compile_assembly(problem, (), 1)
    state = replace(
        initial_fit_state(bare, problem.model.labels),
        corrected=False, held=held, between=held_inputs(problem),
    )  # fmt: skip
    bare = refine_substeps(bare, state)
    bare, fit = fit_without_outliers(bare, state, progress)
    bare, fit = fit_with_own_noise_levels(bare, state, fit, progress) or (bare, fit)
    if state.between and fit.estimate.finite:
        fit = restore_declared_interpolation(bare, fit, progress)
    for effect in problem.model.effects:
        keys = tuple(k for k in problem.scaled if owner_of(k) == effect.label)
        fit = refit_from_other_shapes(bare, fit, effect, keys)
        fit = refit_effect_shapes(bare, fit, effect, keys)
    fit = finish_fit(bare, fit, progress)
    if not problem.candidates:
        bare, fit = fit_with_noise_growth(bare, fit, progress) or (bare, fit)
        run = select_input_interpolation(bare, fit, progress)
        fit = (
            fit
            if run is fit
            else finish_fit(bare, drop_needless_noise(bare, run, progress), progress)
        )
    return bare, replace(fit, estimate=add_standard_errors(fit.estimate))


def _lay_out_candidates(bare: Assembly, fit: LikelihoodFit, progress: Progress) -> StartedStudy:
    """A fit compared with the test records, its candidates listed but not compiled."""
    refitted = compare_likelihood_fit(bare, fit, progress)
    fitted = replace(bare.problem, model=refitted.comparison.model)
    expected = predicted_states(fit)
    variants, left_out, _ = build_variants(fitted, bare.later, expected)
    assembly = replace(
        bare, offered=tuple(variants), left_out=left_out, bare=True, expected=expected
    )
    return StartedStudy(assembly, refitted.fit_state, refitted.comparison, refitted.details)
