"""Gaps bridged and rates changed, only on request: the motion and the phase stay what they were."""

import numpy as np
import pytest

from tests.spoilt import columns, load, note, refusal, rms, rotor


def test_gaps_are_filled_only_when_asked():
    """Three missing values at 1 kHz, of a motion below 40 Hz, come back within the noise."""
    record = rotor()
    table = {k: v.copy() for k, v in columns(record, "speed", "phase").items()}
    holes = np.concatenate([np.arange(i, i + 3) for i in (500, 1500, 4000)])
    table["a"][holes] = np.nan
    error = refusal(table)
    assert "record.fill_gaps=3" in error.try_
    assert "row 500" in error.given
    found = load(table, fill_gaps=3)
    left = found.channels["x"] - record.channels["x"]
    assert rms(left[holes]) < 3 * record.sigma()["x"]
    assert np.count_nonzero(left) == len(holes)
    assert "9 values" in note(found, "gaps")
    (lost,) = found.spoilt["x"]
    assert lost.kind == "missing"
    np.testing.assert_array_equal(np.flatnonzero(lost.where), holes)
    assert "y" not in found.spoilt
    longer = refusal(table, fill_gaps=2)
    assert "3 samples" in longer.given
    assert "row 500" in longer.given
    assert "record.rows" in longer.try_
    table["a"][-2:] = np.nan
    assert "at the end" in refusal(table, fill_gaps=3).given


def test_rows_that_a_file_lacks_are_a_gap():
    record = rotor()
    kept = np.ones(record.samples, dtype=bool)
    kept[[700, 701, 2000, 3000, 3001, 3002]] = False
    table = {k: v[kept] for k, v in columns(record, "speed", "phase").items()}
    assert "record.fill_gaps=3" in refusal(table).try_
    found = load(table, fill_gaps=3)
    np.testing.assert_allclose(found.time, record.time, atol=1e-9)
    np.testing.assert_array_equal(found.channels["y"][kept], record.channels["y"][kept])
    left = found.channels["y"] - record.channels["y"]
    assert rms(left[~kept]) < 3 * record.sigma()["y"]
    assert "6 rows" in note(found, "gaps")
    error = refusal(table, fill_gaps=2)
    assert "3 samples" in error.given
    assert "2.999 s" in error.given


def test_what_fills_a_gap_is_no_reading_whatever_is_done_next():
    """Probes off the axes share their gaps; a change of rate keeps their place; NaN may be many."""
    record = rotor()
    table = {k: v.copy() for k, v in columns(record, "speed", "phase").items()}
    table["a"][500:520] = np.nan
    kept = {k: np.delete(v, slice(2000, 2003)) for k, v in table.items()}
    turned = load(kept, fill_gaps=20, probe_angles={"x": 45, "y": 135})
    for channel in ("x", "y"):
        (lost,) = turned.spoilt[channel]
        assert np.flatnonzero(lost.where).tolist() == [*range(500, 520), *range(2000, 2003)]
    slower = load(table, fill_gaps=20, resample=500)
    (lost,) = slower.spoilt["x"]
    times = slower.time[lost.where]
    assert record.time[499] < times.min() < times.max() < record.time[520]
    longer = load(kept, fill_gaps=3, missing="leave_out")
    (lost,) = longer.spoilt["x"]
    assert lost.where.sum() == 23
    assert "no readings of x, y" in note(longer, "gaps")


def test_a_lower_rate_keeps_motion_and_phase_and_drops_the_rest():
    """1000 -> 240 Hz: 40 Hz and below pass, a tone at 310 Hz does not alias to 70 Hz."""
    record = rotor()
    table = columns(record, "speed", "phase")
    table["a"] = table["a"] + 1e-4 * np.sin(2 * np.pi * 310 * record.time)
    found = load(table, resample=240)
    assert found.dt == pytest.approx(1 / 240)
    quiet = load(columns(record, "speed", "phase"), resample=240)
    assert rms(found.channels["x"] - quiet.channels["x"]) < 1e-3 * 1e-4
    at = np.interp(found.time, record.time, record.inputs["phase"])
    np.testing.assert_allclose(found.inputs["phase"], at, atol=1e-3)
    smooth = np.interp(quiet.time, record.time, record.channels["y"])
    assert rms(quiet.channels["y"] - smooth) < 2 * record.sigma()["y"]
    assert "from 1000 to 240 Hz" in note(found, "resampled")


def test_declared_noise_passes_the_filter():
    rng = np.random.default_rng(0)
    count = 40_000
    table = {"t": 1e-3 * np.arange(count), "a": rng.normal(size=count),
             "b": rng.normal(size=count), "speed": np.full(count, 100.0)}  # fmt: skip
    found = load(table, resample=370.0, noise={"x": 1.0, "y": 1.0})
    assert found.noise["x"] < 0.62
    for name in "xy":
        assert np.std(found.channels[name]) == pytest.approx(found.noise[name], rel=0.03)


def test_uneven_steps_are_made_even():
    """Steps of 0.5 to 1.5 ms become 2 ms; what is left is the noise."""
    record = rotor()
    rng = np.random.default_rng(0)
    time = np.cumsum(rng.uniform(0.5e-3, 1.5e-3, 5800))
    table = {
        k: np.interp(time, record.time, v) for k, v in columns(record, "speed", "phase").items()
    }
    error = refusal(table)
    assert "record.resample" in error.try_
    found = load(table, resample=500)
    assert found.dt == pytest.approx(1 / 500)
    for name in "xy":
        true = np.interp(found.time, record.time, record.channels[name])
        assert rms(found.channels[name] - true) < 3 * record.sigma()[name]
    assert "uneven steps" in note(found, "resampled")


def test_rates_that_cannot_be():
    record = rotor()
    table = columns(record, "speed")
    assert "1000 samples per s" in refusal(table, resample=2000).expected
    for slow in (13.9, 1 / 64):  # 6 s of record would leave 63 samples, or none
        assert "at least 14 samples per s" in refusal(table, resample=slow).expected
    assert len(load(table, resample=14.2).time) >= 64
    kept = np.r_[0:1000, 1005:6001]
    gap = refusal({k: v[kept] for k, v in table.items()}, resample=500)
    assert "record.fill_gaps=5" in gap.try_
    both = load({k: v[kept] for k, v in table.items()}, resample=500, fill_gaps=5)
    assert both.dt == pytest.approx(1 / 500)
    assert "resample" in refusal(table, resample=0).given
    assert "fill_gaps" in refusal(table, fill_gaps=0).given
