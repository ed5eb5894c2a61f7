"""The paper's run-down, embedded."""

from __future__ import annotations

from dataclasses import replace

from spiral_plugins.sources.simulation import Simulation
from spiral_plugins.systems.tilting_rotor import TiltingRotor

from spiral.types.record import Record
from spiral.types.source import Source
from spiral.types.system import System


class RotorCoastdown(Source):
    """The paper's rotor slowing down, simulated with hidden tilts: 40 to 0 Hz in 14 s at 1 kHz.

    The paper contradicts itself about this record (8 s from 60 to 5 Hz in its text, 14 s from 40
    to 0 Hz in its table); the defaults are the table's. Phase is measured.

    Fields
    ------
    seed : of the noise. noise_level : share of each channel's standard deviation, declared.
    phase : angle of the unbalance at zero phase, rad.
    duration : s. rate : samples per s. start_hz, stop_hz : speeds, turns per s.
    settled : run at the first speed before the record starts until the transient has gone.
    """

    seed: int = 11
    noise_level: float = 0.02
    phase: float = 0.4
    duration: float = 14.0
    rate: float = 1000.0
    start_hz: float = 40.0
    stop_hz: float = 0.0
    settled: bool = False

    def as_test(self) -> Source:
        """The same machine with other noise and another mark on the shaft."""
        return replace(self, seed=self.seed + 1000, phase=self.phase + 0.9)

    def load(self, system: System) -> tuple[Record, ...]:
        """Simulate the tilting rotor; the study sees x, y, speed and phase."""
        simulation = Simulation(
            system=TiltingRotor(),
            values={"system.phase_origin": self.phase},
            inputs={"speed": {"sweep": [self.start_hz, self.stop_hz], "unit": "Hz"}},
            duration=self.duration,
            rate=self.rate,
            seed=self.seed,
            noise_level=self.noise_level,
            settled=self.settled,
        )
        record = simulation.load(system)[0]
        return (replace(record, name=f"rotor_coastdown, seed {self.seed}"),)
