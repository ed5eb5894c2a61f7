"""Effects with states of their own, proposed from the spectrum of the missing force.

A resonance or a lag has a frequency that means nothing while its amplitude is zero, and a blind
grid would need hundreds of values. What it exerts per unit amplitude along a given motion is known,
though: its own states z' = g(z, q, q', p) are driven by the motion of its port, and its force is
linear in its amplitudes. So the missing force F(t) (``spiral.latent``) is resolved, frequency by
frequency, into what such an effect with that frequency would exert:

    share(f) = |P_f r|^2 / |F|^2,    r = F less what the model's own parameters can take over,

P_f the projection onto the effect's columns at f (amplitudes within their bounds). For a resonance
this is the periodogram of the missing force through a resonator at f; for a lag f is its corner,
1 / (2 pi T). The largest peaks, refined, are the values that the candidate is then scored at by its
trajectories; as many tests as resonators fit into the band are paid for.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from spiral.assembly import Assembly, Variant, to_model
from spiral.compile import Compiled, compile_model
from spiral.effect import Effect, SensorEffect
from spiral.evidence import Admitted, Masks, Standing, grown, stage_lengths
from spiral.holding import carried, held_variants, reassembled, variant_of
from spiral.judge import held_out
from spiral.latent import LatentForce, MissingForce, missing_force
from spiral.model import Model
from spiral.parameter import Parameter
from spiral.problem import Progress
from spiral.record import Array
from spiral.shooting.elimination import triangle_of
from spiral.shooting.kernel import slopes_along
from spiral.shooting.sensitivities import driven, residuals
from spiral.shooting.series import Series, splines
from spiral.shooting.study import Study
from spiral.statistics import paired_errors, whiteness
from spiral.suggest import Proposal, propose
from spiral.trace import trace

_MOST_OF_IT = 0.7  # share of the rest beyond noise from which an effect without memory explains it
VALUES = 3  # peaks whose frequencies are tried
_STEP = 1.1  # ratio of neighbouring frequencies of the spectrum
_FINE = np.linspace(-0.9, 0.9, 13)  # refinement of a peak, in steps
_LOWEST, _HIGHEST = 4.0, 0.1  # band: periods in the record; share of the sample rate
_MOST = 8192  # samples that the force is compared at
_SETTLING = 0.05  # share of the record in which the driven states forget how they began
_TAKEN = 1e-3  # of a column's size, under which the model's parameters have all of it


def remembered(
    assembly: Assembly,
    standing: Standing,
    proposal: Proposal,
    white: bool,
    masks: tuple[Masks, Masks],
    round_number: int,
    progress: Progress,
) -> Proposal:
    """A round's proposal, with candidates that have states of their own where it calls for them.

    It is in terms of the study ``wide`` if one of them is admitted, else the proposal as it was.
    """
    waiting = called_for(assembly, standing, proposal, white)
    if not waiting:
        return proposal
    progress("resolving the missing force into resonances and lags")
    assert proposal.evidence is not None
    values = proposal.evidence.stage.fitted.point.values
    wide, _ = widened(assembly, replace(standing, values=values), waiting)
    found = propose(wide, carried(standing, assembly, wide), masks, round_number, progress)
    if found.admitted is None or not found.admitted.variant.original.states:
        return proposal
    progress(f"following {found.admitted.variant.original.label} over the whole records")
    if not _outlasts(assembly, standing, proposal, wide, found, masks):
        return proposal
    return replace(found, wide=wide)


def _outlasts(
    assembly: Assembly,
    standing: Standing,
    proposal: Proposal,
    wide: Assembly,
    found: Proposal,
    masks: tuple[Masks, Masks],
) -> bool:
    """Whether an effect with own states still predicts best where no window ends.

    States of its own begin anew in each window, at values of the fit's choice. On windows shorter
    than its memory they imitate whatever is missing there, one sinusoid to a window; over whole
    records its motion has to follow from itself. It is compared there on held-out blocks with what
    an effect without memory makes of them (or the model as it was).
    """
    assert found.admitted is not None
    assert found.evidence is not None
    plain = standing if proposal.admitted is None else proposal.admitted.standing
    base = _over_whole(assembly, plain, masks, found.admitted.stage.length)
    late = _over_whole(wide, found.admitted.standing, masks, found.admitted.stage.length)
    paired = paired_errors(base, late, found.evidence.block)
    return paired.p_fall < assembly.problem.settings.level


def _over_whole(
    assembly: Assembly, standing: Standing, masks: tuple[Masks, Masks], length: int
) -> tuple[Array, ...]:
    """Held-out residuals on the longest windows, after a refit that grows from this length."""
    lengths = [n for n in stage_lengths(assembly) if n >= length]
    *_, last = grown(assembly, standing, masks[0], lengths, patient=True)
    return held_out(assembly, standing.labels, last, masks[1])[1]


def called_for(
    assembly: Assembly, standing: Standing, proposal: Proposal, white: bool
) -> tuple[Effect, ...]:
    """Candidates with states of their own that a round tries; none while others explain the rest.

    They are tried where no other candidate passes and what is left is not white, and where the one
    that passes leaves more than three tenths of what is left beyond the noise, or is a sensor's (a
    reading that comes late and a force that comes late look much the same) and leaves no white
    noise after its refit.
    """
    present = {label.split("#")[0] for label in standing.labels}
    waiting = tuple(e for e in assembly.later if e.label not in present)
    if proposal.evidence is None or not waiting:
        return ()
    if proposal.admitted is None:
        return () if white else waiting
    label, table = proposal.admitted.variant.label, proposal.evidence.table
    lead = next(r for r in proposal.evidence.ranked if r.variant.label == label)
    if isinstance(lead.variant.original, SensorEffect):
        return () if _leaves_noise(assembly, proposal.admitted) else waiting
    return waiting if lead.score.gain < _MOST_OF_IT * (table.rest - table.dof) else ()


def _leaves_noise(assembly: Assembly, admitted: Admitted) -> bool:
    """Whether the refit of an admission leaves white noise on the samples that selected it."""
    settings = assembly.problem.settings
    stage = admitted.stage
    left = residuals(assembly.study, stage.layouts, stage.fitted.point)
    return whiteness(left, settings.lags).p >= settings.whiteness_level


@dataclass(frozen=True)
class Scanned:
    """The spectrum of a missing force as one effect resolves it: Hz, and the shares explained."""

    effect: Effect
    frequency: Array
    share: Array
    variants: tuple[Variant, ...]


def widened(
    assembly: Assembly, standing: Standing, effects: Sequence[Effect]
) -> tuple[Assembly, tuple[Scanned, ...]]:
    """The study with variants of effects that have states of their own, beside its candidates."""
    scans = scanned(assembly, standing, effects)
    more = tuple(v for s in scans for v in s.variants)
    own = held_variants(assembly, standing.labels)
    candidates = tuple(dict.fromkeys((*assembly.problem.candidates, *effects)))
    return reassembled(assembly, candidates, (*own, *more)), scans


def scanned(
    assembly: Assembly, standing: Standing, effects: Sequence[Effect]
) -> tuple[Scanned, ...]:
    """Lay the shapes of effects at the peaks of the missing force of the longest record."""
    study = assembly.study
    number = int(np.argmax([s.samples for s in study.series]))
    row = standing.values[number : number + 1]
    model = to_model(assembly, standing.labels, row, {}, standing.freed, standing.held)
    series, grid = study.series[number], study.inputs(number, standing.values[number])
    missing = None
    if np.isfinite(row).all():
        missing = missing_force(model, series.record, grid, series.substeps)
    band = frequencies(series)
    if missing is None:
        return tuple(_spread(e, band) for e in effects)
    return tuple(_scan(_Scan.of(model, e, series, grid, missing), band) for e in effects)


def frequencies(series: Series) -> Array:
    """Frequencies of the spectrum, Hz: from four periods in the record to a tenth of its rate."""
    low, high = _LOWEST / (series.samples * series.dt), _HIGHEST / series.dt
    count = max(int(np.ceil(np.log(high / low) / np.log(_STEP))), 1) + 1
    return np.geomspace(low, high, count)


def _spread(effect: Effect, band: Array) -> Scanned:
    """Frequencies evenly over the band (logarithms), where no missing force is known."""
    at = band[np.linspace(0, len(band) - 1, 2 * VALUES + 1).astype(int)[1::2]]
    usual = {p.name: _others(p)[len(_others(p)) // 2] for p in _shapes(effect) if not p.spectrum}
    chosen = [{**usual, **_spectral(effect, f)} for f in at]
    variants = tuple(variant_of(effect, str(i + 1), c) for i, c in enumerate(chosen))
    return Scanned(effect, band, np.zeros(len(band)), variants)


def _shapes(effect: Effect) -> list[Parameter]:
    return [p for p in effect.parameters if p.role == "shape"]


def _others(parameter: Parameter) -> tuple[float, ...]:
    return parameter.grid or (parameter.start or 1.0,)


def _spectral(effect: Effect, frequency: float) -> dict[str, float]:
    """The shapes that a frequency stands for: itself in Hz, 1 / (2 pi f) in s."""
    late = float(1.0 / (2 * np.pi * frequency))
    hertz = float(frequency)
    return {p.name: late if p.unit == "s" else hertz for p in _shapes(effect) if p.spectrum}


# --- columns along the missing force's motion ----------------------------------------------------


@dataclass(frozen=True)
class _Scan:
    """One effect's copies compiled beside a model, on the motion that belongs to a missing force.

    ``target`` (rows,) accelerations by the missing force less what the model takes over; ``taken``
    (rows, k) an orthonormal basis of the latter; ``energy`` that of all of it.
    """

    effect: Effect
    copies: tuple[Effect, ...]
    compiled: Compiled
    series: Series
    states: Array
    values: Array
    samples: Array
    target: Array
    taken: Array
    energy: float

    @classmethod
    def of(
        cls, model: Model, effect: Effect, series: Series, grid: Array, missing: MissingForce
    ) -> _Scan:
        """Compile, and put the missing force in terms of accelerations."""
        copies = tuple(replace(effect, variant=str(i + 1)) for i in range(VALUES))
        compiled = compile_model(trace(model.system, (*model.effects, *copies)))
        traced, substeps = compiled.traced, series.substeps
        cut = grid[2 * substeps * missing.start : 2 * substeps * (missing.stop - 1) + 1]
        still = splines(series.record, 1, 0.0)  # the inputs hold the phase correction
        bare = replace(series, inputs=np.ascontiguousarray(cut), splines=still)
        states = np.zeros((len(missing.force), len(traced.states)))
        for j, name in enumerate(missing.task.states):
            states[:, traced.states.index(name)] = missing.states[:, j]
        starts = {k: p.start or 0.0 for k, p in zip(traced.keys, traced.parameters, strict=True)}
        values = np.array([float(model.values.get(k, starts[k])) for k in traced.keys])
        first = int(_SETTLING * len(states))
        samples = np.arange(first, len(states), -(-len(states) // _MOST))
        target = _accelerations(model, missing, samples)
        active = [k for k in model.active if k in traced.keys]
        found = cls(effect, copies, compiled, bare, states, values, samples, target,
                    np.zeros((len(target), 0)), float(target @ target))  # fmt: skip
        taken = _basis(found.columns(states, values, active))
        return replace(found, taken=taken, target=target - taken @ (taken.T @ target))

    def columns(self, states: Array, values: Array, keys: Sequence[str]) -> Array:
        """(rows, keys) accelerations per unit of each parameter along the motion."""
        traced = self.compiled.traced
        at = np.array([traced.keys.index(k) for k in keys], dtype=np.int64)
        rows = _velocity_rows(traced.states)
        out = np.empty((len(self.samples), len(rows), len(at)))
        slopes_along(
            self.compiled.rate, np.ascontiguousarray(states), self.samples, values,
            self.series.inputs, 2 * self.series.substeps, rows, at, out,
        )  # fmt: skip
        return out.reshape(-1, len(at))

    def shares(self, trials: Sequence[Mapping[str, float]]) -> Array:
        """Share of the missing force that each trial (shapes by name) explains."""
        found = []
        for first in range(0, len(trials), VALUES):
            batch = trials[first : first + VALUES]
            values = self.values.copy()
            keys = self.compiled.traced.keys
            for number, copy in enumerate(self.copies):
                for name, value in batch[min(number, len(batch) - 1)].items():
                    values[keys.index(f"{copy.label}.{name}")] = value
            study = Study(self.compiled, (self.series,))
            states = driven(study, 0, self.states.copy(), values)
            found += [self._share(c, states, values) for c in self.copies[: len(batch)]]
        return np.array(found)

    def _share(self, copy: Effect, states: Array, values: Array) -> float:
        traced, names = self.compiled.traced, {p.name for p in copy.amplitudes()}
        bounds = {
            k: -np.inf if p.lower is None else p.lower
            for k, p in zip(traced.keys, traced.parameters, strict=True)
            if k.rsplit(".", 1)[0] == copy.label and p.name in names
        }
        columns = self.columns(states, values, list(bounds))
        if not np.isfinite(columns).all():
            return 0.0
        left = columns - self.taken @ (self.taken.T @ columns)
        size = np.linalg.norm(left, axis=0)
        seen = size > _TAKEN * np.linalg.norm(columns, axis=0)
        if not seen.any():
            return 0.0
        lower = np.array([*bounds.values()])[seen]
        return _explained(left[:, seen] / size[seen], self.target, lower) / max(self.energy, 1e-300)


def _explained(columns: Array, target: Array, lower: Array) -> float:
    """Fall of the sum of squares by least squares with lower bounds."""
    from scipy.optimize import lsq_linear

    triangle = triangle_of(np.column_stack([columns, target]))
    given, wanted = triangle[:, :-1], triangle[:, -1]
    step = lsq_linear(given, wanted, (lower, np.full(len(lower), np.inf))).x
    return max(float(wanted @ wanted - np.sum((wanted - given @ step) ** 2)), 0.0)


def _velocity_rows(states: tuple[str, ...]) -> Array:
    return np.array([states.index(f"{n}_rate") for n in states if f"{n}_rate" in states])


def _accelerations(model: Model, missing: MissingForce, samples: Array) -> Array:
    """(samples * coordinates,) accelerations by the missing force."""
    task = missing.task
    label = LatentForce().label
    latent = [i for i, k in enumerate(task.keys) if k.rsplit(".", 1)[0] == label]
    at = np.array(latent, dtype=np.int64)
    rows = _velocity_rows(task.states)
    out = np.empty((len(samples), len(rows), len(at)))
    slopes_along(
        task.compiled.rate, np.ascontiguousarray(missing.states), samples,
        np.ascontiguousarray(task.values), np.ascontiguousarray(task.inputs),
        2 * task.series.substeps, rows, at, out,
    )  # fmt: skip
    return np.einsum("kra,ka->kr", out, missing.force[samples]).ravel()


def _basis(columns: Array) -> Array:
    """Orthonormal basis of the columns' span."""
    size = np.linalg.norm(columns, axis=0)
    if not np.any(size > 0):
        return np.zeros((len(columns), 0))
    left, values, _ = np.linalg.svd(columns[:, size > 0] / size[size > 0], full_matrices=False)
    return left[:, values > 1e-10 * values[0]]


