"""Parameters that follow different variables are no one cause."""

from spiral_plugins.effects.varying import InverseChange, LinearChange, OtherValue

import spiral
from spiral.inference.likelihood.stand_ins import one_law_sentences, several_causes_sentences
from spiral.physics.formulas.laws import laws_of
from spiral.types.model import seed_model
from tests.scenes import registry

SYSTEM = spiral.system(
    ["m*x'' + c*x' + k*x = F", "C*T' = P - h*T"],
    states={"x": "m", "T": "K"}, inputs={"F": "N", "P": "W"}, observed=["x", "T"],
    parameters={"m": (1.0, "kg"), "c": (2.0, "N*s/m"), "k": (400.0, "N/m"),
                "C": (50.0, "J/K"), "h": (1.0, "W/K")},
)  # fmt: skip
WARM = (LinearChange(port="k-T"), InverseChange(port="c-T"))


def sentences(*effects, given=()):
    return several_causes_sentences(seed_model(SYSTEM, effects), given)


def test_changes_that_follow_different_variables_are_told():
    (said,) = sentences(LinearChange(port="k-T"), InverseChange(port="c-F"))
    assert said.startswith("k follows T and c follows F")


def test_one_cause_may_change_several_parameters():
    assert sentences(*WARM) == ()
    assert sentences(*WARM, OtherValue(port="m")) == ()


def test_what_the_model_had_from_the_start_is_not_doubted():
    found = (*WARM, LinearChange(port="h-F"))
    assert len(sentences(*found)) == 1
    assert sentences(*found, given=("linear_change@h-F",)) == ()


def test_three_laws_of_one_variable_at_one_place_are_parts_of_one():
    """Springs at x; not a spring, a friction and a damper, nor a load beside two springs."""
    made = registry().make

    def told(*names, given=()):
        effects = tuple(made("effect", n) for n in names)
        return one_law_sentences(seed_model(SYSTEM, effects), given)

    springs = ("quadratic_stiffness", "cubic_stiffness", "clearance")
    (said,) = told(*springs)
    assert said.startswith("quadratic_stiffness, cubic_stiffness and clearance are laws of one")
    assert told(*springs, given=("cubic_stiffness",)) == ()
    assert told("cubic_stiffness", "coulomb_friction", "quadratic_damping") == ()
    assert told("cubic_stiffness", "clearance", "constant_load") == ()


def test_laws_with_a_closed_form_count_as_effects_of_the_catalog_do():
    laws = {e.label: e for e in laws_of(SYSTEM)}
    spring = registry().make("effect", "cubic_stiffness")
    found = (spring, laws["sine_law"], laws["power_law"])
    (said,) = one_law_sentences(seed_model(SYSTEM, found), ())
    assert "sine_law" in said
    friction = (spring, laws["sine_law"], laws["tanh_friction_law"])
    assert one_law_sentences(seed_model(SYSTEM, friction), ()) == ()
