"""Admit a candidate: refit the model with it, and free its shapes where the record tells them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from spiral.engine.fit import WindowFit, fit, standard_deviations
from spiral.engine.growth import Stage
from spiral.engine.sensitivities import reduce_windows
from spiral.engine.study import ORIGIN, Point
from spiral.inference.evidence.assembly import (
    Assembly,
    Variant,
    columns_with_bounds,
    effects_of,
)
from spiral.inference.evidence.fit_state import (
    FitState,
    all_samples,
    fit_growing_windows,
    has_two_sided_bounds,
    stage_lengths,
)
from spiral.inference.evidence.scoring import RankedCandidate, amplitude_keys, score_stage
from spiral.inference.problem import Progress
from spiral.types.effect import Effect
from spiral.types.errors import ConfigError
from spiral.types.label import owner_of, split_key
from spiral.types.record import Array

_START, _STARTS = 0.1, 3  # of its upper bound, where an amplitude starts; most shapes refitted so
_WORTH = 10.0  # fall of the sum of squares (sigma^2) for which a shape is set free
TOLD = 0.5  # relative standard error up to which a record tells a parameter


@dataclass(frozen=True)
class AdmittedEffect:
    """A candidate admitted and refitted at one window length."""

    fit_state: FitState
    stage: Stage
    variant: Variant

    @property
    def held(self) -> tuple[str, ...]:
        """Its amplitudes that stay at zero, by their real names."""
        label, name = self.variant.label, self.variant.original.label
        own = [split_key(k) for k in self.fit_state.held]
        return tuple(f"{name}.{key}" for owner, key in own if owner == label)


def admit_candidate(
    assembly: Assembly, fit_state: FitState, stage: Stage, ranked: RankedCandidate
) -> AdmittedEffect:
    """Add a candidate, refit, and set its shapes free where that pays or the record tells them.

    A shape that the record determines, held at its grid's value, makes others' errors too small.

    Where the model is far off, an effect with bounds is also refitted from far starts
    (``far_start_variants``); the refit of the smallest cost is returned.
    """
    near = _refit_from_zero(assembly, fit_state, stage, ranked)
    refits = [
        near,
        *_refits_from_far_starts(assembly, fit_state, stage, ranked.variant.original.label),
    ]
    return min(refits, key=lambda a: a.stage.fitted.cost)


def _refit_from_zero(
    assembly: Assembly, fit_state: FitState, stage: Stage, ranked: RankedCandidate
) -> AdmittedEffect:
    """A candidate refitted from zero amplitude."""
    variant = ranked.variant
    values = refit_start_values(assembly, stage.fitted.point.values, variant, ranked.score.step)
    wider = replace(
        fit_state,
        labels=(*fit_state.labels, variant.label),
        values=values,
        held=(*fit_state.held, *ranked.held),
        shortest=max(fit_state.shortest, stage.length if variant.effect.states else 0),
    )
    fitted = refit(assembly, wider, stage)
    wider = replace(wider, values=fitted.point.values)
    if variant.tuned and np.isfinite(fitted.cost):
        loose = (*wider.freed, *variant.tuned)
        freer = replace(wider, freed=loose, free_from=max(wider.free_from, stage.length))
        trial = refit(assembly, freer, Stage(stage.length, stage.layouts, fitted))
        if fitted.cost - trial.cost > _WORTH or _is_determined(
            assembly, freer, trial, variant.tuned
        ):
            fitted = trial
            wider = replace(freer, values=trial.point.values)
    return AdmittedEffect(wider, Stage(stage.length, stage.layouts, fitted), variant)


def _is_determined(
    assembly: Assembly, fit_state: FitState, fitted: WindowFit, keys: tuple[str, ...]
) -> bool:
    """Whether a fit that converged leaves these parameters a relative error of ``TOLD`` at most."""
    moving, _ = columns_with_bounds(assembly, fit_state.keys(assembly))
    at = [list(moving.index).index(assembly.study.index(k)) for k in keys]
    sizes = np.abs(moving.current(fitted.point.values)[at])
    return fitted.converged and bool(np.all(standard_deviations(fitted)[at] <= TOLD * sizes))


def far_start_variants(
    assembly: Assembly, fit_state: FitState, stage: Stage, label: str
) -> list[Variant]:
    """Variants of an effect that may have a second basin: amplitudes bounded on both sides.

    What a rim lets over, or a limit cuts off, is unseen from zero amplitude. Only where the model
    is far off (chi2/dof of 2 and more): what it lacks there need not be small.
    """
    if stage.fitted.chi2_per_dof < assembly.problem.settings.chi2_limit:
        return []
    return [
        v
        for v in assembly.variants
        if v.original.label == label and has_two_sided_bounds(v.original)
    ]


def _refits_from_far_starts(
    assembly: Assembly, fit_state: FitState, stage: Stage, label: str
) -> list[AdmittedEffect]:
    """Refits from a tenth of the bounds, from the shapes whose first step promises most."""
    study = assembly.study
    starts: list[tuple[float, FitState, Variant]] = []
    for variant in far_start_variants(assembly, fit_state, stage, label):
        values = stage.fitted.point.values.copy()
        for key in amplitude_keys(assembly, variant):
            position = study.index(key)
            values[:, position] = _START * (study.compiled.traced.parameters[position].upper or 0)
        wider = replace(
            fit_state,
            labels=(*fit_state.labels, variant.label),
            values=values,
            freed=(*fit_state.freed, *variant.tuned),
            shortest=stage.length,
        )
        moving, _ = columns_with_bounds(assembly, wider.keys(assembly))
        point = Point(values, stage.fitted.point.starts)
        promised = reduce_windows(study, stage.layouts, point, moving)
        if promised.finite:
            starts.append((float(promised.triangle[-1, -1] ** 2), wider, variant))
    refits = []
    for _, wider, variant in sorted(starts, key=lambda f: f[0])[:_STARTS]:
        fitted = refit(assembly, wider, stage)
        wider = replace(wider, values=fitted.point.values)
        refits.append(AdmittedEffect(wider, Stage(stage.length, stage.layouts, fitted), variant))
    return refits


def with_effects(
    assembly: Assembly, fit_state: FitState, effects: tuple[Effect, ...], progress: Progress
) -> FitState:
    """Admit effects one by one at the shortest windows, without gates, for a good start.

    Those with a second basin are admitted at the longest windows.
    """
    for effect in effects:
        progress(f"adding {effect.label}")
        lengths = (
            stage_lengths(assembly) if has_two_sided_bounds(effect) else stage_lengths(assembly)[:1]
        )
        *_, stage = fit_growing_windows(assembly, fit_state, all_samples(assembly), lengths)
        evidence = score_stage(assembly, fit_state, stage)
        chosen = [r for r in evidence.ranked if r.variant.original.label == effect.label]
        if not chosen:
            raise ConfigError(
                f"effect {effect.label!r} at the sample rate of these records",
                "a rate that shows it",
            )
        fit_state = admit_candidate(assembly, fit_state, stage, chosen[0]).fit_state
    return fit_state


def refit_start_values(assembly: Assembly, values: Array, variant: Variant, step: Array) -> Array:
    """Start values of a refit: zero amplitude, from which the fit takes the damped joint step.

    With a companion the steps (c, s) give amplitude sqrt(c^2 + s^2) and phase origin atan2(s, c),
    since at zero amplitude nothing depends on the phase.
    """
    if variant.companion is None:
        return values
    study = assembly.study
    keys = amplitude_keys(assembly, variant)
    new = values.copy()
    cosine, sine = step[:2]
    new[:, study.index(keys[0])] = np.hypot(cosine, sine)
    new[:, study.index(ORIGIN)] += np.arctan2(sine, cosine)
    return new


def refit(assembly: Assembly, fit_state: FitState, stage: Stage) -> WindowFit:
    """Fit what a fit state moves on a stage's windows, from the window states of that stage."""
    moving, bounds = columns_with_bounds(assembly, fit_state.keys(assembly))
    point = Point(fit_state.values, stage.fitted.point.starts)
    return fit(assembly.study, stage.layouts, point, moving, bounds)


