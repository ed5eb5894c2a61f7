"""Gates: tests that candidate terms must pass, one after the other, before they are admitted.

A gate sees one iteration of the loop as a regression of the measured acceleration on the columns
of the current model and of the candidates, and lets some candidates through. Gates compose in a
list: each sees what those before it have left.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, ClassVar, Literal

import numpy as np

from spiral.engine.leastsquares import Fit, least_squares, solve_triangle, triangle
from spiral.types.plugin import Plugin
from spiral.types.record import Array

Reason = Literal[
    "", "white", "no_term_passes_gate_1", "no_term_passes_a_refinement", "gate_2_f_not_significant",
    "rolled_back", "no_robust_t", "likelihood_not_higher",
]  # fmt: skip
"""Why a gate left nothing: the reasons for which the loop ends."""


@dataclass(frozen=True)
class Surface:
    """The projection of the learned residual onto the candidates (paper, eq. halton_ols).

    ``fit`` is its least squares fit over all points; ``points`` their number; ``r2`` the share of
    the learned residual's energy that the candidates explain.
    """

    fit: Fit
    points: int
    r2: float


@dataclass(frozen=True)
class Trial:
    """The data that gates judge in one round; N samples in order of time, C equations.

    Parameters
    ----------
    names : of the L candidates.
    kept : indices of those still in question.
    target : (N, C) measured acceleration less what is known, z.
    active : (N, C, A) columns of the current model; ``candidates`` (N, C, L).
    residual : (N, C) z less the current model.
    train : (N,) True for the training samples, False for validation.
    amplitude : (N,) size of the motion, for stratified folds.
    record : (N,) number of the record.
    surface : the projection of the learned residual, where there is one.
    seed : of random choices.
    groups : candidates that come and go together (the amplitudes of one effect); left out, each
        stands alone. ``tests`` is their number before the best shapes were chosen.
    gain : 2 (log L_1 - log L_0) after a refit with some candidates, where the evidence has a
        likelihood.
    """

    names: tuple[str, ...]
    kept: tuple[int, ...]
    target: Array
    active: Array
    candidates: Array
    residual: Array
    train: Array
    amplitude: Array
    record: Array
    surface: Surface | None = None
    seed: int = 0
    groups: tuple[tuple[int, ...], ...] = ()
    tests: int = 0
    gain: Callable[[tuple[int, ...]], float] | None = None

    def rows(self, kept: tuple[int, ...], samples: Array) -> tuple[Array, Array]:
        """X (n C, A + q) of the model with candidates, and y (n C,), at chosen samples."""
        width = self.active.shape[2] + len(kept)
        both = np.concatenate([self.active[samples], self.candidates[samples][..., list(kept)]], 2)
        y = self.target[samples].reshape(-1)
        return both.reshape(len(y), width), y

    def fitted(self, kept: tuple[int, ...], samples: Array | None = None) -> Fit:
        """The joint least squares fit (paper, eq. joint_ols), on the training samples."""
        return least_squares(*self.rows(kept, self.train if samples is None else samples))

    def falls(self, groups: Sequence[tuple[int, ...]]) -> dict[tuple[int, ...], float]:
        """Fall of the sum of squares over all samples for each group beside the current model."""
        every = np.ones(len(self.target), dtype=bool)
        offered = tuple(sorted({k for g in groups for k in g}))
        width = self.active.shape[2]
        upper, rows = triangle([np.column_stack(self.rows(offered, every))])
        model = tuple(range(width))
        before = solve_triangle(upper, rows, model).rss
        return {
            g: before
            - solve_triangle(upper, rows, (*model, *(width + offered.index(k) for k in g))).rss
            for g in groups
        }

    @cached_property
    def before(self) -> Fit:
        """The current model fitted to the training samples."""
        return self.fitted(())

    def rmse(self, fit: Fit, kept: tuple[int, ...], samples: Array) -> float:
        """Root mean square of z less a fitted model at chosen samples."""
        x, y = self.rows(kept, samples)
        return float(np.sqrt(np.mean((y - x @ fit.b) ** 2)))


@dataclass(frozen=True)
class Judgement:
    """What a gate decided: candidates let through, why none were, and its figures as plain data.

    ``refused`` says of each candidate stopped here why.
    """

    kept: tuple[int, ...]
    log: Mapping[str, Any]
    reason: Reason = ""
    refused: Mapping[str, str] = field(default_factory=dict)


class Gate(Plugin):
    """One test.

    Its fields are the configuration's ``gate.NAME.FIELD``. A gate never changes the trial. One with
    ``guard`` set is asked before anything is learned, and sees no surface; one with ``likelihood``
    set needs evidence that has one (``Trial.gain``).
    """

    kind: ClassVar[str] = "gate"
    guard: ClassVar[bool] = False
    likelihood: ClassVar[bool] = False

    @abstractmethod
    def judge(self, trial: Trial) -> Judgement:
        """Which of ``trial.kept`` pass, with the figures that decided it."""


def run_gates(
    gates: Sequence[Gate], trial: Trial, log: dict[str, Any], progress: Callable[[str], None]
) -> tuple[Trial, Judgement]:
    """The trial after its gates, and what the last of them said; figures go into the log."""
    judgement = Judgement(trial.kept, {})
    refused: dict[str, str] = {}
    for gate in gates:
        progress(f"gate {gate.plugin_name()}: {len(trial.kept)} terms")
        judgement = gate.judge(trial)
        refused.update(judgement.refused)
        names = [trial.names[k] for k in judgement.kept]
        log[gate.plugin_name()] = {**judgement.log, "left": names}
        trial = replace(trial, kept=judgement.kept)
        if not trial.kept:
            break
    log["refused"] = refused
    return trial, judgement
