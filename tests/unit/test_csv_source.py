"""Own data: what a CSV record accepts, converts and refuses."""

import math
import os

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from spiral.io.registry import load_registry
from spiral.types.errors import ConfigError, InputError, SpiralError

REGISTRY = load_registry()
ROTOR = REGISTRY.make("system", "planar_rotor")
OSCILLATOR = REGISTRY.make("system", "oscillator")
COUNT = 200


def csv(**fields):
    return REGISTRY.make("source", "csv", fields, "record")


def columns(count=COUNT, seed=0):
    rng = np.random.default_rng(seed)
    return {"t": 0.01 * np.arange(count), "a": rng.normal(size=count), "f": rng.normal(size=count)}


def write(path, table, header=None):
    names = header or ",".join(table)
    rows = [",".join(str(v) for v in row) for row in zip(*table.values(), strict=True)]
    path.write_text("\n".join([names, *rows]) + "\n")
    return str(path)


def load(system=OSCILLATOR, **fields):
    usual = {"time": "t", "channels": {"x": "a"}, "inputs": {"force": "f"}}
    if "rate" in fields:
        usual.pop("time")
    return csv(**{**usual, **fields}).load(system)


def test_columns_are_mapped_and_scaled(tmp_path):
    table = columns()
    path = write(tmp_path / "a.csv", table)
    record = load(path=path, units={"x": "um", "force": "mN", "time": "ms"})[0]
    np.testing.assert_allclose(record.channels["x"], 1e-6 * table["a"])
    np.testing.assert_allclose(record.inputs["force"], 1e-3 * table["f"])
    assert math.isclose(record.dt, 1e-5, rel_tol=1e-9)


@pytest.mark.parametrize(("unit", "size"), [("rpm", 2 * math.pi / 60), ("Hz", 2 * math.pi)])
def test_speed_in_turns_becomes_radians(tmp_path, unit, size):
    count = COUNT
    rng = np.random.default_rng(1)
    table = {
        "t": 0.001 * np.arange(count),
        "x": rng.normal(size=count),
        "y": rng.normal(size=count),
        "n": np.linspace(100, 50, count),
    }
    path = write(tmp_path / "r.csv", table)
    record = csv(path=path, time="t", inputs={"speed": "n"}, units={"speed": unit}).load(ROTOR)[0]
    np.testing.assert_allclose(record.inputs["speed"], size * table["n"])
    assert record.measured == ("speed",)
    turned = np.trapezoid(record.inputs["speed"], record.time)
    assert math.isclose(record.inputs["phase"][-1], turned, rel_tol=1e-6)


def test_rate_rows_and_trailing_comma(tmp_path):
    table = columns()
    path = tmp_path / "s.csv"
    rows = [f"{a},{f}" for a, f in zip(table["a"], table["f"], strict=True)]
    path.write_text("\n".join(['"a","f",', *rows]))
    record = load(path=str(path), rate=100.0, rows=[20, 120])[0]
    assert record.samples == 100
    np.testing.assert_allclose(record.channels["x"], table["a"][20:120])
    np.testing.assert_allclose(record.time, 0.01 * np.arange(100))


def test_blank_lines_at_the_end_are_no_rows(tmp_path):
    path = write(tmp_path / "a.csv", columns())
    whole = load(path=path)[0]
    with open(path, "a") as file:
        file.write(",,\n\n\n")
    blank = load(path=path)[0]
    assert blank.samples == whole.samples == COUNT
    assert blank.sha256 == whole.sha256


def test_several_files_are_several_records(tmp_path):
    paths = [write(tmp_path / f"{n}.csv", columns(seed=n)) for n in (1, 2)]
    first, second = load(path=paths, noise={"x": 0.5})
    assert (first.name, second.name) == ("1.csv", "2.csv")
    assert first.noise == {"x": 0.5}
    assert first.sha256 != second.sha256


def test_a_star_is_one_record_for_each_number(tmp_path):
    wave = np.sin(np.arange(COUNT))
    table = {"a[2]": 2 + wave, "a[10]": 10 + wave, "f": wave}
    fields = {"rate": 100, "inputs": {"force": "f"}, "path": write(tmp_path / "a.csv", table)}
    found = csv(channels={"x": "a[*]"}, **fields).load(OSCILLATOR)
    assert [r.channels["x"][0] for r in found] == [2.0, 10.0]
    with pytest.raises(InputError, match="number in the star's place"):
        csv(channels={"x": "b[*]"}, **fields).load(OSCILLATOR)


