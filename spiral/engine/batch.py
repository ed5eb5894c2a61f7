"""Many simulations of one model side by side, on a device that JAX knows.

    x' = f(x, u, p)         y = h(x, u, p)         d y / d p

The expressions and the classical Runge-Kutta steps are those of the compiled loop
(``kernel.trajectories``), in double precision; simulations are the fast axis of all arrays.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial, reduce
from typing import Any

import numpy as np
import sympy as sp

from spiral.engine.batch_inputs import InputColumn
from spiral.physics.array_evaluation import ArrayEvaluator
from spiral.physics.trace import TracedModel
from spiral.types.cache import kept
from spiral.types.errors import ConfigError
from spiral.types.record import Array

_STAGES = ((0.0, 1.0), (0.5, 2.0), (0.5, 2.0), (1.0, 1.0))  # point in the step, weight
_RUNAWAY = 1e12
_UNROLLED = {"cpu": 1000}  # operations of the steps that are written out one after the other
_UNROLLED_ELSEWHERE = 4000  # there a step of a loop costs a start of the device
_FUNCTION = 20  # operations that an elementary function counts for


@dataclass(frozen=True)
class BatchMotion:
    """States and readings, (simulations, samples) each, NaN from where a simulation ran away.

    ``slopes`` (simulations, samples, columns), one array for each channel.
    """

    states: tuple[Array, ...]
    readings: tuple[Array, ...]
    slopes: tuple[Array, ...]
    diverged: Array


def import_jax() -> Any:
    """The module ``jax``, an optional dependency.

    Raises
    ------
    ConfigError : it is not installed.
    """
    try:
        importlib.import_module("jax.numpy")
        importlib.import_module("jax.scipy.special")
        return importlib.import_module("jax")
    except ImportError as error:
        raise ConfigError(
            "a batch of simulations, and no JAX to run it",
            "the extra gpu",
            "pip install 'spiral-po[gpu]', for an NVIDIA card also 'jax[cuda12]'; "
            "or simulate one record after the other with spiral.simulate",
        ) from error


def find_device(name: str | None) -> Any:
    """A device by ``KIND`` or ``KIND:NUMBER`` (``cpu``, ``gpu``, ``gpu:1``); JAX's first if none.

    Raises
    ------
    ConfigError : no such device.
    """
    jax = import_jax()
    if name is None:
        return jax.devices()[0]
    kind, _, number = name.partition(":")
    try:
        return jax.devices(kind)[int(number or 0)]
    except (RuntimeError, ValueError, IndexError) as error:
        known = {f"{d.platform}:{d.id}" for d in (*jax.devices(), *jax.devices("cpu"))}
        raise ConfigError(
            f"device {name!r}",
            f"one that JAX finds here: {', '.join(sorted(known))}",
            "for an NVIDIA card: pip install 'jax[cuda12]'; or leave device out",
        ) from error


def integrate_batch(
    traced: TracedModel,
    starts: Array,
    parameters: Sequence[Array],
    inputs: Sequence[InputColumn],
    samples: int,
    step: float,
    substeps: int,
    by: Sequence[str] = (),
    device: Any = None,
) -> BatchMotion:
    """Integrate all simulations by classical Runge-Kutta and read the sensors.

    Parameters
    ----------
    starts : (simulations, states). parameters : one array each, (simulations,) or () for all.
    inputs : columns as of ``lay_out_inputs``. step : s between samples.
    substeps : integration steps per sample.
    by : parameters and states (their starts) that slopes of the readings are wanted for.
    device : of JAX; its default where left out.

    Raises
    ------
    ConfigError : no JAX. PluginError : a function that JAX lacks.
    """
    jax = import_jax()
    run, arguments = batch_call(
        traced, starts, parameters, inputs, samples, step, substeps, by, device
    )
    with double_precision():
        result = run(*jax.device_put(arguments, device))
        states, readings, slopes = (tuple(np.asarray(a) for a in group) for group in result)
    gone = np.isnan(states[0][:, -1]) if states else np.zeros(len(starts), dtype=bool)
    return BatchMotion(states, readings, slopes, gone)


def batch_call(
    traced: TracedModel, starts: Array, parameters: Sequence[Array],
    inputs: Sequence[InputColumn], samples: int, step: float, substeps: int,
    by: Sequence[str] = (), device: Any = None,
) -> tuple[Callable[..., Any], tuple[Any, ...]]:  # fmt: skip
    """The compiled function of ``integrate_batch`` and its arguments, not on the device yet."""
    most = _UNROLLED.get(getattr(device, "platform", "cpu"), _UNROLLED_ELSEWHERE)
    layout = (tuple(np.ndim(p) == 1 for p in parameters), tuple(c.layout for c in inputs))
    run = _compiled_batch(traced, layout, samples, substeps, tuple(by), most)
    return run, (
        tuple(np.ascontiguousarray(starts.T, dtype=float)),
        tuple(np.asarray(p, dtype=float) for p in parameters),
        tuple(c.parts for c in inputs),
        np.float64(step),
    )


def double_precision() -> Any:
    """A context in which JAX computes with 64 bits; elsewhere it goes on as its user has set it."""
    jax = import_jax()
    if hasattr(jax, "enable_x64"):
        return jax.enable_x64(True)
    return importlib.import_module("jax.experimental").enable_x64()  # before 0.8


Layout = tuple[tuple[bool, ...], tuple[tuple[bool, tuple[bool, ...]], ...]]
"""Which parameters differ between simulations; of each input whether it is stepped, which parts."""


@kept(32)
def _compiled_batch(
    traced: TracedModel, layout: Layout, samples: int, substeps: int, by: tuple[str, ...],
    unrolled: int,
) -> Callable[..., Any]:  # fmt: skip
    """The function of all simulations, compiled by JAX at its first call.

    ``unrolled`` operations are written out in a row: fewer turns of a loop, longer compilation.
    """
    jax, equations = import_jax(), _Equations(traced)
    columns = tuple(InputColumn((), stepped) for stepped, _ in layout[1])
    together = max(1, min(substeps, unrolled // (4 * equations.operations + 1)))
    grid = Grid(samples, substeps, together)
    one = partial(_simulate_one, equations, columns, grid, by)
    vary = tuple(0 if differs else None for differs in layout[0])
    inputs = tuple(tuple(1 if d else None for d in parts) for _, parts in layout[1])
    return jax.jit(jax.vmap(one, in_axes=(0, vary, inputs, None)))


@dataclass(frozen=True)
class Grid:
    """Samples, integration steps per sample, and how many of them are written out in a row."""

    samples: int
    substeps: int
    together: int


class _Equations:
    """Rates and readings of a model as functions of JAX's arrays."""

    def __init__(self, traced: TracedModel) -> None:
        self.traced = traced
        self.operations = _count_operations(traced.rate)
        self._erf = importlib.import_module("jax.scipy.special").erf
        self._library = importlib.import_module("jax.numpy")

    def rates(self, x: Sequence[Any], u: Sequence[Any], p: Sequence[Any]) -> tuple[Any, ...]:
        """f(x, u, p), a value for each state."""
        return self._values(self.traced.rate, x, u, p)

    def readings(self, x: Sequence[Any], u: Sequence[Any], p: Sequence[Any]) -> tuple[Any, ...]:
        """h(x, u, p), a value for each channel."""
        return self._values(self.traced.output, x, u, p)

    def _values(self, expressions: Any, *groups: Sequence[Any]) -> tuple[Any, ...]:
        names = (self.traced.x, self.traced.u, self.traced.p)
        pairs = (zip(n, g, strict=True) for n, g in zip(names, groups, strict=True))
        known = {symbol: value for group in pairs for symbol, value in group}
        evaluator = ArrayEvaluator(self._library, self._erf, known)
        asarray = partial(self._library.asarray, dtype=float)
        return tuple(asarray(evaluator.value(e)) for e in expressions)


