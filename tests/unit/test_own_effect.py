"""An effect written on the page: the example works everywhere, and advice can be typed as given."""

import pytest

from spiral.app.own_effect import effect_overrides, example_formula
from spiral.io.config import compose
from spiral.io.custom import registry_for_config
from spiral.types.errors import ConfigError
from tests.scenes import registry

SYSTEMS = ("oscillator", "planar_rotor", "tilting_rotor", "pendulum", "cascaded_tanks")


def made(system, formula, values=""):
    """The formulas of an effect as the page asks for it."""
    known = registry()
    given = (f"system={system}", *effect_overrides("mine", formula, values))
    effect = registry_for_config(compose(given, known), known).make("effect", "mine")
    return dict(effect.formulas)


@pytest.mark.parametrize("system", SYSTEMS)
def test_the_example_of_every_system_is_an_effect_of_it(system):
    about = example_formula(registry().make("system", system))
    assert made(system, about["formula"])
    names = dict(about["names"])
    assert set(registry().make("system", system).observed) <= {n for k in names for n in names[k]}


@pytest.mark.parametrize(
    "typed", ["x: -k*y; y: k*x", "{x: -k*y, y: k*x}", "expression='{x: -k*y, y: k*x}'",
              "x: -k*y\ny: k*x", "[-k*y, k*x]"]
)  # fmt: skip
def test_one_formula_for_each_axis_as_the_message_advises(typed):
    with pytest.raises(ConfigError, match="one for each axis: x, y"):
        made("planar_rotor", "-k*x")
    assert made("planar_rotor", typed) == {"x": "-k*y", "y": "k*x"}


@pytest.mark.parametrize("values", ["w=0.003, a=N/m", "units='{a: N/m}'", "{a: N/m, w: 1}"])
def test_units_that_are_left_open_as_the_message_advises(values):
    formula = "-a*q*tanh(v/w)" if "w" in values else "-a*q"
    assert made("oscillator", formula, values) == {"x": formula}


def test_commas_inside_a_function_part_nothing():
    assert made("planar_rotor", "x: -k*maximum(x, y); y: -k*y")["x"] == "-k*maximum(x, y)"
