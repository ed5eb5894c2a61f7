"""Signs that a passive machine does not have: springs that push away, dampers that feed energy in.

With F the force of one coefficient alone on an axis, q and v along it:

    damping     (F(q, v) - F(q, -v)) v / 2 > 0     energy comes in, whichever way it moves
    stiffness   F(q, 0) q > 0, F in step with q     it pushes away from rest

A spring that softens (F as q^3) is none of the second kind: it acts beside another.
"""

from __future__ import annotations

from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

from spiral.types.effect import Effect, ForceEffect, values_for
from spiral.types.model import Model
from spiral.types.placement import input_columns
from spiral.types.port import At, Port

DAMPING = "negative damping: it feeds energy in, which a passive machine does not"
STIFFNESS = "negative stiffness: it pushes away from rest, which a passive machine does not"
_SURE = 3.0  # standard errors from zero, nearer than which a sign says nothing
_STRAIGHT = 1e-9  # relative deviation up to which a force counts as proportional to q


def implausible_signs(model: Model) -> dict[str, str]:
    """Coefficients by full name whose sign a passive machine does not have, and what it means.

    Effects that read an input (a speed, the time) or have states of their own are left out: energy
    may come from elsewhere there.
    """
    meanings = {}
    for effect in model.effects:
        if not isinstance(effect, ForceEffect) or effect.inputs or effect.states:
            continue
        port = model.system.place(effect)
        for key in _significant_amplitudes(model, effect, port):
            said = _sign_meaning(_single_coefficient_force(model, effect, port, key), port)
            if said:
                meanings[key] = said
    return meanings


def _significant_amplitudes(model: Model, effect: Effect, port: Port) -> Iterator[str]:
    """The amplitudes of an effect that have a value and are surely not zero."""
    for key, parameter in effect.keys(port):
        value, error = model.values.get(key), model.errors.get(key)
        if parameter.role != "amplitude" or parameter.loose or not value:
            continue
        if error is None or abs(value) >= _SURE * error:
            yield key


def _single_coefficient_force(model: Model, effect: ForceEffect, port: Port, wanted: str) -> Any:
    """The force of one coefficient by positions and velocities, the effect's others zero."""
    values = {}
    for key, parameter in effect.keys(port):
        value = model.values.get(key, parameter.start or 0.0)
        values[key] = value if key == wanted or parameter.role == "shape" else 0.0
    p = values_for(effect, port.axes, values)
    quiet = SimpleNamespace(**dict.fromkeys(input_columns(model.system), 0.0))

    def force(q: tuple[float, ...], v: tuple[float, ...]) -> list[float]:
        forces = effect.force(At(q, v, SimpleNamespace()), quiet, p)
        return [float(value) for value in forces]

    return force


def _sign_meaning(force: Any, port: Port) -> str:
    """The warning for the sign of a coefficient, by its force along every axis; else empty."""
    axes = range(len(port.axes))

    def along(i: int, size: float) -> tuple[float, ...]:
        return tuple(size if j == i else 0.0 for j in axes)

    try:
        gains = [
            (force(along(i, q), along(i, 1.0))[i] - force(along(i, q), along(i, -1.0))[i]) / 2
            for i in axes
            for q in (0.0, 1.0, -1.0)
        ]
        pulls = [(force(along(i, 1.0), along(i, 0.0))[i],
                  force(along(i, 2.0), along(i, 0.0))[i]) for i in axes]  # fmt: skip
    except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError):
        return ""  # an effect that is not defined there
    if min(gains) >= 0 < max(gains):
        return DAMPING
    straight = all(abs(two - 2 * one) <= _STRAIGHT * abs(two) for one, two in pulls)
    ones = [one for one, _ in pulls]
    return STIFFNESS if straight and min(ones) >= 0 < max(ones) else ""
