"""Cascaded tanks: equilibrium by Torricelli, and what an overflow does to it."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from spiral_plugins.systems.cascaded_tanks import CascadedTanks

from spiral.engine.windows import fair_block, halves
from spiral.inference.evidence.admission import admit_candidate, drop_effects
from spiral.inference.evidence.comparison import prepare_study
from spiral.inference.evidence.fit_state import all_samples, fit_growing_windows
from spiral.inference.evidence.refit_scores import rescore_from_far_starts
from spiral.inference.evidence.scoring import score_stage
from spiral.inference.problem import Problem
from spiral.inference.simulate import integrate, simulate
from spiral.inference.where.latent import add_latent_force
from spiral.types.errors import ConfigError
from spiral.types.model import seed_model
from spiral.types.placement import check_effect
from tests.scenes import effect

GAIN, UPPER, LOWER, PUMP = 0.05, 0.06, 0.055, 3.0
VALUES = {"pump.gain": GAIN, "outlets.upper": UPPER, "outlets.lower": LOWER, "outlets.width": 1e-3}
TIME = 4.0 * np.arange(2000)


def settled(*effects, **values):
    model = seed_model(CascadedTanks(), effects, values={**VALUES, **values})
    inputs = {"pump": np.full(len(TIME), PUMP)}
    states, readings = integrate(model, TIME, inputs, {"upper": 1.0, "lower": 1.0})
    return states[-1], readings[-1]


def test_levels_settle_where_outflow_is_inflow():
    """K u = k1 sqrt(x1) = k2 sqrt(x2)."""
    (upper, lower), reading = settled()
    assert UPPER * np.sqrt(upper) == pytest.approx(GAIN * PUMP, rel=1e-6)
    assert LOWER * np.sqrt(lower) == pytest.approx(GAIN * PUMP, rel=1e-6)
    assert reading[0] == lower


def test_an_overflow_takes_what_the_outlet_does_not():
    """K u = k1 sqrt(x1) + (lost + caught) (x1 - r) above the rim; what is caught falls below."""
    values = {"overflow.lost": 0.3, "overflow.caught": 0.2, "overflow.rim": 4.0}
    (upper, lower), _ = settled(effect("overflow"), **values)
    spilled = 0.5 * (upper - 4.0)
    assert spilled > 0
    assert UPPER * np.sqrt(upper) + spilled == pytest.approx(GAIN * PUMP, rel=1e-6)
    into = UPPER * np.sqrt(upper) + 0.4 * spilled
    assert LOWER * np.sqrt(lower) == pytest.approx(into, rel=1e-6)


def test_a_saturated_sensor_changes_the_reading_and_not_the_level():
    values = {"sensor_saturation.share": 1.0, "sensor_saturation.limit": 5.0}
    free, _ = settled()
    states, reading = settled(effect("sensor_saturation"), **values)
    np.testing.assert_array_equal(states, free)
    assert reading[0] == pytest.approx(5.0)


def test_a_force_is_no_effect_of_tanks_and_a_flow_none_of_a_mechanical_system():
    from spiral.io.registry import load_registry

    registry = load_registry(local=False)
    with pytest.raises(ConfigError, match="a flow"):
        check_effect(CascadedTanks(), effect("cubic_stiffness"))
    with pytest.raises(ConfigError, match="upper"):
        check_effect(registry.make("system", "oscillator"), effect("overflow"))
    found = {e.label for e in registry.candidates(CascadedTanks())}
    flows = {"outlets", "overflow", "pump", "sensor_saturation"}
    assert found == flows | {"offset", "gain", "delay", "sensor_lag", "mains_hum"}
    everywhere = {e.label for e in registry.candidates(CascadedTanks(), everywhere=True)}
    assert found | {"linear_loss@upper", "linear_loss@lower"} < everywhere


def test_a_system_without_forces_has_no_missing_force():
    model = seed_model(CascadedTanks())
    assert add_latent_force(model) is model


def test_blocks_are_shortened_until_both_halves_saw_the_same_motion():
    """A slow wave of period 2 blocks is seen by one half alone; a fast one by both."""
    samples = np.arange(4096)
    fast, slow = np.sin(2 * np.pi * samples / 37), np.sin(2 * np.pi * samples / 512)
    assert fair_block(fast[:, None], 256) == 256
    assert fair_block(np.sign(slow)[:, None] + 1e-3 * fast[:, None], 256) < 256
    fair = fair_block(slow[:, None], 256)
    even, odd = halves(len(samples), fair)
    top = np.argsort(slow)[-1024:]
    assert even[top].mean() == pytest.approx(0.5, abs=0.05)
    assert odd[top].mean() == pytest.approx(0.5, abs=0.05)


def _spilling(noise=0.02):
    """A pump in steps that lets the upper tank run over, and the model that knows no rim."""
    values = {"overflow.lost": 0.4, "overflow.caught": 0.4, "overflow.rim": 6.0}
    model = seed_model(CascadedTanks(), (effect("overflow"),), values={**VALUES, **values})
    rng = np.random.default_rng(3)
    steps = np.repeat(rng.uniform(0.5, 4.0, 32), 32)
    time = 4.0 * np.arange(len(steps))
    start = {"upper": 4.0, "lower": 4.0}
    record = simulate(model, time, {"pump": steps}, noise, rng, start=start, substeps=4)
    seed = seed_model(CascadedTanks(), values={"outlets.width": 1e-3})
    return Problem(seed, (record,), (), candidates=(effect("overflow"),))


@pytest.mark.slow
def test_a_rim_is_found_from_afar_where_a_step_from_zero_does_not_see_it():
    """The refit from a tenth of the bounds reaches the noise; the rim lies where it was put."""
    assembly, fit_state = prepare_study(_spilling())
    *_, stage = fit_growing_windows(assembly, fit_state, all_samples(assembly))
    evidence = rescore_from_far_starts(assembly, fit_state, score_stage(assembly, fit_state, stage))
    found = admit_candidate(assembly, fit_state, stage, evidence.ranked[0])
    assert found.fit_state.shortest == stage.length == 1024
    assert found.stage.fitted.chi2_per_dof == pytest.approx(1.0, abs=0.15)
    rim = found.fit_state.values[0, assembly.study.index(f"{found.variant.label}.rim")]
    assert rim == pytest.approx(6.0, rel=0.02)


def test_an_effect_that_is_let_go_no_longer_acts():
    assembly, fit_state = prepare_study(_spilling())
    *_, stage = fit_growing_windows(assembly, fit_state, all_samples(assembly))
    evidence = score_stage(assembly, fit_state, stage)
    found = admit_candidate(assembly, fit_state, stage, evidence.ranked[0])
    label = found.variant.label
    left = drop_effects(assembly, found.fit_state, (label,))
    assert label not in left.labels
    lost, caught = (assembly.study.index(f"{label}.{k}") for k in ("lost", "caught"))
    assert found.fit_state.values[0, lost] > 0
    assert left.values[0, lost] == left.values[0, caught] == 0


def test_a_pump_that_jumps_fills_by_the_value_it_held():
    """Against an adaptive integration interval by interval, for a pump drawn anew every 4 s."""
    time, held = 4.0 * np.arange(100), 3.0 + np.random.default_rng(0).normal(size=100)
    model = seed_model(CascadedTanks(), values=VALUES)
    record = simulate(model, time, {"pump": held}, 0.0)
    states = np.array([[0.0, 0.0]])

    def rate(_, x, pump):
        out = np.sqrt(np.abs(x)) * (UPPER, LOWER)
        return [GAIN * pump - out[0], out[0] - out[1]]

    for pump in held[:-1]:
        found = solve_ivp(rate, (0, 4), np.maximum(states[-1], 0), args=(pump,), rtol=1e-9)
        states = np.vstack([states, found.y[:, -1]])
    assert record.truth["lower"] == pytest.approx(states[:, 1], abs=3e-4 * states[:, 1].std())
