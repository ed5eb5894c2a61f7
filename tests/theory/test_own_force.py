"""A candidate's own force over the missing one: the law itself, at the same states."""

import numpy as np
import pytest
from spiral_plugins.effects.memory import BoucWen
from spiral_plugins.effects.restoring import CrossStiffness, CubicStiffness
from spiral_plugins.effects.sensors import Gain
from spiral_plugins.systems.oscillator import Oscillator
from spiral_plugins.systems.planar_rotor import PlanarRotor

from spiral.inference.simulate import simulate
from spiral.inference.where.latent import missing_force
from spiral.inference.where.own_force import effect_own_force
from spiral.types.model import Model, seed_model
from tests.scenes import SEED_TRUTH, planar_record

TRUTH = {"system.mass": 2.0, "linear_stiffness.stiffness": 4000.0, "linear_damping.damping": 6.0}


def hardening():
    """A record of a hardening spring, the model with it, and the one without."""
    before = Model(Oscillator(), Oscillator().seed, TRUTH)
    after = Model(Oscillator(), (*Oscillator().seed, CubicStiffness()),
                  {**TRUTH, "cubic_stiffness.stiffness": 2e6})  # fmt: skip
    time, rng = np.arange(3000) / 500, np.random.default_rng(0)
    force = 12 * sum(np.sin(6.283 * f * time + rng.uniform(0, 6.3)) for f in np.arange(2, 20, 0.7))
    record = simulate(after, time, {"force": force}, 0.005, rng, substeps=4)
    return missing_force(before, record), after


def test_a_law_is_drawn_as_it_is_and_lies_on_the_force_that_was_missing():
    missing, after = hardening()
    found = effect_own_force(missing, after, "cubic_stiffness")
    x = missing.states[found.rows, 0]
    law = -2e6 * x**3
    np.testing.assert_allclose(found.alone[:, 0], law, atol=1e-9 * np.abs(law).max())
    np.testing.assert_allclose(found.refitted, found.alone, atol=1e-9 * np.abs(law).max())
    left = missing.force[found.rows, 0] - law
    assert np.mean(left**2) < 0.02 * np.mean(law**2)


def test_what_the_refit_changes_elsewhere_is_in_the_second_curve_alone():
    missing, after = hardening()
    moved = {**after.values, "linear_stiffness.stiffness": 3700.0}
    found = effect_own_force(missing, Model(after.system, after.effects, moved), "cubic_stiffness")
    x = missing.states[found.rows, 0]
    size = np.abs(found.alone).max()
    np.testing.assert_allclose(found.alone[:, 0], -2e6 * x**3, atol=1e-9 * size)
    np.testing.assert_allclose((found.refitted - found.alone)[:, 0], 300 * x, atol=1e-9 * size)


def test_axes_of_a_rotor_keep_their_own_forces():
    values, seed = {**SEED_TRUTH, "system.phase_origin": 0.4}, seed_model(PlanarRotor())
    before = Model(seed.system, seed.effects, values)
    values = {**values, "cross_stiffness.stiffness": 900.0}
    after = Model(seed.system, (*seed.effects, CrossStiffness()), values)
    record = planar_record(1, (CrossStiffness(),), {"cross_stiffness.stiffness": 900.0},
                           duration=4.0)  # fmt: skip
    missing = missing_force(before, record)
    found = effect_own_force(missing, after, "cross_stiffness")
    x, y = missing.states[found.rows, :2].T
    law = -900.0 * np.column_stack([y, x])
    np.testing.assert_allclose(found.alone, law, atol=1e-7 * np.abs(law).max())


@pytest.mark.parametrize("effect", [Gain(), BoucWen()])
def test_what_has_no_force_of_the_motion_has_no_curve(effect):
    missing, after = hardening()
    keys = dict.fromkeys((k for k, _ in effect.keys(after.system.place(effect))), 0.1)
    model = Model(after.system, (*Oscillator().seed, effect), {**TRUTH, **keys})
    assert effect_own_force(missing, model, effect.label) is None
