"""Models: a system, its effects, and values with their covariance."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from spiral.types.effect import Effect
from spiral.types.errors import ConfigError, did_you_mean
from spiral.types.formatting import plus_minus
from spiral.types.label import name_of, owner_of, split_key
from spiral.types.parameter import Parameter
from spiral.types.placement import check_effect, model_keys
from spiral.types.system import System


@dataclass(frozen=True)
class Estimate:
    """A parameter's value with its standard error (``None`` where it was not fitted)."""

    estimate: float
    se: float | None
    unit: str

    @property
    def t(self) -> float | None:
        """Estimate over standard error."""
        return self.estimate / self.se if self.se else None

    def as_dict(self) -> dict[str, float | str | None]:
        """As plain data, as ``--json`` writes it."""
        return {"estimate": self.estimate, "se": self.se, "t": self.t, "unit": self.unit}


@dataclass(frozen=True, repr=False)
class Model:
    """A system with its effects, their values and standard errors.

    Parameters
    ----------
    system, effects : the physics; ``effects`` include the system's seed.
    values : by full parameter name (``cubic_stiffness.stiffness``); a name left out takes its
        parameter's start, or is found by the fit.
    freed : shape parameters and known system parameters that a fit may move as well.
    fixed : parameters that no fit moves.
    errors : standard errors by full name, after a fit.
    correlations : of the errors, by pairs of full names, each once; zero where left out.
    """

    system: System
    effects: tuple[Effect, ...]
    values: Mapping[str, float] = field(default_factory=dict)
    freed: tuple[str, ...] = ()
    fixed: tuple[str, ...] = ()
    errors: Mapping[str, float] = field(default_factory=dict)
    correlations: Mapping[str, Mapping[str, float]] = field(default_factory=dict)

    def __repr__(self) -> str:
        rows = [
            f"  {key} = {plus_minus(self.values.get(key), self.errors.get(key))} {self.unit(key)}"
            for key, _ in self.pairs
        ]
        return "\n".join([f"Model of {self.name}", *(row.rstrip() for row in rows)])

    @property
    def name(self) -> str:
        """The system's title, and the effects beside its seed."""
        seed = {e.label for e in self.system.seed}
        added = [label for label in self.labels if label not in seed]
        return " with ".join(filter(None, [self.system.title, ", ".join(added)]))

    def __post_init__(self) -> None:
        labels = [e.label for e in self.effects]
        for label in labels:
            if labels.count(label) > 1:
                raise ConfigError(
                    f"effect {label!r} twice",
                    "each effect once at a port",
                    f"drop one, or place one at another port: {name_of(label)}@PORT",
                )
        for effect in self.effects:
            check_effect(self.system, effect)
        known = [k for k, _ in self.pairs]
        for key in (*self.values, *self.freed, *self.fixed):
            if key not in known:
                raise ConfigError(
                    f"parameter {key!r}", "a parameter of the model", did_you_mean(key, known)
                )

    @property
    def pairs(self) -> tuple[tuple[str, Parameter], ...]:
        """(full name, parameter) in order."""
        return model_keys(self.system, self.effects)

    @property
    def labels(self) -> tuple[str, ...]:
        """Labels of the effects."""
        return tuple(e.label for e in self.effects)

    def amplitudes(self, label: str) -> tuple[str, ...]:
        """Full names of the amplitudes of one effect."""
        return tuple(k for k, p in self.pairs if owner_of(k) == label and p.role == "amplitude")

    @property
    def active(self) -> tuple[str, ...]:
        """Names of the parameters that a fit moves."""
        return tuple(k for k, p in self.pairs if k not in self.fixed and self._is_active(k, p))

    def _is_active(self, key: str, parameter: Parameter) -> bool:
        if key in self.freed or parameter.scope == "record":
            return True
        if parameter.role == "shape":
            return False
        return not key.startswith("system.") or parameter.start is None

    def add(self, effect: Effect, values: Mapping[str, float] | None = None) -> Model:
        """The model with one more effect."""
        return replace(
            self,
            effects=(*self.effects, effect),
            values={**self.values, **(values or {})},
            errors={},
            correlations={},
        )

    def without(self, label: str) -> Model:
        """The model with one effect less."""
        if label not in self.labels:
            raise ConfigError(
                f"effect {label!r}", "an effect of the model", did_you_mean(label, self.labels)
            )
        keep = tuple(e for e in self.effects if e.label != label)
        gone = {k for k, _ in self.pairs if owner_of(k) == label}
        return replace(
            self,
            effects=keep,
            values={k: v for k, v in self.values.items() if k not in gone},
            freed=tuple(k for k in self.freed if k not in gone),
            fixed=tuple(k for k in self.fixed if k not in gone),
            errors={},
            correlations={},
        )

    def covariance(self, keys: Sequence[str]) -> np.ndarray:
        """(keys, keys) covariance of the errors of these parameters, all of which have one."""
        together = np.eye(len(keys))
        for i, first in enumerate(keys):
            for j, second in enumerate(keys[:i]):
                known = self.correlations
                one, other = known.get(first, {}).get(second), known.get(second, {}).get(first)
                together[i, j] = together[j, i] = (one or 0.0) + (other or 0.0)
        spread = np.array([self.errors[k] for k in keys])
        return together * np.outer(spread, spread)

    @property
    def given_values(self) -> dict[str, float]:
        """Values by full name as they were given, or as the system's parameters start."""
        starts = {
            k: p.start for k, p in self.pairs if p.start is not None and owner_of(k) == "system"
        }
        return {**starts, **self.values}

    def row(self, whose: str, hint: str) -> np.ndarray:
        """Values of all parameters in their order; ``hint`` says how to give one that is missing.

        Raises
        ------
        ConfigError : a parameter without a value.
        """
        given = {**{k: p.start for k, p in self.pairs}, **self.values}
        missing = [k for k, _ in self.pairs if given[k] is None]
        if missing:
            raise ConfigError(
                f"no value for {', '.join(missing)}",
                f"a value for every parameter of the {whose}",
                hint.format(missing[0]),
            )
        return np.array([float(given[k]) for k, _ in self.pairs])  # type: ignore[arg-type]

    def unit(self, key: str) -> str:
        """The absolute unit of a parameter."""
        owner = owner_of(key)
        parameter = dict(self.pairs)[key]
        if owner == "system":
            return pretty_unit(parameter.unit)
        effect = next(e for e in self.effects if e.label == owner)
        return pretty_unit(self.system.place(effect).unit(parameter.unit))

    def estimates(self) -> dict[str, dict[str, Estimate]]:
        """owner -> parameter -> estimate, the system's own under ``system``."""
        table: dict[str, dict[str, Estimate]] = {}
        for key, parameter in self.pairs:
            owner, name = split_key(key)
            value = float(
                self.values.get(key, np.nan if parameter.start is None else parameter.start)
            )
            estimate = Estimate(value, self.errors.get(key), self.unit(key))
            table.setdefault(owner, {})[name] = estimate
        return table


