"""The true motion: DOP853, or where a random force acts fixed fine steps.

    x_{n+1} = RK4 step of x' = f(x, u(t), push_n),  push_n constant over the step h

With push_n = s N(0, 1) / sqrt(h) this is a force of white noise of density s^2, and the step that
of Euler and Maruyama in the noise (strong order 1, the noise being additive), of fourth order in
all else.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import SimpleNamespace

import numpy as np

from experiments.imperfections.scenes import Scene
from experiments.studies.signals import Signal
from experiments.studies.trajectory import Values, trajectory

Array = np.ndarray
FINE = 10  # steps for each sample
Push = Callable[[np.random.Generator, int, float], Array]
"""(what draws, steps, step in s) -> a random force of unit size at each step, one axis."""


def undisturbed(scene: Scene, values: Mapping[str, float], signals: Mapping[str, Signal]) -> Array:
    """States (samples, n) without a random force."""
    still = np.zeros(scene.axes)
    start = np.zeros(2 * scene.axes)
    return trajectory(scene.rate, start, scene.time(), {**signals, "push": lambda t: still}, values)


def disturbed(
    scene: Scene,
    values: Mapping[str, float],
    signals: Mapping[str, Signal],
    push: Push,
    share: float,
    rng: np.random.Generator,
) -> Array:
    """States with a random force that makes this share of the motion.

    share = rms(y_with - y_without) / std(y_without), mean over channels, on the machine with
    nothing hidden: it is linear, so that the share grows with the force in proportion.
    """
    step = 1.0 / scene.samples_per_s / FINE
    count = (len(scene.time()) - 1) * FINE
    force = np.column_stack([push(rng, count, step) for _ in range(scene.axes)])
    plain = undisturbed(scene, scene.values, signals)[:, : scene.axes]
    silent = dict.fromkeys(signals, _silent)
    alone = stepped(scene, scene.values, silent, force)[:, : scene.axes]
    reached = np.mean(np.sqrt(np.mean(alone**2, axis=0)) / plain.std(axis=0))
    return stepped(scene, values, signals, share / float(reached) * force)


def _silent(time: Array) -> Array:
    return 0.0 * time


def stepped(
    scene: Scene, values: Mapping[str, float], signals: Mapping[str, Signal], force: Array
) -> Array:
    """States (samples, n) under a force (steps, axes) that is constant over each fine step."""
    known, h = Values(values), 1.0 / scene.samples_per_s / FINE
    half = np.arange(2 * len(force) + 1) * (h / 2)
    series = {k: np.broadcast_to(s(half), half.shape) for k, s in signals.items()}
    names = list(series)
    columns = np.column_stack([*series.values(), half])
    x = np.zeros(2 * scene.axes)
    found = np.empty((len(scene.time()), len(x)))
    found[0] = x

    def slope(x: Array, at: int, push: Array) -> Array:
        row = columns[at]
        now = SimpleNamespace(push=push, time=row[-1])
        for name, value in zip(names, row, strict=False):
            setattr(now, name, value)
        return scene.rate(x, now, known)

    for n, push in enumerate(force):
        a = slope(x, 2 * n, push)
        b = slope(x + h / 2 * a, 2 * n + 1, push)
        c = slope(x + h / 2 * b, 2 * n + 1, push)
        d = slope(x + h * c, 2 * n + 2, push)
        x = x + h / 6 * (a + 2 * b + 2 * c + d)
        if (n + 1) % FINE == 0:
            found[(n + 1) // FINE] = x
    return found
