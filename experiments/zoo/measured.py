"""Measured records as cases of the zoo, where ``SPIRAL_DATA`` has them, and what is known of them.

Left out: the fine steering mirror (three piezos, three sensors, 28 states in its authors' model).
No system of a few modes comes near its data, so that a missing hysteresis could not be told.
"""

from __future__ import annotations

import os
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

from experiments.studies.outcomes import Row, named, told
from experiments.studies.pieces import version
from experiments.studies.question import Question
from spiral.io.registry import Registry, load_registry
from spiral.types.record import Record
from spiral.types.system import System

HERE = Path(__file__).parent
SYSTEMS = HERE / "measured_systems"
WORDS_OF_ANOTHER_MACHINE = ("another machine", "different machine", "other machine", "extrapolat")
"""Of which one should be said where train and test are two machines."""


@cache
def registry() -> Registry:
    """The shipped plugins and those written for these sets, as a user's folder."""
    return load_registry(SYSTEMS)


@dataclass(frozen=True)
class Measured:
    """One measured set: files and their split, the model, and what its source knows.

    Parameters
    ----------
    file : whose presence under ``SPIRAL_DATA`` is asked.
    system, fields, values, free : the model as a user would begin. train, test : (path, rows).
    read : fields of ``spiral.read``. hidden : labels of which one is expected first.
    truth : published values by full name. refused : train and test are two machines.
    """

    file: str
    system: str
    train: tuple[tuple[str, tuple[int, int] | None], ...]
    test: tuple[tuple[str, tuple[int, int] | None], ...]
    read: Mapping[str, Any]
    fields: Mapping[str, object] = field(default_factory=dict)
    values: Mapping[str, float] = field(default_factory=dict)
    free: tuple[str, ...] = ()
    hidden: tuple[str, ...] = ()
    truth: Mapping[str, float] = field(default_factory=dict)
    refused: bool = False
    test_read: Mapping[str, Any] = field(default_factory=dict)

    def asked(self, strategy: str | None) -> Row:
        """Read, discover, and what came of it."""
        system = registry().make("system", self.system, dict(self.fields))
        seeded = {e.label for e in system.seed}
        candidates = [
            e for e in registry().candidates(system, everywhere=True) if e.label not in seeded
        ]
        choices = {
            "values": dict(self.values), "free": self.free, "candidates": candidates,
            "plugins": registry(),
        }  # fmt: skip
        question = Question(
            system,
            self._records(system, self.train, self.read),
            self._records(system, self.test, {**self.read, **self.test_read}),
            choices, self.hidden, self.truth,
        )  # fmt: skip
        row = question.asked(strategy)
        text = f"{row['summary']} {row['advice']}".lower()
        refused = any(w in text for w in WORDS_OF_ANOTHER_MACHINE) if self.refused else None
        return {**row, "refused": refused}

    def _records(
        self,
        system: System,
        parts: tuple[tuple[str, tuple[int, int] | None], ...],
        fields: Mapping[str, Any],
    ) -> tuple[Record, ...]:
        import spiral

        found: list[Record] = []
        for path, rows in parts:
            cut = {} if rows is None else {"rows": list(rows)}
            read = spiral.read(path, system, plugins=registry(), **cut, **fields)
            found += read if isinstance(read, tuple) else (read,)
        return tuple(found)


@dataclass(frozen=True)
class Preset:
    """A measured set that has a preset of its own (``conf/experiment``)."""

    file: str
    preset: str
    hidden: tuple[str, ...]

    def asked(self, strategy: str | None) -> Row:
        """The preset's study, and what came of it."""
        from experiments.measured import problem_of
        from spiral.inference.discover import discover

        words = () if strategy is None else (f"strategy={strategy}",)
        problem, clock = problem_of(self.preset, words), time.process_time()
        run = discover(problem)
        seconds = time.process_time() - clock
        return {
            "hidden": list(self.hidden), **told(run), **named(run, self.hidden),
            "seconds": seconds,
        }  # fmt: skip


_SIMPLE: dict[str, Any] = {
    "fields": {"torque_unit": "N*m"},
    "read": {
        "time": "time", "channels": {"theta": "position"}, "inputs": {"torque": "torque"},
    },
    "free": ("system.inertia",),
    "values": {"system.inertia": 0.08, "linear_damping.damping": 0.05,
               "gravity_torque.torque": 1.5},
    "hidden": ("coulomb_friction",),
    "truth": {"coulomb_friction.level": 0.19},
}  # fmt: skip
_FOLDER = "dfki_simple_pendulum"
_DOUBLE = "dfki_double_pendulum/A0_20220815"