def seed_model(system: System, effects: tuple[Effect, ...] = (), **options) -> Model:
    """The system with its seed and further effects."""
    return Model(system, (*system.seed, *effects), **options)


def estimates_dict(model: Model) -> dict[str, Any]:
    """``{"effects": {effect: {parameter: estimate}}, "system": {parameter: estimate}}``."""

    def rows(table: dict[str, Estimate]) -> dict[str, Any]:
        return {name: estimate.as_dict() for name, estimate in table.items()}

    table = model.estimates()
    return {
        "effects": {owner: rows(t) for owner, t in table.items() if owner != "system"},
        "system": rows(table.get("system", {})),
    }


def correlations_by_name(
    keys: Sequence[str], covariance: np.ndarray
) -> dict[str, dict[str, float]]:
    """Correlations of a covariance (keys, keys) as a model keeps them, where they are told."""
    spread = np.sqrt(np.abs(np.diag(covariance)))
    told = [i for i in range(len(keys)) if 0 < spread[i] < np.inf]
    return {
        keys[i]: {keys[j]: float(covariance[i, j] / (spread[i] * spread[j])) for j in told[:n]}
        for n, i in enumerate(told)
        if n
    }


def pretty_unit(unit: str) -> str:
    """A unit in base form as people write it: ``(m/s^2)/(m)`` -> ``1/s^2``."""
    from spiral.types.units import short_form

    return short_form(unit)
