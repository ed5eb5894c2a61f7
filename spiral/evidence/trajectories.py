"""Evidence from trajectories: fit the model on growing windows, score every candidate."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from spiral.effect import Effect
from spiral.errors import ConfigError
from spiral.evidence.assembly import (
    ORIGIN,
    Assembly,
    Variant,
    active_keys,
    columns,
    first_row,
    unknown_keys,
)
from spiral.evidence.gridnull import effective_tests
from spiral.evidence.inseparable import inseparable
from spiral.problem import Progress
from spiral.record import Array
from spiral.shooting.fit import Fitted, fit
from spiral.shooting.growth import Stage, first_starts, grow, layouts_for, lengths_for
from spiral.shooting.score import (
    Score,
    Table,
    block_samples,
    correlation_samples,
    score,
    tabulate,
)
from spiral.shooting.sensitivities import reduce, residuals
from spiral.shooting.start import SMOOTHING, balance, first_values
from spiral.shooting.study import Point
from spiral.shooting.windows import block_length, fair_block, halves
from spiral.trace import trace

Masks = tuple[Array | None, ...]
_FAR_OFF = 2.0  # chi2 per degree of freedom from which effects are started from afar as well
_START, _STARTS = 0.1, 3  # share of its bound that an amplitude starts from; shapes refitted so
_WORTH = 10.0  # fall of the sum of squares (sigma^2) for which a shape is set free


@dataclass(frozen=True)
class Standing:
    """Where a study stands: active effects (compiled labels), values, shapes set free.

    ``held`` are amplitudes of active effects that stay at zero, not admitted themselves;
    ``shortest`` the shortest windows of later fits: those on which an effect was found from afar.
    """

    labels: tuple[str, ...]
    values: Array
    freed: tuple[str, ...] = ()
    corrected: bool = True
    held: tuple[str, ...] = ()
    shortest: int = 0

    def keys(self, assembly: Assembly) -> tuple[str, ...]:
        """Parameters that a fit of this standing moves."""
        found = active_keys(assembly, self.labels, self.freed, self.corrected)
        return tuple(k for k in found if k not in self.held)


@dataclass(frozen=True)
class Ranked:
    """A candidate's best variant with its evidence; the smallest ``rank`` (BIC) is best.

    ``tests`` is the number of independent tests that its shapes amount to (``gridnull``);
    ``tied`` are effects of the model that can take over part of it, all of it where ``whole``;
    ``held`` are amplitudes that then stay at zero.
    """

    variant: Variant
    columns: tuple[int, ...]
    score: Score
    rank: float
    tests: float = 1.0
    tied: tuple[str, ...] = ()
    held: tuple[str, ...] = ()
    whole: bool = False

    @property
    def log_p(self) -> tuple[float, float]:
        """Classical and robust p-value (logarithms), corrected for the values tried."""
        more = float(np.log(self.tests))
        return min(self.score.log_p + more, 0.0), min(self.score.wald_log_p + more, 0.0)


@dataclass(frozen=True)
class Evidence:
    """Candidates at one window length, best first, with the pass they were scored in."""

    stage: Stage
    ranked: tuple[Ranked, ...]
    table: Table
    block: int


def half_masks(assembly: Assembly) -> tuple[Masks, Masks]:
    """Blocks that select and blocks that judge, for every record (``fair_block``)."""
    pairs = [
        halves(s.samples, fair_block(s.y, block_length(s.samples))) for s in assembly.study.series
    ]
    return tuple(a for a, _ in pairs), tuple(b for _, b in pairs)


def all_samples(assembly: Assembly) -> Masks:
    """No mask: every sample counts."""
    return (None,) * len(assembly.study.series)


def stage_lengths(assembly: Assembly) -> list[int]:
    """Window lengths of this study."""
    shortest = min(s.samples for s in assembly.study.series)
    return lengths_for(assembly.study, block_length(shortest))


def begin(assembly: Assembly, labels: tuple[str, ...]) -> Standing:
    """The first standing: unknown values from the balance of forces.

    Several smoothing windows are tried; the one whose shortest-window fit promises the smallest
    error after one step is kept.
    """
    known = Standing(labels, first_row(assembly))
    keys = known.keys(assembly)
    unknown = unknown_keys(assembly, keys)
    study, model = assembly.study, assembly.problem.model
    if not unknown:
        far = any(two_sided(e) for e in model.effects if e.label in labels)
        return replace(known, shortest=stage_lengths(assembly)[-1]) if far else known
    own = tuple(e for e in model.effects if e.label in labels)
    equations = balance(study, trace(model.system, own), unknown)
    layouts = layouts_for(study, stage_lengths(assembly)[0], all_samples(assembly))
    moving, _ = columns(assembly, keys)
    best, lowest = known, np.inf
    shortest = min(s.samples for s in study.series)
    for window in (w for w in SMOOTHING if 4 * w <= shortest):
        values = first_values(study, equations, known.values, window)
        if not np.all(np.isfinite(values)):
            continue
        point = Point(values, first_starts(study, layouts, values, window))
        reduction = reduce(study, layouts, point, moving)
        promised = float(reduction.triangle[-1, -1] ** 2) if reduction.finite else np.inf
        if promised < lowest:
            best, lowest = Standing(labels, values), promised
    return best


def grown(
    assembly: Assembly,
    standing: Standing,
    masks: Masks,
    lengths: list[int] | None = None,
    patient: bool = False,
) -> Iterator[Stage]:
    """Fit the standing model on growing windows; ``patient`` as in ``grow``.

    Values found from afar are kept while the window starts find theirs.
    """
    moving, bounds = columns(assembly, standing.keys(assembly))
    sizes = lengths or [n for n in stage_lengths(assembly) if n >= standing.shortest]
    alone = columns(assembly, ()) if standing.shortest else None
    yield from grow(assembly.study, standing.values, moving, bounds, masks, sizes, patient, alone)


def score_stage(assembly: Assembly, standing: Standing, stage: Stage) -> Evidence:
    """Score all candidates that are not active, in one pass."""
    keys = standing.keys(assembly)
    present = _labels(assembly, standing)
    absent = [v for v in assembly.variants if v.original.label not in present]
    groups = [(v, tested_keys(assembly, v)) for v in absent]
    candidate_keys = tuple(k for _, g in groups for k in g)
    residual = residuals(assembly.study, stage.layouts, stage.fitted.point)
    counted = sum(int(np.any(r != 0, axis=1).sum()) for r in residual)
    block = block_samples(correlation_samples(residual), counted)
    moving, _ = columns(assembly, (*keys, *candidate_keys))
    active, _ = columns(assembly, keys)
    reduction = reduce(assembly.study, stage.layouts, stage.fitted.point, moving, block)
    table = tabulate(reduction, active.count)
    ranks: dict[str, list[Ranked]] = {}
    for variant, owners, found in scored(assembly, table, groups):
        tied = inseparable(reduction.triangle, active.count, found.columns)
        names = [_owner(assembly, int(moving.index[i])) for i in tied.with_]
        ranked = Ranked(
            variant, found.columns, found, bic(table, found), variant.searched,
            tuple(dict.fromkeys(names)), tuple(owners[i] for i in tied.held), tied.whole,
        )  # fmt: skip
        ranks.setdefault(variant.original.label, []).append(ranked)
    best = [_best(table, variants) for variants in ranks.values()]
    return Evidence(stage, tuple(sorted(best, key=lambda r: r.rank)), table, block)


def scored(
    assembly: Assembly, table: Table, groups: list[tuple[Variant, tuple[str, ...]]]
) -> Iterator[tuple[Variant, tuple[str, ...], Score]]:
    """Each variant with the keys of its columns (one for each record) and their score."""
    parameters, first = assembly.study.compiled.traced.parameters, 0
    for variant, group in groups:
        index = columns(assembly, group)[0].index
        sides = tuple(parameters[i].lower == 0.0 and variant.companion is None for i in index)
        found = score(table, tuple(range(first, first + len(sides))), sides)
        first += len(sides)
        yield variant, tuple(assembly.study.keys[i] for i in index), found


def _owner(assembly: Assembly, index: int) -> str:
    """The effect that an active column belongs to; phase and its correction are the unbalance's."""
    keys = assembly.study.keys
    owner = keys[index].rsplit(".", 1)[0] if index < len(keys) else "system"
    if owner == "system":
        return "unbalance" if index >= len(keys) or keys[index] == ORIGIN else "system"
    known = {v.label: v.original.label for v in assembly.variants}
    return known.get(owner, owner)


