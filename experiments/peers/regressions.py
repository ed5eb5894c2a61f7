"""PySINDy on the same library: STLSQ, SR3, an ensemble and the weak form.

Every equation of motion is one trajectory with the state v and the library's columns as controls,

    v' = sum_l theta_l s_l(t),

so that a term has one coefficient in both equations, as in this package. Columns and target are
scaled to unit rms, thresholds are shares of the acceleration.
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from spiral_plugins.derivatives.kalman_smoother import KalmanSmoother

from experiments.peers.cases import Answer, free_run
from spiral.inference.identifiability.signatures import equation_rows, signatures
from spiral.inference.problem import Problem
from spiral.types.derivative import differentiate

THRESHOLDS = (0.001, 0.003, 0.005, 0.01, 0.02, 0.05, 0.1, 0.3)
_BLOCK = 256  # samples of the interleaved blocks that fit and validate
_SUBDOMAINS = 4000  # of the weak form, at most
_BAGS = 20


@dataclass(frozen=True)
class Table:
    """Trajectories (one for each equation): v (N,), columns (N, p), v' (N,), all scaled."""

    keys: tuple[str, ...]
    velocity: list[np.ndarray]
    columns: list[np.ndarray]
    target: list[np.ndarray]
    scale: np.ndarray
    dt: float
    shapes: dict[str, float]

    @property
    def period(self) -> int:
        """Samples of one turn at the motion's rms frequency: half a weak test function."""
        ratio = np.linalg.norm(self.velocity) / np.linalg.norm(self.target)
        return max(8, round(2 * np.pi * float(ratio) / self.dt))

    def rows(self, even: bool) -> tuple[np.ndarray, np.ndarray]:
        """Columns and targets of every other block."""
        parts = []
        for columns, target in zip(self.columns, self.target, strict=True):
            kept = (np.arange(len(target)) // _BLOCK % 2 == 0) == even
            parts.append((columns[kept], target[kept]))
        return np.concatenate([c for c, _ in parts]), np.concatenate([t for _, t in parts])


def table(problem: Problem) -> Table:
    """Derivatives and columns of a problem's (one) record."""
    (record,) = problem.records
    system = problem.model.system
    y = np.column_stack([record.channels[c] for c in system.observed])
    found = differentiate(KalmanSmoother(), y, record.dt)
    states = dict(zip(system.observed, found.position.T, strict=True))
    states |= dict(zip(equation_rows(system), found.velocity.T, strict=True))
    made = signatures(problem.model, problem.candidates, states, record)
    cut = found.inner
    target = found.acceleration[cut].T
    size = float(np.sqrt(np.mean(target**2)))
    columns = made.columns[:, cut, :]
    norms = np.sqrt(np.mean(columns**2, axis=(0, 1)))
    return Table(
        made.keys,
        [v / size for v in found.velocity[cut].T],
        list(columns / norms),
        [a / size for a in target],
        norms / size,
        record.dt,
        dict(made.shapes),
    )


def _stlsq(threshold: float) -> Any:
    import pysindy

    return pysindy.STLSQ(threshold=threshold, alpha=1e-6, max_iter=50)


def _sr3(threshold: float) -> Any:
    import pysindy

    return pysindy.SR3(
        reg_weight_lam=0.5 * threshold**2, regularizer="l0", max_iter=200, unbias=True
    )


def _ensemble(threshold: float) -> Any:
    import pysindy

    return pysindy.EnsembleOptimizer(_stlsq(threshold), bagging=True, n_models=_BAGS)


def _strong(found: Table, optimizer: Any, even: bool | None) -> np.ndarray:
    """Coefficients (p,) from derivatives; on every other block, or on all."""
    import pysindy

    if even is None:
        columns, target = np.concatenate(found.columns), np.concatenate(found.target)
    else:
        columns, target = found.rows(even)
    model = pysindy.SINDy(optimizer, _only_controls(len(found.keys)))
    state = np.zeros((len(target), 1))
    model.fit(state, t=found.dt, x_dot=target[:, None], u=columns)
    return np.asarray(model.coefficients())[0]


def _weak(found: Table, optimizer: Any, even: bool | None) -> np.ndarray:
    """Coefficients (p,) from integrals against test functions; v' is never formed."""
    import pysindy

    count, width = len(found.target[0]), found.period
    grid = found.dt * np.arange(count)
    np.random.seed(0)  # noqa: NPY002  (PySINDy draws its subdomains from the global generator)
    weak = pysindy.WeakPDELibrary(
        pysindy.IdentityLibrary(),
        spatiotemporal_grid=grid,
        K=min(_SUBDOMAINS, 4 * count // width),
        H_xt=[width * found.dt],
        p=4,
    )
    model = pysindy.SINDy(optimizer, _only_controls(len(found.keys), weak))
    model.fit([v[:, None] for v in found.velocity], t=grid, u=list(found.columns))
    return np.asarray(model.coefficients())[0]


def _only_controls(count: int, library: Any = None) -> Any:
    """The library of the controls alone: the columns are already what they should be."""
    import pysindy

    inner = pysindy.IdentityLibrary() if library is None else library
    return pysindy.GeneralizedLibrary([inner], inputs_per_library=[list(range(1, count + 1))])


METHODS: dict[str, tuple[Callable[[float], Any], Callable[..., np.ndarray]]] = {
    "pysindy stlsq": (_stlsq, _strong),
    "pysindy sr3": (_sr3, _strong),
    "pysindy ensemble": (_ensemble, _strong),
    "pysindy weak": (_stlsq, _weak),
}


def bic(left: np.ndarray, weights: np.ndarray) -> float:
    """N log(mean r^2) + k log N of residuals on samples that did not fit."""
    count = left.size
    return count * float(np.log(np.mean(left**2))) + int(np.sum(weights != 0)) * np.log(count)


def regressed(method: str, problem: Problem, thresholds: tuple[float, ...] = THRESHOLDS) -> Answer:
    """A method's answer, at the threshold with the best information criterion."""
    optimizer, fit = METHODS[method]
    clock = time.perf_counter()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = table(problem)
        columns, target = found.rows(even=False)
        tried = []
        for threshold in thresholds:
            weights = fit(found, optimizer(threshold), True)
            tried.append((bic(target - columns @ weights, weights), threshold))
        weights = fit(found, optimizer(min(tried)[1]), None)
    seconds = time.perf_counter() - clock
    kept = {k: float(w / s) for k, w, s in zip(found.keys, weights, found.scale, strict=True) if w}
    coefficients = _with_mass(_with_phase(kept), problem)
    error = free_run(problem, coefficients, found.shapes)
    return Answer(method, coefficients, error, seconds)


def _with_phase(kept: dict[str, float]) -> dict[str, float]:
    """U cos t - V sin t, the two columns of an unbalance, as its size and angle."""
    origin, moment = "system.phase_origin", "unbalance.moment"
    if origin not in kept:
        return kept
    across, along = kept.pop(origin), kept.get(moment, 0.0)
    size = float(np.hypot(along, across))
    return {**kept, moment: size, origin: float(np.arctan2(across, along))}


def _with_mass(kept: dict[str, float], problem: Problem) -> dict[str, float]:
    """Coefficients of v' = (F - k x ...) / m, from columns that were taken at the mass m_0.

    The column of the mass is -F / m_0^2, so that its coefficient is -m_0^2 / m; all others are
    those of forces over m_0.
    """
    key = "system.mass"
    if key not in kept:
        return kept
    starts = dict(problem.model.pairs)
    known = problem.model.values.get(key) or starts[key].start or 1.0
    mass = -(known**2) / kept.pop(key)
    return {**{k: v * mass / known for k, v in kept.items()}, key: mass}
