"""The curve of a missing force over the state it follows, with its band.

A force is known up to what the seed's own effects can take over (a linear spring hides any linear
part), so the curve of all that a study has added to its seed is what is left of it beside them, by
least squares weighted by how often each value was visited. A change of a parameter is known up to
that parameter's own value: the curve is its share of its mean over what was visited.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from spiral.engine.fit import covariance
from spiral.inference.evidence.admission import AdmittedEffect
from spiral.inference.evidence.assembly import Assembly, columns_with_bounds
from spiral.inference.evidence.comparison import last_stage
from spiral.inference.evidence.fit_state import Masks
from spiral.inference.unknown.curvepath import CurveAxis, StatePath, courses, window_states
from spiral.physics.learned import Learned, LearnedForce, LearnedParameterChange, spacing
from spiral.types.label import owner_of
from spiral.types.port import Port
from spiral.types.record import Array
from spiral.types.run import Suggestion

_POINTS = 81
_TAILS = 0.5  # per cent of the visited values left out at either end
_ONE_SIDED = 0.1  # share of the curve's energy under which a part (odd, even) is left unsaid
_ONE_SIGN = 0.05  # share of the largest value under which the other sign counts as not visited
_KINKED = 0.6  # share of all bending within a stretch of 1.5 spacings from which a curve is kinked
_DRAWS = 4000


@dataclass(frozen=True)
class Curve:
    """The missing force along one axis: ``band`` holds the whole curve with 95 % (simultaneous).

    ``at`` (81,) values of the state in its unit, ``force``, ``se`` and ``band`` (81,) in the port's
    unit of force, ``visited`` (81,) how often each value occurs, summing to one. ``speed`` is the
    velocity at which a curve that is multiplied by one is given, its rms.
    """

    axis: str
    state: str
    at: Array
    force: Array
    se: Array
    band: Array
    visited: Array
    speed: float


@dataclass(frozen=True)
class Unknown:
    """The shape of what is missing.

    ``effect`` is the learned effect that may be admitted; ``quantity`` what its curve gives (a
    force, a flow); ``parity`` odd, even, neither, or one-sided where the state has one sign;
    ``kinked`` the value of the state at which the curve bends sharply, where it does; ``explains``
    its share of the residual's energy; ``others`` the other curves with theirs.
    """

    effect: str
    meaning: str
    state: str
    state_unit: str
    force_unit: str
    times: str
    parity: str
    kinked: float | None
    explains: float
    p_value: float
    curves: tuple[Curve, ...]
    others: Mapping[str, float] = field(default_factory=dict)
    quantity: str = "force"

    @property
    def sentence(self) -> str:
        """In words; of a state that is never negative there is no odd or even."""
        times = f" times {self.times}" if self.times else ""
        ways = {"odd": "odd, ", "even": "even, ", "one-sided": ""}
        way = ways.get(self.parity, "neither odd nor even, ")
        bend = "smooth"
        if self.kinked is not None:
            bend = f"kinked near {self.kinked:.3g} {self.state_unit}"
        return f"A {self.quantity} that follows {self.state}{times}: {way}{bend}."

    def as_dict(self) -> dict[str, Any]:
        """As plain data, as ``--json`` writes it."""
        plain = {k: v for k, v in vars(self).items() if k not in ("curves", "others", "kinked")}
        curves = [
            {k: v.tolist() if isinstance(v, np.ndarray) else v for k, v in vars(c).items()}
            for c in self.curves
        ]
        smooth = {"smooth": self.kinked is None, "kinked_at": self.kinked}
        return {**plain, **smooth, "sentence": self.sentence, "others": dict(self.others),
                "curves": curves}  # fmt: skip


@dataclass(frozen=True)
class CurveFit:
    """A model with a learned effect, fitted.

    Parameters
    ----------
    added : compiled labels of what the study has added to its seed, the learned effect among them.
    row : values of one record in the order of the study's parameters.
    moving : places in it of what the fit moved, with their ``covariance``.
    states : (samples, all states) along the records; ``inputs`` (samples,) by name, and time.
    """

    assembly: Assembly
    learned: Learned
    added: tuple[str, ...]
    row: Array
    moving: tuple[int, ...]
    covariance: Array
    states: Array
    inputs: Mapping[str, Array] = field(default_factory=dict)


def curve_fit_on_windows(assembly: Assembly, admitted: AdmittedEffect, mask: Masks) -> CurveFit:
    """A learned effect that was admitted on windows, refitted on some samples."""
    stage, state = last_stage(assembly, admitted.fit_state, mask), admitted.fit_state
    learned, seed = admitted.variant.effect, assembly.problem.model.labels
    assert isinstance(learned, Learned)
    moving, _ = columns_with_bounds(assembly, state.keys(assembly))
    return CurveFit(
        assembly, learned, tuple(x for x in state.labels if x not in seed),
        stage.fitted.point.values[0], tuple(int(i) for i in moving.index),
        covariance(stage.fitted) * max(stage.fitted.chi2_per_dof, 1.0),
        window_states(assembly, stage),
    )  # fmt: skip


def describe_curve(fit: CurveFit, label: str, suggestions: Sequence[Suggestion]) -> Unknown:
    """The shape of a learned effect, called ``label``, that comes first among ``suggestions``."""
    learned = fit.learned
    port = fit.assembly.problem.model.system.place(learned)
    visited = courses(fit.assembly, fit.states, learned, fit.inputs)
    curves = tuple(_curve_with_band(fit, course) for course in visited)
    best = next(s for s in suggestions if s.effect == label)
    rate = isinstance(learned, LearnedForce) and learned.follows == "velocity"
    return Unknown(
        effect=label,
        meaning=learned.meaning(),
        state=" and ".join(c.state for c in curves),
        state_unit=port.position_unit + ("/s" if rate else ""),
        force_unit=port.force_unit,
        times=learned.times,
        parity=_parity(curves),
        kinked=_kink(curves),
        explains=best.explains,
        p_value=best.p_value,
        curves=curves,
        others={s.effect: s.explains for s in suggestions if s is not best},
        quantity=_quantity_word(learned, port),
    )


def _quantity_word(learned: Learned, port: Port) -> str:
    if isinstance(learned, LearnedParameterChange):
        return f"change of {port.axes[0]}"
    if not isinstance(learned, LearnedForce):
        return "flow"
    return "radial force" if learned.follows == "radius" else "force"


def _curve_with_band(fit: CurveFit, course: CurveAxis) -> Curve:
    low, high = np.percentile(course.seen, [_TAILS, 100 - _TAILS])
    at = np.linspace(low, high, _POINTS)
    edges = np.concatenate([at - (at[1] - at[0]) / 2, [at[-1] + (at[1] - at[0]) / 2]])
    visited = np.histogram(course.seen, edges)[0].astype(float)
    visited /= visited.sum()
    assembly, added, row = fit.assembly, list(fit.added), fit.row
    seed = list(assembly.problem.model.labels)
    path = StatePath(assembly, fit.learned, course, at)
    slopes = np.array([path.slope(row, added, i) for i in fit.moving]).T
    seeds = [i for i, k in enumerate(assembly.study.keys) if owner_of(k) in seed]
    basis = np.array([path.slope(row, seed, i) for i in seeds]).T
    force = path.force(row, added)
    if isinstance(fit.learned, LearnedParameterChange):
        force, left = _share_of_mean(1.0 + force, visited)
    else:
        left = residual_projection(basis, visited)
        force = left @ force
    spread = left @ slopes @ fit.covariance @ slopes.T @ left.T
    se = np.sqrt(np.maximum(np.diag(spread), 0.0))
    return Curve(
        axis=course.axis,
        state=course.state,
        at=at,
        force=force,
        se=se,
        band=_critical_value(spread, se) * se,
        visited=visited,
        speed=course.typical if fit.learned.times else 0.0,
    )


def _share_of_mean(factor: Array, weight: Array) -> tuple[Array, Array]:
    """r = f / m - 1 with m = w f, and (points, points) dr/df: the same for every scale of f."""
    mean = float(weight @ factor)
    return factor / mean - 1.0, np.eye(len(factor)) / mean - np.outer(factor, weight) / mean**2


def residual_projection(basis: Array, weight: Array) -> Array:
    """(points, points) I - P, P the weighted projection onto the columns of a basis."""
    size = np.linalg.norm(basis, axis=0) if basis.size else np.zeros(0)
    kept = basis[:, size > 0] / size[size > 0] if len(size) else np.zeros((len(weight), 0))
    if not kept.shape[1]:
        return np.eye(len(weight))
    root = np.sqrt(weight)[:, None]
    taken = np.linalg.pinv(root * kept, rcond=1e-9) * root.T
    return np.eye(len(weight)) - kept @ taken


def _critical_value(spread: Array, se: Array) -> float:
    """The 95 % quantile of the largest |t| along the curve, by draws from its covariance."""
    unit = spread / np.maximum(np.outer(se, se), 1e-300)
    values, vectors = np.linalg.eigh(unit)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    draws = np.random.default_rng(0).normal(size=(_DRAWS, len(se))) @ root.T
    return float(np.quantile(np.abs(draws).max(axis=1), 0.95))


def _parity(curves: tuple[Curve, ...]) -> str:
    """Odd, even or neither, by the energies of both parts over the values visited both ways."""
    odd = even = 0.0
    for c in curves:
        reach = min(-c.at[0], c.at[-1])
        if reach <= _ONE_SIGN * float(np.abs(c.at).max()):
            return "one-sided"
        s = np.linspace(-reach, reach, _POINTS)
        force, weight = np.interp(s, c.at, c.force), np.interp(s, c.at, c.visited)
        weight = weight + weight[::-1]
        odd += float(np.sum(weight * ((force - force[::-1]) / 2) ** 2))
        even += float(np.sum(weight * ((force + force[::-1]) / 2) ** 2))
    share = even / max(odd + even, 1e-300)
    if share < _ONE_SIDED:
        return "odd"
    return "even" if share > 1 - _ONE_SIDED else "neither"


def _kink(curves: tuple[Curve, ...]) -> float | None:
    """Where most of a curve's bending lies within 1.5 spacings of its knots; else nothing."""
    c = max(curves, key=lambda c: float(np.sum(c.visited * c.force**2)))
    middle = 0.0 if _parity(curves) != "one-sided" else float(c.at[0] + c.at[-1]) / 2
    half = float(np.abs(c.at - middle).max())
    bend, at = np.abs(np.diff(c.force, 2)), c.at[1:-1]
    near = [
        float(bend[np.abs(at - x) <= 0.75 * half * spacing((x - middle) / half)].sum()) for x in at
    ]
    best = int(np.argmax(near))
    return float(at[best]) if near[best] > _KINKED * bend.sum() > 0 else None
