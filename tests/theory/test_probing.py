"""What equations depend on, seen from their values: places of effects, readings that may jump."""

import numpy as np
from numpy.testing import assert_allclose
from spiral_plugins.effects.losses import AsymmetricLoss, QuadraticLoss
from spiral_plugins.systems.oscillator import Oscillator

import spiral
from spiral.physics.trace import trace
from spiral.types.probing import balanced_states, follows_input, readings_with_rates
from spiral.types.record import make_record


def muscle(rate="r*(u - a)"):
    """A joint moved by a muscle whose activation, of no unit, follows a stimulus."""
    return spiral.system(
        ["J*q'' + c*q' + k*q = F*a", f"a' = {rate}"], states={"q": "rad", "a": "1"},
        inputs={"u": "1", "w": "1"},
        parameters={"J": "0.02 kg*m^2", "c": "0.1 N*m*s/rad", "k": "5 N*m/rad", "F": "4 N*m",
                    "r": "16 1/s"},
        observed=["q"],
    )  # fmt: skip


def cell():
    """Its voltage has the current in it, its heat flow none; an acceleration has forces in it."""
    return spiral.system(
        ["C*v' = i - v/R"], states={"v": "V"}, inputs={"i": "A"},
        parameters={"C": "2 F", "R": "3 ohm", "S": "0.5 ohm"},
        observed=["U = -v - S*i", "leak = v/R", "charging = C*v'"],
    )  # fmt: skip


def test_a_state_without_a_unit_follows_an_input_by_their_difference():
    system = muscle()
    assert follows_input(system, "a", "u")
    assert not follows_input(system, "a", "w")
    assert [p.name for p in system.filled] == ["state a", "state a-u"]
    assert system.place(AsymmetricLoss(port="a-u")).against == "u"
    other = muscle("r*(u - a) - r*a**3")
    assert not follows_input(other, "a", "u")
    assert [p.name for p in other.filled] == ["state a"]


def surge_tank(level="(Q - q)/A"):
    """A tunnel's flow Q and the turbines' q, which a tank at the end of the tunnel balances."""
    return spiral.system(
        ["I*Q' = -z - R*Q", f"z' = {level}", "T*q' = u - q"],
        states={"Q": "m^3/s", "z": "m", "q": "m^3/s"}, inputs={"u": "m^3/s"},
        parameters={"I": "34 s^2/m^2", "R": "0.1 s/m^2", "A": "58 m^2", "T": "12 s"},
        observed=["z"],
    )  # fmt: skip


def test_flows_that_a_tank_balances_have_places_against_each_other():
    """What throttles the tank's mouth follows their difference, and acts on either."""
    assert balanced_states(surge_tank(), ("Q", "z", "q")) == {frozenset("Qq")}
    names = [p.name for p in surge_tank().filled]
    assert names == ["state Q", "state z", "state q", "state Q-u", "state q-u", "state Q-q",
                     "state q-Q", "states Q-q"]  # fmt: skip
    other = surge_tank("Q/A - 2*q/A")
    assert not balanced_states(other, ("Q", "z", "q"))
    assert "state Q-q" not in [p.name for p in other.filled]


def test_a_loss_at_such_a_place_follows_the_difference():
    system, loss = surge_tank(), QuadraticLoss(port="Q-q")
    traced = trace(system, (loss,))
    named = {"Q": 3.0, "z": -0.5, "q": 1.2, "u": 2.0, "system.I": 34.0, "system.R": 0.1,
             "system.A": 58.0, "system.T": 12.0, "quadratic_loss@Q-q.rate": 0.02}  # fmt: skip
    symbols = zip((*traced.states, *traced.inputs, *traced.keys), (*traced.x, *traced.u, *traced.p),
                  strict=True)  # fmt: skip
    values = {symbol: named.get(name, 0.0) for name, symbol in symbols}
    rates = [float(rate.subs(values)) for rate in traced.rate]
    assert_allclose(rates, [(0.5 - 0.3) / 34 - 0.02 * 1.8**2, 1.8 / 58, 0.8 / 12], rtol=1e-12)


def test_readings_that_change_with_rates_are_those_that_may_jump():
    assert readings_with_rates(cell()) == {"charging"}
    assert readings_with_rates(Oscillator()) == set()


def test_what_cannot_be_evaluated_may_jump():
    class Strange(Oscillator):
        """An oscillator with a reading that wants more than numbers."""

        @property
        def readings(self):
            return self.states[:1]

        def reading(self, x, rates, u, p):
            raise TypeError("not of numbers")

    assert readings_with_rates(Strange()) == {Strange().states[0].name}


def test_spikes_of_a_voltage_are_left_out_where_its_current_jumps():
    """Not at the jumps themselves."""
    rng = np.random.default_rng(3)
    current = np.repeat(rng.normal(size=60), 25)
    lag = np.exp(-0.02 / 6.0)
    v = np.zeros(len(current))
    for k in range(len(v) - 1):
        v[k + 1] = lag * v[k] + 3 * (1 - lag) * current[k]
    read = -v - 0.5 * current + 2e-3 * rng.normal(size=len(v))
    spikes = rng.choice(np.arange(10, len(v) - 10), 8, replace=False)
    read[spikes] += rng.choice([-1, 1], 8) * 0.3
    given = {"U": read, "leak": v / 3 + 1e-3 * rng.normal(size=len(v)),
             "charging": current - v / 3 + 1e-3 * rng.normal(size=len(v))}  # fmt: skip
    record = make_record(cell(), "r", 0.02 * np.arange(len(v)), given, {"i": current})
    (one,) = record.spoilt["U"]
    assert one.kind == "spike"
    found = np.flatnonzero(one.where)
    assert len({*found} & {*spikes}) >= 6
    assert len({*found} - {*spikes}) <= 1
