"""Physics at rest: f, h and their slopes at zero states and inputs must be numbers.

A system of which a state is never zero (a pressure under a logarithm, a concentration that divides)
is asked at ones instead.

One effect with 0/0 at rest (v/|v|) makes every column of a study NaN, so it is named before a fit.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from spiral.physics.compile import CompiledModel
from spiral.physics.trace import TracedModel, trace
from spiral.types.effect import Effect
from spiral.types.errors import PluginError
from spiral.types.parameter import Parameter
from spiral.types.system import System

Array = np.ndarray


def check_rest(
    compiled: CompiledModel,
    system: System,
    effects: Sequence[Effect],
    candidates: Sequence[Effect] = (),
) -> None:
    """Evaluate a compiled model at rest; where it is not finite, find the effect that makes it so.

    Parameters
    ----------
    compiled : the model with all effects in use. effects : those, under their own labels.
    candidates : more of them, which are asked at rest alone: where the system itself is a number
        only elsewhere, the records say whether they are (``undefined_effects_along``).

    Raises
    ------
    PluginError : the name of the effect, or of the system whose own rates are no numbers.
    """
    if _is_all_finite(_evaluate_compiled_at_rest(compiled)):
        return
    at, bare = 0.0, trace(system, ())
    alone = _evaluate_traced_at_rest(bare)
    if not np.isfinite(alone[0]).all():  # a logarithm, or a quotient, of what is never zero
        at, alone = 1.0, _evaluate_traced_at_rest(bare, 1.0)
    if not np.isfinite(alone[0]).all():
        raise _not_finite_error(f"system {system.plugin_name()!r}", system.plugin_name(), at)
    for effect in (*effects, *(() if at else candidates)):
        beside = _evaluate_traced_at_rest(trace(system, (effect,)), at)
        if (_is_all_finite(alone) and not _is_all_finite(beside)) or not np.isfinite(
            beside[0]
        ).all():
            raise _not_finite_error(f"effect {effect.label!r}", effect.plugin_name(), at)


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
    given = zip(traced.keys, row, traced.parameters, strict=False)
    p = np.array([v or _trial_value(q) if k.startswith("system.") else v for k, v, q in given])
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
        p = [
            (values.get(k) or _trial_value(q)) if k.startswith("system.") else values.get(k, 0.0)
            for k, q in zip(traced.keys, traced.parameters, strict=True)
        ]
        own = np.zeros((len(traced.x) - states.shape[1], len(states)))
        given = [*states.T, *own, *inputs.T, *np.array(p, float)]
        if not _is_all_finite(_evaluate_traced(traced, given)):
            labels.append(effect.label)
    return tuple(labels)


def _not_finite_error(who: str, name: str, at: float) -> PluginError:
    beside = ", nor where all are one" if at else ""
    return PluginError(
        f"{who} is no number at rest (zero states and inputs){beside}",
        "finite values and slopes there",
        f"spiral.math.length for |q|, a smooth form such as tanh(v/w); spiral check {name}",
    )


def _is_all_finite(parts: Sequence[Array]) -> bool:
    return all(bool(np.isfinite(part).all()) for part in parts)


def _trial_value(parameter: Parameter) -> float:
    """A first value where there is one, else 1 or what its bounds allow."""
    if parameter.start is not None:
        return parameter.start
    low, high = parameter.lower, parameter.upper
    return 1.0 if high is None or high > 1 else (high + (low or 0.0)) / 2


def _evaluate_compiled_at_rest(compiled: CompiledModel) -> list[Array]:
    """f, h, then their slopes."""
    traced = compiled.traced
    x, u = np.zeros(len(traced.states)), np.zeros(len(traced.inputs))
    return _evaluate_compiled(
        compiled, x, u, np.array([_trial_value(q) for q in traced.parameters], float)
    )


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


def _evaluate_traced_at_rest(traced: TracedModel, at: float = 0.0) -> list[Array]:
    """The same from expressions, without compiling; ``at`` in place of zero states and inputs."""
    states = np.full(len(traced.x) + len(traced.u), at)
    given = [*states, *(_trial_value(q) for q in traced.parameters)]
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
