"""Physics in no catalog: put into the truth, left out of the model, and of all candidates."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from spiral_plugins.sources.simulation import Simulation
from spiral_plugins.strategies.shooting import Shooting

from experiments.hidden_effects.cases import ROTOR
from spiral.inference.problem import Problem, Settings
from spiral.inference.unknown.forcecurve import residual_projection
from spiral.io.registry import Registry
from spiral.math import length, sin, sqrt, tanh
from spiral.types.effect import Effect, FlowEffect, ForceEffect
from spiral.types.model import seed_model
from spiral.types.parameter import Parameter
from spiral.types.system import System

Array = np.ndarray
_SHAPE = Parameter("length", "position", role="shape", start=1.0)
_WIDTH = Parameter("width", "velocity", role="shape", start=1.0)


class SineSpring(ForceEffect):
    """F = -a sin(q / l): a magnetic or detent torque that comes round again."""

    parameters = (Parameter("size", "force"), _SHAPE)

    def force(self, at, u, p):
        """-a sin(q / l) per axis."""
        return [-p.size * sin(q / p.length) for q in at.position]


class TanhBearing(ForceEffect):
    """F = -a tanh(q / l): a bearing whose force saturates."""

    parameters = (Parameter("size", "force"), _SHAPE)

    def force(self, at, u, p):
        """-a tanh(q / l) per axis."""
        return [-p.size * tanh(q / p.length) for q in at.position]


class RadialBearing(ForceEffect):
    """F = -a tanh(|q| / l) q / |q|: a bearing whose radial force saturates."""

    axes = 2
    parameters = (Parameter("size", "force"), _SHAPE)

    def force(self, at, u, p):
        """-a tanh(|q| / l) along the radius."""
        r = length(at.position)
        return [-p.size * tanh(r / p.length) * q / r for q in at.position]


class PlaceFriction(ForceEffect):
    """F = -a (1 + sin(q / l)) tanh(v / w): dry friction of a guide worn in places."""

    parameters = (Parameter("size", "force"), _SHAPE, _WIDTH)

    def force(self, at, u, p):
        """-a (1 + sin(q / l)) tanh(v / w) per axis."""
        rows = zip(at.position, at.velocity, strict=True)
        return [-p.size * (1 + sin(q / p.length)) * tanh(v / p.width) for q, v in rows]


class SideHole(FlowEffect):
    """x2' = ... - a sqrt((x2 - h)_+): a second hole in the side of the lower tank, at height h."""

    channels = ("lower",)
    parameters = (
        Parameter("size", "position^0.5/s"),
        Parameter("height", "position", role="shape", start=1.0),
    )

    def flow(self, x, u, p):
        """-a sqrt((x2 - h)_+), its corner rounded."""
        above = x.lower - p.height
        wet = (above + sqrt(above * above + (0.05 * p.height) ** 2)) / 2
        return {"lower": -p.size * sqrt(wet)}


class StickyValve(FlowEffect):
    """A valve between the tanks that opens with the upper level: x1' = ... - q, x2' = ... + q.

    q = a (1 + tanh((x1 - m) / w)) / 2.
    """

    channels = ("upper", "lower")
    parameters = (
        Parameter("size", "position/s"),
        Parameter("middle", "position", role="shape", start=1.0),
        Parameter("width", "position", role="shape", start=1.0),
    )

    def flow(self, x, u, p):
        """What leaves the upper tank enters the lower one."""
        moved = p.size * (1 + tanh((x.upper - p.middle) / p.width)) / 2
        return {"upper": -moved, "lower": moved}


@dataclass(frozen=True)
class Case:
    """One hidden law, or none, in one system.

    ``learned`` and ``state`` are the curve and the state that should be named, ``parity`` and
    ``smooth`` what should be said of it; ``truth(at, speed)`` the hidden force along that state,
    ``taken(at)`` what the seed can take over of it (a column for each of its effects).
    """

    system: str
    base: Mapping[str, float]
    record: Mapping[str, Any]
    hidden: Effect | None = None
    values: Mapping[str, float] = field(default_factory=dict)
    learned: str = ""
    state: str = ""
    parity: str = ""
    smooth: bool = True
    truth: Callable[[Array, float], Array] | None = None
    taken: Callable[[Array], Array] = np.ones_like


def _shaken(hidden: Effect | None = None, **fields: Any) -> Case:
    return Case(
        "oscillator",
        {"system.mass": 1.0, "linear_stiffness.stiffness": 4e4, "linear_damping.damping": 20.0},
        {"inputs": {"force": {"noise": 1.0, "band": [5, 60]}}, "duration": 10.0, "rate": 1000.0},
        hidden, **fields,
    )  # fmt: skip


def _run_down(hidden: Effect | None = None, **fields: Any) -> Case:
    return Case(
        "planar_rotor",
        {**ROTOR.truth, "system.phase_origin": 0.4},
        {"inputs": {"speed": {"sweep": [30, 3], "unit": "Hz"}}, "duration": 8.0, "rate": 500.0},
        hidden, **fields,
    )  # fmt: skip


