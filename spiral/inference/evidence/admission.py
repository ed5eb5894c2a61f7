"""Admitting a candidate: refitted, its shapes set free where the record tells them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from spiral.engine.fit import Fitted, fit, standard_deviations
from spiral.engine.growth import Stage
from spiral.engine.sensitivities import reduce
from spiral.engine.study import Point
from spiral.inference.evidence.assembly import (
    ORIGIN,
    Assembly,
    Variant,
    columns,
    effects_of,
)
from spiral.inference.evidence.fit_state import (
    FitState,
    all_samples,
    grown,
    stage_lengths,
    two_sided,
)
from spiral.inference.evidence.scoring import Ranked, score_stage, tested_keys
from spiral.inference.problem import Progress
from spiral.types.effect import Effect
from spiral.types.errors import ConfigError
from spiral.types.record import Array

_START, _STARTS = 0.1, 3  # share of its bound that an amplitude starts from; shapes refitted so
_WORTH = 10.0  # fall of the sum of squares (sigma^2) for which a shape is set free
TOLD = 0.5  # relative standard error up to which a record tells a parameter


@dataclass(frozen=True)
class Admitted:
    """A candidate admitted and refitted at one window length."""

    standing: FitState
    stage: Stage
    variant: Variant

    @property
    def held(self) -> tuple[str, ...]:
        """Its amplitudes that stay at zero, by their real names."""
        label, name = self.variant.label, self.variant.original.label
        own = [k.rsplit(".", 1) for k in self.standing.held]
        return tuple(f"{name}.{key}" for owner, key in own if owner == label)


def admit(assembly: Assembly, standing: FitState, stage: Stage, ranked: Ranked) -> Admitted:
    """Add a candidate, refit, and set its shapes free where that pays or the record tells them.

    A shape that is told but held at its grid's value would make the others' errors too small.

    Where the model is far off, an effect with bounds is started from afar as well (``afar``).
    """
    near = _near(assembly, standing, stage, ranked)
    found = [near, *_refits_from_afar(assembly, standing, stage, ranked.variant.original.label)]
    return min(found, key=lambda a: a.stage.fitted.cost)


def _near(assembly: Assembly, standing: FitState, stage: Stage, ranked: Ranked) -> Admitted:
    """A candidate refitted from zero amplitude."""
    variant = ranked.variant
    values = stepped(assembly, stage.fitted.point.values, variant, ranked.score.step)
    wider = replace(
        standing,
        labels=(*standing.labels, variant.label),
        values=values,
        held=(*standing.held, *ranked.held),
        shortest=max(standing.shortest, stage.length if variant.effect.states else 0),
    )
    fitted = refit(assembly, wider, stage)
    wider = replace(wider, values=fitted.point.values)
    if variant.tuned and np.isfinite(fitted.cost):
        loose = (*wider.freed, *variant.tuned)
        freer = replace(wider, freed=loose, free_from=max(wider.free_from, stage.length))
        trial = refit(assembly, freer, Stage(stage.length, stage.layouts, fitted))
        if fitted.cost - trial.cost > _WORTH or _told(assembly, freer, trial, variant.tuned):
            fitted = trial
            wider = replace(freer, values=trial.point.values)
    return Admitted(wider, Stage(stage.length, stage.layouts, fitted), variant)


def _told(assembly: Assembly, standing: FitState, fitted: Fitted, keys: tuple[str, ...]) -> bool:
    """Whether a fit that converged leaves these parameters a relative error of ``TOLD`` at most."""
    moving, _ = columns(assembly, standing.keys(assembly))
    at = [list(moving.index).index(assembly.study.index(k)) for k in keys]
    sizes = np.abs(moving.current(fitted.point.values)[at])
    return fitted.converged and bool(np.all(standard_deviations(fitted)[at] <= TOLD * sizes))


def afar(assembly: Assembly, standing: FitState, stage: Stage, label: str) -> list[Variant]:
    """Variants of an effect that may have a second basin: amplitudes bounded on both sides.

    What a rim lets over, or a limit cuts off, is unseen from zero amplitude. Only where the model
    is far off (chi2/dof of 2 and more): what it lacks there need not be small.
    """
    if stage.fitted.chi2_per_dof < assembly.problem.settings.chi2_limit:
        return []
    return [v for v in assembly.variants if v.original.label == label and two_sided(v.original)]


def _refits_from_afar(
    assembly: Assembly, standing: FitState, stage: Stage, label: str
) -> list[Admitted]:
    """Refits from a tenth of the bounds, from the shapes whose first step promises most."""
    study = assembly.study
    found: list[tuple[float, FitState, Variant]] = []
    for variant in afar(assembly, standing, stage, label):
        values = stage.fitted.point.values.copy()
        for key in tested_keys(assembly, variant):
            position = study.index(key)
            values[:, position] = _START * (study.compiled.traced.parameters[position].upper or 0)
        wider = replace(
            standing,
            labels=(*standing.labels, variant.label),
            values=values,
            freed=(*standing.freed, *variant.tuned),
            shortest=stage.length,
        )
        moving, _ = columns(assembly, wider.keys(assembly))
        point = Point(values, stage.fitted.point.starts)
        promised = reduce(study, stage.layouts, point, moving)
        if promised.finite:
            found.append((float(promised.triangle[-1, -1] ** 2), wider, variant))
    refits = []
    for _, wider, variant in sorted(found, key=lambda f: f[0])[:_STARTS]:
        fitted = refit(assembly, wider, stage)
        wider = replace(wider, values=fitted.point.values)
        refits.append(Admitted(wider, Stage(stage.length, stage.layouts, fitted), variant))
    return refits


def with_effects(
    assembly: Assembly, standing: FitState, effects: tuple[Effect, ...], progress: Progress
) -> FitState:
    """Admit effects one by one at the shortest windows, without gates, for a good start.

    Those with a second basin are admitted at the longest windows.
    """
    for effect in effects:
        progress(f"adding {effect.label}")
        lengths = stage_lengths(assembly) if two_sided(effect) else stage_lengths(assembly)[:1]
        *_, stage = grown(assembly, standing, all_samples(assembly), lengths)
        evidence = score_stage(assembly, standing, stage)
        chosen = [r for r in evidence.ranked if r.variant.original.label == effect.label]
        if not chosen:
            raise ConfigError(
                f"effect {effect.label!r} at the sample rate of these records",
                "a rate that shows it",
            )
        standing = admit(assembly, standing, stage, chosen[0]).standing
    return standing


def stepped(assembly: Assembly, values: Array, variant: Variant, step: Array) -> Array:
    """Where the refit starts: zero amplitude, from which the fit takes the damped joint step.

    A companion's step becomes amplitude and phase origin, which zero amplitude could not tell.
    """
    if variant.companion is None:
        return values
    study = assembly.study
    keys = tested_keys(assembly, variant)
    new = values.copy()
    cosine, sine = step[:2]
    new[:, study.index(keys[0])] = np.hypot(cosine, sine)
    new[:, study.index(ORIGIN)] += np.arctan2(sine, cosine)
    return new


def refit(assembly: Assembly, standing: FitState, stage: Stage) -> Fitted:
    """Fit a standing on a stage's windows, started from that stage's states."""
    moving, bounds = columns(assembly, standing.keys(assembly))
    point = Point(standing.values, stage.fitted.point.starts)
    return fit(assembly.study, stage.layouts, point, moving, bounds)


def let_go(assembly: Assembly, standing: FitState, labels: tuple[str, ...]) -> FitState:
    """The standing without these effects, whose amplitudes are zero again."""
    for label in labels:
        standing = without(assembly, standing, label)
    return standing


def without(assembly: Assembly, standing: FitState, label: str) -> FitState:
    """The standing without an effect, by its compiled label."""
    values = standing.values.copy()
    for key in tested_keys(assembly, assembly.variant(label)):
        values[:, assembly.study.index(key)] = 0.0  # else it would act on, unseen by the fit
    return replace(
        standing,
        values=values,
        labels=tuple(x for x in standing.labels if x != label),
        freed=tuple(k for k in standing.freed if k.rsplit(".", 1)[0] != label),
        held=tuple(k for k in standing.held if k.rsplit(".", 1)[0] != label),
    )


def second_order(effect: Effect, assembly: Assembly, state: FitState) -> bool:
    """Whether an effect is what one that the state holds leaves beyond leading order."""
    held = effects_of(assembly, state.labels)
    return any(effect.plugin_name() in e.leaves for e in held)


def cannot_be_asked(assembly: Assembly, label: str) -> ConfigError:
    """The error for an effect named by a person that these records cannot be asked about."""
    return ConfigError(
        f"add {label}",
        "an effect that these records can be asked about",
        assembly.left_out.get(label, "it is no number along them, or nothing moves at its port"),
    )
