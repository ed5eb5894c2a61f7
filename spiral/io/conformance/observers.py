"""Conformance checks of observers: each returns what it saw, or raises an error."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from spiral.engine.filter.observer import Observer, Reconstruction
from spiral.engine.filter.task import FilterInput, prepare_task
from spiral.inference.simulate import simulate, with_defaults
from spiral.io.conformance.simulation import stable_time_steps
from spiral.types.errors import ConfigError, PluginError
from spiral.types.model import seed_model
from spiral.types.record import Array
from spiral.types.system import System

_SAMPLES = 800
_NOISE = 0.02
_LOST = 0.5  # error of a measured state, over its deviation, that no observer may have
_ROUND = 1e-9  # what rounding may make of a symmetric matrix, of its largest entry


def tasks(systems: Sequence[System]) -> tuple[FilterInput, ...]:
    """A short record of every system with nominal values: a step of all inputs, 2 % noise."""
    prepared = []
    for system in systems:
        model = with_defaults(seed_model(system))
        if any(q.start is None and k not in model.values for k, q in model.pairs):
            continue
        time = stable_time_steps(system, model)[1] * np.arange(_SAMPLES)
        given = {i.name: np.ones(_SAMPLES) for i in system.inputs if i.derived_from is None}
        if not given:  # nothing drives it from rest
            continue
        record = simulate(model, time, given, _NOISE, np.random.default_rng(0), substeps=1)
        prepared.append(prepare_task(model, record))
    return tuple(prepared)


class ObserverRuns:
    """An observer over the short records; each is reconstructed once, when first asked for."""

    def __init__(self, observer: Observer, systems: Sequence[System]) -> None:
        self.observer = observer
        self.systems = systems
        self._found: list[tuple[FilterInput, Reconstruction]] | None = None
        self._refused: list[str] = []

    def reconstructions(self) -> list[tuple[FilterInput, Reconstruction]]:
        """(task, reconstruction) of each record that the observer does not refuse.

        Raises
        ------
        PluginError : it refuses all of them.
        """
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
        names = [t.model.system.plugin_name() for t, _ in self.reconstructions()]
        return ", ".join(names) + (f"; refused: {len(self._refused)}" if self._refused else "")


def check_reconstruction(watched: ObserverRuns) -> str:
    """Means and deviations (samples, N): the model's states first, finite down to the last."""
    for task, reconstruction in watched.reconstructions():
        count = len(task.states)
        if reconstruction.names[:count] != task.states:
            raise PluginError(f"names {reconstruction.names}", f"the states {task.states} first")
        shape = (task.series.samples, len(reconstruction.names))
        for what, part in (
            ("means", reconstruction.means),
            ("deviations", reconstruction.deviations),
        ):
            if part.shape != shape:
                raise PluginError(f"{what} of shape {part.shape}", f"{shape}")
        given = ~np.isnan(reconstruction.means).all(
            axis=0
        )  # a state that it does not give is all NaN
        if reconstruction.done != shape[0] or not np.isfinite(reconstruction.means[:, given]).all():
            raise PluginError(f"it ran away after {reconstruction.done} samples", f"all {shape[0]}")
        if not (reconstruction.deviations[:, given] >= 0).all():
            raise PluginError("a standard deviation below zero, or none", "zero or above")
    return watched.told


def check_covariances(watched: ObserverRuns) -> str:
    """P = P^T, no eigenvalue below zero, its diagonal the squared deviations; or none at all."""
    seen = False
    for task, reconstruction in watched.reconstructions():
        if not len(reconstruction.covariances):
            continue
        seen, size = True, len(reconstruction.names)
        if reconstruction.covariances.shape != (task.series.samples, size, size):
            shape = (task.series.samples, size, size)
            raise PluginError(
                f"covariances of shape {reconstruction.covariances.shape}", f"{shape}"
            )
        unit = _correlation_matrices(reconstruction.covariances)
        _check_symmetric("covariances", unit)
        if np.linalg.eigvalsh(unit).min() < -1e-6:
            raise PluginError("a covariance with a negative eigenvalue", "none below zero")
        diagonal = np.diagonal(reconstruction.covariances, axis1=1, axis2=2)
        if not np.allclose(diagonal, reconstruction.deviations**2, rtol=1e-6, atol=0):
            raise PluginError("deviations unlike the covariances' diagonal", "its square root")
    return "symmetric, none below zero" if seen else "none given"


def check_innovations(watched: ObserverRuns) -> str:
    """v (samples, channels) and S = S^T > 0 with a finite likelihood; or none at all."""
    seen = False
    for task, reconstruction in watched.reconstructions():
        if not len(reconstruction.innovations):
            continue
        seen = True
        samples, m = task.series.y.shape
        if reconstruction.innovations.shape != (samples, m) or reconstruction.spreads.shape != (
            samples,
            m,
            m,
        ):
            shapes = f"{reconstruction.innovations.shape} and {reconstruction.spreads.shape}"
            raise PluginError(
                f"innovations and spreads of shapes {shapes}", f"{(samples, m)}, {(samples, m, m)}"
            )
        unit = _correlation_matrices(reconstruction.spreads)
        _check_symmetric("spreads", unit)
        if not (np.linalg.eigvalsh(unit).min() > 0 and np.isfinite(reconstruction.log_likelihood)):
            raise PluginError("spreads that are no covariance", "positive, with a likelihood")
    return "finite, with positive spreads" if seen else "none given"


def check_tracking_error(watched: ObserverRuns) -> str:
    """Measured states are followed: off by less than half their own motion."""
    worst = 0.0
    for task, reconstruction in watched.reconstructions():
        truth = task.series.record.truth
        for name in set(task.compiled.traced.channels) & set(task.states):
            true = truth[name]
            error = float(
                np.sqrt(np.mean((reconstruction.state(name)[0] - true) ** 2)) / np.std(true)
            )
            if not error < _LOST:
                system = task.model.system.plugin_name()
                raise PluginError(
                    f"{name} of {system} is off by {error:.2g} of its motion", f"under {_LOST:g}"
                )
            worst = max(worst, error)
    return f"at most {worst:.2g} of the motion"


def check_repeatable_reconstruction(watched: ObserverRuns) -> str:
    """The same record gives the same numbers, and the record stays as it is."""
    task, once = watched.reconstructions()[0]
    before = task.series.y.copy(), task.inputs.copy(), task.values.copy(), task.start.copy()
    again = watched.observer.reconstruct(task)
    after = task.series.y, task.inputs, task.values, task.start
    if not all(np.array_equal(a, b) for a, b in zip(before, after, strict=True)):
        raise PluginError("a task changed in place", "arrays left as they were")
    if not np.array_equal(once.means, again.means, equal_nan=True):
        raise PluginError("two reconstructions that differ", "the same numbers each time")
    return "same numbers"


def _correlation_matrices(matrices: Array) -> Array:
    """Each matrix over its own deviations, so that units do not matter."""
    size = np.sqrt(np.maximum(np.diagonal(matrices, axis1=1, axis2=2), 1e-300))
    return matrices / (size[:, :, None] * size[:, None, :])


def _check_symmetric(what: str, unit: Array) -> None:
    if not np.isfinite(unit).all():
        raise PluginError(f"{what} that are not finite", "finite numbers")
    if not np.abs(unit - np.swapaxes(unit, 1, 2)).max() <= _ROUND:
        raise PluginError(f"{what} that are not symmetric", "P = P^T")
