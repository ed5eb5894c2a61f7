"""A rotor's numbers as files have them, spoilt in known ways; tests of what is done to them."""

import tempfile
from functools import lru_cache
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from spiral.types.errors import SpiralError
from tests.scenes import planar_record, registry

REGISTRY = registry()
ROTOR = REGISTRY.make("system", "planar_rotor")
OSCILLATOR = REGISTRY.make("system", "oscillator")
NOISE = 0.01


@lru_cache(maxsize=2)
def rotor(direction=1):
    """A run-down from 40 to 5 Hz in 6 s at 1 kHz, with phase; negative: turning clockwise."""
    hertz = (40.0 * direction, 5.0 * direction)
    return planar_record(3, noise=NOISE, duration=6.0, hertz=hertz)


def columns(record, *names):
    """The record as a file has it: t, probes a and b, and what else is asked for."""
    found = {"t": record.time, "a": record.channels["x"], "b": record.channels["y"]}
    found.update({n: record.inputs[n] for n in names})
    return found


def load(table, system=ROTOR, **fields):
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "rotor.parquet"
        pd.DataFrame(table).to_parquet(path)
        usual = {"path": str(path), "channels": {"x": "a", "y": "b"}, "time": "t"}
        return REGISTRY.make("source", "file", {**usual, **fields}, "record").load(system)[0]


def refusal(table, **fields):
    with pytest.raises(SpiralError) as caught:
        load(table, **fields)
    return caught.value


def note(record, word):
    return next(n for n in record.notes if word in n)


def key_phasor(phase, duty=0.06, depth=7.0, noise=0.02):
    """A notch in the shaft: the probe's voltage falls for a share of each turn."""
    inside = ((phase - 1.0) / (2 * np.pi)) % 1.0 < duty
    rng = np.random.default_rng(0)
    return -9.0 - depth * inside + noise * depth * rng.normal(size=len(phase))


def with_key(record, *names):
    return {**columns(record, *names), "key": key_phasor(record.inputs["phase"])}


def angle_error(found, true):
    """Rms and largest difference of two phases but for a constant, the mark's place."""
    left = found - true
    left = left - np.mean(left)
    return float(np.sqrt(np.mean(left**2))), float(np.max(np.abs(left)))


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))
