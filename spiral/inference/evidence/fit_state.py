"""State of a study's fit (active effects, values, freed shapes), and fits on growing windows."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from spiral.engine.growth import Stage, first_starts, grow_windows, layouts_for, lengths_for
from spiral.engine.likelihood.noise import NoiseModel
from spiral.engine.sensitivities import reduce_windows
from spiral.engine.start import SMOOTHING, first_values, has_balance, prepare_balance
from spiral.engine.study import Point
from spiral.engine.windows import block_length, fair_block, halves
from spiral.inference.evidence.assembly import (
    Assembly,
    active_keys,
    columns_with_bounds,
    initial_values,
    unknown_keys,
)
from spiral.physics.trace import trace
from spiral.types.effect import Effect
from spiral.types.parameter import Interpolation
from spiral.types.record import Array

Masks = tuple[Array | None, ...]


@dataclass(frozen=True)
class FitState:
    """State of a fit: what is active, and every value of it.

    Fields
    ------
    labels : compiled labels of the active effects.
    values : (records, parameters) of the compiled study.
    freed : shapes that are fitted as well.
    corrected : whether the phase corrections of the records are fitted as well.
    held : amplitudes of active effects that stay at zero, since they were not admitted themselves.
    shortest : the shortest windows of later fits, samples. Longer where an effect was found from
        afar, or has own states, which short windows would begin anew too often.
    free_from : the longest windows on which shapes were set free, samples.
    noise : what acts at random, where the evidence is a likelihood.
    substeps : integration steps per sample, where the evidence is a likelihood.
    starts : (states,) by record, its initial state as all of the record tells it.
    spreads : (states,) by record, standard deviation around it that the filter begins with (nan: as
        for any record).
    between : how inputs run between their samples, where the likelihood prefers another way than
        their system's.
    settle : seconds of each test record that fix its initial state, the same for all models.
    """

    labels: tuple[str, ...]
    values: Array
    freed: tuple[str, ...] = ()
    corrected: bool = True
    held: tuple[str, ...] = ()
    shortest: int = 0
    free_from: int = 0
    noise: NoiseModel | None = None
    substeps: int = 1
    starts: tuple[Array, ...] | None = None
    spreads: tuple[Array, ...] | None = None
    between: Mapping[str, Interpolation] = field(default_factory=dict)
    settle: float | None = None

    def keys(self, assembly: Assembly) -> tuple[str, ...]:
        """Full names of the parameters that a fit from this state moves."""
        active = active_keys(assembly, self.labels, self.freed, self.corrected)
        return tuple(k for k in active if k not in self.held)


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


def initial_fit_state(assembly: Assembly, labels: tuple[str, ...]) -> FitState:
    """The first fit state: unknown values from the balance of forces.

    Several smoothing windows are tried; the one whose shortest-window fit promises the smallest
    error after one step is kept. Where coordinates are hidden, effects begin at zero.
    """
    known = FitState(labels, initial_values(assembly))
    keys = known.keys(assembly)
    unknown = unknown_keys(assembly, keys)
    study, model = assembly.study, assembly.problem.model
    if not unknown:
        far = any(has_two_sided_bounds(e) for e in model.effects if e.label in labels)
        return replace(known, shortest=stage_lengths(assembly)[-1]) if far else known
    traced = trace(model.system, tuple(e for e in model.effects if e.label in labels))
    if not has_balance(traced) and not any(k.startswith("system.") for k in unknown):
        return known  # effects begin at zero
    equations = prepare_balance(study, traced, unknown)
    layouts = layouts_for(study, stage_lengths(assembly)[0], all_samples(assembly))
    moving, _ = columns_with_bounds(assembly, keys)
    best, lowest = known, np.inf
    shortest = min(s.samples for s in study.series)
    for window in (w for w in SMOOTHING if 4 * w <= shortest):
        values = first_values(study, equations, known.values, window)
        if not np.all(np.isfinite(values)):
            continue
        point = Point(values, first_starts(study, layouts, values, window))
        reduction = reduce_windows(study, layouts, point, moving)
        promised = float(reduction.triangle[-1, -1] ** 2) if reduction.finite else np.inf
        if promised < lowest:
            best, lowest = FitState(labels, values), promised
    return best


def fit_growing_windows(
    assembly: Assembly,
    fit_state: FitState,
    masks: Masks,
    lengths: list[int] | None = None,
    patient: bool = False,
) -> Iterator[Stage]:
    """Fit the model of a fit state on growing windows; ``patient`` as in ``grow_windows``.

    Where ``shortest`` is set or shapes are free, the windows' initial states are fitted first, with
    all parameters fixed: beside states read off noisy samples a gap may grow beyond the motion,
    where it acts nowhere and stays. So it may on short windows: freed shapes are fixed on windows
    shorter than those on which they were freed.
    """
    moving, bounds = columns_with_bounds(assembly, fit_state.keys(assembly))
    sizes = lengths or [n for n in stage_lengths(assembly) if n >= fit_state.shortest]
    first = fit_state.shortest or fit_state.freed
    alone = columns_with_bounds(assembly, ()) if first else None
    study, values = assembly.study, fit_state.values
    early = [n for n in sizes[:-1] if n < fit_state.free_from]
    stage: Stage | None = None
    if early:
        shapes = [i in {study.index(k) for k in fit_state.freed} for i in moving.index]
        at = moving.current(values)
        still = (np.where(shapes, at, bounds[0]), np.where(shapes, at, bounds[1]))
        for stage in grow_windows(study, values, moving, still, masks, early, patient, alone):
            yield stage
        if stage is None or not (stage.fitted.converged or patient):
            return
    late = sizes[len(early) :]
    yield from grow_windows(study, values, moving, bounds, masks, late, patient, alone, stage)


def has_two_sided_bounds(effect: Effect) -> bool:
    """Whether all amplitudes of an effect are bounded on both sides."""
    return all(p.lower is not None and p.upper for p in effect.amplitudes())