def _best(table: Table, variants: list[Ranked]) -> Ranked:
    """The best value of a candidate's shapes, and how many tests choosing it amounts to."""
    best = min(range(len(variants)), key=lambda i: variants[i].rank)
    groups = [r.columns for r in variants]
    tests = effective_tests(table, groups, best, np.random.default_rng(0))
    return replace(variants[best], tests=tests * variants[best].tests)


def _labels(assembly: Assembly, standing: Standing) -> set[str]:
    """Real names of the candidates that are active."""
    return {v.original.label for v in assembly.variants if v.label in standing.labels}


def tested_keys(assembly: Assembly, variant: Variant) -> tuple[str, ...]:
    """Amplitudes of a variant, and of its companion."""
    owners = [variant.label] + ([variant.companion.label] if variant.companion else [])
    names = {p.name for p in variant.effect.amplitudes()}
    traced = assembly.study.compiled.traced
    return tuple(
        k
        for owner in owners
        for k, p in zip(traced.keys, traced.parameters, strict=True)
        if k.rsplit(".", 1)[0] == owner and p.name in names
    )


def bic(table: Table, scored: Score) -> float:
    """N log(1 - gain / rest) + q log N: twice the negative log-likelihood gain, plus its price."""
    left = max(1.0 - scored.gain / max(table.rest, 1e-300), 1e-12)
    return table.samples * float(np.log(left)) + scored.rank * float(np.log(table.samples))