def test_columns_with_the_systems_names_need_no_mapping(tmp_path):
    table = columns()
    named = {"time": table["t"], "x": table["a"], "force": table["f"]}
    record = csv(path=write(tmp_path / "a.csv", named)).load(OSCILLATOR)[0]
    assert record.samples == COUNT


def test_names_that_agree_may_be_left_out_beside_others_and_in_units(tmp_path):
    table = columns()
    named = {"t": table["t"], "x": table["a"], "y": table["a"]}
    named |= {"speed": table["f"], "turn": table["f"]}
    path = write(tmp_path / "a.csv", named)
    units = {"speed": "rpm", "x": "mm", "phase": "deg"}
    (record,) = csv(path=path, inputs={"phase": "turn"}, units=units).load(ROTOR)
    assert record.inputs["speed"] == pytest.approx(table["f"] * math.pi / 30)
    assert record.channels["x"] == pytest.approx(table["a"] / 1000)
    assert record.channels["y"] == pytest.approx(table["a"])


@pytest.mark.parametrize("time", ["t", "t [s]", "t (s)"])
@pytest.mark.parametrize("header", ["t,a,f", "t [s],a [m],f [N]", "t [s],a [m],f [1]"])
def test_a_column_is_found_with_its_unit_and_without(tmp_path, time, header):
    path = write(tmp_path / "a.csv", columns(), header)
    assert load(path=path, time=time, channels={"x": "a [m]"})[0].samples == COUNT


@pytest.mark.parametrize(
    ("column", "size"),
    [("a_mm", 1e-3), ("a-um", 1e-6), ("a_m", 1.0), ("a_in", 1.0), ("a_ch1", 1.0), ("a_kPa", 1.0)],
)
def test_a_unit_after_a_columns_name_counts_where_it_is_one_of_the_series(tmp_path, column, size):
    """``in`` is a word sooner than inches; pascals are no lengths."""
    table = columns()
    named = {"time_ms": table["t"], column: table["a"], "f_mN": table["f"]}
    path = write(tmp_path / "a.csv", named)
    fields = {"path": path, "time": "time_ms", "channels": {"x": column}}
    record = csv(**fields, inputs={"force": "f_mN"}).load(OSCILLATOR)[0]
    np.testing.assert_allclose(record.channels["x"], size * table["a"])
    np.testing.assert_allclose(record.inputs["force"], 1e-3 * table["f"])
    assert math.isclose(record.dt, 1e-5, rel_tol=1e-9)
    said = csv(**fields, inputs={"force": "f_mN"}, units={"force": "kN", "time": "s"})
    np.testing.assert_allclose(said.load(OSCILLATOR)[0].inputs["force"], 1e3 * table["f"])


def test_an_index_is_no_unit(tmp_path):
    with pytest.raises(InputError, match="column"):
        load(path=write(tmp_path / "a.csv", columns()), channels={"x": "a[1]"})


def test_data_variable_is_a_second_place(tmp_path, monkeypatch):
    write(tmp_path / "far.csv", columns())
    monkeypatch.setenv("SPIRAL_DATA", str(tmp_path))
    assert load(path="far.csv")[0].samples == COUNT
    with pytest.raises(InputError, match=r"far\.csv"):
        load(path="fart.csv")


def test_parquet_is_read_as_well(tmp_path):
    import pandas as pd

    pd.DataFrame(columns()).to_parquet(tmp_path / "a.parquet")
    assert load(path=str(tmp_path / "a.parquet"))[0].samples == COUNT


def refusal(**fields):
    with pytest.raises(SpiralError) as caught:
        load(**fields)
    return caught.value


def test_missing_file_names_its_neighbours(tmp_path):
    write(tmp_path / "coastdown.csv", columns())
    error = refusal(path=str(tmp_path / "coastdwn.csv"))
    assert "coastdown.csv" in error.try_


def test_a_folder_is_no_file(tmp_path):
    write(tmp_path / "a.csv", columns())
    assert "a.csv" in refusal(path=str(tmp_path)).try_


def test_missing_column_names_its_neighbours(tmp_path):
    path = write(tmp_path / "a.csv", columns(), header="t,displacement,f")
    error = refusal(path=path, channels={"x": "displacment"})
    assert "'displacement'" in error.try_
    assert "record.channels" in error.given


