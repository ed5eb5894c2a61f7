"""One case for each mechanical and rotor effect: put into the truth, left out of the model."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

import numpy as np

from spiral.inference.problem import Problem, Settings
from spiral.inference.simulate import simulate
from spiral.io.registry import Registry, load_registry
from spiral.types.effect import Effect
from spiral.types.model import Model
from spiral.types.record import Record
from spiral.types.system import System


@cache
def installed() -> Registry:
    """The plugins that are installed and the chain of masses, found once for a process."""
    return load_registry(Path(__file__).parent / "systems")


@dataclass(frozen=True)
class Scene:
    """A system, its usual truth, and how it is excited.

    ``repeated``: the same excitation in every record, with fresh noise, and another in every test.
    ``everywhere``: effects at every port and input compete; else those that fit the first port.
    ``corner``, ``force``: of an applied force, the end of its band in Hz, and its size in N.
    """

    system: str
    fields: Mapping[str, object]
    truth: Mapping[str, float]
    duration: float
    rate: float
    substeps: int
    repeated: bool = False
    everywhere: bool = False
    corner: float = 6.0
    force: float = 3.0

    def inputs(self, time: np.ndarray, rng: np.random.Generator) -> dict[str, np.ndarray]:
        """A rotor's run-down from 40 to 0 Hz, band-limited noise, or a pump's voltage in steps."""
        if self.system == "planar_rotor":
            slope = -2 * np.pi * 40.0 / self.duration
            first = 2 * np.pi * 40.0
            return {"speed": first + slope * time, "phase": first * time + slope * time**2 / 2}
        if self.system == "cascaded_tanks":
            steps = rng.uniform(1.0, 3.0, len(time) // 30 + 1)
            steps[1::4] = 3.0  # every record reaches the top, where rims and limits are
            return {"pump": np.repeat(steps, 30)[: len(time)]}
        from scipy.signal import butter, sosfiltfilt

        low = butter(6, self.corner, fs=self.rate, output="sos")
        return {"force": sosfiltfilt(low, rng.normal(size=len(time))) * self.force}


ROTOR = Scene(
    "planar_rotor",
    {},
    {
        "linear_stiffness.stiffness_x": 8085.0,
        "linear_stiffness.stiffness_y": 9672.0,
        "linear_damping.damping_x": 3.5,
        "linear_damping.damping_y": 2.1,
        "unbalance.moment": 1.565e-5,
    },
    duration=14.0,
    rate=1000.0,
    substeps=2,
)
SWING = Scene(
    "oscillator",
    {"position_unit": "rad", "force_unit": "N*m"},
    {
        "system.mass": 0.02,
        "linear_stiffness.stiffness": 0.4,
        "linear_damping.damping": 0.02,
    },
    duration=40.0,
    rate=100.0,
    substeps=4,
)


@dataclass(frozen=True)
class Case:
    """An effect hidden in the truth with these values (none: it belongs to the seed)."""

    effect: str
    values: Mapping[str, float] = field(default_factory=dict)
    scene: Scene = ROTOR


CASES = (
    Case("linear_stiffness"),
    Case("linear_damping"),
    Case("unbalance"),
    Case("quadratic_stiffness", {"stiffness_x": 1e7, "stiffness_y": 1e7}),
    Case("cubic_stiffness", {"stiffness": 3e10}),
    Case("clearance", {"stiffness": 4000.0, "gap": 1.2e-4}),
    Case("stop", {"stiffness": 4000.0, "gap": 1.2e-4}),
    Case("preload", {"force_x": 0.1, "force_y": 0.1, "width": 5e-5}),
    Case("constant_load", {"force_x": 0.3, "force_y": 0.1}),
    Case("cross_stiffness", {"stiffness": 600.0}),
    Case("cross_coupled_stiffness", {"stiffness": 100.0}),
    Case("speed_stiffness", {"coefficient": 0.03}),
    Case("rub", {"stiffness": 4000.0, "gap": 1.5e-4}),
    Case("quadratic_damping", {"damping": 150.0}),
    Case("amplitude_damping", {"damping": 1e8}),
    Case("coulomb_friction", {"level_x": 0.05, "level_y": 0.05, "width": 5e-4}),
    Case("stribeck_friction", {"level_x": 0.1, "level_y": 0.1, "speed": 5e-3, "width": 5e-4}),
    Case("cross_damping", {"damping": 0.8}),
    Case("antisymmetric_damping", {"damping": 1.0}),
    Case("gyroscopic", {"coefficient": 0.01}),
    Case("internal_damping", {"damping": 0.6}),
    Case("shaft_bow", {"cosine": 0.05, "sine": 0.03}),
    Case("misalignment", {"cosine": 0.05, "sine": 0.03}),
    Case("crack", {"cosine": 300.0, "sine": 150.0}),
    Case(
        "hidden_mode",
        {"mass_x": 0.05, "mass_y": 0.05, "natural_frequency": 24.0, "damping_ratio": 0.03},
    ),
    Case("lag", {"stiffness_x": 4000.0, "stiffness_y": 4000.0, "time_constant": 0.01}),
    Case(
        "bouc_wen",
        {"stiffness_x": 4000.0, "stiffness_y": 4000.0, "length": 5e-5, "asymmetry": 0.5},
    ),
    Case("gravity_torque", {"torque": 0.5}, SWING),
    Case("asymmetric_damping", {"damping": 0.008}, SWING),
    Case("position_friction", {"slope": 0.04, "width": 0.03}, SWING),
    Case("asymmetric_stiffness", {"stiffness": 0.06}, SWING),
    Case("stiffness_drift", {"rate": 0.002}, SWING),
    Case("cogging", {"cosine": 0.05, "sine": 0.1, "count": 12.0}, SWING),
    Case("jenkins", {"stiffness": 0.15, "length": 0.2}, SWING),
)


def problem(
    case: Case, registry: Registry, seed: int = 1, noise: float = 0.02, max_rounds: int = 1,
    strategy: str = "shooting",
) -> Problem:  # fmt: skip
    """The study of one case: record and test from the truth, a model without the effect."""
    system = registry.make("system", case.scene.system, dict(case.scene.fields))
    assert isinstance(system, System)
    truth = truth_of(case, system, registry)
    model = Model(system, tuple(e for e in system.seed if e.label != case.effect))
    offered = registry.candidates(system, everywhere=case.scene.everywhere)
    candidates = tuple(e for e in offered if e.label not in model.labels)
    return Problem(
        model,
        (record_of(case.scene, truth, seed, 0.4, noise),),
        (record_of(case.scene, truth, seed + 1000, 1.3, noise, 1),),
        candidates=candidates,
        settings=Settings(max_rounds=max_rounds),
        strategy=registry.make("strategy", strategy),
    )


def truth_of(case: Case, system: System, registry: Registry) -> Model:
    """The system with the hidden effect, where one is named."""
    effects: tuple[Effect, ...] = system.seed
    values = dict(case.scene.truth)
    if case.effect and case.effect not in [e.label for e in effects]:
        effects = (*effects, registry.effect_from_label(case.effect, {}))
        values.update({f"{case.effect}.{k}": v for k, v in case.values.items()})
    return Model(system, effects, values)


def record_of(
    scene: Scene, truth: Model, seed: int, phase: float, noise: float, course: int = 0
) -> Record:
    """A simulated record; ``course`` picks the excitation where it is repeated, else the seed."""
    rng = np.random.default_rng(seed)
    drawn = np.random.default_rng(course) if scene.repeated else rng
    time = np.arange(round(scene.duration * scene.rate) + 1) / scene.rate
    if scene.system == "planar_rotor":
        truth = Model(truth.system, truth.effects, {**truth.values, "system.phase_origin": phase})
    return simulate(
        truth, time, scene.inputs(time, drawn), noise, rng, substeps=scene.substeps,
        name=f"hidden effect, seed {seed}",
    )  # fmt: skip
