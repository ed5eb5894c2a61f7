"""What a record can tell before any fit: whether effects would look alike in it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from spiral.inference.identifiability.identify import Identification, identify
from spiral.inference.problem import Problem
from spiral.io.config import build_derivative
from spiral.io.registry import Registry
from spiral.types.errors import ConfigError, InputError

_EQUAL = 1e-12  # of a cosine: equal up to rounding
_UNKNOWN = "This cannot be told before a fit: states that no sensor sees take part."


def foreseen(
    problem: Problem, config: Mapping[str, Any], registry: Registry
) -> dict[str, Any]:  # fmt: skip
    """Groups of effects that the records cannot tell apart, as ``spiral identify`` finds them.

    Returns
    -------
    ``alike`` groups of effects, ``terms`` how many were looked at, ``samples`` those there are and
    ``needed`` (nothing where no number would do); or ``unknown``, why that cannot be said.
    """
    try:
        derivative = build_derivative(dict(config), registry)
        found = identify(problem, derivative)
        twice = _in_the_equations(problem, found)
        if twice:
            others = tuple(e for e in problem.candidates if e.label not in twice)
            found = identify(replace(problem, candidates=others), derivative)
    except (InputError, ConfigError, ArithmeticError, ValueError):  # LinAlgError is a ValueError
        return {"unknown": _UNKNOWN}
    needed = found.samples_needed
    return {
        "alike": [g for group in found.aliases if len(g := _named(problem, group)) > 1],
        "own": [*problem.model.labels, *_of_system(problem)],
        "terms": found.found.columns,
        "samples": found.found.samples,
        "needed": float(needed) if np.isfinite(needed) else None,
        "advice": found.advice,
    }


def _in_the_equations(problem: Problem, found: Identification) -> set[str]:
    """Candidates whose every signature is one of the system's own parameters', on any record."""
    owners = np.array([k.rsplit(".", 1)[0] for k in found.terms])
    alike = np.abs(found.found.gram) > 1 - _EQUAL
    return {
        e.label
        for e in problem.candidates
        if (mine := owners == e.label).any()
        and all(alike[i][owners == "system"].any() for i in np.flatnonzero(mine))
    }


def _named(problem: Problem, group: Sequence[str]) -> list[str]:
    """A group with the system's own parameters in its place: those that the fit finds, if any."""
    own = _of_system(problem) if "system" in group else []
    return [*own, *(label for label in group if label != "system")]


def _of_system(problem: Problem) -> list[str]:
    """Names of the system's own parameters that the fit finds."""
    return [k.rsplit(".", 1)[1] for k in problem.model.active if k.startswith("system.")]
