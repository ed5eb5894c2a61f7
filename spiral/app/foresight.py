"""What a record can tell before any fit: whether effects would look alike in it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from spiral.inference.identifiability.identify import identify
from spiral.inference.problem import Problem
from spiral.io.config import build_derivative
from spiral.io.registry import Registry
from spiral.types.errors import ConfigError, InputError

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
        found = identify(problem, build_derivative(dict(config), registry))
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


def _named(problem: Problem, group: Sequence[str]) -> list[str]:
    """A group with the system's own parameters in its place: those that the fit finds, if any."""
    own = _of_system(problem) if "system" in group else []
    return [*own, *(label for label in group if label != "system")]


def _of_system(problem: Problem) -> list[str]:
    """Names of the system's own parameters that the fit finds."""
    return [k.rsplit(".", 1)[1] for k in problem.model.active if k.startswith("system.")]
