"""Spread of free runs under random forces: their distance from the motion without these.

Motions are drawn from one start x_0 and compared with that without forces,

    x_{k+1} = f(x_k, u_k) + D z_k dt + w_k,    z_{k+1} = Phi z_k + v_k,

f the machine's own integration over a sample, w white, and z the forces with a memory as the
``noise`` has them; reading j is then off by sqrt(mean (h_j(x) + s_j z - h_j(x without))^2), at most
by sqrt(2) of its deviation: as far as two motions differ that know nothing of one another. Nothing
is linearised: where teeth are passed or a contact opens slopes say nothing of how far a machine is
carried. The same numbers are drawn for the same record whatever the sizes.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import special

from spiral.engine.filter.extended import FilterSettings
from spiral.engine.filter.task import FilterInput
from spiral.engine.likelihood.noise import NoiseMatrices, NoiseModel, noise_matrices
from spiral.types.noise import COLOURED
from spiral.types.record import Array

_STEPS = 200_000  # of integration for all motions together
_FEWEST, _MOST = 8, 64  # motions that are drawn
_SURE = 0.05  # level at which their variance, of few motions, is bounded from above


@dataclass(frozen=True)
class FreeSpread:
    """What a free run that begins at a given start is off by.

    rms : (samples, channels) over the drawn motions.
    squares : (motions,) mean square of each over samples, in squared deviations of a channel, mean
        over channels.
    """

    rms: Array
    squares: Array


def free_spread(
    task: FilterInput, settings: FilterSettings, noise: NoiseModel, first: int = 0
) -> FreeSpread:
    """The spread of free runs that begin at ``settings.start``; mean squares from ``first`` on."""
    total, squares = np.zeros_like(task.series.y), []
    for miss in draw_free_misses(task, settings, noise):
        total += miss**2
        squares.append(np.mean((miss[first:] / task.series.deviations) ** 2))
    return FreeSpread(np.sqrt(total / len(squares)), np.array(squares))


def independent_values(spreads: Sequence[FreeSpread]) -> float:
    """How many independent values, all alike, have a mean square that varies as these records' do.

    nu = 2 m^2 / s^2 of chi2 with nu degrees of freedom (Satterthwaite 1946), at least 1: m the mean
    square of all samples over the drawn motions, s^2 its variance, at the upper end of what is
    known of it from so few.
    """
    samples = np.array([len(s.rms) for s in spreads], dtype=float)
    shares = samples / samples.sum()
    mean = sum(share * s.squares.mean() for share, s in zip(shares, spreads, strict=True))
    variance = 0.0
    for share, spread in zip(shares, spreads, strict=True):
        freedom = len(spread.squares) - 1
        largest = freedom / special.chdtri(freedom, 1 - _SURE)
        variance += share**2 * spread.squares.var(ddof=1) * largest
    return float(max(2 * mean**2 / variance, 1.0)) if variance > 0 else 1.0


def draw_free_misses(
    task: FilterInput, settings: FilterSettings, noise: NoiseModel, seed: int = 0
) -> Iterator[Array]:
    """(samples, channels) that each of 8 to 64 drawn motions is off by.

    It is as large as it can be from where a motion leaves all bounds, and all along where a random
    force would move it without bounds from the first sample. The motions of one record and ``seed``
    are drawn from the same numbers.
    """
    most = np.sqrt(2.0) * task.series.deviations
    parts, n = noise_matrices(task, settings, noise.without(*COLOURED, "drift")), len(task.states)
    samples, substeps = task.series.samples, task.series.substeps
    count = int(np.clip(_STEPS // max((samples - 1) * substeps, 1), _FEWEST, _MOST))
    if not np.isfinite(parts.q).all():
        yield from [np.broadcast_to(most, (samples, len(most))).copy() for _ in range(count)]
        return
    rng = np.random.default_rng(seed)
    white, forces = (
        _scaled_covariance_root(parts.q[:n, :n], task.scales),
        _draw_coloured_forces(parts, samples, count, rng),
    )
    kicks = np.zeros((samples - 1, substeps, n))
    usual = _disturbed_readings(task, settings.start, kicks)
    for z in forces:
        kicks[:] = (z[:-1] @ parts.driven.T * (task.series.dt / substeps))[:, None]
        kicks[:, -1] += rng.normal(size=(samples - 1, n)) @ white.T
        with np.errstate(all="ignore"):
            miss = _disturbed_readings(task, settings.start, kicks) + z @ parts.seen.T - usual
        yield np.clip(np.nan_to_num(miss, nan=np.inf), -most, most)


def _disturbed_readings(task: FilterInput, start: Array, kicks: Array) -> Array:
    """(samples, channels) readings of one motion; infinite from where it leaves all bounds.

    ``kicks`` (samples - 1, substeps, n) are added to the states after each step.
    """
    from spiral.engine.filter.stochastic_kernel import disturbed_trajectory

    series = task.series
    states, readings = np.empty((series.samples, len(task.states))), np.full_like(series.y, np.inf)
    disturbed_trajectory(
        task.compiled.rate_value, task.compiled.output_value, np.array(start, dtype=float),
        task.values, task.inputs, series.substeps, series.dt,
        kicks.reshape(-1, kicks.shape[2]), states, readings,
    )  # fmt: skip
    return readings


def _draw_coloured_forces(
    parts: NoiseMatrices, samples: int, count: int, rng: np.random.Generator
) -> Array:
    """(count, samples, k) forces with a memory, of so many motions."""
    k = len(parts.phi)
    if not k:
        return np.zeros((count, samples, 0))
    sizes = np.sqrt(np.maximum(np.diag(parts.p)[-k:], np.finfo(float).tiny))
    first, added = (
        _scaled_covariance_root(parts.p[-k:, -k:], sizes),
        _scaled_covariance_root(parts.q[-k:, -k:], sizes),
    )
    z = rng.normal(size=(samples, count, k))
    z[0] = z[0] @ first.T
    for i in range(1, samples):
        z[i] = z[i - 1] @ parts.phi.T + z[i] @ added.T
    return np.ascontiguousarray(z.swapaxes(0, 1))


def _scaled_covariance_root(covariance: Array, sizes: Array) -> Array:
    """L of V = L L^T; ``sizes`` are of the deviations, for which it is well scaled."""
    values, vectors = np.linalg.eigh(covariance / np.outer(sizes, sizes))
    return sizes[:, None] * vectors * np.sqrt(np.maximum(values, 0.0))