# --- admitting -----------------------------------------------------------------------------------


@dataclass(frozen=True)
class Admitted:
    """A candidate admitted and refitted at one window length."""

    standing: Standing
    stage: Stage
    variant: Variant

    @property
    def held(self) -> tuple[str, ...]:
        """Its amplitudes that stay at zero, by their real names."""
        label, name = self.variant.label, self.variant.original.label
        own = [k.rsplit(".", 1) for k in self.standing.held]
        return tuple(f"{name}.{key}" for owner, key in own if owner == label)


def admit(assembly: Assembly, standing: Standing, stage: Stage, ranked: Ranked) -> Admitted:
    """Add a candidate, refit, and set its shapes free where that pays.

    Where the model is far off, an effect with bounds is started from afar as well (``afar``).
    """
    near = _near(assembly, standing, stage, ranked)
    found = [near, *_refits_from_afar(assembly, standing, stage, ranked.variant.original.label)]
    return min(found, key=lambda a: a.stage.fitted.cost)


def _near(assembly: Assembly, standing: Standing, stage: Stage, ranked: Ranked) -> Admitted:
    """A candidate refitted from zero amplitude."""
    variant = ranked.variant
    values = stepped(assembly, stage.fitted.point.values, variant, ranked.score.step)
    wider = replace(
        standing,
        labels=(*standing.labels, variant.label),
        values=values,
        held=(*standing.held, *ranked.held),
    )
    fitted = refit(assembly, wider, stage)
    wider = replace(wider, values=fitted.point.values)
    if variant.tuned and np.isfinite(fitted.cost):
        freer = replace(wider, freed=(*wider.freed, *variant.tuned))
        trial = refit(assembly, freer, Stage(stage.length, stage.layouts, fitted))
        if fitted.cost - trial.cost > _WORTH:
            fitted = trial
            wider = replace(freer, values=trial.point.values)
    return Admitted(wider, Stage(stage.length, stage.layouts, fitted), variant)


def afar(assembly: Assembly, standing: Standing, stage: Stage, label: str) -> list[Variant]:
    """Variants of an effect that may have a second basin: amplitudes bounded on both sides.

    What a rim lets over, or a limit cuts off, is unseen from zero amplitude. Only where the model
    is far off (chi2/dof of 2 and more): what it lacks there need not be small.
    """
    if stage.fitted.chi2_per_dof < _FAR_OFF:
        return []
    return [v for v in assembly.variants if v.original.label == label and two_sided(v.original)]


def two_sided(effect: Effect) -> bool:
    """Whether all amplitudes of an effect are bounded on both sides."""
    return all(p.lower is not None and p.upper for p in effect.amplitudes())


def _refits_from_afar(
    assembly: Assembly, standing: Standing, stage: Stage, label: str
) -> list[Admitted]:
    """Refits from a tenth of the bounds, from the shapes whose first step promises most."""
    study = assembly.study
    found: list[tuple[float, Standing, Variant]] = []
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
    assembly: Assembly, standing: Standing, effects: tuple[Effect, ...], progress: Progress
) -> Standing:
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


def refit(assembly: Assembly, standing: Standing, stage: Stage) -> Fitted:
    """Fit a standing on a stage's windows, started from that stage's states."""
    moving, bounds = columns(assembly, standing.keys(assembly))
    point = Point(standing.values, stage.fitted.point.starts)
    return fit(assembly.study, stage.layouts, point, moving, bounds)
