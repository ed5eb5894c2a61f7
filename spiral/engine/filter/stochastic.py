"""Records whose truth is a stochastic differential equation, x' = f(x, u, p) + w.

    x_{k+1} = RK4(x_k) + sqrt(Q_ii h) N(0, 1)

at every integration step h: the drift is of fourth order, the additive noise of strong order one.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from spiral.engine.filter.noise import noise_intensity
from spiral.engine.filter.task import FilterInput
from spiral.types.errors import ConfigError
from spiral.types.record import Array, Record


def simulate_disturbed(
    task: FilterInput,
    levels: Mapping[str, float],
    noise_level: float,
    rng: np.random.Generator,
    start: Array | None = None,
) -> Record:
    """A record of the task's model under its inputs, with real process noise and white noise.

    Parameters
    ----------
    levels : process noise by group, as ``spiral.engine.filter.noise`` defines it.
    noise_level : measurement noise as a share of each channel's standard deviation; declared.
    start : (n,) state at the first sample; rest where left out.

    Raises
    ------
    ConfigError : a motion that grows without bound.
    """
    from spiral.engine.filter.stochastic_kernel import disturbed_trajectory

    series, n = task.series, len(task.states)
    steps = (series.samples - 1) * series.substeps
    step = series.dt / series.substeps
    kicks = rng.normal(size=(steps, n)) * np.sqrt(noise_intensity(task, levels) * step)
    states, readings = np.empty((series.samples, n)), np.empty_like(series.y)
    first = np.zeros(n) if start is None else np.array(start, dtype=float)
    ok = disturbed_trajectory(
        task.compiled.rate_value, task.compiled.output_value, first, task.values, task.inputs,
        series.substeps, series.dt, kicks, states, readings,
    )  # fmt: skip
    if not ok:
        raise ConfigError("a disturbed motion that grows without bound", "a smaller process noise")
    names = series.record.channels
    noise = {c: noise_level * float(np.std(readings[:, j])) for j, c in enumerate(names)}
    noisy = readings + rng.normal(size=readings.shape) * np.array(list(noise.values()))
    return replace(
        series.record,
        name="disturbed",
        channels={c: noisy[:, j] for j, c in enumerate(names)},
        noise={c: s for c, s in noise.items() if s > 0},
        truth={s: states[:, i] for i, s in enumerate(task.states)},
    )
