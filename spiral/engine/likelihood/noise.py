"""The noise model: random forces and sensor noise as terms with sizes, and as filter matrices.

Each term is a Gaussian process of its own, white or a state of the noise z (``kernel``):

    white     v_j ~ N(0, a^2)                        measurement noise of channel j
    coloured  z' = -z / T + w,  std a                measurement noise with correlation time T
    band      B_n(d/dt / w0) z = w                   noise behind a low-pass of corner w0 / 2 pi
    vibration z'' = -2 d w0 z' - w0^2 z + w          a sensor's mount that rings at w0 / 2 pi
    drift     z' = w,  a per s^(1/2)                 a sensor's zero that wanders
    force     white acceleration                     level as ``spiral.engine.filter.noise`` says
    gust      (T/c d/dt + 1)^n z = w,  std a        acceleration with correlation time T
    swell     P_n(d/dt / w0) z = w                   acceleration of std a around w0 / 2 pi

A reading that is no state (an acceleration) has what forces add to the rates that it is made of,
at once; a white force is then a value that is held for a sample.

B_n is the Butterworth polynomial of the term's order n (2: s^2 + 2^(1/2) s + 1), as an anti-alias
filter has it; P_n that of a Butterworth band-pass of n poles, 2 d w0 wide (2: s^2 + 2 d s + 1), of
which the n/2-th derivative of z acts. A gust of order 1 jumps from sample to sample, one of order 2
is smooth (Matern's 3/2), of order n what has come through n things that fill or move; with
c = 4^(n-1) / C(2n-2, n-1), 1 and 2 for these, T is the integral of its autocorrelation. Sizes are
what a likelihood decides (``fit``), on a logarithmic scale. A gust's a and a swell's are shares of
the standard deviation of the rate that they act on.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from math import comb

import numpy as np

from spiral.engine.filter.extended import FilterSettings, block_diagonal
from spiral.engine.filter.noise import (
    driven_states,
    noise_groups,
    noise_intensity,
    sampled_covariance,
)
from spiral.engine.filter.task import FilterInput
from spiral.types.noise import COLOURED, CORRELATED, FORCES, Kind
from spiral.types.record import Array

EXTRA: tuple[Kind, ...] = (*COLOURED, "drift", *CORRELATED)
"""Kinds beyond white noise and a white force."""

_LEAST, _MOST = 1e-6, 10.0  # sizes over the deviation of their channel, or as a level
LEAST_FORCE = 1e-5  # least level of a force
OWN = 1.0  # its largest: beside a random force above the machine's own no term can be identified
_UNSEEN = 10.0  # the same where nothing else moves the machine (a store alone: the root of two)
_SHORTEST, _LONGEST = 0.3, 0.3  # correlation time: samples; share of the record
STEEPEST = 8
"""Highest order of the low-pass of a ``band``, and most poles of a ``swell``."""
SMOOTHEST = 4
"""Highest order of a ``gust``."""
_RINGING, _DEAD = 0.005, 0.2  # damping ratio of a vibration: beyond it is noise behind a low-pass
_BROAD = 1.0  # largest damping ratio of a swell: its band is then as wide as its frequency


@dataclass(frozen=True)
class NoiseTerm:
    """One random force or sensor noise; ``where`` is a channel, or a group of states, or one state.

    ``order`` is that of the low-pass of a ``band`` or ``gust``, and the poles of the band-pass of a
    ``swell``; left out, the lowest of its kind.
    """

    kind: Kind
    where: str
    order: int = 0

    def __post_init__(self) -> None:
        if not self.order:
            object.__setattr__(self, "order", 1 if self.kind == "gust" else 2)

    @property
    def size(self) -> str:
        """Name of its size."""
        return f"{self.kind}.{self.where}"

    @property
    def time(self) -> str:
        """Name of its correlation time (or corner's 1 / w0), which all of a kind share."""
        return f"{self.kind}.time" if self.kind in (*COLOURED, *CORRELATED) else ""

    @property
    def damping(self) -> str:
        """Name of the damping ratio d of a vibration or a swell."""
        return f"{self.kind}.damping" if self.kind in ("vibration", "swell") else ""

    @property
    def states(self) -> int:
        """Number of filter states that it adds for one channel or rate."""
        shaped = dict.fromkeys(("band", "swell", "gust"), self.order) | {"vibration": 2}
        return {"white": 0, "force": 0, **shaped}.get(self.kind, 1)


@dataclass(frozen=True)
class NoiseModel:
    """Terms with their sizes and times by name."""

    terms: tuple[NoiseTerm, ...]
    values: Mapping[str, float]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the sizes, times and damping ratios, each once."""
        all_names = (n for t in self.terms for n in (t.size, t.time, t.damping) if n)
        return tuple(dict.fromkeys(all_names))

    def has_kind(self, kind: Kind) -> bool:
        """Whether there is a term of this kind."""
        return any(t.kind == kind for t in self.terms)

    def with_values(self, values: Mapping[str, float]) -> NoiseModel:
        """The same terms with other sizes."""
        return replace(self, values={**self.values, **values})

    def with_terms(self, terms: tuple[NoiseTerm, ...], values: Mapping[str, float]) -> NoiseModel:
        """With further terms."""
        return NoiseModel((*self.terms, *terms), {**self.values, **values})

    def without(self, *kinds: Kind) -> NoiseModel:
        """Without the terms of these kinds."""
        return self.select_terms(t for t in self.terms if t.kind not in kinds)

    def replace_with_white(self, *kinds: Kind) -> NoiseModel:
        """Without the terms of these kinds, white ones in their place: (a_white^2 + a^2)^(1/2).

        White noise that had vanished beside them would not come back: on the logarithmic scale of
        sizes it has no slope.
        """
        less = self.without(*kinds)
        sizes = dict(less.values)
        for term in (t for t in self.terms if t.kind in kinds and t.kind != "drift"):
            white = f"{'force' if term.kind in CORRELATED else 'white'}.{term.where}"
            if white in sizes:
                sizes[white] = float(np.hypot(sizes[white], self.values[term.size]))
        return less.with_values(sizes)

    def select_terms(self, terms: Iterable[NoiseTerm]) -> NoiseModel:
        """Some of its terms alone."""
        kept = tuple(terms)
        names = NoiseModel(kept, {}).names
        return NoiseModel(kept, {k: v for k, v in self.values.items() if k in names})


def first_noise(task: FilterInput, level: float, sizes: Array | None = None) -> NoiseModel:
    """White noise of every channel and a white force on every group of states.

    Parameters
    ----------
    level : of the forces. sizes : (channels,) of the white noise; left out, the record's own.
    """
    channels = task.compiled.traced.channels
    white = task.series.sigma if sizes is None else sizes
    terms = (
        *(NoiseTerm("white", c) for c in channels),
        *(NoiseTerm("force", g) for g in noise_groups(task)),
    )
    values = {f"white.{c}": float(s) for c, s in zip(channels, white, strict=True)}
    return NoiseModel(terms, values | {f"force.{g}": level for g in noise_groups(task)})


def size_limits(task: FilterInput, name: str) -> tuple[float, float]:
    """Smallest and largest value that a size or time may take."""
    kind, _, where = name.partition(".")
    if where == "time":
        return _SHORTEST * task.series.dt, _LONGEST * task.series.dt * task.series.samples
    if where == "damping":
        return _RINGING, _DEAD if kind == "vibration" else _BROAD
    if kind in FORCES:
        return LEAST_FORCE, _UNSEEN if task.is_driven_unseen else OWN
    channels = task.compiled.traced.channels
    spread = float(task.series.deviations[channels.index(where)]) or 1.0
    if kind == "drift":
        length = np.sqrt(task.series.dt * task.series.samples)
        return _LEAST * spread / length, _MOST * spread / length
    return _LEAST * spread, _MOST * spread


def drop_inapplicable_forces(task: FilterInput, noise: NoiseModel) -> NoiseModel:
    """The noise without forces on states that a model does not have.

    An effect that is dropped from the model takes its own states with it.
    """
    return noise.select_terms(
        t for t in noise.terms if t.kind not in FORCES or driven_states(task, t.where)
    )


def hold_idle_sizes(
    task: FilterInput, noise: NoiseModel, others: Sequence[NoiseModel]
) -> list[NoiseModel]:
    """Other values of a noise model, without those of terms that do nothing in this record.

    Sizes are small beside the readings of a record, and one that is the least where readings are
    large acts where they are small. A term that is varied must have the states that it has.
    """
    idle = {t.size: noise.values[t.size] for t in noise.terms if _is_idle(task, t, noise.values)}
    return [other.with_values(idle) for other in others] if idle else [*others]


def _is_idle(task: FilterInput, term: NoiseTerm, values: Mapping[str, float]) -> bool:
    """Whether a term has the least size, at which it does nothing."""
    return values[term.size] <= size_limits(task, term.size)[0]


@dataclass(frozen=True)
class NoiseMatrices:
    """Noise of one record for ``kernel.predict_record``; ``p`` is before the first sample."""

    r: Array
    q: Array
    p: Array
    phi: Array
    seen: Array
    driven: Array


def noise_matrices(task: FilterInput, settings: FilterSettings, noise: NoiseModel) -> NoiseMatrices:
    """The noise of one record as matrices."""
    n, channels = len(task.states), task.compiled.traced.channels
    white = [noise.values.get(f"white.{c}", 0.0) for c in channels]
    levels = {t.where: noise.values[t.size] for t in noise.terms if t.kind == "force"}
    steady = np.where(task.felt.any(axis=0), 0.0, noise_intensity(task, levels))
    q = block_diagonal(sampled_covariance(task, steady), settings.wander)
    p = settings.first_covariance
    blocks = [b for t in noise.terms for b in _term_blocks(task, t, noise.values)]
    k = sum(len(b.phi) for b in blocks)
    phi, added, first = np.zeros((k, k)), np.zeros((k, k)), np.zeros((k, k))
    seen, driven = np.zeros((len(channels), k)), np.zeros((n, k))
    at = 0
    for block in blocks:
        part = slice(at, at := at + len(block.phi))
        phi[part, part], added[part, part], first[part, part] = block.phi, block.q, block.p
        if block.channel >= 0:
            seen[block.channel, part.start] = 1.0
        else:
            driven[block.state, part.start + block.shown] = 1.0
    seen += task.felt @ driven
    size = len(q) + k
    whole, start = np.zeros((size, size)), np.zeros((size, size))
    whole[: len(q), : len(q)], whole[len(q) :, len(q) :] = q, added
    start[: len(q), : len(q)], start[len(q) :, len(q) :] = p, first
    return NoiseMatrices(np.array(white) ** 2, whole, start, phi, seen, driven)


def state_offsets(task: FilterInput, noise: NoiseModel) -> dict[str, int]:
    """By size of a term: the first of its states, counted from the first of all terms' states."""
    counts = [sum(len(b.phi) for b in _term_blocks(task, t, noise.values)) for t in noise.terms]
    return {t.size: sum(counts[:i]) for i, t in enumerate(noise.terms)}


def sensor_autocovariance(task: FilterInput, noise: NoiseModel, channel: str, lags: int) -> Array:
    """(lags,) autocovariance of a sensor's stationary noise, lags of 0, 1, ... samples."""
    whole = np.zeros(lags)
    whole[0] = noise.values.get(f"white.{channel}", 0.0) ** 2
    for term in noise.terms:
        if term.kind not in COLOURED or term.where != channel:
            continue
        for block in _term_blocks(task, term, noise.values):
            ahead = block.p
            for lag in range(lags):
                whole[lag] += ahead[0, 0]
                ahead = block.phi @ ahead
    return whole


@dataclass(frozen=True)
class _Block:
    """One process z: its transition, added and first covariance, and what it acts on.

    ``shown`` is the state of it that acts: z, or a derivative over powers of w0.
    """

    phi: Array
    q: Array
    p: Array
    channel: int = -1
    state: int = -1
    shown: int = 0


def _term_blocks(task: FilterInput, term: NoiseTerm, values: Mapping[str, float]) -> list[_Block]:
    """The processes of a term; none where its size is the least, at which it does nothing."""
    dt, size = task.series.dt, values[term.size]
    if _is_idle(task, term, values):
        return []
    if term.kind == "force":
        at_once = np.flatnonzero(task.felt.any(axis=0))
        if not at_once.size:
            return []
        spread = np.sqrt(noise_intensity(task, {term.where: size}) / dt)
        return [replace(_white_block(spread[i]), state=int(i)) for i in at_once if spread[i] > 0]
    if not term.states:
        return []
    if term.kind in CORRELATED:
        whole, shown = _shaped_block(dt, term, values), _acting_state(term.kind, term.order)
        return [
            replace(_scaled(whole, float(task.rates[i])), state=i, shown=shown)
            for i in driven_states(task, term.where)
        ]
    channel = task.compiled.traced.channels.index(term.where)
    if term.kind == "drift":
        one = np.ones((1, 1))
        return [_Block(one, one * size**2 * dt, 0.0 * one, channel)]
    if term.kind in ("band", "vibration"):
        return [replace(_shaped_block(dt, term, values), channel=channel)]
    return [replace(_relaxation_block(dt, values[term.time], size), channel=channel)]


def _acting_state(kind: Kind, order: int) -> int:
    """Of z, z', ... the one that acts."""
    return order // 2 if kind == "swell" else 0


def _scaled(block: _Block, scale: float) -> _Block:
    """The process times a number."""
    return replace(block, q=block.q * scale**2, p=block.p * scale**2)


def _white_block(size: float) -> _Block:
    """White noise held within a sample, of standard deviation ``size``."""
    whole = np.full((1, 1), size**2)
    return _Block(np.zeros((1, 1)), whole, whole)


def _relaxation_block(dt: float, time: float, size: float) -> _Block:
    """A stationary process of standard deviation ``size`` that forgets with this time constant."""
    phi = np.full((1, 1), np.exp(-dt / time))
    whole = np.full((1, 1), size**2)
    return _Block(phi, whole * (1 - phi**2), whole)


def _shaped_block(dt: float, term: NoiseTerm, values: Mapping[str, float]) -> _Block:
    """White noise behind a low-pass, a resonance or a band-pass with w0 = 1 / time.

    Of a gust w0 is c / time. The states are z and its derivatives over the powers of w0.
    Stationary, the one that acts with the standard deviation ``size``.
    """
    from scipy.linalg import expm

    ratio = values[term.damping] if term.damping else None
    rate, first = _shaped_process(term.kind, term.order, ratio)
    time = values[term.time]
    if term.kind == "gust":
        time /= 4.0 ** (term.order - 1) / comb(2 * term.order - 2, term.order - 1)
    phi = expm(rate * dt / time)
    first = first * values[term.size] ** 2
    return _Block(phi, first - phi @ first @ phi.T, first)


@lru_cache(maxsize=64)
def _shaped_process(kind: Kind, order: int, ratio: float | None) -> tuple[Array, Array]:
    """Rates of z, z', ... of an all-pole process with w0 = 1, and their covariance.

    Of the state that acts it is one. Poles are those of Butterworth's low-pass of this order, of a
    resonance with a damping ratio, of Butterworth's band-pass around it, or of a gust: equal ones.
    """
    from scipy.linalg import companion, solve_continuous_lyapunov
    from scipy.signal import buttap, lp2bp_zpk

    if kind == "swell":
        poles = np.real(np.poly(lp2bp_zpk(*buttap(order // 2), bw=2.0 * (ratio or 0.0))[1]))
    elif kind == "gust":
        poles = np.poly(-np.ones(order))
    elif ratio is None:
        poles = np.real(np.poly(buttap(order)[1]))
    else:
        poles = np.array([1.0, 2.0 * ratio, 1.0])
    rate = companion(poles)[::-1, ::-1]  # z, z', ...: the last row holds the coefficients
    drive = np.zeros((order, order))
    drive[-1, -1] = 1.0
    covariance = solve_continuous_lyapunov(rate, -drive)
    acts = _acting_state(kind, order)
    return rate, covariance / covariance[acts, acts]
