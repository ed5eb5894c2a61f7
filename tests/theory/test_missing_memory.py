"""Whether a missing force has memory: told where it has, and only there."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from experiments.memory.bench import SAYS, asked
from spiral.physics.memory_forces import _KNOTS, PresentForce, RememberedForce, _spline_terms
from spiral.types.port import At
from tests.marks import others_slow

CANDIDATES = ["cubic_stiffness", "quadratic_damping"]


@pytest.mark.parametrize("kind", others_slow(["bouc_wen", "stribeck"], 1))
def test_hysteresis_is_told_and_a_curve_is_not(kind):
    """Bouc-Wen of exponent two against friction that falls with speed: neither is a candidate."""
    run = asked(kind, 0.02, 11, CANDIDATES)
    told = run.memory is not None
    assert told == (kind == "bouc_wen")
    assert (SAYS in run.summary) == told
    if told:
        assert (run.verdict, run.missing) == ("unknown_structure", ())
        assert (run.memory["port"], run.memory["kind"]) == ("mass", "yields")
        (loop,) = run.memory["loops"]
        assert len(loop["position"]) == len(loop["force"]) > 20
        assert run.as_dict()["memory"] == run.memory


@pytest.mark.slow
def test_a_spring_that_hardens_is_named_beside_hysteresis():
    """Its cubic force is there whatever the memory; k3 = 400 N/m / (0.016 m)^2 = 1.56e6 N/m^3."""
    run = asked("hardening", 0.01, 2, CANDIDATES)
    assert run.memory is not None
    assert "cubic_stiffness" in run.missing
    assert "cubic_stiffness" not in run.memory["stand_ins"]


def _driven(speed):
    """States of the force with memory over ten cycles of one path, run through at some speed."""
    effect, p = RememberedForce(), SimpleNamespace(middle=0.0, reach=1.0, drift=0.0, pace=1.0)
    names = [s.name for s in effect.states]
    steps = 4_000
    dt, z, path = 10 * 2 * np.pi / speed / steps, dict.fromkeys(names, 0.0), []
    for k in range(steps):
        q, v = np.sin(speed * k * dt), speed * np.cos(speed * k * dt)
        own = SimpleNamespace(**{n: (z[n],) for n in names})
        rates = effect.rate(At((q,), (v,), own), SimpleNamespace(), p)
        z = {n: z[n] + dt * rates[n][0] for n in names}
        path.append(list(z.values()))
    return dict(zip(names, np.array(path).T, strict=True))


def test_what_yields_does_so_at_every_speed_and_what_relaxes_does_not():
    slow, fast = _driven(0.2), _driven(5.0)
    for name, states in slow.items():
        off = np.abs(states - fast[name]).max() / np.abs(states).max()
        assert (off < 1e-9) == name.startswith("yielding")


def test_the_curves_of_a_force_without_memory_are_natural_splines():
    """Bends with 1 and z span SciPy's natural splines, straight outside the knots."""
    z = np.linspace(-4.0, 4.0, 201)
    heights = np.random.default_rng(0).normal(size=len(_KNOTS))
    spline = CubicSpline(_KNOTS, heights, bc_type="natural")
    inside = np.clip(z, _KNOTS[0], _KNOTS[-1])
    wanted = spline(inside) + spline(inside, 1) * (z - inside)
    columns = np.stack([np.ones_like(z), z, *_spline_terms(z)], axis=1)
    found = columns @ np.linalg.lstsq(columns, wanted, rcond=None)[0]
    np.testing.assert_allclose(found, wanted, atol=1e-9)


def test_a_force_without_memory_is_the_sum_of_its_terms():
    effect, rng = PresentForce(), np.random.default_rng(1)
    at = At(tuple(rng.normal(size=(2, 5))), tuple(rng.normal(size=(2, 5))), SimpleNamespace())
    shapes = {"middle": 0.1, "reach": 2.0, "drift": 0.2, "pace": 3.0, "record": 10.0}
    u = SimpleNamespace(time=np.linspace(0.0, 10.0, 5))
    names = [q.name for q in effect.amplitudes()]
    terms = effect.terms(at, u, SimpleNamespace(**shapes))
    for j, name in enumerate(names):
        unit = {n: (float(n == name),) * 2 for n in names}
        force = effect.force(at, u, SimpleNamespace(**shapes, **unit))
        np.testing.assert_allclose(force, [axis[j] for axis in terms])
