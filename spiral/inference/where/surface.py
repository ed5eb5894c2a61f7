"""The state that the missing force depends on: a restoring-force surface, state by state.

The missing force is known up to what the model's own free parameters can take over, so their
columns are projected out first. What is left, f, is explained in turn by one shape of one state,

    f_i ~ s r^(n-1)    (s a position or a velocity, r its size over all axes, n = 0, 1, 2, 3),

or by the rotor's angle, cos k theta and sin k theta. A shape describes data and is no effect: it
shows what the force depends on before any candidate is named. (Masri and Caughey 1979.)
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np

from spiral.engine.series import sample_inputs
from spiral.engine.study import ORIGIN
from spiral.inference.where.latent import LatentForce, MissingForce
from spiral.types.record import Array

Kind = Literal["position", "velocity", "other position", "other velocity", "angle"]

_Named = tuple[Kind, str, int, bool]

_MOST = 6000  # samples that are regressed
_TINY = 1e-9


@dataclass(frozen=True)
class ForceShape:
    """One shape of the missing force on one axis.

    ``power`` is n, or k for an angle; ``even`` where the sign of the state does not matter;
    ``share`` of the force's energy explained (that the model cannot take over itself), from 0 to 1.
    """

    axis: str
    kind: Kind
    state: str
    power: int
    share: float
    even: bool = False


def rank_force_shapes(missing: MissingForce, active: tuple[str, ...]) -> tuple[ForceShape, ...]:
    """All shapes on all axes, by the share of the missing force that they explain, best first.

    Parameters
    ----------
    active : parameters of the model that its fit moves.
    """
    samples = len(missing.force)
    at = np.unique(np.linspace(0, samples - 1, min(samples, _MOST)).astype(int))
    own = _model_force_columns(missing, active, at)
    ranked = []
    for number, axis in enumerate(missing.axes):
        basis = _orthonormal_basis(np.column_stack([own[:, number], np.ones(len(at))]))
        left = _project_out(missing.force[at, number : number + 1], basis)
        energy = float(np.sum(left**2))
        for shape, columns in _shape_columns(missing, number, at):
            seen = _orthonormal_basis(
                _project_out(columns / np.linalg.norm(columns, axis=0), basis)
            )
            share = float(np.sum((seen.T @ left) ** 2)) / energy if energy > 0 else 0.0
            kind, state, power, even = shape
            ranked.append(ForceShape(axis, kind, state, power, share, even))
    return tuple(sorted(ranked, key=lambda s: -s.share))


def best_shape(candidates: tuple[ForceShape, ...], axes: tuple[str, ...]) -> ForceShape | None:
    """The shape with the largest mean share over these axes, named on the axis it explains best."""
    groups: dict[tuple, list[ForceShape]] = {}
    for shape in (s for s in candidates if s.axis in axes):
        groups.setdefault((shape.kind, shape.power, shape.even), []).append(shape)
    if not groups:
        return None
    means = {key: float(np.mean([s.share for s in group])) for key, group in groups.items()}
    best = max(means, key=lambda key: means[key])
    first = max(groups[best], key=lambda s: s.share)
    return ForceShape(first.axis, first.kind, first.state, first.power, means[best], first.even)


def _model_force_columns(missing: MissingForce, active: tuple[str, ...], at: Array) -> Array:
    """(samples, axes, columns): forces at the port that the model's own parameters stand for."""
    task = missing.task
    latent = [i for i, k in enumerate(task.keys) if k.startswith(f"{LatentForce().label}.")]
    wanted = [task.keys.index(k) for k in {*active, ORIGIN} if k in task.keys]
    inputs = sample_inputs(task.inputs, task.series.substeps)
    slopes = task.compiled.rate.parameter_slopes(
        missing.states[at], inputs[at], task.values, [*latent, *wanted]
    )
    return np.linalg.pinv(slopes[..., : len(latent)]) @ slopes[..., len(latent) :]


def _shape_columns(missing: MissingForce, number: int, at: Array) -> Iterator[tuple[_Named, Array]]:
    """Every shape of one axis with its columns (samples, 1 or 2)."""
    task = missing.task
    names = task.states
    axes = [a if a in names else None for a in missing.axes]
    q = {a: missing.states[at, names.index(a)] for a in axes if a}
    rates = {a: task.compiled.traced.rate_name(a) for a in q}
    v = {a: missing.states[at, names.index(r)] for a, r in rates.items() if r in names}
    axis = missing.axes[number]
    if axis in q:
        yield from _power_columns("position", axis, q, 1)
        yield ("position", axis, 2, True), q[axis][:, None] ** 2
        for other in (o for o in q if o != axis):
            yield ("other position", other, 1, False), q[other][:, None]
    if axis in v:
        yield from _power_columns("velocity", rates[axis], v, 0, axis)
        for other in (o for o in v if o != axis):
            yield ("other velocity", rates[other], 1, False), v[other][:, None]
    columns = task.compiled.traced.inputs
    if "phase" in columns:
        phase = sample_inputs(task.inputs, task.series.substeps)[at, columns.index("phase")]
        for k in (1, 2, 3):
            yield (
                ("angle", "phase", k, False),
                np.column_stack([np.cos(k * phase), np.sin(k * phase)]),
            )


def _power_columns(
    kind: Kind, name: str, states: dict[str, Array], lowest: int, axis: str = ""
) -> Iterator[tuple[_Named, Array]]:
    """s r^(n-1) for n up to 3; the sign of s for n = 0."""
    own = states[axis or name]
    size = np.sqrt(sum(s * s for s in states.values()))
    for power in range(lowest, 4):
        column = np.sign(own) if power == 0 else own * size ** (power - 1)
        yield (kind, name, power, False), column[:, None]


def _orthonormal_basis(columns: Array) -> Array:
    """An orthonormal basis of the columns' span, nearly dependent ones left out."""
    norms = np.linalg.norm(columns, axis=0)
    kept = columns[:, norms > _TINY] / norms[norms > _TINY]
    if not kept.shape[1]:
        return np.zeros((len(columns), 0))
    left, sizes, _ = np.linalg.svd(kept, full_matrices=False)
    return left[:, sizes > 1e-7 * sizes[0]]


def _project_out(columns: Array, basis: Array) -> Array:
    return columns - basis @ (basis.T @ columns)
