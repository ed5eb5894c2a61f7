"""Slopes of the rates by what is injected: M^-1 by numbers is the formula's."""

from __future__ import annotations

import numpy as np
import pytest

from spiral.io.registry import load_registry
from spiral.physics.signatures import SystemMotion, _injection_gain_along, injection_slopes
from spiral.physics.trace import trace

REGISTRY = load_registry(None)


@pytest.mark.parametrize("name", ["oscillator", "pendulum", "tilting_rotor", "robot", "structure"])
def test_the_numbers_are_those_of_the_formula(name):
    system, rng = REGISTRY.make("system", name), np.random.default_rng(0)
    traced, count = trace(system, ()), 3
    x, u = rng.normal(size=(count, len(traced.x))), rng.normal(size=(count, len(traced.u)))
    values = {p.name: 0.5 + rng.random() for p in system.parameters}
    seen = np.zeros((count, len(system.observed)))
    gain = _injection_gain_along(SystemMotion(system, x, u, 0 * x, seen, values))
    for k in range(count):
        at = dict(zip([*traced.x, *traced.u], [*x[k], *u[k]], strict=True))
        at |= dict(zip(traced.p, [values[p.name] for p in system.parameters], strict=True))
        expected = np.array(injection_slopes(system).subs(at), dtype=float)
        np.testing.assert_allclose(gain[k], expected, rtol=1e-9, atol=1e-12 * abs(expected).max())
