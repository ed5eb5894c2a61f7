"""Information in a record: standard errors of parameters, and whether effects can be told apart.

With J the signatures of a record (initial states free) in units of its noise, the Fisher
information of the parameters is J^T J, and a standard error is sqrt(diag (J^T J)^-1). An effect A
is told from another, B, by what is left of A's response once B and all that is fitted have taken
over what they can,

    m = (I - P[B, fitted]) J_A a,    lambda = |m|^2,    sin(angle) = |m| / |(I - P[fitted]) J_A a|.

lambda is the rise of chi^2 when A is true and B is fitted in its place. The loop calls B an alias
of A where the paired difference of their errors on the half that judges is not significant; that
difference has mean lambda / 2 and variance 2 lambda, so A and B come apart with probability
Phi(sqrt(lambda / 8) - z), z the two-sided quantile of the alias level.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from spiral.engine.sensitivities import reduce_windows
from spiral.engine.study import Layouts, ParameterColumns, Point
from spiral.inference.evidence.assembly import Assembly, columns_with_bounds, initial_values
from spiral.inference.evidence.fit_state import FitState
from spiral.inference.evidence.scoring import amplitude_keys
from spiral.types.effect import Effect
from spiral.types.errors import ConfigError
from spiral.types.label import owner_of
from spiral.types.record import Array

_RANK = 1e-7  # relative size under which a signature is called zero


@dataclass(frozen=True)
class Distinguishability:
    """Whether a test tells one effect, when it is the true one, from another.

    ``noncentrality`` lambda; ``alone`` the same without the other; ``angle`` in degrees.
    """

    true: str
    other: str
    noncentrality: float
    alone: float

    @property
    def angle(self) -> float:
        """Angle between the true one's response and what the other can make of it, degrees."""
        ratio = np.sqrt(self.noncentrality / self.alone) if self.alone > 0 else 0.0
        return float(np.degrees(np.arcsin(min(ratio, 1.0))))

    def as_dict(self) -> dict[str, Any]:
        """As plain data, as ``--json`` writes it."""
        return {
            "true": self.true,
            "other": self.other,
            "noncentrality": self.noncentrality,
            "angle_deg": self.angle,
        }


def separation_probability(pairs: Sequence[Distinguishability], level: float) -> float | None:
    """Probability that all pairs come apart at a level: product of Phi(sqrt(lambda / 8) - z)."""
    from scipy.stats import norm

    if not pairs:
        return None
    z = norm.isf(level / 2)
    return float(np.prod([norm.cdf(np.sqrt(p.noncentrality / 8) - z) for p in pairs]))


@dataclass(frozen=True)
class RecordInformation:
    """The signatures of one record in units of its noise, initial states projected out.

    ``triangle`` is R of their QR decomposition; ``moving`` names its columns, ``fitted`` of which
    a fit moves.
    """

    assembly: Assembly
    moving: ParameterColumns
    fitted: int
    triangle: Array

    @classmethod
    def of(cls, assembly: Assembly, layouts: Layouts, point: Point) -> RecordInformation:
        """At a point of a study, the effects of its model being fitted.

        Raises
        ------
        ConfigError : the model does not stay finite on the record.
        """
        fit_state = FitState(assembly.problem.model.labels, point.values)
        keys = fit_state.keys(assembly)
        more = tuple(k for v in assembly.variants for k in amplitude_keys(assembly, v))
        moving, _ = columns_with_bounds(assembly, (*keys, *more))
        reduction = reduce_windows(assembly.study, layouts, point, moving)
        if not reduction.finite:
            raise ConfigError("a motion that grows without bound", "a stable one")
        count = columns_with_bounds(assembly, keys)[0].count
        return cls(assembly, moving, count, reduction.triangle[:-1, :-1])

    def noncentrality_alone(self, label: str) -> float:
        """lambda of an effect of the model against all else that is fitted: what it changes."""
        own = self._amplitude_columns(label)
        rest = [i for i in range(self.fitted) if i not in own]
        return (
            _squared_distance_to_span(self._response(own), self.triangle[:, rest]) if own else 0.0
        )

    def pairs(self, label: str, others: tuple[Effect, ...]) -> list[Distinguishability]:
        """An effect of the model against others; of a shape the value that is nearest counts."""
        own = self._amplitude_columns(label)
        if not own:
            return []
        response, alone = self._response(own), self.noncentrality_alone(label)
        rest = [i for i in range(self.fitted) if i not in own]
        pairs = []
        for other in others:
            labels = [v.label for v in self.assembly.variants if v.original.label == other.label]
            left = min(
                _squared_distance_to_span(
                    response, self.triangle[:, [*rest, *self._variant_columns(x)]]
                )
                for x in (labels or [other.label])
            )
            pairs.append(Distinguishability(label, other.label, left, alone))
        return pairs

    def _response(self, own: list[int]) -> Array:
        """J_A a: what an effect's amplitudes change, to first order."""
        return self.triangle[:, own] @ self.moving.current(initial_values(self.assembly))[own]

    def standard_error(self, parameter: str) -> float:
        """Standard error of a parameter, all others that are fitted being free."""
        place = self.assembly.study.index(parameter)
        at = [i for i in range(self.fitted) if self.moving.index[i] == place]
        if not at:
            raise ConfigError(f"{parameter}, which no fit moves", "free=[...] to free it")
        rest = [i for i in range(self.fitted) if i not in at]
        seen = _squared_distance_to_span(self.triangle[:, at[0]], self.triangle[:, rest])
        return float(1.0 / np.sqrt(seen)) if seen > 0 else float("inf")

    def _amplitude_columns(self, label: str) -> list[int]:
        """Amplitudes of an effect of the model among the fitted columns."""
        keys = self.assembly.study.keys
        roles = self.assembly.study.compiled.traced.parameters
        return [
            i
            for i in range(self.fitted)
            if self.moving.index[i] < len(keys)
            and owner_of(keys[self.moving.index[i]]) == label
            and roles[self.moving.index[i]].role == "amplitude"
        ]

    def _variant_columns(self, label: str) -> list[int]:
        """Columns of a variant that is not fitted, its companion's too."""
        owners = {label}
        for variant in self.assembly.variants:
            if variant.label == label and variant.companion is not None:
                owners.add(variant.companion.label)
        keys = self.assembly.study.keys
        last = range(self.fitted, self.moving.count)
        return [i for i in last if owner_of(keys[self.moving.index[i]]) in owners]


def _squared_distance_to_span(response: Array, others: Array) -> float:
    """Squared length of what the span of other columns cannot make, columns scaled first."""
    size = np.linalg.norm(others, axis=0)
    unit = others[:, size > 0] / size[size > 0]
    left, singular, _ = np.linalg.svd(unit, full_matrices=False)
    basis = left[:, singular > _RANK]
    rest = response - basis @ (basis.T @ response)
    return float(rest @ rest)
