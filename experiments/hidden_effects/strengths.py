"""How strong a hidden effect is: its amplitude for a wanted share of the response.

share = rms(y_with - y_without) / std(y_without), mean over channels, on the noise-free record.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from hashlib import sha256

import numpy as np

from experiments.hidden_effects.cases import ROTOR, SWING, Case, Scene, record_of, truth_of
from spiral.engine.growth import layouts_for
from spiral.engine.study import Point
from spiral.inference.evidence.assembly import assemble, initial_values
from spiral.inference.evidence.comparison import refine_substeps
from spiral.inference.evidence.fit_state import FitState
from spiral.inference.evidence.scales import largest_port_motion, shape_scale
from spiral.inference.identifiability.information import RecordInformation
from spiral.inference.problem import Problem
from spiral.io.registry import Registry
from spiral.types.effect import Effect
from spiral.types.errors import SpiralError
from spiral.types.record import Record
from spiral.types.system import System

SHARES = {"weak": 0.05, "medium": 0.2, "strong": 0.5}
NOISES = (0.005, 0.02, 0.05)
KNOWN_FROM = 100.0  # rise of chi^2 that an effect must cause to count as identifiable

# Short records, so that thousands of studies fit into half an hour; steps so fine that a sharp
# friction of the truth is not that of the integrator.
SCENES = {
    "planar_rotor": replace(ROTOR, duration=3.0, rate=200.0, substeps=16),
    "oscillator": replace(SWING, fields={}, duration=8.0, rate=125.0, repeated=True, substeps=16),
    "cascaded_tanks": Scene(
        "cascaded_tanks",
        {},
        {"pump.gain": 0.04, "outlets.upper": 0.05, "outlets.lower": 0.05},
        duration=2000.0,
        rate=0.25,
        substeps=4,
        repeated=True,
    ),
}
CHAINS = {
    f"chain_{n}": Scene(
        "chain", {"masses": n},
        {"linear_stiffness.stiffness": 4000.0, "linear_damping.damping": 2.0},
        duration=8.0, rate=200.0, substeps=16, everywhere=True, corner=30.0, force=20.0,
    )
    for n in (1, 2, 3, 4, 6)
}  # fmt: skip
"""One to six coordinates, of which two are measured; effects at every port and on the force."""
SCENES |= CHAINS
_SKIPPED = {"cascaded_tanks": ("mains_hum",)}  # a sample every 4 s shows no mains
_STEPS = 30
_CLOSE = 0.03
_STEEPEST = 100.0  # factor on an amplitude from one strength to the next


@dataclass(frozen=True)
class Hidden:
    """One effect hidden in one scene (``system``) at one strength; ``change`` at a noise of 2 %.

    ``change`` is lambda, the rise of chi^2 that it causes beyond what the seed can take over.
    """

    system: str
    effect: str
    strength: str
    values: Mapping[str, float]
    share: float
    change: float

    @property
    def case(self) -> Case:
        """As the studies take it."""
        return Case(self.effect, dict(self.values), SCENES[self.system])

    def identifiable(self, noise: float) -> bool:
        """Whether a record of this noise can show it: lambda falls with the noise squared."""
        return self.change * (0.02 / noise) ** 2 >= KNOWN_FROM


def effects_of(scene: str, registry: Registry) -> tuple[str, ...]:
    """Every effect that may be missing from a scene's seed, at one of the places where it fits.

    Where effects at every port compete, the place of each is drawn by a hash of both names.
    """
    made = registry.make("system", SCENES[scene].system, dict(SCENES[scene].fields))
    seeded = [e.label for e in made.seed]
    places: dict[str, list[str]] = {}
    for effect in registry.candidates(made, everywhere=SCENES[scene].everywhere):
        if effect.label not in (*seeded, *_SKIPPED.get(scene, ())):
            places.setdefault(effect.plugin_name(), []).append(effect.label)
    return tuple(own[_drawn(scene, name) % len(own)] for name, own in places.items())


def _drawn(*names: str) -> int:
    return int.from_bytes(sha256(" ".join(names).encode()).digest()[:4], "big")


def strengths(name: str, label: str, registry: Registry) -> list[Hidden]:
    """An effect at every strength that it can have without the motion of a scene running away."""
    scene = SCENES[name]
    made = registry.make("system", scene.system, dict(scene.fields))
    effect = registry.effect_from_label(label)
    base = _clean(Case("", {}, scene), made, registry)
    direction, shapes = _direction(effect, made), _shapes(effect, made, base)
    found, size = [], 1e-3
    most = min((p.upper or np.inf for p in effect.amplitudes()), default=np.inf)
    shown = partial(_share, direction=direction, shapes=shapes, label=label, system=made,
                    scene=scene, base=base, registry=registry)  # fmt: skip
    for strength, share in SHARES.items():
        reached = _solved(share, size, shown, most)
        if reached is None or (found and reached[0] > _STEEPEST * size):
            break
        size, got = reached
        values = {**{k: size * v for k, v in direction.items()}, **shapes}
        change = _change(Case(label, values, scene), made, registry)
        found.append(Hidden(name, label, strength, values, got, change))
    return found


def _direction(effect: Effect, system: System) -> dict[str, float]:
    """Amplitudes of equal size; a second one of a pair half as large, for a general angle."""
    keys = [
        (k.rsplit(".", 1)[1], p)
        for k, p in effect.keys(system.place(effect))
        if p.role == "amplitude"
    ]
    names = list(dict.fromkeys(p.name for _, p in keys))
    return {k: 0.5 if names.index(p.name) else 1.0 for k, p in keys}


def _shapes(effect: Effect, system: System, base: Record) -> dict[str, float]:
    """Each shape in the middle of its grid, in units of the largest motion.

    A hidden frequency lies a third above the one that halves the energy of the motion.
    """
    states = np.column_stack([base.truth[s.name] for s in system.states])
    largest, place = largest_port_motion(system, (base,), (states,)), system.place(effect)
    found = {}
    for key, p in effect.keys(place):
        if p.role == "shape":
            middle = 0 if any(a.upper for a in effect.amplitudes()) else len(p.grid) // 2
            value = (p.grid[middle] if p.grid else 1.0) * shape_scale(p, largest, place)
            if p.spectrum:
                hertz = 4 / 3 * _median_frequency(base)
                value = 1 / (2 * np.pi * hertz) if p.unit == "s" else hertz
            found[key.rsplit(".", 1)[1]] = value
    return found


def _median_frequency(base: Record) -> float:
    """Hz below which half of the channels' energy lies."""
    channels = np.column_stack(list(base.channels.values()))
    energy = np.sum(np.abs(np.fft.rfft(channels - channels.mean(axis=0), axis=0)) ** 2, axis=1)
    at = int(np.searchsorted(np.cumsum(energy), energy.sum() / 2))
    return float(np.fft.rfftfreq(len(channels), base.dt)[max(at, 1)])


