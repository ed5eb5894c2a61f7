"""Conformance checks of strategies: one round on a small study; each returns what it saw."""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from spiral.inference.discover import discover
from spiral.inference.problem import Problem, Settings
from spiral.inference.simulate import simulate
from spiral.inference.strategies.base import Strategy
from spiral.io.problem_setup import pose_problem
from spiral.io.writing import to_json
from spiral.types.errors import PluginError
from spiral.types.model import Model, seed_model
from spiral.types.record import Record
from spiral.types.run import Run

if TYPE_CHECKING:
    from spiral.io.registry import Registry

_VALUES = {
    "system.mass": 1.0,
    "linear_stiffness.stiffness": 1e3,
    "linear_damping.damping": 2.0,
    "cubic_stiffness.stiffness": 3e7,
}
_RATE, _SECONDS = 200.0, 8.0  # of a motion of 5 Hz


def rehearsal(strategy: Strategy, registry: Registry) -> Problem:
    """A mass on a spring whose cubic part the model lacks, shaken by tones for eight seconds."""
    model = seed_model(registry.make("system", "oscillator"))
    truth = Model(
        model.system, (*model.effects, registry.effect_from_label("cubic_stiffness")), _VALUES
    )
    known = Model(
        model.system, model.effects, {k: v for k, v in _VALUES.items() if "cubic" not in k}
    )
    records = tuple((_simulate_shaken(truth, seed),) for seed in (1, 2))
    return pose_problem(
        registry, known, *records, candidates=["cubic_stiffness", "quadratic_damping"],
        settings=Settings(max_rounds=1), strategy=strategy,
    )  # fmt: skip


def _simulate_shaken(truth: Model, seed: int) -> Record:
    rng = np.random.default_rng(seed)
    time = np.arange(round(_SECONDS * _RATE)) / _RATE
    tones = np.arange(1, 41) / _SECONDS  # up to 10 Hz
    phases = rng.uniform(0, 2 * np.pi, len(tones))
    force = np.cos(2 * np.pi * tones * time[:, None] + phases).sum(axis=1)
    return simulate(truth, time, {"force": force}, 0.01, rng)


@dataclass(frozen=True)
class FirstRound:
    """A strategy in its first round on that study."""

    strategy: Strategy
    registry: Registry

    @cached_property
    def problem(self) -> Problem:
        """The study."""
        return rehearsal(self.strategy, self.registry)

    @cached_property
    def run(self) -> Run:
        """The study run for at most one round."""
        return discover(self.problem)


def check_first_round(at: FirstRound) -> str:
    """The loop comes to its end, with a model whose values are numbers."""
    values = at.run.model.values
    if not all(np.isfinite(v) for v in values.values()):
        raise PluginError(f"a model with the values {dict(values)}", "numbers")
    return f"{at.run.verdict}, {len(at.run.rounds) - 1} admitted"


def check_admissions(at: FirstRound) -> str:
    """What it admits was offered and is then in the model; what it suggests was offered."""
    known = {e.label for e in at.problem.candidates}
    told = {s.effect for r in at.run.rounds for s in r.suggestions}
    admitted = {label for r in at.run.rounds for label in r.admitted}
    if not (told | admitted) <= known:
        raise PluginError(f"{', '.join(sorted((told | admitted) - known))}", "candidates only")
    retired = {label for r in at.run.rounds for label in r.retired}
    if not admitted - retired <= set(at.run.model.labels):
        raise PluginError(f"{', '.join(admitted)} admitted and not in the model", "settled with it")
    return f"{len(told)} suggested"


def check_run_log(at: FirstRound) -> str:
    """Its details are plain data that JSON takes."""
    return f"{len(json.loads(to_json(at.run.as_dict())))} keys"