def drop_effects(assembly: Assembly, fit_state: FitState, labels: tuple[str, ...]) -> FitState:
    """The fit state without these effects, their amplitudes set to zero."""
    for label in labels:
        fit_state = drop_effect(assembly, fit_state, label)
    return fit_state


def drop_effect(assembly: Assembly, fit_state: FitState, label: str) -> FitState:
    """The fit state without an effect (compiled label), its amplitudes set to zero."""
    values = fit_state.values.copy()
    for key in amplitude_keys(assembly, assembly.variant(label)):
        values[:, assembly.study.index(key)] = 0.0  # else it would go on acting, moved by no fit
    return replace(
        fit_state,
        values=values,
        labels=tuple(x for x in fit_state.labels if x != label),
        freed=tuple(k for k in fit_state.freed if owner_of(k) != label),
        held=tuple(k for k in fit_state.held if owner_of(k) != label),
    )


def is_second_order_remainder(effect: Effect, assembly: Assembly, state: FitState) -> bool:
    """Whether an active effect leaves this one beyond leading order (``Effect.leaves``)."""
    held = effects_of(assembly, state.labels)
    return any(effect.plugin_name() in e.leaves for e in held)


def untestable_effect_error(assembly: Assembly, label: str) -> ConfigError:
    """The error for an effect that the user names and these records cannot test."""
    return ConfigError(
        f"add {label}",
        "an effect that these records can test",
        assembly.left_out.get(label, "along them it is not a number, or nothing moves at its port"),
    )
