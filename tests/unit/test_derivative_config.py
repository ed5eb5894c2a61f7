"""The group ``derivative=``: chosen by name, its fields checked, also on runs saved without it."""

import pytest
from spiral_plugins.derivatives.savitzky_golay import SavitzkyGolay
from spiral_plugins.derivatives.total_variation import TotalVariation

from spiral.io.config import build_derivative, compose
from spiral.types.errors import ConfigError
from tests.scenes import registry

REGISTRY = registry()


def test_fields_reach_the_estimator():
    given = ["derivative=savitzky_golay", "derivative.window=61"]
    config = compose(["experiment=rotor_coastdown", *given], REGISTRY)
    assert build_derivative(config, REGISTRY) == SavitzkyGolay(window=61)


def test_unknown_names_and_fields_are_refused_with_near_misses():
    with pytest.raises(ConfigError, match="savitzky_golay"):
        compose(["derivative=savitzky"], REGISTRY)
    with pytest.raises(ConfigError, match="window"):
        compose(["derivative=savitzky_golay", "derivative.windw=61"], REGISTRY)


def test_a_configuration_saved_before_there_was_a_group_gets_the_usual_one():
    old = compose(["experiment=rotor_coastdown"], REGISTRY)
    del old["derivative"]
    assert build_derivative(compose([], REGISTRY, old), REGISTRY) == TotalVariation()


def test_an_estimator_inside_another_is_chosen_by_name_too():
    given = ["derivative=shape_functions", "derivative.shapes=[[1, 0.1], [1, -0.2]]"]
    for chosen in ("{name: savitzky_golay, window: 61}", "savitzky_golay"):
        config = compose([*given, f"derivative.inner={chosen}"], REGISTRY)
        window = 61 if "61" in chosen else 31
        assert build_derivative(config, REGISTRY).inner == SavitzkyGolay(window=window)
