"""Physics at rest: f, h and their slopes at zero states and inputs must be numbers.

A system of which a state is never zero (a pressure under a logarithm, a concentration that divides)
is asked where its states are declared to begin instead, and then at ones. Parameters have the
values that were given: a mass matrix of ones would be singular.

One effect with 0/0 at rest (v/|v|) makes every column of a study NaN, so it is named before a fit.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from spiral.physics.compile import CompiledModel
from spiral.physics.starts import fill_declared_starts
from spiral.physics.trace import TracedModel, trace
from spiral.types.cache import kept
from spiral.types.effect import Effect
from spiral.types.errors import PluginError
from spiral.types.parameter import Parameter
from spiral.types.system import System

Array = np.ndarray


@dataclass(frozen=True)
class _Rest:
    """A place to ask a model at: one value of all states and inputs, but where these begin."""

    told: str
    value: float
    declared: bool


_AT_ZERO = _Rest("at zero", 0.0, declared=False)
_PLACES = (
    _AT_ZERO,
    _Rest("where the states begin", 0.0, declared=True),
    _Rest("where all are one", 1.0, declared=True),
)


def check_rest(
    compiled: CompiledModel,
    system: System,
    effects: Sequence[Effect],
    candidates: Sequence[Effect] = (),
    known: Mapping[str, float] | None = None,
) -> None:
    """Evaluate a compiled model at rest; where it is not finite, find the effect that makes it so.

    Parameters
    ----------
    compiled : the model with all effects in use. effects : those, under their own labels.
    candidates : more of them, which are asked at rest alone, where the compiled model is no number:
        where the system itself is one only elsewhere, the records say whether they are
        (``undefined_effects_along``).
    known : values of parameters by name, in place of the system's own (``System.defaults``).

    Raises
    ------
    PluginError : the name of the effect, or of the system whose own rates are no numbers.
    """
    values = {**system.defaults, **(known or {})}
    parts = _evaluate_compiled_at_rest(compiled, values)
    if _is_all_finite(parts):
        return
    bare = trace(system, ())
    asked = ((place, _evaluate_traced_at_rest(bare, values, place)) for place in _PLACES)
    finite = next(((p, parts) for p, parts in asked if np.isfinite(parts[0]).all()), None)
    if finite is None:
        name = getattr(system, "path", "") or system.plugin_name()
        zero = [p.name for p in system.parameters if p.start == 0]
        raise _not_finite_error(f"system {system.title!r}", name, _PLACES[-1], zero)
    where, alone = finite
    if where is _AT_ZERO and not _is_all_finite(alone) and np.isfinite(parts[0]).all():
        return  # slopes of the system itself are no numbers there, and all effects have values
    for effect in (*effects, *(candidates if where is _AT_ZERO else ())):
        if not _is_number_beside(system, effect, tuple(values.items()), where):
            raise _not_finite_error(f"effect {effect.label!r}", effect.plugin_name(), where)


@kept(1024)
def _is_number_beside(
    system: System, effect: Effect, known: tuple[tuple[str, float], ...], where: _Rest
) -> bool:
    """Whether a system with an effect is a number, and its slopes where they are without it.

    Every study of the same problem asks this of all candidates: once for each.
    """
    values = dict(known)
    alone = _evaluate_traced_at_rest(trace(system, ()), values, where)
    beside = _evaluate_traced_at_rest(trace(system, (effect,)), values, where)
    return _is_all_finite(beside if _is_all_finite(alone) else beside[:1])


def is_finite_along(compiled: CompiledModel, row: Array, states: Array, inputs: Array) -> bool:
    """Whether a compiled model and its slopes are numbers at some states and inputs.

    Parameters
    ----------
    row : (parameters,) values, 0 where none is known; a parameter of the system then takes 1 or
        what its bounds allow. states : (points, n) of the system, states that effects bring are at
        zero. inputs : (points, columns).
    """
    traced = compiled.traced
    x = np.zeros((len(states), len(traced.states)))
    x[:, : states.shape[1]] = states
    p = _trial_values(traced, dict(zip(traced.keys, row, strict=False)))
    return all(
        _is_all_finite(_evaluate_compiled(compiled, at, u, p))
        for at, u in zip(x, inputs, strict=True)
    )


def undefined_effects_along(
    system: System,
    effects: Sequence[Effect],
    values: Mapping[str, float],
    states: Array,
    inputs: Array,
) -> tuple[str, ...]:
    """Labels of the effects that are no numbers, values or slopes, at some of these states."""
    labels = []
    for effect in effects:
        traced = trace(system, (effect,))
        own = np.zeros((len(traced.x) - states.shape[1], len(states)))
        given = [*states.T, *own, *inputs.T, *_trial_values(traced, values)]
        if not _is_all_finite(_evaluate_traced(traced, given)):
            labels.append(effect.label)
    return tuple(labels)


def _not_finite_error(who: str, name: str, where: _Rest, zero: Sequence[str] = ()) -> PluginError:
    first = f"another value than zero of {', '.join(zero)}; " if zero else ""
    beside = "" if where is _AT_ZERO else f", nor {where.told}"
    return PluginError(
        f"{who} is no number at rest (zero states and inputs){beside}",
        "finite values and slopes there",
        f"{first}spiral.math.length for |q|, a smooth form such as tanh(v/w), or a state that "
        f"begins elsewhere (start); spiral check {name}",
    )


def _is_all_finite(parts: Sequence[Array]) -> bool:
    return all(bool(np.isfinite(part).all()) for part in parts)


def _trial_value(parameter: Parameter) -> float:
    """A first value where there is one, else 1 or what its bounds allow."""
    if parameter.start is not None:
        return parameter.start
    low, high = parameter.lower, parameter.upper
    return 1.0 if high is None or high > 1 else (high + (low or 0.0)) / 2


def _values_at_rest(traced: TracedModel, known: Mapping[str, float]) -> Array:
    """(parameters,) values at which a model is asked at rest: of effects, 1 where none is known."""
    pairs = zip(traced.keys, traced.parameters, strict=True)
    return np.array([known.get(k) or _trial_value(q) for k, q in pairs], float)


def _trial_values(traced: TracedModel, known: Mapping[str, float]) -> Array:
    """(parameters,) values along a motion: of effects, 0 where none is known."""
    pairs = zip(traced.keys, traced.parameters, strict=True)
    return np.array(
        [known.get(k) or (_trial_value(q) if k.startswith("system.") else 0.0) for k, q in pairs],
        float,
    )


def _evaluate_compiled_at_rest(compiled: CompiledModel, known: Mapping[str, float]) -> list[Array]:
    """f, h, then their slopes."""
    traced = compiled.traced
    x, u = np.zeros(len(traced.states)), np.zeros(len(traced.inputs))
    return _evaluate_compiled(compiled, x, u, _values_at_rest(traced, known))


def _evaluate_compiled(compiled: CompiledModel, x: Array, u: Array, p: Array) -> list[Array]:
    traced = compiled.traced
    x, u = np.ascontiguousarray(x), np.ascontiguousarray(u)
    values, slopes = [], []
    for function, count in (
        (compiled.rate, len(x)),
        (compiled.output, len(traced.channels)),
    ):
        value = np.zeros(count)
        by_x, by_p = np.zeros((count, len(x))), np.zeros((count, len(p)))
        function(x, u, p, value, by_x, by_p)
        values.append(value)
        slopes += [by_x.ravel(), by_p.ravel()]
    return [np.concatenate(values), *slopes]


def _evaluate_traced_at_rest(
    traced: TracedModel, known: Mapping[str, float], where: _Rest
) -> list[Array]:
    """The same from expressions, without compiling."""
    states, inputs = (np.full(len(symbols), where.value) for symbols in (traced.x, traced.u))
    if where.declared:
        fill_declared_starts(traced, states, inputs)
    given = [*states, *inputs, *_values_at_rest(traced, known)]
    return _evaluate_traced(traced, [np.float64(v) for v in given])


def _evaluate_traced(traced: TracedModel, given: Sequence[Any]) -> list[Array]:
    """Values of f and h, then their slopes, each (entries, points) where points are given."""
    import sympy as sp

    symbols = [*traced.x, *traced.u, *traced.p]
    values = []
    slopes = (traced.rate_x, traced.rate_p, traced.output_x, traced.output_p)
    for flat in ([*traced.rate, *traced.output], *(m.flat() for m in slopes)):
        with np.errstate(all="ignore"):
            numbers = sp.lambdify(symbols, flat, "numpy")(*given) if flat else []
        values.append(np.array(np.broadcast_arrays(*numbers), dtype=float))
    return values
