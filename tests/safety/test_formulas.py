"""Formulas that would take the machine for themselves are refused in words, at once."""

import time
from math import comb

import pytest
import sympy as sp

from spiral.physics.formulas.syntax import MOST_TERMS, compute, names, read, terms
from spiral.types.errors import ConfigError

LONG = "(a+b+c+d+e+f+g)"


@pytest.mark.hostile("formulas")
@pytest.mark.parametrize(
    "text",
    [
        f"-{LONG}**12*(h+i+j+k+l+m+n)**12*q",  # took over a minute
        f"{LONG}**12",
        f"(({LONG}**6)**6)**6",
        f"tanh({LONG}**12)",
        f"where(x > {LONG}**12, x, 0)",
        f"1/{LONG}**12",
        f"x*{LONG}**-12",
        "*".join(["(a+b)"] * 12),
    ],
)
def test_what_grows_without_end_is_refused_at_once(text):
    began = time.monotonic()
    with pytest.raises(ConfigError, match="terms when multiplied out"):
        read(text)
    assert time.monotonic() - began < 1


@pytest.mark.parametrize(
    "text", ["-k3*x**3", "-F*tanh(v/w)", "x*(a+b*x+c*x**2)**3", "(a+b+c)**12*x", "x/(1+x**2)**2"]
)
def test_what_a_machine_needs_is_read(text):
    assert terms(read(text)) <= MOST_TERMS


@pytest.mark.parametrize("text", ["(a+b+c)**4", "(a+b)**3*(c+d+e)**2", "(a-b)*(c+d)+e*(f+g)**3"])
def test_the_bound_is_the_number_of_terms(text):
    """Of sums of names that differ: no term meets another."""
    symbols = {name: sp.Symbol(name) for name in names(text)}
    expanded = sp.expand(compute(text, symbols))
    assert terms(read(text)) == len(sp.Add.make_args(expanded))
    assert terms(read("(a+b+c)**4")) == comb(6, 2)


def test_a_power_may_have_a_name():
    """A Hill exponent; of what may be negative it has no value."""
    names = {"c": 2.0, "n": 1.7, "k": 3.0, "least": 0.1}
    written = compute("1/(1 + (maximum(c, least)/k)^-n)", names)
    assert written == pytest.approx(1 / (1 + (2 / 3) ** -1.7))
    assert compute("abs(c)**n", names) == pytest.approx(2**1.7)
    assert compute("(maximum(c, least)/k)**1.7", names) == pytest.approx((2 / 3) ** 1.7)
    for text in ("c**n", "(c - k)**n", "(c/k)**1.7", "c**(n + 1)"):
        with pytest.raises(ConfigError, match="power"):
            compute(text, names)


def test_a_power_is_written_in_either_way():
    symbols = {name: sp.Symbol(name) for name in "kxy"}
    assert compute("-k*x^2*y + 2^3", symbols) == compute("-k*x**2*y + 2**3", symbols)
    with pytest.raises(ConfigError, match="terms when multiplied out"):
        read(f"{LONG}^12")
