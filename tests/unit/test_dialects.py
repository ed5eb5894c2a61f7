"""Text files: every dialect reads back the same, and says how it was understood."""

import codecs
import os
import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from spiral.io.readers.dialect import units_in_names
from spiral.io.readers.formats import read_table
from spiral.io.registry import load_registry
from spiral.types.errors import ConfigError, InputError

REGISTRY = load_registry()
OSCILLATOR = REGISTRY.make("system", "oscillator")
ROTOR = REGISTRY.make("system", "planar_rotor")
COUNT = 100
RNG = np.random.default_rng(0)
VALUES = {"t": 0.01 * np.arange(COUNT), "a": RNG.normal(size=COUNT), "f": RNG.normal(size=COUNT)}
_PRIMES = """
equations: m*x'' + k*x = F
states: {x: m}
inputs: {F: N}
parameters: {m: 1 kg, k: 1 N/m}
observed: [x', x'']
"""
SPACED = st.sampled_from(["", " "])


def text(separator=",", decimal=".", above=(), units=None, names=None, values=VALUES):
    rows = [
        separator.join(repr(float(v)).replace(".", decimal) for v in row)
        for row in zip(*values.values(), strict=True)
    ]
    head = [*above, separator.join(names or values)]
    return "\n".join([*head, *([separator.join(units)] if units else []), *rows]) + "\n"


def write(folder, content, encoding="utf-8"):
    path = folder / "a.csv"
    path.write_bytes(content.encode(encoding))
    return str(path)


def load(path, system=OSCILLATOR, **fields):
    usual = {"time": "t", "channels": {"x": "a"}, "inputs": {"force": "f"}}
    return REGISTRY.make("source", "csv", {"path": path, **usual, **fields}, "record").load(system)[
        0
    ]


def agrees(record):
    np.testing.assert_allclose(record.channels["x"], VALUES["a"], rtol=1e-14)
    np.testing.assert_allclose(record.inputs["force"], VALUES["f"], rtol=1e-14)


@pytest.mark.parametrize(
    ("dialect", "words"),
    [
        ({}, "separated by commas, decimal point"),
        ({"separator": ";"}, "separated by semicolons, decimal point"),
        ({"separator": "\t"}, "separated by tabs, decimal point"),
        ({"separator": "|"}, "separated by bars"),
        ({"separator": "  "}, "separated by spaces"),
        ({"separator": ";", "decimal": ","}, "separated by semicolons, decimal comma"),
        ({"separator": "\t", "decimal": ","}, "separated by tabs, decimal comma"),
        ({"above": ["# rig 3", "# 2024"]}, "2 lines above the names left out"),
        ({"above": ["Device,XY 7", "Rate,100", ""]}, "3 lines above the names left out"),
        ({"separator": ";", "above": ["Rate;100;Hz", "Rig 3; a b"]}, "2 lines above"),
        ({"names": ["# t", "a", "f"]}, "separated by commas"),
        ({"separator": ";", "units": ["s", "-", ""]}, "row of units under the names (t in s)"),
    ],
)
def test_dialect_is_found_and_told(tmp_path, dialect, words):
    record = load(write(tmp_path, text(**dialect)))
    agrees(record)
    assert words in record.notes[0]


@pytest.mark.parametrize(
    ("encoding", "word"),
    [("utf-8-sig", "byte order mark"), ("utf-16", "UTF-16"), ("cp1252", "Latin-1")],
)
def test_encodings(tmp_path, encoding, word):
    content = text(separator=";", decimal=",", above=["Gerät;7"])
    record = load(write(tmp_path, content, encoding))
    agrees(record)
    assert word in record.notes[0]


def test_quotes_let_commas_be_both(tmp_path):
    rows = [",".join(f'"{v!r}"'.replace(".", ",") for v in map(float, row)) for row in
            zip(*VALUES.values(), strict=True)]  # fmt: skip
    agrees(load(write(tmp_path, "\n".join(["t,a,f", *rows]))))


def test_units_under_the_names_are_used_unless_others_are_given(tmp_path):
    count = COUNT
    values = {"t": 0.5 * np.arange(count), "x": RNG.normal(size=count),
              "y": RNG.normal(size=count), "n": np.linspace(3000, 2000, count)}  # fmt: skip
    path = write(tmp_path, text(";", ",", units=["ms", "[um]", "(µm)", "rpm"], values=values))
    fields = {"channels": {"x": "x", "y": "y"}, "inputs": {"speed": "n"}}
    record = load(path, ROTOR, **fields)
    np.testing.assert_allclose(record.channels["x"], 1e-6 * values["x"])
    np.testing.assert_allclose(record.channels["y"], 1e-6 * values["y"])
    np.testing.assert_allclose(record.inputs["speed"], 2 * np.pi / 60 * values["n"])
    assert record.dt == pytest.approx(0.5e-3)
    assert "x from 'x' in um" in record.notes[1]
    record = load(path, ROTOR, **fields, units={"x": "mm"})
    np.testing.assert_allclose(record.channels["x"], 1e-3 * values["x"])


def test_units_in_brackets_at_the_end_of_names(tmp_path):
    names = ["t (ms)", "Weg [mm]", "Kraft [N]"]
    path = write(tmp_path, text(";", ",", names=names))
    fields = {"time": "t (ms)", "channels": {"x": "Weg [mm]"}, "inputs": {"force": "Kraft [N]"}}
    record = load(path, **fields)
    np.testing.assert_allclose(record.channels["x"], 1e-3 * VALUES["a"])
    np.testing.assert_allclose(record.inputs["force"], VALUES["f"])
    assert record.dt == pytest.approx(1e-5)
    np.testing.assert_allclose(
        load(path, **fields, units={"x": "um"}).channels["x"], 1e-6 * VALUES["a"]
    )


