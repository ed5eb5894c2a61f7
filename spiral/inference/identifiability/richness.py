"""How rich an excitation is: the paper's identifiability theory on a matrix of signatures.

With unit-rms columns the normalised Gram matrix G = Phi^T Phi / N has ones on its diagonal, and
mu = lambda_min(G) is between 0 (some columns are combinations of others) and 1 (orthogonal).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from spiral.types.errors import ConfigError
from spiral.types.record import Array

FLOOR = 1e-3  # smallest singular value of unit columns that is believed
_NOISE = 0.5  # share of a direction's signature that noise may make
_TIED = 0.05  # entry of the projector on the unseen directions that ties two columns


@dataclass(frozen=True)
class Richness:
    """Rank, condition and alias groups of a signature matrix.

    Parameters
    ----------
    samples : N, rows of the matrix. columns : p.
    gram : (p, p) normalised Gram matrix, unit-rms columns.
    mu : its smallest eigenvalue, the paper's mu_Phi of condition (C2); 0 where that is rounding.
    condition : largest over smallest eigenvalue of the Gram matrix; infinite where mu is 0.
    coherence : largest entry of the Gram matrix off its diagonal, the mutual coherence.
    singular : (p,) singular values of unit-norm columns, largest first.
    rank : how many of the directions are above the threshold.
    threshold : singular value under which a direction counts as unseen.
    unseen : (p, p - rank) orthonormal combinations of columns that cannot be told from zero.
    """

    samples: int
    gram: Array
    mu: float
    condition: float
    coherence: float
    singular: Array
    rank: int
    threshold: float
    unseen: Array

    @property
    def columns(self) -> int:
        """Number of columns, p."""
        return len(self.gram)


def richness(phi: Array, disturbed: Array | None = None, least: float = 0.0) -> Richness:
    """Rank, mu and condition of a signature matrix.

    Parameters
    ----------
    phi : (N, p) signatures, no column zero.
    disturbed : (N, p) the same signatures with measurement noise once more, where they come from
        measurements: what noise makes of a direction, |(disturbed - phi) v|^2, is taken off its
        singular value squared, and a direction that is noise by more than half is unseen.
    least : singular value that noise in the target leaves visible.

    Raises
    ------
    ConfigError : no columns, fewer rows than columns, or a column without any signal.
    """
    count, columns = phi.shape
    norms = np.linalg.norm(phi, axis=0)
    if not columns or count <= columns or not np.all(norms > 0):
        raise ConfigError(
            f"a signature matrix of {count} rows and {columns} columns",
            "more samples than terms, and terms that act somewhere",
            "a longer record, or candidates=[NAME,NAME]",
        )
    unit = phi / norms
    _, singular, right = np.linalg.svd(np.linalg.qr(unit, mode="r"))
    seen = singular**2
    if disturbed is not None:
        made = np.linalg.norm((disturbed - phi) / norms @ right.T, axis=0) ** 2
        seen = np.where(made < _NOISE * seen, seen - made, 0.0)
    threshold = max(FLOOR, least)
    kept: Array = np.sqrt(seen) > threshold
    gram = unit.T @ unit
    mu = _smallest_eigenvalue(singular)
    off = np.abs(gram - np.diag(np.diag(gram)))
    return Richness(
        samples=count,
        gram=gram,
        mu=mu,
        condition=float(singular[0] ** 2 / mu) if mu > 0 else float("inf"),
        coherence=float(off.max()) if columns > 1 else 0.0,
        singular=singular,
        rank=int(np.sum(kept)),
        threshold=threshold,
        unseen=right[~kept].T,
    )


def _smallest_eigenvalue(singular: Array) -> float:
    """The smallest eigenvalue of the Gram matrix; 0 where it is the rounding of the largest."""
    rounding = len(singular) * np.finfo(float).eps * singular[0]
    return float(singular[-1] ** 2) if singular[-1] > rounding else 0.0


def alias_groups(excitation: Richness, owners: Sequence[str]) -> tuple[tuple[str, ...], ...]:
    """Effects whose columns appear together in an unseen combination.

    The projector V V^T on the unseen directions does not depend on their basis: columns with a
    large entry in it are tied, effects with tied columns form one group.
    """
    tied = np.abs(excitation.unseen @ excitation.unseen.T) > _TIED
    links = [{owners[int(j)] for j in np.flatnonzero(row)} for row in tied]
    return merge_overlapping_groups([link for link in links if link])


def merge_overlapping_groups(links: Sequence[set[str]]) -> tuple[tuple[str, ...], ...]:
    """Connected components of overlapping sets, each sorted."""
    merged: list[set[str]] = []
    for link in links:
        touching = [m for m in merged if m & link]
        merged = [*(m for m in merged if not m & link), link.union(*touching)]
    return tuple(tuple(sorted(m)) for m in merged)


def snr_min(
    mu: float, columns: int, samples: int, epsilon: float = 0.0, level: float = 0.05
) -> float:
    """Eq. (SNR_min): sqrt(p) / (sqrt(mu) (1 - eps_0)) sqrt(F_{level, p, N - p} / N).

    Infinite where mu is 0 or the library explains nothing (eps_0 of 1 or more).
    """
    from scipy.stats import f

    if mu <= 0 or epsilon >= 1 or samples <= columns:
        return float("inf")
    critical = float(f.isf(level, columns, samples - columns))
    return float(np.sqrt(columns / mu) / (1.0 - epsilon) * np.sqrt(critical / samples))


def detection_margin(columns: int, level: float = 0.05, miss: float = 0.05) -> float:
    """[z_{1 - delta/2} + z_{1 - alpha/(2p)}]^2 of eq. (Nmin): 21.1 for p = 6 and 5 % each.

    The paper's corollary on the rotor prints 30.3 for these numbers; its formula gives 21.1.
    """
    from scipy.stats import norm

    return float((norm.isf(miss / 2) + norm.isf(level / (2 * columns))) ** 2)


def samples_needed(
    mu: float, columns: int, noise: float, smallest: float, level: float = 0.05, miss: float = 0.05
) -> float:
    """Eq. (Nmin): sigma^2 / (mu theta_min^2) [z_{1 - delta/2} + z_{1 - alpha/(2p)}]^2 + p.

    Parameters
    ----------
    noise, smallest : sigma_eps and theta_min in one unit; with unit-rms columns theta_min is the
        rms of the smallest term's contribution.
    level, miss : family-wise error alpha and probability delta of missing a term.
    """
    if mu <= 0:
        return float("inf")
    margin = detection_margin(columns, level, miss)
    return (noise / smallest) ** 2 / mu * margin + columns


def bias_bound(mu: float, mismatch: float) -> float:
    """Theorem 1: |bias of theta|_2 <= eps_0 |Delta|_rms / sqrt(mu), in the unit of ``mismatch``.

    ``mismatch`` is the rms of what the library cannot express, eta; independent of N.
    """
    return mismatch / np.sqrt(mu) if mu > 0 else float("inf")


def spread_bound(mu: float, columns: int, samples: int, noise: float) -> float:
    """Theorem 1: root mean square of |theta - E theta|_2 <= sigma_eps sqrt(p / (N mu))."""
    return float(noise * np.sqrt(columns / (samples * mu))) if mu > 0 else float("inf")
