"""Uncertain parameters as a Gaussian: as the user declares them, or from the covariance of a fit.

A model that was fitted brings its standard errors and their correlations with it (``model_prior``);
what is declared takes their place.

    uncertain={"bearing.*": 0.2, "system.phase_origin": 0.05, "preload.force": {"absolute": 3}}

A name or a pattern (``*``, ``?``) stands for full names as a model shows them
(``linear_stiffness@bearing_1.stiffness_x``), for place and parameter (``bearing_1.stiffness_x``),
or for places that are numbered (``bearing.stiffness_x``); of several that fit a parameter the last
one counts. A number is the standard deviation as a share of the value, of an angle in rad.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from fnmatch import fnmatchcase
from typing import Any

import numpy as np

from spiral.engine.filter.prior import Prior
from spiral.engine.filter.task import FilterInput
from spiral.engine.fit import covariance
from spiral.inference.reconstruction.calibrate import Calibration
from spiral.types.errors import ConfigError, did_you_mean
from spiral.types.label import split_key, split_port
from spiral.types.model import Model
from spiral.types.parameter import Parameter

_HOW = "a share of the value such as 0.2, or {absolute: 3} in the parameter's unit"


def declared_prior(model: Model, task: FilterInput, uncertain: Mapping[str, Any]) -> Prior | None:
    """Independent parameters around a task's values; nothing where none is uncertain.

    Raises
    ------
    ConfigError : a pattern that names nothing, a deviation that is none, or a share of zero.
    """
    deviations: dict[str, float] = {}
    for pattern, given in uncertain.items():
        fitting = [k for k in task.keys if any(fnmatchcase(n, pattern) for n in pattern_names(k))]
        if not fitting:
            raise ConfigError(
                f"uncertain={{{pattern}: ...}}, which names no parameter",
                f"names or patterns over {', '.join(task.keys)}",
                did_you_mean(pattern, [n for k in task.keys for n in pattern_names(k)]),
            )
        for name in fitting:
            deviations[name] = _declared_deviation(
                model, name, float(task.parameter_values((name,))[0]), given
            )
    keys = tuple(k for k in task.keys if deviations.get(k))
    spread = np.array([deviations[k] for k in keys])
    return Prior(keys, task.parameter_values(keys), np.diag(spread**2)) if keys else None


def model_prior(model: Model, task: FilterInput) -> Prior | None:
    """The standard errors of a fitted model's values, as they are correlated; none of others.

    A record's own parameters (a phase origin) are left out: the filter follows them. So are values
    whose error reaches beyond a bound: the data did not tell them, and a filter at such values
    would tell nothing either.
    """
    known = set(task.keys)

    def is_told(key: str, parameter: Parameter) -> bool:
        error = model.errors.get(key, 0.0)
        if key not in known or parameter.scope == "record" or not 0 < error < np.inf:
            return False
        low, high = model.values[key] - error, model.values[key] + error
        above = parameter.lower is None or low > parameter.lower
        return above and (parameter.upper is None or high < parameter.upper)

    keys = tuple(k for k, p in model.pairs if is_told(k, p))
    values = task.parameter_values(keys)
    return Prior(keys, values, model.covariance(keys), settled=True) if keys else None


def fitted_prior(calibration: Calibration, record: int) -> Prior | None:
    """The covariance of a fit's parameters, for the record of this number, which is in it.

    What belongs to one record (a phase origin), and splines of the phase, are left out: the filter
    follows them.
    """
    study = calibration.columns
    if calibration.fitted is None or study is None:
        return None
    whole, model = covariance(calibration.fitted), calibration.models[record]
    known = [k for k, _ in model.pairs]
    scopes = [p.scope for _, p in model.pairs]
    own = [c for c, i in enumerate(study.index) if i < len(known) and scopes[i] != "record"]
    keys = tuple(known[study.index[c]] for c in own)
    values = np.array([model.values[k] for k in keys])
    return Prior(keys, values, whole[np.ix_(own, own)], settled=True) if keys else None


def pattern_names(key: str) -> tuple[str, ...]:
    """Its names in patterns: ``effect@place_1.name``, ``place_1.name`` and ``place.name``."""
    owner, parameter = split_key(key)
    name, port = split_port(owner)
    place = port or name
    return key, f"{place}.{parameter}", f"{re.sub('_?[0-9]+$', '', place)}.{parameter}"


def _declared_deviation(model: Model, name: str, value: float, given: Any) -> float:
    absolute = isinstance(given, Mapping) and set(given) == {"absolute"}
    number = given["absolute"] if absolute else given
    if isinstance(number, bool) or not isinstance(number, int | float) or not 0 <= number < np.inf:
        raise ConfigError(f"uncertain: {name} with {given!r}", _HOW)
    if absolute or model.unit(name) == "rad":
        return float(number)
    if value == 0 and number:
        raise ConfigError(
            f"uncertain: a share of {name}, which is zero",
            "a deviation in its unit", f"uncertain={{{name}: {{absolute: 1}}}}",
        )  # fmt: skip
    return float(number) * abs(value)
