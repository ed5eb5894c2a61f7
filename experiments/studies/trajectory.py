"""The true motion: x' = f(t, x, u, v) by SciPy's DOP853, from equations written by hand."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from itertools import pairwise
from types import SimpleNamespace

import numpy as np

from experiments.studies.signals import Signal, Steps

Array = np.ndarray


class Values(dict[str, float]):
    """Numbers of a machine by full name; an effect that is not there has zeros."""

    def __missing__(self, key: str) -> float:
        return 0.0


Rate = Callable[[Array, SimpleNamespace, Values], Array]
"""(states, inputs, values) -> time derivatives; ``inputs.time`` is the time in s."""


def trajectory(
    rate: Rate,
    start: Array,
    time: Array,
    signals: Mapping[str, Signal],
    values: Mapping[str, float],
    tolerance: float = 1e-9,
) -> Array:
    """States (samples, n) of the true motion.

    The absolute tolerance of a state is ``tolerance`` of its largest value in a coarse run over the
    first quarter.
    Where a stepped input jumps the integration begins anew.

    Raises
    ------
    FloatingPointError : the motion runs away, or the integrator gives up.
    """
    known = Values(values)
    some = time[: max(2, len(time) // 4)]
    coarse = _integrated(rate, start, some, signals, known, 1e-4, np.full(len(start), 1e-9))
    scale = np.abs(coarse).max(axis=0)
    least = np.where(scale > 0, scale, 1.0) * tolerance
    return _integrated(rate, start, time, signals, known, tolerance, least)


def _integrated(
    rate: Rate,
    start: Array,
    time: Array,
    signals: Mapping[str, Signal],
    values: Values,
    relative: float,
    absolute: Array,
) -> Array:
    from scipy.integrate import solve_ivp

    found, x = [start[None, :]], start
    moving = {k: s for k, s in signals.items() if not isinstance(s, Steps)}
    for first, last in _pieces(time, signals):
        middle = 0.5 * (time[first] + time[first + 1])
        held = {k: s(middle) for k, s in signals.items() if k not in moving}

        def slope(t: float, x: Array, held: dict[str, Array] = held) -> Array:
            now = {k: s(t) for k, s in moving.items()}  # type: ignore[arg-type]
            return rate(x, SimpleNamespace(time=t, **held, **now), values)

        part = solve_ivp(
            slope, (time[first], time[last]), x, "DOP853", time[first + 1 : last + 1],
            rtol=relative, atol=absolute,
        )  # fmt: skip
        if not part.success or not np.all(np.isfinite(part.y)):
            raise FloatingPointError(f"the motion runs away: {part.message}")
        found.append(part.y.T)
        x = part.y[:, -1]
    return np.concatenate(found)


def _pieces(time: Array, signals: Mapping[str, Signal]) -> list[tuple[int, int]]:
    """Samples between which no stepped input changes."""
    changed = np.zeros(len(time), dtype=bool)
    for signal in signals.values():
        if isinstance(signal, Steps):
            changed[1:] |= np.diff(signal(time)) != 0.0
    inner = np.flatnonzero(changed)
    edges = [0, *(int(i) for i in inner if 0 < i < len(time) - 1), len(time) - 1]
    return list(pairwise(edges))
