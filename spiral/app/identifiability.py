"""Identifiability before any fit: which effects the records could not tell apart."""

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
from spiral.types.label import owner_of, parameter_of

_EQUAL = 1e-12  # of a cosine: equal up to rounding
_UNKNOWN = "This cannot be told before a fit: states that no sensor sees take part."


def identifiability_forecast(
    problem: Problem, config: Mapping[str, Any], registry: Registry
) -> dict[str, Any]:  # fmt: skip
    """Groups of effects that the records cannot tell apart, as ``spiral identify`` computes them.

    Returns
    -------
    ``alike`` groups of effects, ``own`` terms of the model and ``seed`` its effects, ``terms`` how
    many were looked at, ``samples`` those there are and ``needed`` (nothing where no number would
    do); or ``unknown``, why that cannot be said.
    """
    try:
        derivative = build_derivative(dict(config), registry)
        identification = identify(problem, derivative)
        twice = _candidates_in_equations(problem, identification)
        if twice:
            others = tuple(e for e in problem.candidates if e.label not in twice)
            identification = identify(replace(problem, candidates=others), derivative)
    except (InputError, ConfigError, ArithmeticError, ValueError):  # LinAlgError is a ValueError
        return {"unknown": _UNKNOWN}
    needed = identification.samples_needed
    return {
        "alike": [
            g
            for group in identification.aliases
            if len(g := _replace_system_label(problem, group)) > 1
        ],
        "seed": list(problem.model.labels),
        "own": [*problem.model.labels, *_free_system_parameters(problem)],
        "terms": identification.richness.columns,
        "samples": identification.richness.samples,
        "needed": float(needed) if np.isfinite(needed) else None,
        "advice": identification.advice,
    }


def _candidates_in_equations(problem: Problem, identification: Identification) -> set[str]:
    """Candidates of which every regressor equals one of a system parameter (|cosine| = 1)."""
    owners = np.array([owner_of(k) for k in identification.terms])
    alike = np.abs(identification.richness.gram) > 1 - _EQUAL
    return {
        e.label
        for e in problem.candidates
        if (mine := owners == e.label).any()
        and all(alike[i][owners == "system"].any() for i in np.flatnonzero(mine))
    }


def _replace_system_label(problem: Problem, group: Sequence[str]) -> list[str]:
    """A group with the label ``system`` replaced by the names of the system's free parameters."""
    own = _free_system_parameters(problem) if "system" in group else []
    return [*own, *(label for label in group if label != "system")]


def _free_system_parameters(problem: Problem) -> list[str]:
    """Names of the system's own parameters that the fit finds."""
    return [parameter_of(k) for k in problem.model.active if k.startswith("system.")]
