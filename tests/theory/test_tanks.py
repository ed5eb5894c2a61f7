"""Cascaded tanks: equilibrium by Torricelli, and what an overflow does to it."""

import numpy as np
import pytest
from spiral_plugins.systems.cascaded_tanks import CascadedTanks

from spiral.errors import ConfigError
from spiral.latent import with_latent
from spiral.model import seed_model
from spiral.simulate import integrate
from spiral.trace import check_effect
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
    """K u = k1 sqrt(x1) + spilled (x1 - r) above the rim; what is caught raises the lower tank."""
    values = {"overflow.spilled": 0.5, "overflow.caught": 0.2, "overflow.rim": 4.0}
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
    from spiral.registry import load_registry

    registry = load_registry(local=False)
    with pytest.raises(ConfigError, match="a flow"):
        check_effect(CascadedTanks(), effect("cubic_stiffness"))
    with pytest.raises(ConfigError, match="upper"):
        check_effect(registry.make("system", "oscillator"), effect("overflow"))
    found = {e.label for e in registry.candidates(CascadedTanks())}
    flows = {"linear_loss", "outlets", "overflow", "pump", "sensor_saturation"}
    assert found == flows | {"offset", "gain", "delay", "mains_hum"}


def test_a_system_without_forces_has_no_missing_force():
    model = seed_model(CascadedTanks())
    assert with_latent(model) is model