def test_a_unit_behind_a_name_does_not_hide_it(tmp_path):
    """``t [ms],x (mm),force [N]``: found by their names, and read in these units."""
    values = {"t": 1e3 * VALUES["t"], "x": 1e3 * VALUES["a"], "force": VALUES["f"]}
    path = write(tmp_path, text(names=["t [ms]", "x (mm)", "force [N]"], values=values))
    (record,) = REGISTRY.make("source", "csv", {"path": path}, "record").load(OSCILLATOR)
    assert record.dt == pytest.approx(0.01)
    np.testing.assert_allclose(record.channels["x"], VALUES["a"])
    np.testing.assert_allclose(record.inputs["force"], VALUES["f"])


def test_rates_may_be_named_as_equations_write_them(tmp_path):
    system = REGISTRY.make("system", "equations", {"text": _PRIMES})
    values = {"t": VALUES["t"], "x'": VALUES["a"], "x'' (mm/s^2)": VALUES["a"], "F": VALUES["f"]}
    path = write(tmp_path, text(names=list(values), values=values))
    (record,) = REGISTRY.make("source", "csv", {"path": path}, "record").load(system)
    np.testing.assert_allclose(record.channels["x_rate"], VALUES["a"])
    np.testing.assert_allclose(record.channels["x_acceleration"], 1e-3 * VALUES["a"])


def test_brackets_that_hold_no_unit_are_part_of_a_name():
    known = {"n [1/min]": "1/min", "phi (°)": "°", "v [mm/s]": "mm/s", "F (N)": "N"}
    assert units_in_names((*known, "y (left)", "ch (a)", "x [-]", "F [foo]", "mm", "[]")) == known


def test_rows_are_counted_below_the_units(tmp_path):
    path = write(tmp_path, text(units=["s", "m", "N"]))
    np.testing.assert_allclose(load(path, rows=[10, 90]).channels["x"], VALUES["a"][10:90])


def test_a_wrong_unit_in_the_file_is_told(tmp_path):
    with pytest.raises(InputError, match="'kg'"):
        load(write(tmp_path, text(units=["s", "kg", "N"])))


def test_commas_for_columns_and_fractions_are_refused(tmp_path):
    with pytest.raises(InputError) as caught:
        load(write(tmp_path, text(",", ",")))
    assert "3 names" in caught.value.given
    assert "semicolons" in caught.value.try_


def test_thousands_or_fractions_are_refused_until_told(tmp_path):
    rows = [f"{i};1,{500 + i};2,{100 + i}" for i in range(COUNT)]
    path = write(tmp_path, "\n".join(["t;a;f", *rows]))
    with pytest.raises(InputError, match="thousands"):
        load(path)
    np.testing.assert_allclose(load(path, decimal=",").channels["x"], 1.5 + 1e-3 * np.arange(COUNT))


def test_text_is_named_in_a_file_with_decimal_commas(tmp_path):
    lines = text(";", ",").splitlines()
    lines[20] = "0,19;oops;1,0"
    with pytest.raises(InputError, match=r"row 19 \(line 21\): text 'oops'"):
        load(write(tmp_path, "\n".join(lines)))


def test_wrong_options_are_told(tmp_path):
    path = write(tmp_path, text())
    with pytest.raises(InputError, match=r"leave record\.separator"):
        load(path, separator=";")
    with pytest.raises(ConfigError, match="one character"):
        load(path, separator="ab")
    with pytest.raises(ConfigError, match=r"record\.decimal"):
        load(path, decimal="x")


FINITE = st.floats(-1e12, 1e12, allow_subnormal=False)


@settings(max_examples=60, deadline=None)
@given(
    rows=st.lists(st.tuples(FINITE, FINITE, FINITE), min_size=3, max_size=20),
    separator=st.sampled_from([",", ";", "\t", "|"]),
    comma=st.booleans(),
    units=st.booleans(),
    above=st.integers(0, 3),
    mark=st.booleans(),
)
def test_any_numbers_in_any_dialect_read_back(rows, separator, comma, units, above, mark):
    decimal = "," if comma and separator != "," else "."
    values = dict(zip(("t", "a", "f"), np.array(rows).T, strict=True))
    content = text(
        separator,
        decimal,
        [f"# line {i}" for i in range(above)],
        ["s", "um", "N"] * units,
        values=values,
    ).encode()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.csv"
        path.write_bytes(codecs.BOM_UTF8 * mark + content)
        table = read_table(str(path))
    assert table.columns == ("t", "a", "f")
    assert table.units == ({"t": "s", "a": "um", "f": "N"} if units else {})
    for name, expected in values.items():
        found = table.column(name, "", 0, len(rows))
        np.testing.assert_allclose(found, expected, rtol=4e-16, atol=0)


def test_the_example_of_the_how_to(tmp_path):
    page = Path(__file__).parents[2] / "docs" / "how-to" / "own-data.md"
    example = next(b for b in page.read_text(encoding="utf-8").split("```") if "t;a;f" in b)
    table = read_table(write(tmp_path, example.strip() + "\n"))
    assert table.units == {"t": "ms", "a": "um", "f": "N"}
    np.testing.assert_array_equal(table.column("a", "", 0, 2), [1.25, 1.31])


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() == 0, reason="root reads all")
def test_a_file_without_permission(tmp_path):
    path = write(tmp_path, text())
    Path(path).chmod(0)
    with pytest.raises(InputError, match="can be read"):
        load(path)
