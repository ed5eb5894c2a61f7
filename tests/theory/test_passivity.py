"""Signs that a passive machine does not have, by the work that each force does."""

import pytest
from spiral_plugins.effects.dissipative import (
    AmplitudeDamping,
    AntisymmetricDamping,
    CoulombFriction,
    CrossDamping,
    Gyroscopic,
    LinearDamping,
    QuadraticDamping,
)
from spiral_plugins.effects.restoring import CrossStiffness, CubicStiffness, LinearStiffness
from spiral_plugins.systems.oscillator import Oscillator
from spiral_plugins.systems.planar_rotor import PlanarRotor

from spiral.physics.formulas.laws import laws_of
from spiral.physics.passivity import DAMPING, STIFFNESS, implausible_signs
from spiral.types.effect import ForceEffect
from spiral.types.model import Model


def signs(effect, system=None, errors=None, **values):
    given = {f"{effect.label}.{k}": v for k, v in values.items()}
    wrong = {f"{effect.label}.{k}": v for k, v in (errors or {}).items()}
    found = implausible_signs(Model(system or Oscillator(), (effect,), given, errors=wrong))
    return {k.rpartition(".")[2]: v for k, v in found.items()}


@pytest.mark.parametrize("kind", [LinearDamping, QuadraticDamping, AmplitudeDamping])
def test_a_damper_that_feeds_energy_in_is_told_and_one_that_takes_it_is_not(kind):
    assert signs(kind(), damping=-2.0) == {"damping": DAMPING}
    assert signs(kind(), damping=2.0) == {}


def test_a_spring_that_pushes_away_is_told_and_one_that_softens_is_not():
    assert signs(LinearStiffness(), stiffness=-3.0) == {"stiffness": STIFFNESS}
    assert signs(LinearStiffness(), stiffness=3.0) == {}
    assert signs(CubicStiffness(), stiffness=-3.0) == {}


def test_of_two_axes_the_one_with_the_sign_is_named():
    found = signs(LinearDamping(), PlanarRotor(), damping_x=5.0, damping_y=-1.0)
    assert found == {"damping_y": DAMPING}


@pytest.mark.parametrize("size", [-4.0, 4.0])
@pytest.mark.parametrize("kind", [CrossStiffness, CrossDamping, AntisymmetricDamping, Gyroscopic])
def test_what_couples_axes_has_no_sign_of_its_own(kind, size):
    known = [k.rpartition(".")[2] for k, _ in kind().keys(PlanarRotor().ports[0])]
    assert signs(kind(), PlanarRotor(), **dict.fromkeys(known, size)) == {}


def test_formulas_of_ones_own_are_asked_by_the_same_rule():
    """Every law with a closed form, which may name the inputs too."""
    found = {}
    for law in laws_of(Oscillator()):
        if isinstance(law, ForceEffect):
            port = Oscillator().place(law)
            values = {k: -1.0 if p.role == "amplitude" else p.start or 0.7
                      for k, p in law.keys(port)}  # fmt: skip
            found[law.label] = set(implausible_signs(Model(Oscillator(), (law,), values)).values())
    assert DAMPING in set().union(*found.values())
    assert len(found) > 10


def test_friction_against_the_motion_is_passive():
    assert signs(CoulombFriction(), level=2.0, width=0.01) == {}


def test_a_sign_that_is_not_sure_says_nothing():
    assert signs(LinearDamping(), damping=-2.0, errors={"damping": 1.0}) == {}
    assert signs(LinearDamping(), damping=-2.0, errors={"damping": 0.5}) == {"damping": DAMPING}
