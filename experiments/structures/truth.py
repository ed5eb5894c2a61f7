"""The true motion: modes of the whole structure, its flexibility at the places, Newmark's rule.

    q = V z,    V of the lowest modes and K^-1 b of each node (R. H. MacNeal 1971, S. Rubin 1975),
    z'' + (2 d w + W V^T G V) z' + w^2 z = V^T (b_drive F - b f(s, s')),    s = b^T q,

by the average acceleration (N. M. Newmark 1959), the one unknown f of each step by bisection. None
of it is the package's: neither its reduction nor its effects nor its integration.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache

import numba as nb
import numpy as np
from scipy.linalg import eigh, qr
from scipy.sparse.linalg import eigsh, splu

from experiments.structures.kinds import KINDS

Array = np.ndarray
MODES = 60
STEPS = 64
"""Of each sample."""
LAWS = {"none": 0, "cubic_stiffness": 1, "clearance": 2, "coulomb_friction": 3}


@dataclass(frozen=True)
class Modes:
    """w^2 of the modes, the rows of the kept nodes (nodes, modes), G between the modes."""

    squares: Array
    rows: Array
    gyroscopic: Array


@cache
def modes(name: str) -> Modes:
    """Those of a kind: the lowest of the whole structure, and what its places need beside them."""
    kind = KINDS[name]()
    mass, stiffness = kind.matrices["M"], kind.matrices["K"]
    dofs = [int(str(n["dof"])) for n in kind.nodes.values()]
    size = mass.shape[0]
    if size <= 2 * MODES:
        basis = np.eye(size)  # all modes
    else:
        start = np.random.default_rng(0).normal(size=size)
        _, lowest = eigsh(stiffness, MODES, mass, sigma=0.0, v0=start)
        unit = np.zeros((size, len(dofs)))
        unit[dofs, np.arange(len(dofs))] = 1.0
        basis, _ = qr(np.hstack([lowest, splu(stiffness.tocsc()).solve(unit)]), mode="economic")
    squares, own = eigh(basis.T @ (stiffness @ basis), basis.T @ (mass @ basis))
    shapes = basis @ own
    turning = kind.matrices.get("G")
    gyroscopic = np.zeros((len(squares),) * 2) if turning is None else shapes.T @ (turning @ shapes)
    return Modes(squares, shapes[dofs], gyroscopic)


def place(name: str, port: str) -> Array:
    """b of a place among the kept nodes: a node, or a pair (second less first)."""
    kind = KINDS[name]()
    names = list(kind.nodes)
    found = np.zeros(len(names))
    ends = kind.pairs.get(port, (port,))
    found[names.index(ends[-1])] += 1.0
    if len(ends) == 2:
        found[names.index(ends[0])] -= 1.0
    return found


def compliance(name: str, port: str) -> float:
    """Static deflection of a place for a unit force there, m/N."""
    own = modes(name)
    side = place(name, port) @ own.rows
    return float(side / own.squares @ side)


def motion(
    name: str,
    port: str,
    law: str,
    numbers: tuple[float, float],
    ratio: float,
    speed: float,
    force: Array,
    step: float,
) -> tuple[Array, Array]:
    """Displacements of the kept nodes and the place's own, every ``STEPS`` steps.

    Parameters
    ----------
    numbers : of the law: stiffness; stiffness and gap; level and width.
    ratio : damping of every mode. speed : rad/s. force : on the driven node, at each step.
    """  # fmt: skip
    kind, own = KINDS[name](), modes(name)
    damping = np.diag(2 * ratio * np.sqrt(own.squares)) + speed * own.gyroscopic
    drive = own.rows[list(kind.nodes).index(kind.using("input")[0])]
    side = place(name, port) @ own.rows
    effective = np.eye(len(damping)) + step / 2 * damping + step**2 / 4 * np.diag(own.squares)
    z = _newmark(
        np.linalg.inv(effective), damping, own.squares, drive, side, force, step, LAWS[law],
        numbers[0], numbers[1], STEPS,
    )  # fmt: skip
    return z @ own.rows.T, z @ side


@nb.njit
def _law(kind, first, second, s, v):
    """f(s, s')."""
    if kind == 1:
        return first * s**3
    if kind == 2:
        return first * np.sign(s) * max(abs(s) - second, 0.0)
    if kind == 3:
        return first * np.tanh(v / second)
    return 0.0


@nb.njit
def _newmark(inverse, damping, squares, drive, side, force, step, kind, first, second, every):
    """z at every so many steps, from rest."""
    n = len(squares)
    z, v, a = np.zeros(n), np.zeros(n), np.zeros(n)
    out = np.zeros(((len(force) - 1) // every + 1, n))
    by_drive, by_side = inverse @ drive, inverse @ side
    reach = side @ by_side
    for k in range(1, len(force)):
        z_free = z + step * v + step**2 / 4 * a
        v_free = v + step / 2 * a
        a_free = by_drive * force[k] - inverse @ (damping @ v_free + squares * z_free)
        s = side @ z_free + step**2 / 4 * (side @ a_free)
        r = side @ v_free + step / 2 * (side @ a_free)
        low, high = 0.0, _law(kind, first, second, s, r)
        for _ in range(60):  # f falls along its own push: the root lies between 0 and f(s, r)
            f = 0.5 * (low + high)
            if f in (low, high):
                break
            there = _law(kind, first, second, s - step**2 / 4 * reach * f, r - step / 2 * reach * f)
            if (f - there) * (high - low) < 0:
                low = f
            else:
                high = f
        f = 0.5 * (low + high)
        a = a_free - by_side * f
        z = z_free + step**2 / 4 * a
        v = v_free + step / 2 * a
        if k % every == 0:
            out[k // every] = z
    return out


def told(values: Mapping[str, float]) -> tuple[float, float]:
    """The numbers of a law, in the order of ``motion``."""
    found = [*values.values(), 0.0]
    return found[0], found[1]