def _count_operations(expressions: Sequence[sp.Expr]) -> int:
    """Operations of expressions, what occurs in several places counted once."""
    nodes = {node for e in expressions for node in sp.preorder_traversal(e) if node.args}
    functions = sum(isinstance(node, sp.Function | sp.exp) for node in nodes)
    return sum(max(1, len(node.args) - 1) for node in nodes) + _FUNCTION * functions


def _simulate_one(
    equations: _Equations, columns: Sequence[InputColumn], grid: Grid, by: tuple[str, ...],
    start: Any, parameters: Any, inputs: Any, step: Any,
) -> tuple[Any, Any, Any]:  # fmt: skip
    """States, readings and, where wanted, slopes of one simulation, of scalars at each sample."""
    run = partial(_trajectory, equations, columns, grid, step, inputs)
    if not by:
        return (*run(start, parameters), ())
    jax, n = import_jax(), len(start)
    names = (*equations.traced.states, *equations.traced.keys)
    places = [names.index(key) for key in by]
    values = [*start, *parameters]

    def moved(varied: Any) -> tuple[Any, Any]:
        here = list(values)
        for place, value in zip(places, varied, strict=True):
            here[place] = value
        states, readings = run(tuple(here[:n]), tuple(here[n:]))
        return readings, (states, readings)

    point = importlib.import_module("jax.numpy").stack([values[place] for place in places])
    slopes, (states, readings) = jax.jacfwd(moved, has_aux=True)(point)
    return states, readings, slopes


