"""Temperatures have a zero of their own: degrees Celsius of a file are kelvin of a model."""

import numpy as np
import pytest

import spiral
from spiral.types.errors import InputError
from spiral.types.units import conversion, factor

ROOM = """
equations:
  - C*T' = P - G*(T - To)
states: {T: UNIT}
inputs: {P: W, To: UNIT}
parameters:
  C: 1.0e5 J/K
  G: 50 W/UNIT
free: [G]
observed: [T]
"""
HEATED = spiral.system(
    lambda t, x, u, p: [(u.P - p.G * (x.T - u.Ta)) / p.C, x.w, -p.k * x.th],
    states={"T": "K", "th": "rad", "w": "rad/s"}, inputs={"P": "W", "Ta": "K"},
    observed=["T", "th"],
    parameters={"C": (100.0, "J/K"), "G": (2.0, "W/K"), "k": (1.0, "1/s^2")},
)  # fmt: skip
TIME = np.arange(200) / 100


@pytest.mark.parametrize(
    ("given", "wanted", "one", "zero"),
    [
        ("degC", "K", 1.0, 273.15),
        ("K", "degC", 1.0, -273.15),
        ("degF", "K", 5 / 9, 273.15 - 32 * 5 / 9),
        ("delta_degC", "K", 1.0, 0.0),
        ("degC", "degC", 1.0, 0.0),
        ("um", "m", 1e-6, 0.0),
        ("deg", "rad", np.pi / 180, 0.0),
    ],
)
def test_factor_and_zero_of_units(given, wanted, one, zero):
    assert conversion(given, wanted, "x") == pytest.approx((one, zero), rel=1e-12, abs=1e-9)


@pytest.mark.parametrize("wanted", ["", "1"])
def test_of_a_number_without_a_unit_the_message_names_units_that_fit(wanted):
    """A scale is no unit; percent and millionths are."""
    with pytest.raises(InputError) as caught:
        conversion("1e-5", wanted, "rho")
    for word in ("'1e-5' of rho", "a number without a unit: 1, '%' or 'ppm'", "multiplied"):
        assert word in str(caught.value)
    assert conversion("ppm", wanted, "rho") == pytest.approx((1e-6, 0.0))
    with pytest.raises(InputError, match="converts to a number without a unit"):
        conversion("m", wanted, "rho")


def test_differences_have_no_zero():
    assert factor("W/degC", "W/K", "G") == 1.0
    assert factor("J/(kg*degC)", "J/(kg*K)", "c") == 1.0


def test_a_level_is_no_straight_line_of_a_power():
    with pytest.raises(InputError, match="dBm"):
        conversion("dBm", "W", "power")


def room(tmp_path, unit):
    path = tmp_path / "room.yaml"
    path.write_text(ROOM.replace("UNIT", unit))
    return spiral.system(path)


def file_of(tmp_path, header):
    t = np.arange(80) * 60.0
    rows = np.c_[t, 20 + np.sin(t / 500), 1000 + 0 * t, 5 + np.cos(t / 900)]
    np.savetxt(tmp_path / "room.csv", rows, delimiter=",", header=header, comments="")
    return tmp_path / "room.csv", rows


@pytest.mark.parametrize("header", ["t,T [°C],P,To [degC]", "t,T,P,To"])
def test_degrees_of_a_file_become_kelvin(tmp_path, header):
    path, rows = file_of(tmp_path, header)
    units = None if "[" in header else {"T": "degC", "To": "°C"}
    record = spiral.read(path, room(tmp_path, "K"), time="t", units=units)
    np.testing.assert_allclose(record.channels["T"], rows[:, 1] + 273.15)
    np.testing.assert_allclose(record.inputs["To"], rows[:, 3] + 273.15)
    np.testing.assert_allclose(record.inputs["P"], rows[:, 2])
    assert "(0 is 273.15 K)" in str(record.notes)


def test_an_instruments_offset_is_in_the_units_of_the_file(tmp_path):
    path, rows = file_of(tmp_path, "t,T,P,To")
    record = spiral.read(
        path, room(tmp_path, "K"), time="t", units={"T": "degC"}, offset={"T": 0.5}
    )
    np.testing.assert_allclose(record.channels["T"], rows[:, 1] - 0.5 + 273.15)


def test_a_model_may_work_in_degrees(tmp_path):
    path, rows = file_of(tmp_path, "t,T,P,To")
    record = spiral.read(path, room(tmp_path, "degC"), time="t", units={"To": "degF"})
    np.testing.assert_allclose(record.channels["T"], rows[:, 1])
    np.testing.assert_allclose(record.inputs["To"], (rows[:, 3] - 32) * 5 / 9, atol=1e-9)


@pytest.mark.parametrize(
    ("columns", "units", "asked"),
    [
        ({"T": 20.0 + TIME}, {}, {"T"}),
        ({"T": 20.0 + TIME}, {"T": "degC"}, set()),
        ({"T": 20.0 + TIME}, {"T": "K"}, set()),
        ({"T": 40.0 * TIME}, {}, set()),  # a rise
        ({"T": 290.0 + TIME}, {}, set()),
        ({"Ta": 21.0 + 0.0 * TIME}, {}, {"Ta"}),
        ({"th": 15 * np.sin(9 * TIME)}, {}, {"th"}),
        ({"th": 15 * np.sin(9 * TIME)}, {"th": "deg"}, set()),
        ({"th": 60 * TIME}, {}, set()),  # a shaft that turns
    ],
)
def test_numbers_that_are_unlikely_in_a_unit_that_nobody_said_are_asked_after(
    columns, units, asked
):
    usual = {"T": 290 + TIME, "th": np.sin(9 * TIME), "P": np.sin(TIME), "Ta": 290 + 0 * TIME}
    record = spiral.read({"t": TIME, **usual, **columns}, HEATED, time="t", units=units)
    assert set(record.doubts) == asked
    assert all(name in said for name, said in record.doubts.items())
    assert all(said in repr(record) for said in record.doubts.values())


def test_a_rate_that_contradicts_a_column_of_time_is_asked_after():
    usual = {"T": 290 + TIME, "th": np.sin(9 * TIME), "P": np.sin(TIME), "Ta": 290 + 0 * TIME}
    for time, asked in ((TIME, {"time"}), (1000 * TIME / 2, set()), (np.arange(len(TIME)), set())):
        record = spiral.read({"t": time, **usual}, HEATED, rate=2 / (TIME[1] - TIME[0]))
        assert set(record.doubts) == asked


def test_units_may_be_named_by_column(tmp_path):
    path, rows = file_of(tmp_path, "clock,room,P,To")
    record = spiral.read(
        path, room(tmp_path, "K"), time="clock", channels={"T": "room"},
        units={"clock": "ms", "room": "degC"},
    )  # fmt: skip
    assert record.dt == pytest.approx(0.06)
    np.testing.assert_allclose(record.channels["T"], rows[:, 1] + 273.15)


def test_columns_before_the_systems_names_are_turned_around_in_the_hint(tmp_path):
    path, _ = file_of(tmp_path, "t,room,P,To")
    with pytest.raises(InputError, match=r"record\.channels='\{T: room\}'"):
        spiral.read(path, room(tmp_path, "K"), time="t", channels={"room": "T"})
