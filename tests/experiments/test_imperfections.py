"""Imperfect records: what is said of their making holds."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import sympy as sp

from experiments.imperfections.cases import cases, measured, question
from experiments.imperfections.motion import disturbed, stepped, undisturbed
from experiments.imperfections.rows import (
    NOISE,
    ROWS,
    autoregressive,
    band_limited,
    growing,
    student,
    white,
    white_force,
)
from experiments.imperfections.scenes import SCENES
from experiments.studies.question import model_of
from experiments.studies.trajectory import Values
from spiral.physics.trace import trace
from tests.scenes import registry


def brief(name, share=0.2):
    scene = SCENES[name]
    return replace(scene, duration=scene.duration * share)


@pytest.mark.parametrize("name", SCENES)
def test_the_equations_by_hand_are_those_of_the_plugin(name):
    scene = SCENES[name]
    system = registry().make("system", scene.system)
    model = model_of(system, scene.values, ())
    label = next(iter(scene.hidden)).rsplit(".", 1)[0]
    model = model.add(registry().effect_from_label(label), scene.hidden)
    traced = trace(model.system, model.effects)
    rate = sp.lambdify((traced.x, traced.u, traced.p), traced.rate, "numpy")
    p = [model.values[k] for k in traced.keys]
    rng = np.random.default_rng(1)
    values = Values({**scene.values, **scene.hidden})
    for _ in range(10):
        time = rng.uniform(0.0, scene.duration)
        now = {k: float(s(time)) for k, s in scene.excite(rng, scene.duration).items()}
        x = rng.normal(size=len(traced.x))
        seen = SimpleNamespace(time=time, push=np.zeros(scene.axes), **now)
        u = [time if n == "time" else now[n] for n in traced.inputs]
        np.testing.assert_allclose(scene.rate(x, seen, values), rate(x, u, p), rtol=1e-9)


@pytest.mark.parametrize("name", SCENES)
def test_fine_steps_are_the_motion_of_dop853(name):
    scene = brief(name)
    signals = scene.excite(np.random.default_rng(0), scene.duration)
    force = np.zeros(((len(scene.time()) - 1) * 10, scene.axes))
    wanted = undisturbed(scene, scene.values, signals)
    found = stepped(scene, scene.values, signals, force)
    assert np.abs(found - wanted).max() <= 1e-6 * np.abs(wanted).max()


def test_a_random_force_makes_its_share_of_the_motion():
    scene, rng = brief("oscillator", 0.5), np.random.default_rng(2)
    signals = scene.excite(rng, scene.duration)
    plain = undisturbed(scene, scene.values, signals)[:, 0]
    found = disturbed(scene, scene.values, signals, white_force, 0.05, rng)[:, 0]
    assert np.sqrt(np.mean((found - plain) ** 2)) / plain.std() == pytest.approx(0.05, rel=1e-3)


def test_white_noise_moves_a_free_mass_as_theory_says():
    """m = 1 and neither spring nor damper: v is a random walk, its variance t."""
    scene, values = brief("oscillator", 0.01), {"system.mass": 1.0}
    still = {"force": np.zeros_like}
    count, step = (len(scene.time()) - 1) * 10, 1e-3
    final = []
    for k in range(200):
        force = white_force(np.random.default_rng(k), count, step)[:, None]
        final.append(stepped(scene, values, still, force)[-1, 1])
    assert np.var(final) == pytest.approx(scene.time()[-1], rel=0.3)


@pytest.mark.parametrize("noise", [white, band_limited, student, growing])
def test_noise_has_unit_size(noise):
    clean = np.sin(np.arange(60_000) * 0.1)
    found = noise(np.random.default_rng(3), clean)
    assert found.std() == pytest.approx(1.0, rel=0.15 if noise is student else 0.02)


def test_autoregressive_noise_has_its_memory():
    drawn = autoregressive(np.random.default_rng(4), np.zeros(60_000), 0.9)
    assert drawn.std() == pytest.approx(1.0, rel=0.05)
    assert np.mean(drawn[1:] * drawn[:-1]) / np.var(drawn) == pytest.approx(0.9, abs=0.01)


@pytest.mark.parametrize("row", [n for n, r in ROWS.items() if r.push is None])
def test_every_row_gives_a_record_with_its_noise(row):
    scene = brief("oscillator")
    system = registry().make("system", "oscillator")
    record, floor = measured(scene, system, ROWS[row], {}, 0, 0)
    assert np.all(np.isfinite(record.channels["x"]))
    assert 0.5 * NOISE < floor < 2 * NOISE
    assert bool(record.noise) == (ROWS[row].declared is not None)


@pytest.mark.slow
def test_both_machines_are_asked_every_row_twice():
    assert len(cases()) == 2 * len(ROWS) >= 54
    asked = question("rotor", "input_noise_1", 0)
    assert asked.hidden == ("gyroscopic",)
    assert "phase" not in asked.records[0].measured
    assert question("rotor", "white null", 0).hidden == ()