def _trajectory(
    equations: _Equations, columns: Sequence[InputColumn], grid: Grid, step: Any, inputs: Any,
    start: Any, p: Any,
) -> tuple[Any, Any]:  # fmt: skip
    """States and readings at every sample, one array for each."""
    lax, numpy = (importlib.import_module(f"jax.{name}") for name in ("lax", "numpy"))
    half_steps, each = 2 * grid.substeps, step / grid.substeps

    def stages(parts: Any, first: int) -> list[Any]:
        return [c.stage(own, first, half_steps) for c, own in zip(columns, parts, strict=True)]

    def advance(x: Any, u: Any) -> Any:
        return _runge_kutta(equations, x, u, p, each), None

    def to_next(x: Any, parts: Any) -> Any:
        readings = equations.readings(x, stages(parts, 0), p)
        steps = [[stages(parts, 2 * k + j) for j in range(3)] for k in range(grid.substeps)]
        if grid.together == grid.substeps:
            later = reduce(lambda state, u: advance(state, u)[0], steps, x)
        else:
            later, _ = lax.scan(advance, x, _stack(numpy, steps), unroll=grid.together)
        within = reduce(numpy.logical_and, [numpy.abs(v) <= _RUNAWAY for v in later])
        return tuple(numpy.where(within, v, numpy.nan) for v in later), (x, readings)

    return lax.scan(to_next, start, inputs, grid.samples)[1]


def _stack(numpy: Any, steps: Sequence[Sequence[Sequence[Any]]]) -> Any:
    """Inputs at the stages of all steps, one array for each stage and column."""
    return [
        [
            numpy.stack([numpy.asarray(v, dtype=float) for v in values])
            for values in zip(*stage, strict=True)
        ]
        for stage in zip(*steps, strict=True)
    ]


def _runge_kutta(equations: _Equations, x: Any, u: Any, p: Any, step: Any) -> tuple[Any, ...]:
    """One step; ``u`` at its start, middle and end."""
    total = slope = x
    for stage, (point, weight) in enumerate(_STAGES):
        here = [a + point * step * b for a, b in zip(x, slope, strict=True)] if stage else x
        slope = equations.rates(here, u[(stage + 1) // 2], p)
        total = [t + weight * b for t, b in zip(total, slope, strict=True)] if stage else slope
    return tuple(a + step / 6.0 * b for a, b in zip(x, total, strict=True))
