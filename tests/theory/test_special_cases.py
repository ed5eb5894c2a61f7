"""Effects become their declared special cases in the limits of their shapes."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from spiral.types.effect import ForceEffect
from spiral.types.port import At
from tests.scenes import effect, registry

W = 2 * np.pi  # of the motion q = sin(W t)

LIMITS = {  # effect, special case: shapes and amplitudes near the limit, the special case's own
    ("lag", "linear_stiffness"): ({"stiffness": 3.0, "time_constant": 1e3}, {"stiffness": 3.0}),
    ("lag", "linear_damping"): ({"stiffness": 2e3, "time_constant": 1e-3}, {"damping": 2.0}),
    ("hidden_mode", "linear_stiffness"): (
        {"mass": 3.0e6, "natural_frequency": 1e-3 / W, "damping_ratio": 0.0}, {"stiffness": 3.0},
    ),
    ("bouc_wen", "coulomb_friction"): (
        {"stiffness": 2e5, "length": 1e-5, "asymmetry": 0.0, "exponent": 1.0},
        {"level": 2.0, "width": 1e-3},
    ),
    ("bouc_wen", "linear_stiffness"): (
        {"stiffness": 3.0, "length": 1e4, "asymmetry": 0.0, "exponent": 1.0}, {"stiffness": 3.0},
    ),
    ("jenkins", "coulomb_friction"): (
        {"stiffness": 2e5, "length": 1e-5}, {"level": 2.0, "width": 1e-3},
    ),
    ("jenkins", "linear_stiffness"): ({"stiffness": 3.0, "length": 10.0}, {"stiffness": 3.0}),
    ("iwan", "coulomb_friction"): (
        {"stiffness": 2e5, "length": 1e-5}, {"level": 2.0, "width": 1e-3},
    ),
    ("iwan", "linear_stiffness"): ({"stiffness": 3.0, "length": 10.0}, {"stiffness": 3.0}),
    ("lugre", "bouc_wen"): (
        {"stiffness": 1e3, "damping": 0.0, "length": 0.1, "rise": 0.0, "speed": 1.0},
        {"stiffness": 1e3, "length": 0.1, "asymmetry": 0.0, "exponent": 1.0},
    ),
    ("lugre", "coulomb_friction"): (
        {"stiffness": 2e5, "damping": 0.0, "length": 1e-5, "rise": 0.0, "speed": 1.0},
        {"level": 2.0, "width": 1e-3},
    ),
    ("clearance", "linear_stiffness"): (
        {"stiffness": 3.0, "gap": 0.0, "width": 1e-6}, {"stiffness": 3.0},
    ),
    ("preload", "linear_stiffness"): ({"force": 3e3, "width": 1e3}, {"stiffness": 3.0}),
    ("coulomb_friction", "linear_damping"): ({"level": 2e3, "width": 1e3}, {"damping": 2.0}),
}  # fmt: skip


@pytest.mark.parametrize(
    ("name", "special"), LIMITS, ids=lambda x: x if isinstance(x, str) else None
)
def test_an_effect_becomes_its_special_case(name, special):
    assert special in effect(name).special
    general, simple = (
        _force(effect(n), values)
        for n, values in zip((name, special), LIMITS[name, special], strict=True)
    )
    assert np.linalg.norm(general - simple) < 0.05 * np.linalg.norm(simple)


def test_every_special_case_of_a_force_is_among_them():
    shipped = [e.plugin for e in registry().entries if e.kind == "effect"]
    forces = [p for p in shipped if issubclass(p, ForceEffect)]
    told = {(p.plugin_name(), s) for p in forces for s in p.special}
    # the drop of friction as motion sets in is dry friction where its speed is large
    assert told - set(LIMITS) == {("stribeck_friction", "coulomb_friction")}


def _force(asked, values):
    """Force along q = sin(W t), own states from zero, over two periods after the first."""
    per_axis = {p.name for p in asked.parameters if p.per_axis}
    p = SimpleNamespace(**{k: (v,) if k in per_axis else v for k, v in values.items()})
    names = [s.name for s in asked.states]
    per = {s.name for s in asked.states if s.per_axis}

    def at(t, z):
        own = {n: (x,) if n in per else x for n, x in zip(names, z, strict=True)}
        return At((np.sin(W * t),), (W * np.cos(W * t),), SimpleNamespace(**own))

    def rate(t, z):
        rates = asked.rate(at(t, z), SimpleNamespace(), p)
        return [rates[n][0] if n in per else rates[n] for n in names]

    times = np.linspace(1.002, 3.002, 401)  # no turning point of the motion among them
    motion = np.zeros((0, len(times)))
    if names:
        motion = solve_ivp(
            rate, (0.0, 3.01), np.zeros(len(names)), "Radau", times, rtol=1e-6, atol=1e-9,
            max_step=0.01,
        ).y  # fmt: skip
    return np.array(
        [
            asked.force(at(t, z), SimpleNamespace(), p)[0]
            for t, z in zip(times, motion.T, strict=True)
        ],
        dtype=float,
    )
