"""Craig and Bampton's reduction of a structure to the nodes that are kept and a few modes.

    q = [q_b; q_i] = T [q_b; e],    T = [[I, 0], [-K_ii^-1 K_ib, P]],    K_ii p = w^2 M_ii p

b the nodes that are kept, i the others, P the lowest modes with the kept nodes held, each scaled to
its largest entry. Reduced matrices are T^T (.) T. (R. R. Craig, M. C. C. Bampton, AIAA Journal 6,
1968, 1313-1319.)

Natural modes v above a frequency w_c, which would set the step of the integration, are lowered to
it by mass (L. Olovsson, K. Simonsson, M. Unosson, Int. J. Numer. Meth. Eng. 63, 2005, 1436-1445),

    M + sum_i (w_i^2 / w_c^2 - 1) (M v_i) (M v_i)^T,    v_i^T M v_i = 1,

so that the static response stays as it is, and theirs at w is off by (w / w_c)^2 of it.

The reduced coordinates are the kept nodes and all natural modes but as many as there are nodes:
modes are not coupled to each other, and only the nodes' equations are full.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import sparse
from scipy.linalg import eigh, qr
from scipy.sparse.linalg import eigsh, splu

from spiral.types.errors import ConfigError
from spiral.types.record import Array

FREQUENCIES = 60  # of the comparison with the full structure
HARMONICS = 4  # of the band's end: what lies below keeps its frequency, the third harmonic included
_DENSE = 400  # up to so many others their modes are found by a dense solver
_LOSS = 0.02  # loss factor of the comparison where no damping matrix is given


@dataclass(frozen=True)
class ReducedStructure:
    """Matrices of the kept nodes, then of the modes; and how far they are from the full ones.

    ``response_error`` : rms over the band of |H_reduced - H|, over that of |H|, H the response of
    the sensors to forces at inputs and ports. ``frequency_error`` : largest relative error of a
    natural frequency inside the band. ``highest`` : largest natural frequency that is left, Hz.
    ``lowered`` : how many modes were lowered to it.
    """

    matrices: dict[str, Array]
    band: tuple[float, float]
    response_error: float
    frequency_error: float
    highest: float
    lowered: int


def reduce_structure(
    matrices: Mapping[str, Any],
    kept: Sequence[int],
    size: int,
    band: tuple[float, float],
    sensors: Sequence[int],
    forces: Sequence[int],
    highest: float | None = None,
) -> ReducedStructure:
    """The structure with ``size`` coordinates.

    Parameters
    ----------
    matrices : sparse, by name (M, K, C, G, parts ``K_NAME`` on top of K).
    kept : rows of the nodes. sensors, forces : places among them.
    band : low and high end of the comparison, Hz.
    highest : frequency to which higher modes are lowered, Hz; ``HARMONICS`` times the end of the
        band where it is left out.

    Raises
    ------
    ConfigError : fewer coordinates than nodes, or a structure that is loose with them held.
    """
    total = matrices["M"].shape[0]
    if not len(kept) <= size <= total:
        raise ConfigError(
            f"size={size} of a structure of {total} with {len(kept)} kept nodes",
            f"{len(kept)} to {total} coordinates",
        )
    basis = _craig_bampton_basis(matrices, np.asarray(kept), size)
    small = {k: basis.T @ (m @ basis) for k, m in matrices.items()}
    small = {k: 0.5 * (m - m.T if k == "G" else m + m.T) for k, m in small.items()}
    limit = HARMONICS * band[1] if highest is None else highest
    small["M"], lowered = _lower_high_modes(small["M"], whole_stiffness(small), limit)
    turned = _node_mode_transform(small, basis, len(kept))
    small = {k: turned.T @ m @ turned for k, m in small.items()}
    response, frequency, top = _reduction_errors(
        matrices, small, np.asarray(kept), band, sensors, forces
    )
    return ReducedStructure(small, band, response, frequency, top, lowered)


def whole_stiffness(matrices: Mapping[str, Any]) -> Any:
    """K with all its parts at their nominal size."""
    return sum((m for k, m in matrices.items() if k.startswith("K_")), start=matrices["K"])


def _lower_high_modes(mass: Array, stiffness: Array, limit: float) -> tuple[Array, int]:
    """M with mass added to the modes above ``limit`` in Hz, and how many these are."""
    values, modes = eigh(stiffness, mass)
    ratios = np.maximum(values / (2 * np.pi * limit) ** 2 - 1, 0)
    sides = mass @ modes
    return mass + (sides * ratios) @ sides.T, int(np.sum(ratios > 0))


def _node_mode_transform(small: Mapping[str, Array], basis: Array, count: int) -> Array:
    """T of x = T [q_b; e], e the natural modes but those that the nodes' motion tells best.

    x = V_d d + V_e e with q_b = V_bd d + V_be e, where V_bd is chosen by pivots; each e in units
    of the largest entry of its mode.
    """
    _, modes = eigh(whole_stiffness(small), small["M"])
    modes = modes / np.abs(basis @ modes).max(axis=0)
    nodes = modes[:count]
    factors: Any = qr(nodes, mode="economic", pivoting=True)
    order = factors[2]
    told, left = np.sort(order[:count]), np.sort(order[count:])
    by_nodes = modes[:, told] @ np.linalg.inv(nodes[:, told])
    turned = np.hstack([by_nodes, modes[:, left] - by_nodes @ nodes[:, left]])
    turned[:count] = np.eye(count, len(modes))
    return turned


def _craig_bampton_basis(matrices: Mapping[str, Any], kept: Any, size: int) -> Array:
    mass, stiffness = matrices["M"], sparse.csc_matrix(whole_stiffness(matrices))
    total, count = mass.shape[0], size - len(kept)
    others = np.setdiff1d(np.arange(total), kept)
    basis = np.zeros((total, size))
    basis[kept, np.arange(len(kept))] = 1.0
    inner = sparse.csc_matrix(stiffness[others][:, others])
    if len(others):
        try:
            held = splu(inner).solve(stiffness[others][:, kept].toarray())
        except RuntimeError as error:
            raise ConfigError(
                "a structure that is loose where its kept nodes are held",
                "a stiffness that holds every other node",
                "keep a node of each part that can move freely",
            ) from error
        basis[np.ix_(others, np.arange(len(kept)))] = -held
    if count:
        modes = _lowest_modes(inner, sparse.csc_matrix(mass[others][:, others]), count)
        basis[np.ix_(others, np.arange(len(kept), size))] = modes / np.abs(modes).max(axis=0)
    return basis


def _lowest_modes(stiffness: Any, mass: Any, count: int) -> Array:
    """(n, count) lowest modes, of a definite sign."""
    if stiffness.shape[0] <= max(_DENSE, 2 * count):
        _, modes = eigh(stiffness.toarray(), mass.toarray(), subset_by_index=(0, count - 1))
    else:
        start = np.random.default_rng(0).normal(size=stiffness.shape[0])
        values, modes = eigsh(stiffness, count, mass, sigma=0.0, v0=start)
        modes = modes[:, np.argsort(values)]
    largest = np.abs(modes).argmax(axis=0)
    return modes * np.sign(modes[largest, np.arange(count)])


# --- against the full structure ------------------------------------------------------------------


def _reduction_errors(
    full: Mapping[str, Any],
    small: Mapping[str, Array],
    kept: Any,
    band: tuple[float, float],
    sensors: Sequence[int],
    forces: Sequence[int],
) -> tuple[float, float, float]:
    frequencies = np.linspace(*band, FREQUENCIES)
    of_full = _frequency_response(full, kept[list(sensors)], kept[list(forces)], frequencies)
    of_small = _frequency_response(
        {k: sparse.csc_matrix(m) for k, m in small.items()}, sensors, forces, frequencies
    )
    response = float(np.sqrt(np.mean(np.abs(of_small - of_full) ** 2) / np.mean(abs(of_full) ** 2)))
    reduced_frequencies = np.sqrt(
        np.maximum(eigh(whole_stiffness(small), small["M"], eigvals_only=True), 0)
    )
    reduced_frequencies = reduced_frequencies / (2 * np.pi)
    count = int(min(np.sum(reduced_frequencies <= 1.2 * band[1]), full["M"].shape[0] - 2))
    if not count:
        return response, 0.0, float(reduced_frequencies[-1])
    true = _lowest_frequencies(whole_stiffness(full), full["M"], count, band[1])
    inside = true <= band[1]
    gaps = np.abs(reduced_frequencies[:count] - true)[inside] / np.maximum(
        true[inside], 1e-3 * band[1]
    )
    return response, float(gaps.max(initial=0.0)), float(reduced_frequencies[-1])


def _lowest_frequencies(stiffness: Any, mass: Any, count: int, high: float) -> Array:
    """The lowest natural frequencies, Hz, by a shift below zero, which lets rigid motions be."""
    stiffness = sparse.csc_matrix(stiffness)
    if stiffness.shape[0] <= _DENSE:
        values = eigh(stiffness.toarray(), mass.toarray(), eigvals_only=True)[:count]
    else:
        shift = -((0.2 * np.pi * high) ** 2)
        start = np.random.default_rng(0).normal(size=stiffness.shape[0])
        values = eigsh(stiffness, count, mass, sigma=shift, v0=start, return_eigenvectors=False)
    return np.sqrt(np.maximum(np.sort(values), 0)) / (2 * np.pi)


def _frequency_response(
    matrices: Mapping[str, Any], sensors: Any, forces: Any, frequencies: Array
) -> Array:
    """(frequencies, sensors, forces) motion per force."""
    stiffness, mass = whole_stiffness(matrices), matrices["M"]
    damping = matrices.get("C")
    unit = np.zeros((mass.shape[0], len(forces)), dtype=complex)
    unit[list(forces), np.arange(len(forces))] = 1.0
    responses = []
    for omega in 2 * np.pi * frequencies:
        loss = 1j * _LOSS * stiffness if damping is None else 1j * omega * damping
        moved = splu(sparse.csc_matrix(stiffness + loss - omega**2 * mass)).solve(unit)
        responses.append(moved[list(sensors)])
    return np.array(responses)
