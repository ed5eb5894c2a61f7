"""Gaps of an input: bridged where a bridge tells it, refused where it would be made up."""

from __future__ import annotations

import numpy as np
import pytest

import spiral
from spiral.types.clock import suggest_even_steps, suggest_forward_steps
from spiral.types.errors import InputError

COUNT, RATE = 1000, 100.0
TIME = np.arange(COUNT) / RATE


def read(smooth, lost):
    """A record of an oscillator whose force is white noise averaged over so many samples."""
    rng = np.random.default_rng(1)
    force = np.convolve(rng.normal(size=COUNT + smooth), np.hanning(smooth), "same")[:COUNT]
    kept = np.r_[0:400, 400 + lost : COUNT]
    series = {"t": TIME, "x": rng.normal(size=COUNT), "f": force}
    return spiral.read(
        {k: v[kept] for k, v in series.items()}, "oscillator", time="t", channels={"x": "x"},
        inputs={"force": "f"}, fill_gaps=60,
    )  # fmt: skip


@pytest.mark.parametrize(("smooth", "lost"), [(200, 30), (40, 5), (9, 1)])
def test_an_input_that_a_bridge_tells_is_bridged(smooth, lost):
    assert read(smooth, lost).samples == COUNT


@pytest.mark.parametrize(("smooth", "lost"), [(40, 50), (9, 20)])
def test_an_input_that_would_be_made_up_is_refused_with_the_rows_beside_it(smooth, lost):
    with pytest.raises(InputError) as caught:
        read(smooth, lost)
    assert f"up to {lost} samples in a row (at 4 s)" in caught.value.given
    assert caught.value.try_.startswith(f"record.rows='[[0, 400], [400, {COUNT - lost}]]'")


HEATER = spiral.system(
    ["C*T' = P - G*T"], states={"T": "K"},
    inputs={"P": {"unit": "W", "interpolation": "zero_order"}},
    parameters={"C": "50 J/K", "G": "3 W/K"}, observed=["T"],
)  # fmt: skip


@pytest.mark.parametrize("scatter", [0.0, 0.1])
def test_a_held_input_stays_at_its_levels_over_gaps_and_uneven_steps(scatter):
    """Akima and an anti-alias filter made -35 to 1528 W of a heater of 0 or 1500 W."""
    rng = np.random.default_rng(4)
    power = 1500.0 * (np.arange(COUNT) // 150 % 2)
    time = TIME + scatter / RATE * rng.uniform(-1, 1, COUNT)
    kept = np.r_[0:400, 404:COUNT]
    series = {"t": time, "T": np.cumsum(power) / 1e4 + rng.normal(size=COUNT), "P": power}
    resample = {"resample": RATE} if scatter else {}
    record = spiral.read(
        {k: v[kept] for k, v in series.items()}, HEATER, time="t", fill_gaps=4, **resample
    )
    assert set(np.unique(record.inputs["P"])) == {0.0, 1500.0}


def test_lost_rows_of_a_clock_that_scatters_are_answered_with_one_advice():
    rng = np.random.default_rng(5)
    time = np.delete(600.0 * np.arange(400), [100, 101, 102, 250])
    scattered = np.diff(time + rng.uniform(-20, 20, len(time)))
    assert "record.fill_gaps=3 bridges" in suggest_even_steps(np.diff(time), 606.0)
    said = suggest_even_steps(scattered, float(scattered.mean()))
    assert "record.fill_gaps=3 together with record.resample=0.00166" in said


def cells_lost(where, count=2000):
    """Of a force that is white noise, these cells are empty."""
    rng = np.random.default_rng(3)
    force = rng.normal(size=count)
    force[where] = np.nan
    return spiral.read(
        {"t": np.arange(count) / RATE, "x": rng.normal(size=count), "f": force}, "oscillator",
        time="t", channels={"x": "x"}, inputs={"force": "f"}, fill_gaps=60,
    )  # fmt: skip


def test_a_cell_that_is_lost_of_many_is_bridged_though_no_bridge_tells_it():
    assert cells_lost(777).samples == 2000


@pytest.mark.parametrize(("every", "lost", "words"), [
    (20, 1, "fewer gaps"), (40, 10, "fewer gaps"), (30, 15, "fewer gaps"),
    (400, 50, "record.rows='[[0, 400], [450, 800], [850, 1200], [1250, 1600], [1650, 2000]]'"),
])  # fmt: skip
def test_gaps_all_over_are_refused(every, lost, words):
    where = np.flatnonzero(np.arange(2000) % every < lost)
    with pytest.raises(InputError) as caught:
        cells_lost(where[where >= lost])
    assert words in caught.value.try_


def test_stamps_that_scatter_are_told_from_steps_that_differ():
    rng = np.random.default_rng(2)
    scattered = np.diff(TIME + 0.3 / RATE * rng.uniform(-1, 1, COUNT))
    uneven = 1 / RATE * rng.uniform(0.4, 1.6, COUNT)
    assert "record.rate=100" in suggest_even_steps(scattered, 1 / RATE)
    assert "scatter" not in suggest_even_steps(uneven, float(uneven.mean()))


@pytest.mark.parametrize(
    ("time", "words"),
    [
        (TIME[::-1], "sort the rows"),
        (np.insert(TIME, 500, TIME[499]), "stand there twice"),
        (np.floor(TIME * 20) / 20, "clock is coarser than the rows: record.rate=100"),
        (0 * TIME, "record.rate=HZ"),
    ],
)
def test_what_is_wrong_with_time_is_told(time, words):
    assert words in suggest_forward_steps(np.diff(time))