def _clean(case: Case, system: System, registry: Registry) -> Record:
    return record_of(case.scene, truth_of(case, system, registry), 0, 0.4, 0.0)


def _share(
    size: float,
    direction: Mapping[str, float],
    shapes: Mapping[str, float],
    label: str,
    system: System,
    scene: Scene,
    base: Record,
    registry: Registry,
) -> float:
    """Share of the response at an amplitude; infinite where the motion runs away."""
    values = {**{k: size * v for k, v in direction.items()}, **shapes}
    try:
        record = _clean(Case(label, values, scene), system, registry)
    except SpiralError:
        return float("inf")
    shares = [
        np.sqrt(np.mean((record.channels[c] - y) ** 2)) / np.std(y)
        for c, y in base.channels.items()
    ]
    return float(np.mean(shares))


def _solved(wanted: float, size: float, share, most: float) -> tuple[float, float] | None:
    """The amplitude of a wanted share, by steps in proportion; nothing where none has it.

    An amplitude with an upper bound (a hard stop) may stay below, down to half the share.
    """
    low, high = 0.0, np.inf
    if np.isfinite(most) and share(most) < wanted:
        return (most, share(most)) if share(most) > wanted / 2 else None
    for _ in range(_STEPS):
        got = share(size)
        if np.isfinite(got) and abs(got / wanted - 1) < _CLOSE:
            return size, got
        if got > wanted:
            high = min(high, size)
        else:
            low = max(low, size)
        step = wanted / got if np.isfinite(got) and got > 1e-9 else (0.1 if got > wanted else 1e4)
        size *= float(np.clip(step, 1e-4, 1e4))
        if not low < size < high:
            size = np.sqrt(low * high) if low and np.isfinite(high) else low * 2 or high / 10
    return None


def _change(case: Case, system: System, registry: Registry) -> float:
    """lambda at 2 % noise, by the signatures of the true model."""
    truth = truth_of(case, system, registry)
    record = _clean(case, system, registry)
    record = replace(record, noise={c: 0.02 * float(np.std(v)) for c, v in record.channels.items()})
    effect = registry.effect_from_label(case.effect)
    model = replace(truth, values={**truth.values, **_origin(truth)})
    assembly = assemble(Problem(model, (record,), ()))
    assembly = refine_substeps(assembly, FitState(model.labels, initial_values(assembly)))
    starts = np.array([[record.truth[s][0] if s in record.truth else 0.0
                        for s in assembly.study.compiled.traced.states]])  # fmt: skip
    layouts = layouts_for(assembly.study, record.samples, (None,))
    view = RecordInformation.of(assembly, layouts, Point(initial_values(assembly), (starts,)))
    return view.noncentrality_alone(effect.label)


def _origin(truth) -> dict[str, float]:
    return {k: 0.4 for k, _ in truth.pairs if k == "system.phase_origin"}
