"""Places at the springs and dampers of equations, whatever coordinates they join."""

from types import SimpleNamespace

import pytest
import sympy as sp
from spiral_plugins.effects.restoring import LinearStiffness

import spiral
from spiral.physics.trace import trace

RACK = {
    "equations": ["J*phi'' = T - d*phi' - r*k*(r*phi - x) - r*c*(r*phi' - x')",
                  "m*x'' = k*(r*phi - x) + c*(r*phi' - x') - m*g*sin(x/l)"],
    "states": {"phi": "rad", "x": "m"},
    "inputs": {"T": "N*m"},
    "parameters": {"J": "0.1 kg*m^2", "d": "0.1 N*m*s/rad", "r": "0.05 m", "k": "1000 N/m",
                   "c": "3 N*s/m", "m": "2 kg", "g": "9.81 m/s^2", "l": "1 m"},
    "free": ["k"],
    "observed": ["x"],
}  # fmt: skip


def test_springs_between_coordinates_of_any_kind_are_places_of_their_own():
    """k (r phi - x) and its damper stand at one place; d, and a weight, at none of their own."""
    system = spiral.system(RACK)
    assert [p.name for p in system.ports] == ["phi", "x", "phi_x"]
    port = system.port("phi_x")
    assert (port.position_unit, port.force_unit) == ("m", "N")
    q, p = SimpleNamespace(phi=2.0, x=0.3), SimpleNamespace(r=0.05)
    assert abs(port.coordinates(q, p)[0]) == pytest.approx(0.2)


def test_an_effect_at_a_spring_acts_as_the_spring_does():
    """What the spring's own law does with another stiffness, a linear spring at its place does."""
    system = spiral.system(RACK)
    traced = trace(system, (LinearStiffness(port="phi_x"),))
    at = dict(zip(traced.p, (0.1, 0.1, 0.05, 1000.0, 3.0, 2.0, 9.81, 1.0, 70.0), strict=True))
    stiffer = at | {traced.p[3]: 1070.0, traced.p[-1]: 0.0}
    for with_it, own in zip(traced.rate, traced.rate, strict=True):
        assert sp.simplify(with_it.subs(at) - own.subs(stiffer)) == pytest.approx(0, abs=1e-9)


@pytest.mark.parametrize(("equation", "joined"), [
    ("k*(b - a)", []),  # a place between the two is there in any case
    ("k*(a + b)", ["a_b"]),
    ("k*(2*b - a)", ["a_b"]),
    ("k*(b - a)^3", []),
    ("k*(b - a - u)", []),
])  # fmt: skip
def test_places_at_elements_are_linear_in_coordinates_and_new(equation, joined):
    opposite = equation.replace("k*", "-k*", 1)
    share = "2*" if "2*b" in equation else ""
    sign = "-" if "a + b" in equation else ""
    given = {
        "equations": [f"m*a'' = F + {sign}{equation} - h*a", f"m*b'' = {share}({opposite})"],
        "states": {"a": "m", "b": "m"}, "inputs": {"F": "N", "u": "m"},
        "parameters": {"m": "1 kg", "h": "1 N/m",
                       "k": "1 N/m^3" if "^3" in equation else "1 N/m"},
        "observed": ["a"],
    }  # fmt: skip
    names = [p.name for p in spiral.system(given).ports]
    plain = ["a", "b", "a_b"]
    assert names == (plain if not joined else [*plain, "k"])


def test_two_springs_on_the_same_coordinates_are_two_places():
    """A deck on a spring at each end: y - a phi, and y + b phi."""
    deck = spiral.system(
        ["m*y'' + k1*(y - a*phi) + k2*(y + b*phi) = F",
         "J*phi'' - a*k1*(y - a*phi) + b*k2*(y + b*phi) = 0"],
        states={"y": "m", "phi": "rad"}, inputs={"F": "N"}, observed=["y", "phi"],
        parameters={"m": "1800 kg", "J": "2430 kg*m^2", "a": "1.4 m", "b": "1.1 m",
                    "k1": "235e3 N/m", "k2": "222e3 N/m"},
    )  # fmt: skip
    assert [p.name for p in deck.ports] == ["y", "phi", "y_phi", "k2"]
    at = SimpleNamespace(y=0.5, phi=0.1), SimpleNamespace(a=1.4, b=1.1)
    ends = [deck.port(name).coordinates(*at)[0] for name in ("y_phi", "k2")]
    assert sorted(map(abs, ends)) == pytest.approx([0.36, 0.61])
