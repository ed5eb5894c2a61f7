"""Conformance check of a system in motion: x' = f(x, u, p) integrated with inputs u held."""

from __future__ import annotations

from itertools import product
from typing import TYPE_CHECKING

import numpy as np

from spiral.io.conformance.physics import Physics, require_finite_rows, rest_states
from spiral.types.errors import ConfigError, PluginError
from spiral.types.formatting import duration
from spiral.types.system import System

if TYPE_CHECKING:
    from spiral.types.model import Model

_SAMPLES = 8192  # of the short simulated record: exp(819) of the fastest motion is infinite
_USUAL = 1e-3  # s
_LEVELS = tuple(10.0**-k for k in range(16))  # of inputs, tried in turn until it stays finite


def check_simulation(system: System) -> str:
    """A short record with every input held at one, where all values are known.

    Where that is too much for the machine (an ampere into a cell) inputs are a tenth as large, and
    so on.
    """
    from spiral.inference.simulate import integrate, with_defaults
    from spiral.types.model import seed_model

    model = with_defaults(seed_model(system))
    unknown = [k for k, q in model.pairs if q.start is None and k not in model.values]
    if unknown:
        return f"not tried: no nominal value for {', '.join(unknown)}"
    names = [i.name for i in system.inputs if i.derived_from is None]
    steps = dict.fromkeys(stable_time_steps(system, model))  # often one
    times = [step * np.arange(_SAMPLES) for step in steps]
    for level, time in product(_LEVELS if names else _LEVELS[:1], times):
        try:
            states, _ = integrate(model, time, {n: np.full(_SAMPLES, level) for n in names})
        except ConfigError:  # it grows without bound
            continue
        if np.isfinite(states).all():
            held = f", each input held at {level:.0e}" if level < 1 else ""
            return f"{_SAMPLES} samples simulated, one every {duration(time[1])}{held}"
    sizes = f", with inputs of 1 and of all sizes down to {_LEVELS[-1]:.0e}" if names else ""
    raise PluginError(
        f"a simulation of {times[0][-1]:.3g} s that grows without bound{sizes}",
        "nominal values of a motion that stays finite",
        "check signs and sizes of the parameters' values; a machine that only its controller holds "
        "grows so by itself, and is studied all the same",
    )


def stable_time_steps(system: System, model: Model) -> tuple[float, float]:
    """A tenth of the fastest motion about rest, in s; and no more than 1 ms of it.

    Away from rest a machine may move much faster.
    """
    physics = Physics(system, model.effects)
    traced = physics.compiled.traced
    p = np.array([float(model.values.get(k, q.start or 0.0)) for k, q in model.pairs])
    value, slopes, by_p = physics.evaluate(rest_states(traced), np.zeros(len(traced.u)), p)
    require_finite_rows(physics, value, np.hstack([slopes, by_p]))
    fastest = float(np.abs(np.linalg.eigvals(slopes[: len(traced.x)])).max())
    step = 0.1 / fastest if fastest > 0 else _USUAL
    return step, min(_USUAL, step)