SETS: dict[str, Measured | Preset] = {
    "silverbox": Preset("silverbox/SNLS80mV.csv", "silverbox", ("cubic_stiffness",)),
    "cascaded_tanks": Preset("cascaded_tanks/dataBenchmark.csv", "cascaded_tanks", ("overflow",)),
    "multiarm_pendulum": Preset(
        "multiarm_pendulum/SinglePendulumDataForParameterEstimation.mat", "multiarm_pendulum",
        ("coulomb_friction", "quadratic_damping"),
    ),
    "rk4_rotor_runup": Preset("rk4_rotor_runup/runup_1x_1037_2615rpm.csv", "rk4_rotor_runup", ()),
    "dfki_simple_sysid": Measured(
        f"{_FOLDER}/sysid_data_measured.csv", "pendulum",
        ((f"{_FOLDER}/sysid_data_measured.csv", (0, 800)),),
        ((f"{_FOLDER}/sysid_data_measured.csv", (800, 1170)),),
        **{**_SIMPLE, "read": {**_SIMPLE["read"], "resample": 300}},
    ),
    "dfki_simple_ddp": Measured(
        f"{_FOLDER}/ddp_data_measured.csv", "pendulum",
        ((f"{_FOLDER}/ddp_data_measured.csv", (0, 2000)),),
        ((f"{_FOLDER}/ddp_data_measured.csv", (2000, 3000)),),
        **{**_SIMPLE, "read": {**_SIMPLE["read"], "resample": 500}},
    ),
    "dfki_simple_payload": Measured(
        f"{_FOLDER}/energy_shaping_data_measured_1kg.csv", "pendulum",
        ((f"{_FOLDER}/energy_shaping_data_measured.csv", None),),
        ((f"{_FOLDER}/energy_shaping_data_measured_1kg.csv", None),),
        **{**_SIMPLE, "read": {**_SIMPLE["read"], "resample": 200}, "refused": True},
    ),
    "dfki_double_pendulum": Measured(
        f"{_DOUBLE}_00.csv", "double_pendulum",
        ((f"{_DOUBLE}_00.csv", None), (f"{_DOUBLE}_12.csv", None)),
        ((f"{_DOUBLE}_01.csv", None),),
        {
            "time": "time", "resample": 250,
            "channels": {"shoulder": "pos_meas1", "elbow": "pos_meas2"},
            "inputs": {"shoulder_torque": "tau_meas1", "elbow_torque": "tau_meas2"},
        },
        values={"linear_damping.damping": 0.01, "linear_damping@elbow.damping": 0.01},
        free=("system.first_inertia", "system.second_inertia"),
        hidden=("coulomb_friction", "coulomb_friction@elbow"),
        truth={"coulomb_friction.level": 0.093, "coulomb_friction@elbow.level": 0.078},
    ),
    "bouc_wen": Measured(
        "bouc_wen/train.h5", "oscillator",
        (("bouc_wen/train.h5", (0, 8192)),),
        (("bouc_wen/test.h5", None),),
        {
            "rate": 750, "channels": {"x": "multisine/y"}, "inputs": {"force": "multisine/u"},
        },
        values={"system.mass": 2.0, "linear_stiffness.stiffness": 8e4,
                "linear_damping.damping": 15.0},
        hidden=("bouc_wen",), truth={"bouc_wen.stiffness": 5e4},
    ),
    "coupled_electric_drives": Measured(
        "coupled_electric_drives/drive.mat", "coupled_drives",
        (("coupled_electric_drives/drive.mat", None),),
        (("coupled_electric_drives/drive.mat", None),),
        {"rate": 50, "channels": {"pulley_rate": "z1"}, "inputs": {"voltage": "u1"}},
        values={
            "system.motor_inertia": 0.3, "system.pulley_inertia": 0.1,
            "linear_damping.damping": 0.4, "linear_stiffness@belt.stiffness": 20.0,
            "linear_damping@belt.damping": 0.2,
        },
        hidden=("rectified_reading",), truth={"rectified_reading.share": 1.0},
        test_read={"channels": {"pulley_rate": "z2"}, "inputs": {"voltage": "u2"}},
    ),
    "mr_damper": Measured(
        "mr_damper/measured_4.1.mat", "damper_rig",
        (("mr_damper/measured_4.1.mat", (0, 2000)),),
        (("mr_damper/measured_4.1.mat", (2000, 3001)),),
        {
            "rate": 100, "channels": {"damper_force": "x_F[2]"},
            "inputs": {"stroke": "x_F[0]", "stroke_rate": "x_F[1]"},
        },
        values={"viscous_part.damping": 1.0, "gas_spring.stiffness": 1.0,
                "gas_spring.preload": 0.0},
        hidden=("dahl_friction", "dry_part"), truth={"dahl_friction.level": 50.237},
    ),
}  # fmt: skip
"""Every measured set by name."""


def here() -> dict[str, Measured | Preset]:
    """The sets whose files are there."""
    root = os.environ.get("SPIRAL_DATA")
    return {k: m for k, m in SETS.items() if root and (Path(root) / m.file).exists()}


def absent() -> str:
    """Why measured sets are left out, in words; empty where all are there."""
    missing = [k for k in SETS if k not in here()]
    return f"not under SPIRAL_DATA: {', '.join(missing)}" if missing else ""


def definition() -> str:
    """The version of what makes the questions about measured records."""
    return version(Path(__file__), SYSTEMS)
