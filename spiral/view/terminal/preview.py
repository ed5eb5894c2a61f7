"""Summary of the records as they were read; a wrong unit or column shows in its numbers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from spiral.inference.problem import Problem
from spiral.types.record import Record
from spiral.types.system import System

_QUIET = 0.3  # share of the fitted range under which a test record hardly moves
_RPM = 30 / np.pi


def describe_records(problem: Problem) -> list[dict[str, Any]]:
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
            "series": _series_rows(system, record),
            "notes": list(record.remarks),
        }
        for part, records in parts
        for record in records
    ]


def is_test_held_out(descriptions: Sequence[Mapping[str, Any]]) -> bool:
    """Whether the test record is a part of the record that is fitted."""
    return any(r["part"] == "test" and r["name"].endswith("kept apart)") for r in descriptions)


def quiet_test_warning(descriptions: Sequence[Mapping[str, Any]]) -> str:
    """A warning where the test record hardly moves compared with the fitted one; else empty.

    A run-down whose last part is kept apart is tested below its resonances, where any model is
    right. A channel's range is its largest one over the records of a part.
    """
    fitted, tested = (_channel_ranges(descriptions, part) for part in ("fit", "test"))
    shares = {n: tested[n] / d for n, d in fitted.items() if d and n in tested}
    if not shares or max(shares.values()) > _QUIET:
        return ""
    name = max(shares, key=lambda n: shares[n])
    said = f"The test record misses what was excited: {name} spans there {shares[name]:.0%} of "
    said += "what it spans in the fitted part, so a low test error says little."
    if not is_test_held_out(descriptions):
        return f"{said} Give a test record of a like run."
    return f"{said} Keep parts of blocks apart (holdout_blocks=5), or give a record of another run."


def _channel_ranges(descriptions: Sequence[Mapping[str, Any]], part: str) -> dict[str, float]:
    """The largest range of every channel over the records of a part."""
    ranges: dict[str, float] = {}
    for record in (r for r in descriptions if r["part"] == part):
        for series in (s for s in record["series"] if s.get("kind") == "channel"):
            span = series["highest"] - series["lowest"]
            ranges[series["name"]] = max(span, ranges.get(series["name"], 0.0))
    return ranges


def _series_rows(system: System, record: Record) -> list[dict[str, Any]]:
    sigma = record.sigma()
    rows = []
    for name, values in (*record.channels.items(), *record.inputs.items()):
        unit = system.unit_of(name)
        kind = "channel" if name in record.channels else "input"
        if kind == "input" and name not in record.measured:
            kind = "derived"
        row = {"name": name, "kind": kind, **_value_extent(values), "unit": unit}
        if name in sigma:
            row["noise"] = sigma[name]
            row["noise_declared"] = bool(record.noise.get(name))
        rows.append(row)
        if name == "speed" and unit == "rad/s":
            rows.append({**row, **_value_extent(_RPM * values), "unit": "rpm"})
    return rows


def _value_extent(values: np.ndarray) -> dict[str, float]:
    return {
        "lowest": float(values.min()),
        "highest": float(values.max()),
        "deviation": float(np.std(values)),
    }
