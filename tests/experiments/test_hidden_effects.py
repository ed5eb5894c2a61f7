"""Every mechanical and rotor effect, hidden in the truth and left out of the model."""

import pytest

from experiments.hidden_effects.cases import CASES
from experiments.hidden_effects.run import outcome
from spiral.effect import ForceEffect
from tests.scenes import registry


@pytest.mark.parametrize("case", CASES, ids=lambda c: c.effect)
def test_the_hidden_effect_is_the_first_suggestion_and_adding_it_is_enough(case):
    found = outcome(case, seed=1, noise=0.02)
    assert found["hit"]
    assert found["before"] > 1.5
    assert found["after"] <= 1.2


def test_every_shipped_force_effect_with_a_name_has_a_case():
    names = {c.effect for c in CASES}
    effects = [e for e in registry().entries if e.kind == "effect" and not e.plugin.bare]
    assert {e.name for e in effects if issubclass(e.plugin, ForceEffect)} == names
