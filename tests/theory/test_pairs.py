"""Forces that couple two coordinates which are no plane: where they stand, what work they do."""

import numpy as np
import pytest
import sympy as sp
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline

import spiral
from spiral.physics.trace import trace
from spiral.types.placement import at_every_place
from spiral.types.record import make_record
from tests.scenes import effect, registry

MASS, DAMPING, STIFFNESS, SECOND, COUPLING = 1.0, 0.5, 200.0, 135.0, 0.8
PAIR = "antisymmetric_damping@a-b"


def _rhs(t, x, u, p):
    rate_a = (u.F - p.c * x.va - p.k * x.a) / p.m
    rate_b = (-p.c * x.vb - SECOND * x.b - 20.0 * (x.b - x.a)) / p.m
    return [x.va, x.vb, rate_a, rate_b]


def _system():
    return spiral.system(
        _rhs,
        states={"a": "m", "b": "m", "va": "m/s", "vb": "m/s"},
        inputs={"F": "N"},
        observed=["a", "b"],
        parameters={"m": (1.0, "kg"), "c": (0.45, "N*s/m"), "k": (215.0, "N/m")},
        free=["c", "k"],
    )


def test_pairs_are_of_coordinates_and_not_of_differences():
    names = [port.name for port in _system().ports]
    (pair,) = _system().links
    assert names == ["a", "b", "a_b"]
    assert (pair.name, pair.axes, pair.position_unit, pair.force_unit) == (
        "a-b", ("a", "b"), "m", "N"
    )  # fmt: skip


def test_masses_of_a_chain_are_no_pair():
    """They are on one line, the first and the third as well, whatever stands beside it."""
    chain = spiral.system(
        ["m*a'' = F - k*(a - b)", "m*b'' = -k*(b - a) - k*(b - c)", "m*c'' = -k*(c - b)",
         "m*d'' = -k*d"],
        states=dict.fromkeys("abcd", "m"), inputs={"F": "N"}, observed=["a", "d"],
        parameters={"m": "1 kg", "k": "200 N/m"},
    )  # fmt: skip
    assert [p.name for p in chain.planes] == ["a-d", "b-d", "c-d"]
    offered = [e.port for e in at_every_place(chain, effect("antisymmetric_damping"))]
    assert {"a-d", "b-d", "c-d"} < {*offered}
    assert not {"a-b", "a-c", "b-c"} & {*offered}
    assert chain.port("a-c").axes == ("a", "c")  # by hand it may stand there


def test_coordinates_of_two_units_are_no_pair():
    angle = spiral.system(
        lambda t, x, u, p: [x.v, x.w, -p.k * x.q / p.m, -p.g * x.a / p.J],
        states={"q": "m", "a": "rad", "v": "m/s", "w": "rad/s"},
        observed=["q", "a"],
        parameters={"m": (1, "kg"), "k": (2, "N/m"), "J": (1, "kg*m^2"), "g": (2, "N*m")},
    )
    assert angle.links == ()


def test_a_plane_is_no_pair_and_keeps_its_effects():
    rotor = registry().make("system", "planar_rotor")
    assert rotor.links == ()
    labels = [e.label for e in registry().candidates(rotor, everywhere=True)]
    assert {"antisymmetric_damping", "cross_coupled_stiffness", "rub"} <= {*labels}
    assert not any("-" in x for x in labels if not x.startswith("cross_sensitivity"))


def test_only_what_needs_no_plane_is_offered_to_a_pair():
    labels = [e.label for e in registry().candidates(_system(), everywhere=True)]
    assert {x for x in labels if x.endswith("@a-b")} == {
        PAIR, "cross_coupled_stiffness@a-b", "cross_sensitivity@a-b",
    }  # fmt: skip


@pytest.mark.parametrize("name", ["antisymmetric_damping@a-b", "cross_coupled_stiffness@a-b"])
def test_the_coupling_is_skew(name):
    """Of rates by hand: m a_1 = -c s_2 and m a_2 = +c s_1, s the rates or the positions."""
    traced = trace(_system(), (effect(name),))
    bare = trace(_system(), ())
    amplitude = traced.p[-1]
    states = traced.x[2:4] if name.startswith("anti") else traced.x[:2]
    mass = traced.p[traced.keys.index("system.m")]
    pushed = [(m - n).subs(dict(zip(bare.p, traced.p[:-1], strict=True))) * mass
              for m, n in zip(traced.rate[2:4], bare.rate[2:4], strict=True)]  # fmt: skip
    expected = (-amplitude * states[1], amplitude * states[0])
    assert [sp.simplify(p - e) for p, e in zip(pushed, expected, strict=True)] == [0, 0]


def _record(name, seed, samples):
    """By DOP853 from equations of their own: a Coriolis force between two coordinates."""
    rng, dt = np.random.default_rng(seed), 0.01
    spectrum = rng.normal(size=(2, samples // 2 + 1)).T @ [1, 1j]
    spectrum[np.fft.rfftfreq(samples, dt) > 6.0] = 0.0
    force = np.fft.irfft(spectrum, samples)
    force *= 3.0 / force.std()
    time = np.arange(samples) * dt
    push = CubicSpline(time, force)

    def rate(t, x):
        a, b, va, vb = x
        return [
            va, vb,
            (push(t) - DAMPING * va - STIFFNESS * a + COUPLING * vb) / MASS,
            (-DAMPING * vb - SECOND * b - COUPLING * va - 20.0 * (b - a)) / MASS,
        ]  # fmt: skip

    y = solve_ivp(rate, (0, time[-1]), [0] * 4, "DOP853", time, rtol=1e-9, atol=1e-12).y
    seen = {
        k: v + 0.01 * v.std() * rng.normal(size=samples) for k, v in zip("ab", y[:2], strict=True)
    }
    return make_record(_system(), name, time, seen, {"F": force})


@pytest.mark.slow
def test_a_coriolis_force_between_two_masses_is_named_first_and_alone():
    run = spiral.discover(_record("record", 1, 2000), _system(), test=_record("test", 2, 800))
    assert run.missing == (PAIR,)
    found = run.model.estimates()[PAIR]["damping"]
    assert abs(found.estimate + COUPLING) < 3 * found.se
    assert found.se < 0.01 * COUPLING
