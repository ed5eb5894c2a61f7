"""What was understood of the records, in numbers: a unit or a column mixed up shows here."""

from __future__ import annotations

from typing import Any

import numpy as np

from spiral.inference.problem import Problem
from spiral.types.record import Record
from spiral.types.system import System

_RPM = 30 / np.pi


def described(problem: Problem) -> list[dict[str, Any]]:
    """Every record: its part (fit, test), length, rate, notes, and the series in it.

    Numbers are in the system's units; ``noise`` is the declared or estimated standard deviation.
    """
    system = problem.model.system
    parts = (("fit", problem.records), ("test", problem.test))
    return [
        {
            "part": part,
            "name": record.name,
            "samples": record.samples,
            "rate": 1 / record.dt,
            "series": _series(system, record),
            "notes": list(record.remarks),
        }
        for part, records in parts
        for record in records
    ]


def _series(system: System, record: Record) -> list[dict[str, Any]]:
    sigma = record.sigma()
    found = []
    for name, values in (*record.channels.items(), *record.inputs.items()):
        unit = system.unit_of(name)
        kind = "channel" if name in record.channels else "input"
        if kind == "input" and name not in record.measured:
            kind = "derived"
        row = {"name": name, "kind": kind, **_extent(values), "unit": unit}
        if name in sigma:
            row["noise"] = sigma[name]
            row["noise_declared"] = bool(record.noise.get(name))
        found.append(row)
        if name == "speed" and unit == "rad/s":
            found.append({**row, **_extent(_RPM * values), "unit": "rpm"})
    return found


def _extent(values: np.ndarray) -> dict[str, float]:
    return {
        "lowest": float(values.min()),
        "highest": float(values.max()),
        "deviation": float(np.std(values)),
    }