def test_file_without_names_is_told(tmp_path):
    path = tmp_path / "a.csv"
    np.savetxt(path, np.column_stack(list(columns().values())), delimiter=",")
    assert "first line holds numbers" in refusal(path=str(path)).try_
    assert "no names" in refusal(path=str(path)).given


def test_text_among_numbers_names_row_and_line(tmp_path):
    table = {k: v.astype(object) for k, v in columns().items()}
    table["a"][17] = "n/a?"
    error = refusal(path=write(tmp_path / "a.csv", table))
    assert "row 17" in error.given
    assert "line 19" in error.given
    assert "n/a?" in error.given


def test_gaps_are_counted(tmp_path):
    table = {k: v.astype(object) for k, v in columns().items()}
    table["a"][[5, 6]] = ""
    error = refusal(path=write(tmp_path / "a.csv", table))
    assert "row 5" in error.given
    assert "2 missing" in error.given


@pytest.mark.parametrize(
    ("content", "word"),
    [(b"", "empty"), (b"\n \n", "blank"), (b"\x00\x01PK" * 50, "binary"), (b"t,a,f\n", "no rows")],
)
def test_unusable_files_are_named(tmp_path, content, word):
    path = tmp_path / "a.csv"
    path.write_bytes(content)
    assert word in refusal(path=str(path)).given


@pytest.mark.parametrize("rows", [[-1, 100], [100, 100], [0, COUNT + 1], [150, 20]])
def test_rows_out_of_range(tmp_path, rows):
    path = write(tmp_path / "a.csv", columns())
    assert str(COUNT) in refusal(path=path, rows=rows).expected


@pytest.mark.parametrize(
    ("fields", "word"),
    [
        ({"units": {"x": "kg"}}, "kg"),
        ({"units": {"x": "blorb"}}, "blorb"),
        ({"units": {"velocity": "m/s"}}, "velocity"),
        ({"channels": {"z": "a"}}, "'z'"),
        ({"inputs": {"torque": "f"}}, "torque"),
        ({"noise": {"x": -1.0}}, "noise"),
        ({"noise": {"y": 1.0}}, "noise"),
        ({"time": "a"}, "time"),
    ],
)
def test_wrong_names_units_and_numbers(tmp_path, fields, word):
    path = write(tmp_path / "a.csv", columns())
    assert word in refusal(path=path, **fields).given


def test_time_or_rate_but_not_both():
    with pytest.raises(ConfigError, match="one of them"):
        csv(path="a.csv", time="t", rate=100.0)
    with pytest.raises(ConfigError, match="above zero"):
        csv(path="a.csv", rate=0.0)


def test_neither_time_nor_rate(tmp_path):
    table = columns()
    path = write(tmp_path / "a.csv", {"a": table["a"], "f": table["f"]})
    error = refusal(path=path, time=None)
    assert "record.rate" in error.try_


CELLS = st.sampled_from(["1", "2.5", "-3e-4", "", "nan", "x", "1,2", '"', "\t", "é", "1e400"])
LINES = st.lists(st.lists(CELLS, min_size=0, max_size=4).map(",".join), max_size=12)


@settings(
    max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(header=st.lists(CELLS | st.sampled_from(["t", "a", "f"]), max_size=4), lines=LINES)
def test_any_text_gives_a_record_or_one_clear_message(tmp_path, header, lines):
    path = tmp_path / "any.csv"
    path.write_text("\n".join([",".join(header), *lines]))
    error = refusal(path=str(path))
    assert error.given
    assert error.expected


@settings(max_examples=25, deadline=None)
@given(content=st.binary(max_size=300))
def test_any_bytes_give_one_clear_message(content):
    import tempfile

    with tempfile.NamedTemporaryFile(suffix=".csv", delete=False) as file:
        file.write(content)
    try:
        assert refusal(path=file.name).expected
    finally:
        os.unlink(file.name)


@settings(
    max_examples=15, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(start=st.integers(0, 60), extra=st.integers(64, 140), scale=st.floats(1e-9, 1e9))
def test_rows_select_exactly(tmp_path, start, extra, scale):
    table = columns()
    table["a"] = scale * table["a"]
    path = write(tmp_path / "a.csv", table)
    record = load(path=path, rows=[start, start + extra])[0]
    np.testing.assert_array_equal(record.channels["x"], table["a"][start : start + extra])
