"""Draws from a curved posterior, such as that of two bearings that share one stiffness.

In w, with theta = m + R w around the most probable values and R R^T the covariance there, the
whitened innovations and the prior's own rows are, to second order,

    F(w) = F_0 + A w + 1/2 T(w, w),    log p = -1/2 |F(w)|^2,    A^T A = I,

T from differences of the slopes A at +-1 along each axis of w. Where T is not small the Gaussian
at the top is far too narrow, as the region is long, thin and curved. Draws are made along it in
other coordinates: those axes u of w across whose own tangent F bends, and for all others

    v = A_v^T F(u, w_v),    p(u, v) = p(w) / |det dv/dw_v|,

in which the region is straight. v moves by v' = sqrt(1 - b^2) v + b N(0, I), which leaves N(0, I)
as it is (Cotter et al. 2013, pCN), u by a random walk; a move is accepted by what is left.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from spiral.types.record import Array

_BENT = 0.1  # second order across the tangent, at one standard deviation, for an axis of u
_FLAT = 0.1  # the same in any direction, under which the region counts as straight
_CHAINS, _MOVES, _NEWTON, _CLOSE = 64, 200, 12, 1e-6
_WANTED, _GAIN = 0.3, 0.03  # share of moves accepted, and how fast their size follows


@dataclass(frozen=True)
class Expansion:
    """``first`` (d,), ``slopes`` (d, r) and ``second`` (r, r, d): F_0, A and T."""

    first: Array
    slopes: Array
    second: Array

    @property
    def straight(self) -> bool:
        """Whether the second order does not matter within one standard deviation."""
        own = np.linalg.norm(np.diagonal(self.second, axis1=0, axis2=1), axis=0)
        return not np.any(0.5 * own > _FLAT)

    @property
    def bent(self) -> Array:
        """(r,) which axes bend across the tangent."""
        base, _ = np.linalg.qr(self.slopes)
        own = np.diagonal(self.second, axis1=0, axis2=1).T
        return np.linalg.norm(own - own @ base @ base.T, axis=1) > _BENT

    def evaluate(self, w: Array) -> tuple[Array, Array]:
        """F (points, d) and its slopes (points, r, d) at w (points, r)."""
        r, d = self.second.shape[1:]
        bend = (w @ self.second.reshape(r, -1)).reshape(len(w), r, d)
        value = self.first + w @ self.slopes.T + 0.5 * np.einsum("pid,pi->pd", bend, w)
        return value, self.slopes.T + bend

    def log_density(self, w: Array) -> Array:
        """(points,) log p(w) - log p(0)."""
        value, _ = self.evaluate(w)
        return 0.5 * (float(self.first @ self.first) - np.sum(value**2, axis=1))


def build_expansion(
    e: Array, slopes: Array, second: Array, prior: Array, prior_slopes: Array
) -> Expansion:
    """F_0, A and T from the rows of a whole record, reduced to their QR triangle.

    Parameters
    ----------
    e : (n,) whitened innovations; slopes : (n, r); second : (r, r, n), symmetric.
    prior : (p,) the prior's coordinates, and prior_slopes : (p, r), rows of their own.
    """
    r, extra = slopes.shape[1], len(prior)
    upper = np.triu_indices(r)
    whole = np.concatenate([e[:, None], slopes, second[upper].T], axis=1)
    small = np.asarray(np.linalg.qr(whole, mode="r") if len(whole) > whole.shape[1] else whole)
    d = len(small)
    packed = np.zeros((r, r, d + extra))
    packed[upper[0], upper[1], :d] = small[:, 1 + r :].T
    packed[upper[1], upper[0], :d] = small[:, 1 + r :].T
    return Expansion(
        np.concatenate([small[:, 0], prior]),
        np.concatenate([small[:, 1 : 1 + r], prior_slopes]),
        packed,
    )


def draw_samples(expanded: Expansion, count: int, rng: np.random.Generator) -> Array:
    """(count, r) draws of w, each the end of a Markov chain of its own."""
    chains, r = max(_CHAINS, count), expanded.slopes.shape[1]
    along = np.flatnonzero(expanded.bent)
    across = np.flatnonzero(~expanded.bent)
    u, v = np.zeros((chains, len(along))), np.zeros((chains, len(across)))
    v += expanded.first @ expanded.slopes[:, across]
    w, height = _invert_coordinates(expanded, along, across, u, v, np.zeros((chains, r)))
    share, size = 0.5, 1.0
    for move in range(_MOVES):
        length = size * rng.uniform(size=(chains, 1))
        other_u = u + length * rng.normal(size=u.shape)
        other_v = np.sqrt(1 - share**2) * v + share * rng.normal(size=v.shape)
        trial, reached = _invert_coordinates(expanded, along, across, other_u, other_v, w)
        taken = np.log(rng.uniform(size=chains)) < reached - height
        u[taken], v[taken], w[taken] = other_u[taken], other_v[taken], trial[taken]
        height = np.where(taken, reached, height)
        if move < _MOVES // 2:
            factor = float(np.exp(_GAIN * (taken.mean() - _WANTED)))
            share, size = min(share * factor, 1.0), min(size * factor, 3.0)
    return w[rng.permutation(chains)[:count]]


def _invert_coordinates(
    expanded: Expansion, along: Array, across: Array, u: Array, v: Array, near: Array
) -> tuple[Array, Array]:
    """w of coordinates (u, v) by Newton's steps, and log p(u, v) + |v|^2 / 2; -inf where none."""
    w = near.copy()
    w[:, along] = u
    base, step = expanded.slopes[:, across], np.zeros_like(v)
    value, square = np.zeros((len(w), len(base))), np.zeros((len(w), len(across), len(across)))
    with np.errstate(all="ignore"):
        for _ in range(_NEWTON):
            value, slopes = expanded.evaluate(np.clip(np.nan_to_num(w), -1e6, 1e6))
            square = slopes[:, across] @ base
            step = _solve_points(square, value @ base - v)
            if not np.any(np.abs(step) > _CLOSE):
                break
            w[:, across] -= step
        sign, log_det = np.linalg.slogdet(np.nan_to_num(square))
        height = -0.5 * np.sum(value**2, axis=1) - log_det + 0.5 * np.sum(v**2, axis=1)
    fine = np.all(np.abs(step) <= 1e3 * _CLOSE, axis=1) & np.isfinite(height) & (sign > 0)
    return w, np.where(fine, height, -np.inf)


def _solve_points(square: Array, right: Array) -> Array:
    """Solutions (points, r) of H^T x = b for each point; NaN where H is singular."""
    try:
        turned = np.nan_to_num(square).transpose(0, 2, 1)
        return np.linalg.solve(turned, right[:, :, None])[:, :, 0]
    except np.linalg.LinAlgError:
        return np.full_like(right, np.nan)
