"""Models at rest: asked at the values that were given, and where their states begin."""

import pytest

import spiral
from spiral.io.testing import check_system, failed
from spiral.physics import rest
from spiral.physics.compile import compile_model
from spiral.physics.rest import check_rest
from spiral.physics.trace import trace
from tests.scenes import effect


def _require_finite_rest(system):
    check_rest(compile_model(trace(system, ())), system, ())


def test_a_coupled_mass_matrix_is_asked_at_its_own_values():
    """I at - a^2 is no zero, though it is where all are one."""

    def roll(t, x, u, p):
        ship, tank = u.K - p.C * x.f - p.c * x.s, -p.c * (x.s + x.f)
        det = p.I * p.at - p.a * p.a
        return [x.df, x.ds, (p.at * ship - p.a * tank) / det, (p.I * tank - p.a * ship) / det]

    coupled = spiral.system(
        roll,
        states={"f": "rad", "s": "rad", "df": "rad/s", "ds": "rad/s"},
        inputs={"K": "N*m"},
        observed=["f"],
        parameters={
            "I": (25.0, "kg*m**2/rad"),
            "at": (3.0, "kg*m**2/rad"),
            "a": (1.2, "kg*m**2/rad"),
            "C": (12.0, "N*m/rad"),
            "c": (1.6, "N*m/rad"),
        },
        free=["I", "at", "a"],
    )
    _require_finite_rest(coupled)
    assert not failed(check_system(coupled))


def _chemostat(**biomass):
    return spiral.system(
        ["X' = mu*X - D*X", "F' = f/X - D*F"],
        states={"X": {"unit": "g/L"} | biomass, "F": "1"},
        inputs={"D": "1/s"},
        parameters={"mu": (0.3, "1/s"), "f": (0.1, "g/L/s")},
        observed=["X"],
    )


def test_a_state_that_begins_elsewhere_is_asked_there():
    began = _chemostat(start=0.5)
    _require_finite_rest(began)
    assert not failed(check_system(began))
    one, *_ = failed(check_system(_chemostat()))
    assert one.name == "finite at rest"
    assert "start" in one.try_
    assert "FAILS" in str(one)


def test_a_reaction_is_asked_at_its_temperature():
    """Arrhenius: 1 / T of a temperature that is measured and declared to begin at 340 K."""
    reactor = spiral.system(
        {"equations": ["C' = D*(C0 - C) - rate", "T' = D*(T0 - T) + h*rate"],
         "let": {"rate": "k*exp(-E*(1/T - 1/T0))*C"}},
        states={"C": {"unit": "mol/L", "start": 0.9}, "T": {"unit": "K", "start": 340}},
        inputs={"D": "1/s"}, observed=["T"],
        parameters={"k": (1e-3, "1/s"), "E": (7600.0, "K"), "T0": (340.0, "K"),
                    "C0": (1.5, "mol/L"), "h": (20.0, "K*L/mol")},
    )  # fmt: skip
    assert not failed(check_system(reactor))
    _require_finite_rest(reactor)


def test_each_state_that_is_declared_to_begin_moves_by_a_share_of_its_own_size():
    """A flow of 0.4 kg/s beside a pressure of 6000 Pa: one common step bends the flow's cubic."""
    compressor = spiral.system(
        ["m' = A*(p0 + H*(1.5*m/W - 0.5*(m/W - 1)**3 - 0.5) - dp)",
         "dp' = B*(m - k*valve*sqrt(maximum(dp, least)))"],
        states={"m": {"unit": "kg/s", "start": 0.4}, "dp": {"unit": "Pa", "start": 6000}},
        inputs={"valve": "1"}, observed=["m", "dp"],
        parameters={"A": (0.01, "m"), "B": (2.12e6, "1/m/s^2"), "p0": (3000, "Pa"),
                    "H": (2630, "Pa"), "W": (0.144, "kg/s"), "k": (0.0102, "kg/s/Pa^0.5"),
                    "least": (1.0, "Pa")},
    )  # fmt: skip
    assert not failed(check_system(compressor))


@pytest.mark.parametrize("law", ["k0*exp(-E/T)*c", "k0*T^2*exp(-E/T)*c"])
def test_candidates_are_asked_at_rest_once(law, monkeypatch):
    """A slope that is no number at zero is the system's own: not asked of each candidate again."""
    system = spiral.system(
        [f"c' = D*(cf - c) - {law}", f"T' = D*(Tf - T) + h*{law}"],
        states={"c": {"unit": "mol/m^3", "start": 500.0}, "T": {"unit": "K", "start": 330.0}},
        inputs={"cf": "mol/m^3"}, observed=["T"],
        parameters={"D": (1e-3, "1/s"), "Tf": (318.0, "K"), "h": (0.02, "K*m^3/mol"),
                    "k0": (1e3, "1/s/K^2" if "T^2" in law else "1/s"), "E": (6000.0, "K")},
    )  # fmt: skip
    effects = tuple(effect(n, port="T") for n in ("linear_loss", "cubic_loss", "root_loss"))
    compiled = compile_model(trace(system, effects))
    check_rest(compiled, system, (), effects)
    asked, evaluate = [], rest._evaluate_traced
    monkeypatch.setattr(rest, "_evaluate_traced", lambda *a: asked.append(a) or evaluate(*a))
    check_rest(compiled, system, (), effects)
    assert len(asked) <= 1  # the system alone