def _pumped(hidden: Effect | None = None, **fields: Any) -> Case:
    return Case(
        "cascaded_tanks",
        {"pump.gain": 0.04, "outlets.upper": 0.05, "outlets.lower": 0.05},
        {
            "inputs": {"pump": {"noise": 0.7, "offset": 2.0, "band": [0.0002, 0.01]}},
            "duration": 6000.0, "rate": 0.25, "start": {"upper": 2.0, "lower": 2.0},
        },
        hidden, **fields,
    )  # fmt: skip


def _root(at: Array) -> Array:
    """The seed's outlets along a level."""
    return at / (at * at + 0.1**2) ** 0.25


CASES = {
    "sine": _shaken(
        SineSpring(), values={"size": 0.5, "length": 4e-5}, learned="learned_spring", state="x",
        parity="odd", truth=lambda q, v: -0.5 * np.sin(q / 4e-5), taken=np.array,
    ),
    "tanh": _shaken(
        TanhBearing(), values={"size": 0.6, "length": 3e-5}, learned="learned_spring", state="x",
        parity="odd", truth=lambda q, v: -0.6 * np.tanh(q / 3e-5), taken=np.array,
    ),
    "friction": _shaken(
        PlaceFriction(), values={"size": 0.2, "length": 6e-5, "width": 1e-3},
        learned="learned_dry_friction", state="x", parity="odd",
        truth=lambda q, v: -0.2 * (1 + np.sin(q / 6e-5)) * np.tanh(v / 1e-3),
    ),
    "rotor axes": _run_down(
        TanhBearing(), values={"size": 0.3, "length": 1e-4}, learned="learned_spring",
        state="x and y", parity="odd", truth=lambda q, v: -0.3 * np.tanh(q / 1e-4), taken=np.array,
    ),
    "rotor radius": _run_down(
        RadialBearing(), values={"size": 0.3, "length": 1e-4}, learned="learned_radial_spring",
        state="the radius of x and y", parity="one-sided",
        truth=lambda r, v: -0.3 * np.tanh(r / 1e-4), taken=np.array,
    ),
    "tanks hole": _pumped(
        SideHole(), values={"size": 0.03, "height": 2.0}, learned="learned_lower_flow",
        state="lower", parity="one-sided", smooth=False,
        truth=lambda x, v: -0.03 * np.sqrt((x - 2 + np.hypot(x - 2, 0.1)) / 2), taken=_root,
    ),
    "tanks valve": _pumped(
        StickyValve(), values={"size": 0.03, "middle": 2.5, "width": 0.3},
        learned="learned_transfer", state="upper", parity="one-sided",
        truth=lambda x, v: -0.015 * (1 + np.tanh((x - 2.5) / 0.3)), taken=_root,
    ),
    "nothing, oscillator": _shaken(),
    "nothing, rotor": _run_down(),
    "nothing, tanks": _pumped(),
}  # fmt: skip


def source_of(case: Case, system: System, seed: int, noise: float = 0.02) -> Simulation:
    """Where the records of a case come from."""
    hidden = () if case.hidden is None else (case.hidden,)
    own = {f"{e.label}.{k}": v for e in hidden for k, v in case.values.items()}
    return Simulation(
        system=system, effects=hidden, values={**case.base, **own}, noise_level=noise, seed=seed,
        **case.record,
    )  # fmt: skip


def problem(name: str, registry: Registry, seed: int = 0, **settings: Any) -> Problem:
    """The study of a case: a record and a test record from the truth, all candidates."""
    case = CASES[name]
    system = registry.make("system", case.system)
    assert isinstance(system, System)
    source = source_of(case, system, seed)
    record, test = (s.load(system)[0] for s in (source, source.as_test()))
    model = seed_model(system)
    candidates = tuple(e for e in registry.candidates(system) if e.label not in model.labels)
    found = Problem(model, (record,), (test,), candidates=candidates, settings=Settings(**settings),
                    strategy=Shooting())  # fmt: skip
    return replace(found, dictionary=registry.dictionary(system))


@dataclass(frozen=True)
class Coverage:
    """Shares of the visited values at which the band holds the true curve, beside the seed.

    ``whole`` of the simultaneous band, ``pointwise`` of 1.96 standard errors.
    """

    whole: float
    pointwise: float


def coverage(case: Case, unknown: Mapping[str, Any]) -> Coverage:
    """How much of the true curve lies inside the band, least over the axes."""
    assert case.truth is not None
    found = []
    for curve in unknown["curves"]:
        at, force, se, band, visited = (
            np.array(curve[k]) for k in ("at", "force", "se", "band", "visited")
        )
        left = residual_projection(np.column_stack([case.taken(at)]), visited)
        off = np.abs(force - left @ case.truth(at, curve["speed"]))
        found.append([float(visited[off <= width].sum()) for width in (band, 1.96 * se)])
    return Coverage(*(float(v) for v in np.min(found, axis=0)))
