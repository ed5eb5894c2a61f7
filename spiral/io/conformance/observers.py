"""What the conformance suite looks at in observers: functions that return what was seen."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from spiral.engine.filter.observer import Observer, Reconstruction
from spiral.engine.filter.task import Task, prepare_task
from spiral.inference.simulate import simulate, with_defaults
from spiral.io.conformance.physics import time_step
from spiral.types.errors import ConfigError, PluginError
from spiral.types.model import seed_model
from spiral.types.record import Array
from spiral.types.system import System

_SAMPLES = 800
_NOISE = 0.02
_LOST = 0.5  # error of a measured state, over its deviation, that no observer may have
_ROUND = 1e-9  # what rounding may make of a symmetric matrix, of its largest entry


def tasks(systems: Sequence[System]) -> tuple[Task, ...]:
    """A short record of every system with nominal values: a step of all inputs, 2 % noise."""
    found = []
    for system in systems:
        model = with_defaults(seed_model(system))
        if any(q.start is None and k not in model.values for k, q in model.pairs):
            continue
        time = time_step(system, model) * np.arange(_SAMPLES)
        given = {i.name: np.ones(_SAMPLES) for i in system.inputs if i.derived_from is None}
        if not given:  # nothing drives it from rest
            continue
        record = simulate(model, time, given, _NOISE, np.random.default_rng(0), substeps=1)
        found.append(prepare_task(model, record))
    return tuple(found)


class Watched:
    """An observer over the short records; each is reconstructed once, when first asked for."""

    def __init__(self, observer: Observer, systems: Sequence[System]) -> None:
        self.observer = observer
        self.systems = systems
        self._found: list[tuple[Task, Reconstruction]] | None = None
        self._refused: list[str] = []

    def found(self) -> list[tuple[Task, Reconstruction]]:
        """Tasks with what the observer made of them; refusals that say what to change are left."""
        if self._found is None:
            self._found = []
            for task in tasks(self.systems):
                try:
                    self._found.append((task, self.observer.reconstruct(task)))
                except ConfigError as error:
                    self._refused.append(error.given)
        if not self._found:
            raise PluginError("; ".join(self._refused) or "no record", "states of one system")
        return self._found

    @property
    def told(self) -> str:
        """Which systems it was tried on."""
        names = [t.model.system.plugin_name() for t, _ in self.found()]
        return ", ".join(names) + (f"; refused: {len(self._refused)}" if self._refused else "")


def reconstructs(watched: Watched) -> str:
    """Means and deviations (samples, N): the model's states first, finite down to the last."""
    for task, found in watched.found():
        count = len(task.states)
        if found.names[:count] != task.states:
            raise PluginError(f"names {found.names}", f"the states {task.states} first")
        shape = (task.series.samples, len(found.names))
        for what, part in (("means", found.means), ("deviations", found.deviations)):
            if part.shape != shape:
                raise PluginError(f"{what} of shape {part.shape}", f"{shape}")
        given = ~np.isnan(found.means).all(axis=0)  # a state that it does not give is all NaN
        if found.done != shape[0] or not np.isfinite(found.means[:, given]).all():
            raise PluginError(f"it ran away after {found.done} samples", f"all {shape[0]}")
        if not (found.deviations[:, given] >= 0).all():
            raise PluginError("a standard deviation below zero, or none", "zero or above")
    return watched.told


def covariances(watched: Watched) -> str:
    """P = P^T, no eigenvalue below zero, its diagonal the squared deviations; or none at all."""
    seen = False
    for task, found in watched.found():
        if not len(found.covariances):
            continue
        seen, size = True, len(found.names)
        if found.covariances.shape != (task.series.samples, size, size):
            shape = (task.series.samples, size, size)
            raise PluginError(f"covariances of shape {found.covariances.shape}", f"{shape}")
        unit = _scaled(found.covariances)
        _symmetric("covariances", unit)
        if np.linalg.eigvalsh(unit).min() < -1e-6:
            raise PluginError("a covariance with a negative eigenvalue", "none below zero")
        diagonal = np.diagonal(found.covariances, axis1=1, axis2=2)
        if not np.allclose(diagonal, found.deviations**2, rtol=1e-6, atol=0):
            raise PluginError("deviations unlike the covariances' diagonal", "its square root")
    return "symmetric, none below zero" if seen else "none given"


def innovations(watched: Watched) -> str:
    """v (samples, channels) and S = S^T > 0 with a finite likelihood; or none at all."""
    seen = False
    for task, found in watched.found():
        if not len(found.innovations):
            continue
        seen = True
        samples, m = task.series.y.shape
        if found.innovations.shape != (samples, m) or found.spreads.shape != (samples, m, m):
            shapes = f"{found.innovations.shape} and {found.spreads.shape}"
            raise PluginError(
                f"innovations and spreads of shapes {shapes}", f"{(samples, m)}, {(samples, m, m)}"
            )
        unit = _scaled(found.spreads)
        _symmetric("spreads", unit)
        if not (np.linalg.eigvalsh(unit).min() > 0 and np.isfinite(found.log_likelihood)):
            raise PluginError("spreads that are no covariance", "positive, with a likelihood")
    return "finite, with positive spreads" if seen else "none given"


def follows(watched: Watched) -> str:
    """Measured states are followed: off by less than half their own motion."""
    worst = 0.0
    for task, found in watched.found():
        truth = task.series.record.truth
        for name in set(task.compiled.traced.channels) & set(task.states):
            true = truth[name]
            error = float(np.sqrt(np.mean((found.state(name)[0] - true) ** 2)) / np.std(true))
            if not error < _LOST:
                system = task.model.system.plugin_name()
                raise PluginError(
                    f"{name} of {system} is off by {error:.2g} of its motion", f"under {_LOST:g}"
                )
            worst = max(worst, error)
    return f"at most {worst:.2g} of the motion"


def reconstructs_again(watched: Watched) -> str:
    """The same record gives the same numbers, and the record stays as it is."""
    task, once = watched.found()[0]
    before = task.series.y.copy(), task.inputs.copy(), task.values.copy(), task.start.copy()
    again = watched.observer.reconstruct(task)
    after = task.series.y, task.inputs, task.values, task.start
    if not all(np.array_equal(a, b) for a, b in zip(before, after, strict=True)):
        raise PluginError("a task changed in place", "arrays left as they were")
    if not np.array_equal(once.means, again.means, equal_nan=True):
        raise PluginError("two reconstructions that differ", "the same numbers each time")
    return "same numbers"


def _scaled(matrices: Array) -> Array:
    """Each matrix over its own deviations, so that units do not matter."""
    size = np.sqrt(np.maximum(np.diagonal(matrices, axis1=1, axis2=2), 1e-300))
    return matrices / (size[:, :, None] * size[:, None, :])


def _symmetric(what: str, unit: Array) -> None:
    if not np.isfinite(unit).all():
        raise PluginError(f"{what} that are not finite", "finite numbers")
    if not np.abs(unit - np.swapaxes(unit, 1, 2)).max() <= _ROUND:
        raise PluginError(f"{what} that are not symmetric", "P = P^T")
