"""Units as engineers write them, in the sense in which they mean them."""

from __future__ import annotations

import numpy as np
import pytest
from spiral_plugins.effects.inputs import InputGain
from spiral_plugins.effects.sensors import Gain

from spiral.physics.formulas.definition import parse_sections
from spiral.types.errors import ConfigError, near_misses
from spiral.types.units import base_form, conversion, short_form

WRITTEN = [
    ("Nm", "N*m"), ("kNm", "kN*m"), ("mNm", "mN*m"), ("Nm/rad", "N*m/rad"),
    ("Nms/rad", "N*m*s/rad"), ("Nm·s/rad", "N*m*s/rad"), ("rad/Nm", "rad/(N*m)"),
    ("Ns/m", "N*s/m"), ("Vs/rad", "V*s/rad"), ("As", "A*s"), ("Js", "J*s"), ("Pas", "Pa*s"),
    ("kgm2", "kg*m**2"), ("kgm²", "kg*m**2"), ("kgm^2/s", "kg*m**2/s"), ("kg*m²", "kg*m**2"),
    ("m3/s", "m**3/s"), ("mm2", "mm**2"), ("m3 s-1", "m**3/s"), ("kOhm", "kohm"),
    ("Ns^2/m^2", "N*s**2/m**2"), ("Nms^2/rad^2", "N*m*s**2/rad**2"), ("Nm^10", "N*m**10"),
    ("Nm-1", "N/m"), ("cNm", "cN*m"), ("daNm", "daN*m"), ("\u03bcNm", "µN*m"), ("Nmm", "N*mm"),
    ("m/s2", "m/s**2"), ("1/s", "1/s"), ("rev", "turn"), ("Torr", "torr"),
]  # fmt: skip


@pytest.mark.parametrize(("written", "meant"), WRITTEN)
def test_a_unit_written_together_is_a_product(written, meant):
    factor, powers = base_form(written)
    expected, powers_of_expected = base_form(meant)
    assert (factor, powers) == (pytest.approx(expected), powers_of_expected)


@pytest.mark.parametrize(
    "unit", ["N*m", "N*m*s/rad", "V*s/rad", "kg*m^2", "W/m/K", "J/kg/K", "N*m/A", "A*s"]
)
def test_a_product_is_shown_in_the_order_that_engineers_use(unit):
    assert short_form(unit) == short_form(f"1*{unit}") == unit


@pytest.mark.parametrize("unit", ["m", "mm", "nm", "ms", "s", "kg", "min", "N/m", "mN", "Pa", "km"])
def test_units_of_one_word_stay_what_they_are(unit):
    assert conversion(unit, unit, "x") == (1.0, 0.0)
    assert base_form(unit) != base_form(f"{unit}*s")


@pytest.mark.parametrize("unit", ["rpm", "U/min", "1/min", "rev/min", "r/min"])
def test_turns_per_minute_in_every_spelling(unit):
    assert conversion(unit, "rad/s", "speed")[0] == pytest.approx(0.10471975511965977)
    if unit != "1/min":
        assert conversion(unit, "rpm", "speed")[0] == pytest.approx(1.0)


@pytest.mark.parametrize("wanted", ["Hz", "1/s"])
def test_a_speed_of_rotation_in_hertz_counts_turns(wanted):
    """2400 rpm are 40 Hz, as 40 Hz are 251.3 rad/s; to pint a turn is 6.28."""
    assert 2400 * conversion("rpm", wanted, "speed")[0] == pytest.approx(40)
    assert conversion("rev/s", wanted, "speed")[0] == pytest.approx(1)
    assert conversion("1/min", wanted, "rate")[0] == pytest.approx(1 / 60)
    assert conversion("rad/s", "Hz", "speed")[0] == pytest.approx(1 / (2 * np.pi))
    assert conversion("rad/s", "1/s", "rate")[0] == pytest.approx(1)
    assert conversion("kHz", "Hz", "frequency")[0] == pytest.approx(1000)


@pytest.mark.parametrize("unit", ["pu", "p.u.", "-", "1", ""])
def test_a_number_per_unit_has_no_unit(unit):
    assert conversion(unit, "1", "I") == (1.0, 0.0)


def test_an_unknown_unit_is_named():
    from spiral.physics.formulas.definition import definition_of

    text = """
    equations: ["m*x'' + k*x = F"]
    states: {x: m}
    inputs: {F: N}
    parameters: {m: 2.0 kgg, k: 400 N/m}
    observed: [x]
    """
    with pytest.raises(ConfigError, match="'kgg' of m: no kgg is known"):
        definition_of(text)


def test_a_key_that_stands_twice_is_refused_with_its_line():
    with pytest.raises(ConfigError, match="line 3: a second 'k'"):
        parse_sections("states: {x: m}\nparameters: {m: 2.0 kg,\n k: 1 N/m, k: 2 N/m}\n")


def test_a_name_without_its_owner_is_found():
    known = ["system.k_1", "system.k_2", "cubic_stiffness.k_1x"]
    assert near_misses("k_1", known)[0] == "system.k_1"
    assert near_misses("k1", known)[0] in {"system.k_1", "system.k_2"}


@pytest.mark.parametrize(
    ("factor", "words"),
    [
        (999.2, "10^3"),
        (1.05e-3, ""),
        (57.4, "rad to degrees"),
        (-1.01, "turns the sign"),
        (1.3, ""),
    ],
)
def test_a_scale_that_no_sensor_is_wrong_by_is_told_as_a_unit(factor, words):
    assert InputGain().remark({"error": factor - 1}, 0.01).count(words or "near") == bool(words)
    assert bool(Gain().remark({"error_x": factor - 1}, 0.01)) == (factor != 1.3)
