"""Amplitude and phase of one order, a row per turn, as a record."""

import numpy as np
import pytest
from spiral_plugins.systems.planar_rotor import PlanarRotor

from spiral.io.registry import load_registry
from spiral.types.errors import SpiralError

REGISTRY = load_registry()
START, RATE = 100.0, 24.0  # rad/s, rad/s^2


def source(**fields):
    return REGISTRY.make("source", "order_table", fields, "record")


def slow(time):
    """A vector that turns and changes size within some turns, in um."""
    return (3 + 2 * np.sin(2.0 * time)) * np.exp(1j * (0.5 - 1.5 * time))


@pytest.fixture
def table(tmp_path):
    """A run-up at a steady rise of speed, written as a tracking filter would."""
    turns = 2 * np.pi * np.arange(120)
    time = (np.sqrt(START**2 + 2 * RATE * turns) - START) / RATE
    vector, speed = slow(time), START + RATE * time
    rows = np.column_stack((speed * 30 / np.pi, np.abs(vector), np.rad2deg(np.angle(vector))))
    path = tmp_path / "bode.csv"
    np.savetxt(path, rows, delimiter=",", header="speed,amplitude,phase", comments="")
    return str(path)


def test_the_rotating_signal_comes_back(table):
    """x + i y = A exp i(t + phi), the angle and the speed those of the rise; SI from um."""
    (record,) = source(path=table, units={"amplitude": "um"}, noise=0.5).load(PlanarRotor())
    time = record.time
    angle = START * time + RATE * time**2 / 2
    np.testing.assert_allclose(record.inputs["speed"], START + RATE * time, rtol=1e-3)
    np.testing.assert_allclose(record.inputs["phase"], angle, atol=0.02)
    seen = record.channels["x"] + 1j * record.channels["y"]
    expected = 1e-6 * slow(time) * np.exp(1j * angle)
    assert np.abs(seen - expected).max() < 0.03 * np.abs(expected).max()
    assert record.noise == {"x": 0.5e-6, "y": 0.5e-6}
    assert len(time) == pytest.approx(120, abs=1)


@pytest.mark.parametrize(
    ("fields", "word"),
    [
        ({"path": ""}, "record.path"),
        ({"rows": (0, 4)}, "at least 8 rows"),
        ({"amplitude": "size"}, "size"),
        ({"units": {"amplitude": "V"}}, "V"),
        ({"units": {"lead": "deg"}}, "lead"),
    ],
)
def test_what_cannot_be_used_is_named(table, fields, word):
    with pytest.raises(SpiralError, match=word):
        source(**{"path": table, **fields}).load(PlanarRotor())


def test_a_system_without_two_probes_is_refused(table):
    with pytest.raises(SpiralError, match="planar_rotor"):
        source(path=table).load(REGISTRY.make("system", "oscillator"))
