"""Records from what a notebook holds: frames, series by name, arrays; and what is no record."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pyarrow as pa
import pytest

import spiral
from spiral.types.errors import ConfigError, InputError

COUNT = 400
TIME = 0.01 * np.arange(COUNT)
FIELDS = {"time": "t", "channels": {"x": "x"}, "inputs": {"force": "f"}}


@pytest.fixture
def frame():
    rng = np.random.default_rng(0)
    force = np.convolve(rng.normal(size=COUNT), np.ones(9) / 9, "same")
    return pd.DataFrame({"t": TIME, "x": np.cumsum(force) + rng.normal(size=COUNT), "f": force})


def test_a_frame_is_read_as_its_file_is(frame, tmp_path):
    frame.to_csv(tmp_path / "a.csv", index=False)
    (whole,) = [spiral.read(tmp_path / "a.csv", "oscillator", **FIELDS)]
    moments = frame.set_index(pd.to_datetime(frame["t"], unit="s").rename("t")).drop(columns="t")
    alike = (frame, frame.set_index("t"), {k: frame[k].to_numpy() for k in frame}, moments)
    for given in alike:
        record = spiral.read(given, "oscillator", **FIELDS)
        np.testing.assert_allclose(record.channels["x"], whole.channels["x"])
        np.testing.assert_allclose(record.time, whole.time)


def test_masked_readings_are_missing_ones(frame):
    hidden = np.arange(COUNT) % 50 == 7
    given = {**frame, "x": np.ma.masked_array(frame["x"] + 100 * hidden, hidden)}
    with pytest.raises(InputError, match="8 missing values"):
        spiral.read(given, "oscillator", **FIELDS)
    record = spiral.read(given, "oscillator", **FIELDS, missing="leave_out")
    assert record.gone("x").sum() == 8


def test_tables_of_other_libraries_and_decimal_commas_are_read(frame):
    whole = spiral.read(frame, "oscillator", **FIELDS).channels["x"]
    commas = frame.assign(x=[str(v).replace(".", ",") for v in frame["x"]])
    for given, more in ((pa.Table.from_pandas(frame), {}), (commas, {"decimal": ","})):
        record = spiral.read(given, "oscillator", **FIELDS, **more)
        np.testing.assert_allclose(record.channels["x"], whole)


def test_rows_and_frames_in_the_place_of_a_record_are_told_what_to_do(frame):
    with pytest.raises(InputError, match="DataFrame"):
        spiral.read(frame.to_dict("records"), "oscillator", **FIELDS)
    with pytest.raises(ConfigError, match="a DataFrame where a record"):
        spiral.discover(frame, "oscillator")
    with pytest.raises(InputError, match="as in all 400 rows"):
        spiral.read(frame.assign(x=np.nan), "oscillator", **FIELDS)


def test_units_in_names_are_those_of_the_file(frame, tmp_path):
    named = pd.DataFrame({"t [ms]": 1e3 * TIME, "x [mm]": frame["x"], "f": frame["f"]})
    named.to_csv(tmp_path / "a.csv", index=False)
    whole = spiral.read(tmp_path / "a.csv", "oscillator", **FIELDS)
    record = spiral.read(named, "oscillator", **FIELDS)
    np.testing.assert_allclose(record.channels["x"], 1e-3 * frame["x"])
    np.testing.assert_allclose(record.channels["x"], whole.channels["x"])
    assert record.dt == pytest.approx(0.01)


def test_moments_of_every_kind_are_time(frame):
    start = pd.Timestamp("2026-01-01 08:00", tz="Europe/Berlin")
    moments = start + pd.to_timedelta(TIME, unit="s")
    for clock in (moments, moments.to_pydatetime(), pd.to_timedelta(TIME, unit="s"), list(moments)):
        record = spiral.read({**frame.drop(columns="t"), "t": clock}, "oscillator", **FIELDS)
        assert record.dt == pytest.approx(0.01)


def test_several_frames_are_several_records(frame):
    pair = spiral.read([frame, frame[:200]], "oscillator", **FIELDS)
    assert [r.samples for r in pair] == [400, 200]


def test_units_and_rows_are_asked_of_a_frame_as_of_a_file(frame):
    parts = spiral.read(
        frame, "oscillator", **FIELDS, units={"x": "mm"}, rows=[[0, 150], [200, 400]]
    )
    assert [p.samples for p in parts] == [150, 200]
    np.testing.assert_allclose(parts[1].channels["x"], 1e-3 * frame["x"][200:])
    assert parts[1].name == "data rows [200, 400)"


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda f: f.to_numpy(), r"an array of shape \(400, 3\)"),
        (lambda f: f["x"], r"an array of shape \(400,\)"),
        (lambda f: f.drop(columns="f"), "column 'f' of data"),
        (lambda f: f.assign(x=f["x"].where(f["t"] != 1.0)), "'x' of data, row 100: nan"),
        (lambda f: f.assign(x=["?"] * COUNT), "row 0: text '\\?'"),
        (lambda f: {"t": f["t"], "x": f.to_numpy(), "f": f["f"]}, r"'x' of shape \(400, 3\)"),
    ],
)
def test_what_cannot_be_read_is_refused_in_words(frame, change, words):
    with pytest.raises((ConfigError, InputError), match=words):
        spiral.read(change(frame), "oscillator", **FIELDS)


LATE = TIME + np.where(np.arange(COUNT) > 200, 0.1, 0.0)
ONE_NAN = np.where(np.arange(COUNT) == 3, np.nan, np.sin(TIME))


@pytest.mark.parametrize(
    ("time", "values", "words"),
    [
        (LATE, np.sin(TIME), "worst after row 200"),
        (TIME[::-1], np.sin(TIME), "increases"),
        (TIME, ONE_NAN, "'x' is nan at row 3"),
        (TIME, np.sin(TIME)[None], r"shape \(1, 400\)"),
        (TIME, np.sin(TIME)[:-5], r"shape \(395,\)"),
        (TIME, ["much"] * COUNT, "could not convert"),
    ],
)
def test_a_record_is_a_number_for_every_even_step(time, values, words):
    with pytest.raises(InputError, match=words):
        spiral.Record("bench", time, {"x": values}, {"force": np.cos(TIME)})


def test_a_record_takes_series_of_a_frame_and_numbers_as_objects(frame):
    late = frame[5:]
    record = spiral.Record(
        "bench", late["t"], {"x": late["x"].astype(object)}, {"force": late["f"]}
    )
    assert record.samples == COUNT - 5
    assert record.channels["x"].dtype == float


def test_a_record_of_another_system_is_refused():
    other = spiral.Record("bench", TIME, {"y": np.sin(TIME)}, {"force": np.cos(TIME)})
    for call in (spiral.compare, spiral.discover, lambda r, s: spiral.estimate(s, r)):
        with pytest.raises(InputError, match="channel 'x' of system 'oscillator'"):
            call(other, "oscillator")
    undriven = spiral.Record("bench", TIME, {"x": np.sin(TIME)})
    with pytest.raises(InputError, match="input 'force' of system 'oscillator'"):
        spiral.compare(undriven, "oscillator")


def test_arguments_of_a_wrong_kind_are_answered_in_words():
    plain = spiral.system(["m*x'' + k*x = F"], states={"x": "m"}, inputs={"F": "N"}, observed=["x"],
                          parameters={"m": (1.0, "kg"), "k": (4.0, "N/m")})  # fmt: skip
    with pytest.raises(ConfigError, match="a Equations to export"):
        spiral.export(plain)
    record = spiral.Record("bench", TIME, {"x": np.sin(TIME)}, {"force": np.cos(TIME)})
    with pytest.raises(ConfigError, match="settings=3"):
        spiral.compare(record, "oscillator", settings=3)
    with pytest.raises(ConfigError, match="rows"):
        spiral.read({"t": TIME, "x": TIME, "f": TIME}, "oscillator", **FIELDS, rows=[])
    with pytest.raises(ConfigError, match="did you mean 'cubic_stiffness'"):
        spiral.discover(record, "oscillator", candidates="cubic_stifness")
