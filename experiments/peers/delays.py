"""Methods in surrogate coordinates: SINDy on delay coordinates, and HAVOK.

z = the leading right singular vectors of the Hankel matrix of y (Takens; Brunton et al. 2017).
Known inputs stand beside z in both. They name no terms: they are judged by prediction alone.
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from itertools import combinations_with_replacement

import numpy as np

from experiments.peers.cases import Answer
from experiments.peers.regressions import bic
from spiral.inference.problem import Problem
from spiral.types.record import Record

DELAYS, STRIDE = 24, 2
_KEPT = 0.8  # share of the record that a choice of rank and degree is fitted on
THRESHOLDS = (0.0, 1e-4, 1e-3, 1e-2)
_SETTLE = 0.1  # share of the test record before the free run starts


@dataclass(frozen=True)
class Embedding:
    """y (N, C) -> z (N - span, r): delays stacked, projected on the fit record's directions."""

    directions: np.ndarray
    centre: np.ndarray
    size: np.ndarray

    @property
    def span(self) -> int:
        """Samples before the first row."""
        return (DELAYS - 1) * STRIDE

    def __call__(self, y: np.ndarray) -> np.ndarray:
        """Coordinates of every sample that has its delays."""
        return hankel((y - self.centre) / self.size) @ self.directions

    def back(self, z: np.ndarray) -> np.ndarray:
        """The newest sample that coordinates stand for, (N, C)."""
        newest = self.directions[: len(self.size)]
        gram = self.directions.T @ self.directions
        return self.centre + self.size * (z @ np.linalg.solve(gram, newest.T))


def hankel(y: np.ndarray) -> np.ndarray:
    """Rows (y_k, y_{k - stride}, ...) of (N, C) samples."""
    span = (DELAYS - 1) * STRIDE
    return np.hstack([y[span - i * STRIDE : len(y) - i * STRIDE] for i in range(DELAYS)])


def embedded(y: np.ndarray, rank: int) -> Embedding:
    """The embedding of a record; coordinates have unit rms."""
    centre, size = y.mean(axis=0), y.std(axis=0)
    stacked = hankel((y - centre) / size)
    _, singular, right = np.linalg.svd(np.linalg.qr(stacked, mode="r"))
    scale = singular[:rank] / np.sqrt(len(stacked))
    return Embedding(right[:rank].T / scale, centre, size)


def channels(record: Record, problem: Problem) -> np.ndarray:
    """(N, C) measured channels."""
    return np.column_stack([record.channels[c] for c in problem.model.system.observed])


def drive(record: Record) -> np.ndarray:
    """(N, m) known inputs of unit size; of a rotor speed, and the rotating force it knows."""
    if "speed" not in record.inputs:
        given = np.column_stack(list(record.inputs.values()))
        return given / np.std(given, axis=0)
    speed, phase = record.inputs["speed"], record.inputs["phase"]
    top = float(np.abs(speed).max())
    force = (speed / top) ** 2
    return np.column_stack([speed / top, force * np.cos(phase), force * np.sin(phase)])


def library(z: np.ndarray, u: np.ndarray, degree: int) -> np.ndarray:
    """1, z, u and, at degree 2, their products and at degree 3 those of z once more."""
    both = np.hstack([z, u])
    columns = [np.ones(len(z)), *both.T]
    for order in range(2, degree + 1):
        wide = both if order == 2 else z[:, :4]
        columns += [
            np.prod(wide[:, list(which)], axis=1)
            for which in combinations_with_replacement(range(wide.shape[1]), order)
        ]
    return np.column_stack(columns)


Step = Callable[[np.ndarray, np.ndarray, float], np.ndarray]
"""(z_k, u_k, forcing) -> z_{k+1}."""


@dataclass(frozen=True)
class Fitted:
    """A map of delay coordinates, with the embedding it was made for."""

    embedding: Embedding
    step: Step

    def error(self, y: np.ndarray, u: np.ndarray, first: int) -> float:
        """Relative error of a free run over samples ``first`` to the end, mean over channels."""
        first = max(first, self.embedding.span)
        z = self.embedding(y)[first - self.embedding.span :]
        found = np.empty_like(z)
        found[0] = z[0]
        with np.errstate(all="ignore"):
            for k in range(len(z) - 1):
                found[k + 1] = self.step(found[k], u[first + k], float(z[k, -1]))
            miss = self.embedding.back(found) - y[first:]
            seen = y[first:] - y[first:].mean(axis=0)
            errors = np.sqrt(np.mean(miss**2, axis=0) / np.mean(seen**2, axis=0))
        return float(np.mean(errors)) if np.isfinite(errors).all() else float("inf")


Build = Callable[[np.ndarray, np.ndarray, int, int], Fitted]
"""(y, u, rank, degree) -> the fitted map."""


def delay_map(y: np.ndarray, u: np.ndarray, rank: int, degree: int) -> Fitted:
    """z_{k+1} - z_k = Theta(z_k, u_k) Xi by STLSQ, its threshold chosen by ``bic``."""
    import pysindy

    embedding = embedded(y, rank)
    z = embedding(y)
    columns = library(z[:-1], u[embedding.span : -1], degree)
    steps = np.diff(z, axis=0)
    even = np.arange(len(steps)) // 256 % 2 == 0
    tried = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for threshold in THRESHOLDS:
            fit = pysindy.STLSQ(threshold=threshold, alpha=1e-6).fit(columns[even], steps[even])
            left = steps[~even] - columns[~even] @ fit.coef_.T
            tried.append((bic(left, fit.coef_), threshold, fit.coef_.T))
    weights = min(tried, key=lambda t: t[0])[2]

    def step(state: np.ndarray, inputs: np.ndarray, _: float) -> np.ndarray:
        return state + (library(state[None], inputs[None], degree) @ weights)[0]

    return Fitted(embedding, step)


def havok_map(y: np.ndarray, u: np.ndarray, rank: int, degree: int) -> Fitted:
    """z_{1..r-1} one step on = A z_{1..r-1} + b z_r + B u; z_r is given where it predicts."""
    embedding = embedded(y, rank)
    z = embedding(y)
    columns = np.hstack([z, u[embedding.span :]])[:-1]
    weights = np.linalg.lstsq(columns, z[1:, :-1], rcond=None)[0]

    def step(state: np.ndarray, inputs: np.ndarray, forcing: float) -> np.ndarray:
        moved = np.concatenate([state[:-1], [forcing], inputs]) @ weights
        return np.append(moved, forcing)

    return Fitted(embedding, step)


def in_delays(method: str, problem: Problem) -> Answer:
    """A method's answer; rank and degree are those that predict the record's last fifth best."""
    build, choices = METHODS[method]
    clock = time.perf_counter()
    y, u = channels(problem.records[0], problem), drive(problem.records[0])
    cut = round(_KEPT * len(y))
    tried = [(build(y[:cut], u[:cut], *choice).error(y, u, cut), choice) for choice in choices]
    fitted = build(y, u, *min(tried)[1])
    seconds = time.perf_counter() - clock
    record = problem.test[0]
    settle = problem.settle if problem.settle is not None else _SETTLE * record.samples * record.dt
    error = fitted.error(channels(record, problem), drive(record), round(settle / record.dt))
    return Answer(method, test_error=error, seconds=seconds, named=False)


METHODS: dict[str, tuple[Build, tuple[tuple[int, int], ...]]] = {
    "delay sindy": (delay_map, ((4, 3), (8, 1), (8, 2))),
    "havok": (havok_map, ((4, 1), (8, 1), (16, 1))),
}
