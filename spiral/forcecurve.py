"""The curve of a missing force over the state it follows, with its band.

A force is known up to what the seed's own effects can take over (a linear spring hides any linear
part), so the curve of all that a study has added to its seed is what is left of it beside them, by
least squares weighted by how often each value was visited.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import numpy as np

from spiral.assembly import Assembly, columns
from spiral.compare import last_stage
from spiral.effect import Effect, ForceEffect, expand
from spiral.evidence import Admitted, Masks, Standing
from spiral.learned import SPACING, LearnedForce
from spiral.port import At
from spiral.record import Array
from spiral.run import Suggestion
from spiral.shooting.fit import covariance
from spiral.shooting.growth import Stage
from spiral.shooting.sensitivities import run_windows

_POINTS = 81
_TAILS = 0.5  # per cent of the visited values left out at either end
_ONE_SIDED = 0.1  # share of the curve's energy under which a part (odd, even) is left unsaid
_KINKED = 0.6  # share of all bending within a stretch of 1.5 spacings from which a curve is kinked
_DRAWS = 4000
_STEP = 1e-4


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

    ``effect`` is the learned effect that may be admitted; ``parity`` odd, even or neither;
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

    @property
    def sentence(self) -> str:
        """In words."""
        times = f" times {self.times}" if self.times else ""
        way = {"odd": "odd", "even": "even"}.get(self.parity, "neither odd nor even")
        bend = "smooth"
        if self.kinked is not None:
            bend = f"kinked near {self.kinked:.3g} {self.state_unit}"
        return f"A force that follows {self.state}{times}: {way}, {bend}."

    def as_dict(self) -> dict[str, Any]:
        """As the JSON contract writes it."""
        plain = {k: v for k, v in vars(self).items() if k not in ("curves", "others", "kinked")}
        curves = [
            {k: v.tolist() if isinstance(v, np.ndarray) else v for k, v in vars(c).items()}
            for c in self.curves
        ]
        smooth = {"smooth": self.kinked is None, "kinked_at": self.kinked}
        return {**plain, **smooth, "sentence": self.sentence, "others": dict(self.others),
                "curves": curves}  # fmt: skip


def described(
    assembly: Assembly, admitted: Admitted, suggestions: tuple[Suggestion, ...], mask: Masks
) -> Unknown:
    """The shape of an admitted learned effect, refitted on the half that did not select it."""
    stage = last_stage(assembly, admitted.standing, mask)
    learned = admitted.variant.effect
    assert isinstance(learned, LearnedForce)
    system = assembly.problem.model.system
    port = system.place(learned)
    states, typical = _visited(assembly, stage, learned)
    curves = tuple(
        _curve(assembly, admitted.standing, stage, learned, axis, states[axis], typical[axis])
        for axis in range(len(port.axes))
    )
    best = suggestions[0]
    span = max(float(np.abs(c.at).max()) for c in curves)
    unit = port.position_unit + ("/s" if learned.follows == "velocity" else "")
    return Unknown(
        effect=admitted.variant.original.label,
        meaning=learned.meaning(),
        state=" and ".join(c.state for c in curves),
        state_unit=unit,
        force_unit=port.force_unit,
        times=learned.times,
        parity=_parity(curves),
        kinked=_kink(curves, SPACING * span),
        explains=best.explains,
        p_value=best.p_value,
        curves=curves,
        others={s.effect: s.explains for s in suggestions[1:]},
    )


def _visited(
    assembly: Assembly, stage: Stage, learned: LearnedForce
) -> tuple[list[Array], list[float]]:
    """Of each axis: the values of the state in the fitted windows, and the rms velocity."""
    import sympy as sp

    from spiral.assembly import at_port

    traced, system = assembly.study.compiled.traced, assembly.problem.model.system
    parts = [
        run_windows(assembly.study, r, layout, stage.fitted.point)[0]
        for r, layout in enumerate(stage.layouts)
    ]
    states = np.concatenate([p[np.isfinite(p).all(axis=1)] for p in parts])
    seen: dict[str, list[Array]] = {}
    for kind, expressions in at_port(system, system.place(learned), traced):
        values = sp.lambdify(traced.x, expressions, "numpy")(*states.T)
        seen[kind] = [np.broadcast_to(v, (len(states),)) for v in values]
    return seen[learned.follows], [float(np.sqrt(np.mean(v**2))) for v in seen["velocity"]]


def _curve(
    assembly: Assembly,
    standing: Standing,
    stage: Stage,
    learned: LearnedForce,
    axis: int,
    seen: Array,
    typical: float,
) -> Curve:
    low, high = np.percentile(seen, [_TAILS, 100 - _TAILS])
    at = np.linspace(low, high, _POINTS)
    edges = np.concatenate([at - (at[1] - at[0]) / 2, [at[-1] + (at[1] - at[0]) / 2]])
    visited = np.histogram(seen, edges)[0].astype(float)
    visited /= visited.sum()
    seed = assembly.problem.model.labels
    added = [x for x in standing.labels if x not in seed]
    row = stage.fitted.point.values[0]
    moving, _ = columns(assembly, standing.keys(assembly))
    path = _Path(assembly, learned, axis, at, typical)
    slopes = np.array([path.slope(row, added, int(i)) for i in moving.index]).T
    seeds = [i for i, k in enumerate(assembly.study.keys) if k.rsplit(".", 1)[0] in seed]
    basis = np.array([path.slope(row, list(seed), i) for i in seeds]).T
    left = beside(basis, visited)
    spread = left @ slopes @ covariance(stage.fitted) @ slopes.T @ left.T
    spread = spread * max(stage.fitted.chi2_per_dof, 1.0)
    se = np.sqrt(np.maximum(np.diag(spread), 0.0))
    port = assembly.problem.model.system.place(learned)
    rate = "'" if learned.follows == "velocity" else ""
    force = left @ path.force(row, added)
    return Curve(
        axis=port.axes[axis],
        state=port.axes[axis] + rate,
        at=at,
        force=force,
        se=se,
        band=_critical(spread, se) * se,
        visited=visited,
        speed=typical if learned.times else 0.0,
    )


@dataclass(frozen=True)
class _Path:
    """A state of one axis that takes given values, all others at rest.

    Of a curve that is multiplied by a velocity it is the part of the force that turns with the
    velocity's sign, at its rms value.
    """

    assembly: Assembly
    learned: LearnedForce
    axis: int
    at: Array
    typical: float

    def force(self, row: Array, labels: list[str]) -> Array:
        """(points,) the force of some effects along the axis."""
        if not self.learned.times:
            return self._at(row, labels, 0.0)
        ahead, back = (self._at(row, labels, v) for v in (self.typical, -self.typical))
        return (ahead - back) / 2

    def slope(self, row: Array, labels: list[str], index: int) -> Array:
        """(points,) its derivative by a parameter."""
        keys = self.assembly.study.keys
        if index >= len(keys) or keys[index].rsplit(".", 1)[0] not in labels:
            return np.zeros(len(self.at))
        step = _STEP * max(abs(row[index]), 1e-12)
        if self.assembly.study.compiled.traced.parameters[index].role == "amplitude":
            step = 1.0  # linear: exact for any step
        ahead, back = row.copy(), row.copy()
        ahead[index] += step
        back[index] -= step
        owner = [keys[index].rsplit(".", 1)[0]]
        return (self.force(ahead, owner) - self.force(back, owner)) / (2 * step)

    def _at(self, row: Array, labels: list[str], velocity: float) -> Array:
        system, study = self.assembly.problem.model.system, self.assembly.study
        own = system.place(self.learned)
        still = np.zeros(len(self.at))
        q, v = [still] * len(own.axes), [still] * len(own.axes)
        moving = v if self.learned.follows == "velocity" else q
        moving[self.axis] = self.at
        if self.learned.times:
            v[self.axis] = still + velocity
        total = still.copy()
        for effect in _effects(self.assembly, labels):
            reads = set(effect.inputs) or effect.states
            if reads or not isinstance(effect, ForceEffect) or effect.port != self.learned.port:
                continue
            p = SimpleNamespace()
            for parameter in effect.parameters:
                values = [
                    row[study.index(k)] for k, _ in expand(effect.label, (parameter,), own.axes)
                ]
                setattr(p, parameter.name, tuple(values) if parameter.per_axis else values[0])
            with np.errstate(invalid="ignore", divide="ignore"):
                given = effect.force(At(tuple(q), tuple(v), SimpleNamespace()), None, p)  # type: ignore[arg-type]
            total = total + np.nan_to_num(np.broadcast_to(given[self.axis], total.shape))
        return total


def _effects(assembly: Assembly, labels: list[str]) -> list[Effect]:
    own: list[Effect] = [e for e in assembly.problem.model.effects if e.label in labels]
    return own + [v.effect for v in assembly.variants if v.label in labels]


def beside(basis: Array, weight: Array) -> Array:
    """(points, points): what is left of a curve once these columns have taken what they can."""
    size = np.linalg.norm(basis, axis=0) if basis.size else np.zeros(0)
    kept = basis[:, size > 0] / size[size > 0] if len(size) else np.zeros((len(weight), 0))
    if not kept.shape[1]:
        return np.eye(len(weight))
    root = np.sqrt(weight)[:, None]
    taken = np.linalg.pinv(root * kept, rcond=1e-9) * root.T
    return np.eye(len(weight)) - kept @ taken


def _critical(spread: Array, se: Array) -> float:
    """The 95 % quantile of the largest |t| along the curve, by draws from its covariance."""
    unit = spread / np.maximum(np.outer(se, se), 1e-300)
    values, vectors = np.linalg.eigh(unit)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    draws = np.random.default_rng(0).normal(size=(_DRAWS, len(se))) @ root.T
    return float(np.quantile(np.abs(draws).max(axis=1), 0.95))


def _parity(curves: tuple[Curve, ...]) -> str:
    """Odd, even, or neither, by the energies of both parts over the values visited both ways."""
    odd = even = 0.0
    for c in curves:
        reach = min(-c.at[0], c.at[-1])
        if reach <= 0:
            return "neither"
        s = np.linspace(-reach, reach, _POINTS)
        force, weight = np.interp(s, c.at, c.force), np.interp(s, c.at, c.visited)
        weight = weight + weight[::-1]
        odd += float(np.sum(weight * ((force - force[::-1]) / 2) ** 2))
        even += float(np.sum(weight * ((force + force[::-1]) / 2) ** 2))
    share = even / max(odd + even, 1e-300)
    if share < _ONE_SIDED:
        return "odd"
    return "even" if share > 1 - _ONE_SIDED else "neither"


def _kink(curves: tuple[Curve, ...], spacing: float) -> float | None:
    """Where most of a curve's bending lies in one short stretch; nothing for a smooth one."""
    c = max(curves, key=lambda c: float(np.sum(c.visited * c.force**2)))
    step = float(c.at[1] - c.at[0])
    bend = np.abs(np.diff(c.force, 2))
    width = max(1, min(round(1.5 * spacing / step), len(bend)))
    held = np.convolve(bend, np.ones(width), "valid") / max(bend.sum(), 1e-300)
    best = int(np.argmax(held))
    return float(c.at[best + 1 + width // 2]) if held[best] > _KINKED else None
