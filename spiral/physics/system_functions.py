"""A system's own expressions along many states at once: NumPy functions, each made once."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import sympy as sp

from spiral.physics.trace import TracedModel, trace
from spiral.types.cache import kept
from spiral.types.label import parameter_of
from spiral.types.system import MechanicalSystem, System, has_coordinates

Function = Callable[..., Any]


@kept(64)
def auxiliary_function(system: System, name: str) -> Function:
    """a(x, u, p) of one auxiliary."""
    traced = trace(system, ())
    x = SimpleNamespace(**dict(zip(traced.states, traced.x, strict=True)))
    u = SimpleNamespace(**dict(zip(traced.inputs, traced.u, strict=True)))
    value = system.auxiliary(x, u, parameter_symbols(traced))[name]
    return sp.lambdify([*traced.x, *traced.u, *traced.p], value, "numpy")


@kept(32)
def mass_matrix(system: MechanicalSystem) -> Function:
    """M(x, p) of a mechanical system."""
    traced = trace(system, ())
    x = SimpleNamespace(**dict(zip(traced.states, traced.x, strict=True)))
    mass = system.mass(system.split(x)[0], parameter_symbols(traced))
    return sp.lambdify([*traced.x, *traced.p], mass, "numpy")


@kept(32)
def capacities(system: MechanicalSystem) -> tuple[list[str], Function]:
    """Names of ``MechanicalSystem.capacities``, and their values by (x, u, p)."""
    traced = trace(system, ())
    x = SimpleNamespace(**dict(zip(traced.states, traced.x, strict=True)))
    u = SimpleNamespace(**dict(zip(traced.inputs, traced.u, strict=True)))
    named = system.capacities(*system.split(x), u, parameter_symbols(traced))
    values = sp.lambdify([*traced.x, *traced.u, *traced.p], list(named.values()), "numpy")
    return list(named), values


@kept(128)
def port_geometry(system: System, name: str) -> Function:
    """Position, velocity and Jacobian of a port by the states."""
    assert has_coordinates(system)
    traced = trace(system, ())
    port = system.port(name)
    x = SimpleNamespace(**dict(zip(traced.states, traced.x, strict=True)))
    p = parameter_symbols(traced)
    q, v = system.split(x)
    names = [c.name for c in system.coordinates]
    position = sp.Matrix([sp.sympify(e) for e in port.coordinates(q, p)])
    jacobian = position.jacobian([getattr(q, n) for n in names])
    velocity = jacobian * sp.Matrix([getattr(v, n) for n in names])
    parts = [position.flat(), velocity.flat(), jacobian.tolist()]
    return sp.lambdify([*traced.x, *traced.p], parts, "numpy")


@kept(128)
def port_position(system: System, name: str) -> Function:
    """Position of a port of a system that is not mechanical, by the states."""
    traced = trace(system, ())
    port = system.port(name)
    x = SimpleNamespace(**dict(zip(traced.states, traced.x, strict=True)))
    p = parameter_symbols(traced)
    place = [sp.sympify(e) for e in port.coordinates(x, p)]
    return sp.lambdify([*traced.x, *traced.p], place, "numpy")


def parameter_symbols(traced: TracedModel) -> SimpleNamespace:
    """The symbols of a system without effects, by the names of its parameters."""
    return SimpleNamespace(
        **{parameter_of(k): s for k, s in zip(traced.keys, traced.p, strict=True)}
    )
