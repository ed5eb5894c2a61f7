"""The records that all methods see, their truth, and how an answer is scored."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import numpy as np
from spiral_plugins.libraries.projection import Projection
from spiral_plugins.systems.planar_rotor import PlanarRotor

from spiral.inference.compare import predict
from spiral.inference.problem import Problem
from spiral.io.config import build_problem, compose
from spiral.io.registry import Registry
from spiral.types.errors import SpiralError
from spiral.types.model import Model

HIDDEN = ("cross_stiffness", "cubic_stiffness", "gyroscopic")
_ROTOR = ("linear_stiffness.stiffness_x=8085", "linear_stiffness.stiffness_y=9672",
          "linear_damping.damping_x=3.5", "linear_damping.damping_y=2.1",
          "unbalance.moment=1.565e-5")  # fmt: skip


@dataclass(frozen=True)
class Case:
    """One record with its test: ``overrides`` of the command line, and effects that are true.

    ``rotor`` hides the tilt, ``nothing`` hides nothing (the seed's own motion), ``silverbox`` is
    measured, so that its truth is not known.
    """

    name: str
    noise: float = 0.02
    seed: int = 11
    duration: float = 14.0

    @property
    def overrides(self) -> tuple[str, ...]:
        """What ``spiral discover`` is told."""
        if self.name == "silverbox":
            return ("experiment=silverbox",)
        shared = (f"record.duration={self.duration:g}", f"record.noise_level={self.noise:g}",
                  f"record.seed={self.seed}", f"test.seed={self.seed + 1000}")  # fmt: skip
        if self.name == "rotor":
            test = (f"test.duration={self.duration:g}", f"test.noise_level={self.noise:g}")
            return ("experiment=rotor_coastdown", *shared, "test.phase=0.4", *test)
        values = ", ".join(v.replace("=", ": ") for v in _ROTOR)
        return ("system=planar_rotor", "record=simulation", *shared,
                "record.inputs={speed: {sweep: [40, 0], unit: Hz}}",
                f"record.values={{{values}}}")  # fmt: skip

    def problem(self, registry: Registry) -> Problem:
        """Model, records, test and candidates."""
        return build_problem(compose(self.overrides, registry), registry)

    def truth(self) -> dict[str, float] | None:
        """Key -> coefficient of the observable equations; second-order terms without one.

        None where nobody knows it.
        """
        if self.name == "silverbox":
            return None
        if self.name == "nothing":
            return {k: float(v) for k, v in (text.split("=") for text in _ROTOR)}
        return dict(_projected())


@lru_cache
def _projected() -> tuple[tuple[str, float], ...]:
    """The hidden tilt's projection to first order, and names alone to second."""
    first, second = (
        {t.key: t.predicted for t in Projection(order=order).terms(PlanarRotor())}
        for order in (1, 2)
    )
    return tuple((key, float(first.get(key) or np.nan)) for key in second)


@dataclass(frozen=True)
class Answer:
    """What a method says: coefficients by full key, its free-run error, its seconds.

    ``named`` tells whether it has named terms at all; methods in surrogate coordinates have none.
    """

    method: str
    coefficients: Mapping[str, float] = field(default_factory=dict)
    test_error: float = np.inf
    seconds: float = 0.0
    named: bool = True


def scored(case: Case, answer: Answer, truth: Mapping[str, float] | None) -> dict[str, Any]:
    """One row of the table: terms found and false, coefficient errors, test error, seconds."""
    found = {_owner(k) for k, v in answer.coefficients.items() if v} - {"system"}
    row: dict[str, Any] = {
        "case": case.name, "noise": case.noise, "seed": case.seed, "method": answer.method,
        "named": answer.named, "found": sorted(found), "test_error": answer.test_error,
        "seconds": answer.seconds, "coefficients": dict(answer.coefficients),
    }  # fmt: skip
    if truth is not None and answer.named:
        row["false"] = sorted(found - {_owner(k) for k in truth})
        row["errors"] = {
            k: answer.coefficients.get(k, 0.0) / v - 1.0
            for k, v in truth.items()
            if v == v and _owner(k) in HIDDEN
        }
    return row


def _owner(key: str) -> str:
    owner, name = key.rsplit(".", 1)
    return "unbalance" if name == "phase_origin" else owner


def free_run(
    problem: Problem, coefficients: Mapping[str, float], shapes: Mapping[str, float]
) -> float:
    """Relative free-run error on the test record of a model with these coefficients.

    Only the initial state and the record's own nuisances are estimated, from its first tenth, as
    for every model of this package. Infinite where the motion runs away.
    """
    labels = {_owner(k) for k in coefficients}
    effects = (*problem.model.effects, *problem.candidates)
    chosen = tuple(e for e in effects if e.label in labels)
    known = {e.label for e in chosen}
    values = {k: v for k, v in {**shapes, **coefficients}.items() if k.rsplit(".", 1)[0] in known}
    for effect in chosen:
        for key, parameter in effect.keys(problem.model.system.place(effect)):
            values.setdefault(key, 0.0 if parameter.role == "amplitude" else parameter.start or 0.0)
    own = {k: v for k, v in coefficients.items() if k.startswith("system.")}
    try:
        model = Model(problem.model.system, chosen, {**problem.model.values, **own, **values})
        run = predict(model, problem.test, problem.settle)
    except (SpiralError, FloatingPointError, np.linalg.LinAlgError, ValueError):
        return float("inf")
    errors = run.errors(problem.model.system.observed)
    return float(np.mean([e.relative for e in errors.values()]))