def _scan(scan: _Scan, band: Array) -> Scanned:
    """The spectrum, and variants at its refined peaks."""
    effect = scan.effect
    names = [p.name for p in _shapes(effect) if not p.spectrum]
    others = [
        dict(zip(names, values, strict=True))
        for values in itertools.product(*(_others(p) for p in _shapes(effect) if not p.spectrum))
    ]
    grid = [[{**o, **_spectral(effect, f)} for o in others] for f in band]
    flat = scan.shares([t for row in grid for t in row])
    share = flat.reshape(len(band), len(others)).max(axis=1)
    chosen = []
    for peak in peaks(share)[:VALUES]:
        trials = [{**o, **_spectral(effect, band[peak] * _STEP**d)} for d in _FINE for o in others]
        chosen.append(trials[int(np.argmax(scan.shares(trials)))])
    searched = max(len(band) // len(chosen), 1)
    variants = tuple(variant_of(effect, str(i + 1), c, searched) for i, c in enumerate(chosen))
    return Scanned(effect, band, share, variants)


def peaks(share: Array) -> list[int]:
    """Positions of the local maxima, the largest first; the ends count."""
    padded = np.concatenate([[-np.inf], share, [-np.inf]])
    at = np.flatnonzero((padded[1:-1] > padded[:-2]) & (padded[1:-1] >= padded[2:]))
    return [int(i) for i in at[np.argsort(-share[at], kind="stable")]]
