"""Records from amplitude and phase of one order, a row for each turn of the shaft."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from spiral.io.readers.formats import read_table
from spiral.io.readers.pulses import smooth_phase
from spiral.io.readers.table import Table
from spiral.types.errors import ConfigError, InputError
from spiral.types.record import Record, make_record
from spiral.types.source import Source
from spiral.types.system import System
from spiral.types.units import factor

_FEWEST = 8  # turns


class OrderTable(Source):
    """First order of one probe over a run-up: x + i y = A exp i(t + phi), t the shaft's angle.

    A table of speed W, amplitude A and phase phi, one row per turn and in order of time, as a
    tracking filter gives them (a Bode table). Time is rebuilt from the turns: one takes 4 pi / (W +
    W_next). x is the probe's own signal at first order. y is no second probe: it is x a quarter
    turn late, so that a row's two numbers become two channels. Both follow the model of a rotor
    whose two axes are alike; what tells its axes apart is not in such a table.

    Between turns the slow vector A exp(i phi) is interpolated linearly in time; one sample per turn
    on average keeps as many numbers as the table has.

    Fields
    ------
    path : a file of any format that is known; also looked for under ``SPIRAL_DATA``.
    speed, amplitude, phase : its columns; phase is a lead (it falls by half a turn at a resonance).
    units : of these three; left out rpm, the system's own, deg.
    rows : [start, stop], zero-based data rows, stop excluded.
    rate : samples per s; left out, the mean number of turns per s.
    noise : standard deviation of x and of y, where it is known, in the amplitude's unit.
    """

    path: str = ""
    speed: str = "speed"
    amplitude: str = "amplitude"
    phase: str = "phase"
    units: Mapping[str, str] | None = None
    rows: tuple[int, int] | None = None
    rate: float | None = None
    noise: float | None = None

    def load(self, system: System) -> tuple[Record, ...]:
        """One record of x, y, speed and phase."""
        if not self.path:
            raise ConfigError("record=order_table without a file", "record.path=FILE")
        if set(system.observed) != {"x", "y"}:
            raise ConfigError(
                f"record=order_table for channels {', '.join(system.observed)}",
                "a rotor seen in x and y",
                "system=planar_rotor",
            )
        table = read_table(self.path, None, None)
        scale = self._unit_factors(system)
        marks, slow = self._slow_vector_by_turn(table, scale)
        rate = self.rate or (len(marks) - 1) / marks[-1]
        time = np.arange(int(marks[-1] * rate) + 1) / rate
        angle, speed, _ = smooth_phase(marks, time)
        seen = np.interp(time, marks, slow) * np.exp(1j * angle)
        noise = None if self.noise is None else self.noise * scale["amplitude"]
        told = f"x and y from first order of {len(marks)} turns, at {rate:.4g} samples per s"
        record = make_record(
            system,
            Path(self.path).name,
            time,
            {"x": seen.real, "y": seen.imag},
            {"speed": speed, "phase": angle},
            None if noise is None else {"x": noise, "y": noise},
            notes=(*table.notes, told),
        )
        return (record,)

    def _unit_factors(self, system: System) -> dict[str, float]:
        """Factor from the file's unit to the system's for each column."""
        own = {"speed": "rad/s", "amplitude": system.unit_of("x"), "phase": "rad"}
        given = {**own, "speed": "rpm", "phase": "deg", **(self.units or {})}
        unknown = sorted(set(given) - set(own))
        if unknown:
            raise ConfigError(f"record.units of {', '.join(unknown)}", f"units of {', '.join(own)}")
        return {n: factor(given[n], own[n], n) for n in own}

    def _slow_vector_by_turn(
        self, table: Table, scale: Mapping[str, float]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Times of the turns in s, from zero, and the slow vector A exp(i phi) of each."""
        count = table.rows({f"record.{n}": getattr(self, n) for n in scale})
        start, stop = self.rows or (0, count)
        if not 0 <= start < stop <= count or stop - start < _FEWEST:
            raise InputError(
                f"rows [{start}, {stop}) of {table.name}, which has {count}",
                f"at least {_FEWEST} rows, one for each turn",
                "check record.rows",
            )
        speed, amplitude, lead = (
            scale[n] * table.column(getattr(self, n), f"record.{n}", start, stop) for n in scale
        )
        if not np.all(speed > 0):
            raise InputError(
                f"{table.name}: a speed of {speed.min():.4g} rad/s", "speeds above zero"
            )
        steps = 4 * np.pi / (speed[1:] + speed[:-1])
        return np.concatenate(([0.0], np.cumsum(steps))), amplitude * np.exp(1j * lead)
