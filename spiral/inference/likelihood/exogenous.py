"""Whether what acts at random is random: it is independent of the inputs, or it is no chance.

A force that nobody knows may follow anything but what the inputs do to the machine. Let f be the
force that the whole record tells (``engine.likelihood.disturbances``) and s the inputs and the
states of a free run, which is a function of the inputs alone. On one half of the record (every
other of ``_BLOCKS`` stretches) f is regressed on a curve over one s some time before,

    f(t) = b_0 + sum_k b_k g_k(s(t - lag)),

for each s and lag, and once more on s itself at whichever lag up to a tenth of the record explains
most there (an *echo*: a cut that meets the chip of the turn before, a loop with dead time); the one
that explains most there is judged by the share of f that it explains
on the other half, and the halves change places. Where f is random the same figure comes out of f
shifted in time against s, whatever the spectra of both are (a circular shift; the surrogate of
Andrzejak and others 2003, Phys. Rev. E 68): f is no chance where no shift by a tenth of the record
or more does half as well, and more than a quarter of it is explained. Of what changes slowly few
shifts are independent, and one of ten does best by chance once in ten times.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from spiral.engine.filter.noise import noise_groups
from spiral.engine.filter.task import FilterInput, run_from
from spiral.engine.likelihood.disturbances import smoothed_forces
from spiral.engine.likelihood.noise import NoiseModel
from spiral.engine.series import sample_inputs
from spiral.inference.disturbances import what_acts
from spiral.inference.likelihood.fitting import LikelihoodFit
from spiral.types.formatting import duration, percent
from spiral.types.noise import FORCES
from spiral.types.placement import TIME
from spiral.types.record import Array

_BLOCKS = 8
_LAGS = (0.0, 0.5, 1.0, 2.0, 4.0)  # of the time in which s changes by its deviation
_FURTHEST = 4.0  # deviations, up to which curves go on
_SHARP, _CORNERS = 3.0, (-1.0, -0.5, 0.0, 0.5, 1.0)  # of rounded steps, tanh(3 (s - corner))
_LEAST = 1e-3  # of a state's own rate, from which a force acts on it
_SHARE = 0.25  # of the force's mean square
_LEAD = 2.0  # times what any other shift explains
_NEAR = 0.1  # share of the record by which a shifted force is another one
_MOST = 16_384  # samples that are asked
_ROOM = 2e7  # numbers that transitions of all samples may hold


Correlation = Callable[[Array, Array], Array]
"""(2, columns, shifts) sums on each half of columns (samples, columns) times values (samples,)."""


@dataclass(frozen=True)
class _Curve:
    """What a curve over ``source``, ``lag`` samples before, is made of: (samples, terms).

    ``squares`` (2, terms, terms) are the sums of their products on each half of the record.
    """

    source: str
    lag: int
    values: Array
    squares: Array
    inverses: Array


@dataclass(frozen=True)
class FollowedForce:
    """A force that follows ``source`` of ``lag`` s before, which explains ``share`` of it."""

    state: str
    source: str
    lag: float
    share: float


def followed_force(fit: LikelihoodFit) -> FollowedForce | None:
    """The random force that is explained best by what the inputs do; nothing where all are chance.

    The longest record is asked.
    """
    from scipy.fft import prev_fast_len

    task, settings = max(fit.estimate.prepared, key=lambda pair: pair[0].series.samples)
    size = len(task.states) + 1
    if task.series.samples * size**2 > _ROOM:
        return None
    forces = smoothed_forces(task, settings, fit.estimate.noise)
    sources = None if forces is None else _exogenous_motion(task)
    if forces is None or sources is None:
        return None
    most = slice(0, prev_fast_len(min(len(forces), _MOST), real=True))
    moving = {name: s[most] for name, s in sources.items()}
    curves = [curve for name, s in moving.items() for curve in _delayed_curves(name, s)]
    acted_on = _acted_on(task, fit.estimate.noise)
    pushed = [i for i in acted_on if forces[:, i].std() > 0] if curves else []
    tested = (_explained(task.states[i], forces[most, i], curves, moving) for i in pushed)
    found = max((t for t in tested if t is not None), key=lambda t: t.share, default=None)
    return found and replace(found, lag=found.lag * task.series.dt)


def _acted_on(task: FilterInput, noise: NoiseModel) -> list[int]:
    """States on which a random force of some size acts, by place.

    What the record tells of one that is next to nothing is the slope of its likelihood: a value
    that is held a little off shows in it.
    """
    groups = noise_groups(task)
    acting = (t for t in noise.terms if t.kind in FORCES and noise.values[t.size] > _LEAST)
    places = (groups.get(t.where) or (task.states.index(t.where),) for t in acting)
    return sorted({i for some in places for i in some})


def followed_force_sentences(fit: LikelihoodFit) -> tuple[str, ...]:
    """That a force beside the model is not random, and what it follows; empty where it may be."""
    followed = followed_force(fit)
    if followed is None:
        return ()
    acting = what_acts(fit.estimate.prepared[0][0].model)
    before = f" of {duration(followed.lag)} before" if followed.lag else ""
    return (
        f"the random {acting} on {followed.state.removesuffix('_rate')} is no chance: "
        f"{percent(followed.share)} of its mean square follows {followed.source}{before}",
    )


def _exogenous_motion(task: FilterInput) -> dict[str, Array] | None:
    """Inputs, and states of a free run, by name; nothing where it runs away."""
    states = run_from(task, task.start)
    if states is None:
        return None
    inputs = sample_inputs(task.inputs, task.series.substeps)
    names = task.compiled.traced.inputs
    told = {n: u for n, u in zip(names, inputs.T, strict=True) if n != TIME}
    return told | dict(zip(task.states, states.T, strict=True))


def _delayed_curves(source: str, s: Array) -> Iterator[_Curve]:
    """Curves over s at some lags, none of what does not move."""
    spread = s.std()
    if not (np.isfinite(spread) and spread > 0):
        return
    z = np.clip((s - s.mean()) / spread, -_FURTHEST, _FURTHEST)
    time = 1 / max(float(np.gradient(z).std()), 1 / len(z))
    lags = dict.fromkeys(round(share * time) for share in _LAGS)
    for lag in (k for k in lags if k <= _NEAR * len(z)):
        past = np.concatenate([np.full(lag, z[0]), z[: len(z) - lag]])
        steps = (np.tanh(_SHARP * (past - corner)) for corner in _CORNERS)
        values = np.column_stack([np.ones(len(past)), past, past**2, *steps])
        squares = _multiply_by_halves(values, values)
        yield _Curve(source, lag, values, squares, np.linalg.pinv(squares))


def _explained(
    state: str, force: Array, curves: Sequence[_Curve], echoing: Mapping[str, Array]
) -> FollowedForce | None:
    """What a force follows, and by how many samples, where that is no chance.

    What is explained without a shift is asked first: where that is too little, no shift is.
    """
    f, count = force - force.mean(), len(force)
    reach, halves = round(_NEAR * count), _halves(count)
    energy = np.maximum(_correlate(halves, f**2), np.finfo(float).tiny)
    echoes = [_regress_echo(s, f, halves, energy, reach) for s in echoing.values()]

    def shares_of_all(correlate: Correlation, energy: Array) -> Array:
        shares = [_regress_curve(c, correlate(c.values, f), energy) for c in curves]
        return np.array([*shares, *(s[..., : energy.shape[1]] for s, _ in echoes)])

    unshifted = shares_of_all(_multiply_by_halves, energy[:, :1])
    if _confirmed_shares(unshifted)[0] < _SHARE:
        return None
    told = [(c.source, c.lag) for c in curves]
    told += [(name, lag) for name, (_, lag) in zip(echoing, echoes, strict=True)]
    source, lag = told[int(np.argmax(unshifted[:, :, 1, 0].sum(axis=1)))]
    share = _confirmed_shares(shares_of_all(_correlate_by_halves, energy))
    far = np.arange(reach, count - 2 * reach)  # no lag of an echo comes near to none there
    if not share[0] > _LEAD * share[far].max(initial=0.0):
        return None
    return FollowedForce(state, source, lag, float(share[0]))


def _confirmed_shares(fits: Array) -> Array:
    """(shifts,) what the curve that explains most on one half explains on the other, on the mean.

    ``fits`` : (curves, halves, inside and outside, shifts).
    """
    at = np.arange(fits.shape[-1])
    return np.mean([o[np.argmax(i, axis=0), at] for i, o in fits.transpose(1, 2, 0, 3)], axis=0)


def _regress_echo(
    s: Array, force: Array, halves: Array, energy: Array, reach: int
) -> tuple[Array, int]:
    """As ``_regress_shifted`` for s alone, so many samples before as explain most on each half.

    At a shift m these are m to m + ``reach``. The lag is that of the whole record, without shift.
    """
    z = s - s.mean()
    parts = halves * z[:, None]
    seen, squares = _correlate(parts, force), np.sum(parts**2, axis=0)
    squares = np.maximum(squares, np.finfo(float).tiny)
    told = seen**2 / squares[:, None] / energy
    shares = []
    for here, there in ((0, 1), (1, 0)):
        at = _largest_within(told[here], reach)
        b = seen[here, at] / squares[here]
        left = (2 * b * seen[there, at] - b**2 * squares[there]) / energy[there, at]
        shares.append((told[here, at], left))
    whole = np.abs(seen.sum(axis=0))[:reach]
    return np.array(shares), int(np.argmax(whole)) if len(whole) else 0


def _largest_within(values: Array, width: int) -> Array:
    """Where the largest of the next ``width`` values lies, from each place, around the end."""
    at, span = np.arange(len(values)), 1

    def better(first: Array, second: Array) -> Array:
        return np.where(values[second] > values[first], second, first)

    while 2 * span <= width:
        at, span = better(at, np.roll(at, -span)), 2 * span
    return better(at, np.roll(at, span - max(width, span)))


def _regress_curve(curve: _Curve, seen: Array, energy: Array) -> Array:
    """(2, 2, shifts) shares of a force, shifted around the end, that a curve explains.

    Fitted on either half, of the force there and on the other half; ``seen`` (2, terms, shifts) are
    the curve's sums with the force on each half, ``energy`` (2, shifts) is the force's.
    """
    shares = []
    for here, there in ((0, 1), (1, 0)):
        b = curve.inverses[here] @ seen[here]
        inside = np.sum(b * seen[here], axis=0) / energy[here]
        left = 2 * np.sum(b * seen[there], axis=0)
        left -= np.sum(b * (curve.squares[there] @ b), axis=0)
        shares.append((inside, left / energy[there]))
    return np.array(shares)


def _halves(count: int) -> Array:
    """(samples, 2) whether each sample is in a half of the record: every other stretch."""
    block = np.arange(count) * _BLOCKS // count
    return np.column_stack([block % 2 == half for half in (0, 1)]).astype(float)


def _multiply_by_halves(columns: Array, values: Array) -> Array:
    """(2, columns, ...) sums over t of column(t) value(t), on each half."""
    edges = -(-np.arange(_BLOCKS + 1) * len(values) // _BLOCKS)  # of the stretches of _halves
    sums = [columns[a:b].T @ values[a:b] for a, b in pairwise(edges)]
    return np.array([sum(sums[half::2]) for half in (0, 1)]).reshape(2, columns.shape[1], -1)


def _correlate_by_halves(columns: Array, values: Array) -> Array:
    """(2, columns, shifts) sums of the columns on each half with values, shifted around the end."""
    halves = _halves(len(values)).T
    return np.array([_correlate(columns * half[:, None], values) for half in halves])


def _correlate(columns: Array, values: Array) -> Array:
    """(columns, shifts) sum over t of column(t) value(t + shift), around the end.

    All shifts at once, by the fast Fourier transform.
    """
    spectrum = np.conj(np.fft.rfft(columns, axis=0)) * np.fft.rfft(values)[:, None]
    return np.fft.irfft(spectrum, len(values), axis=0).T
