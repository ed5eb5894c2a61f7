"""What drives a machine where its model has no path: inputs, states, and readings of others."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import spiral
from spiral.io.problem_setup import candidates_for
from spiral.io.registry import load_registry
from spiral.types.errors import ConfigError
from spiral.types.model import seed_model
from spiral.types.port import place_name
from spiral.types.record import make_record

REGISTRY = load_registry()
DT, COUNT = 0.01, 1500
L, R, K, J, B, EMF = 0.05, 1.2, 0.3, 0.02, 0.01, 0.25
SUN, WIRED = 0.004, 0.6


def motor():
    """A motor in volts and a fan's torque; its builder forgot what turning induces."""

    def rhs(t, x, u, p):
        return [(u.V - p.R * x.i) / p.L, (p.K * x.i - p.B * x.w - u.load) / p.J]

    return spiral.system(
        rhs, states={"i": "A", "w": "rad/s"}, inputs={"V": "V", "load": "N*m"},
        parameters={"L": (0.045, "H"), "R": (1.4, "ohm"), "K": (0.3, "N*m/A"),
                    "J": (0.023, "kg*m^2"), "B": (0.012, "N*m*s/rad")},
        observed=["i", "w"], free=["L", "R", "J", "B"],
    )  # fmt: skip


def turned(emf=0.0, crosstalk=0.0, seed=0):
    """A record of the motor, by SciPy; both inputs held between samples."""
    rng, time = np.random.default_rng(seed), DT * np.arange(COUNT)
    volts = np.repeat(rng.uniform(-12, 12, COUNT // 10), 10)
    load = np.repeat(rng.uniform(-0.5, 0.5, COUNT // 25), 25)
    states = [np.zeros(2)]
    for v, m in zip(volts[:-1], load[:-1], strict=True):

        def rate(t, x, v=v, m=m):
            induced = emf * x[1] + crosstalk * m
            return [(v - R * x[0] - induced) / L, (K * x[0] - B * x[1] - m) / J]

        states.append(solve_ivp(rate, (0, DT), states[-1], rtol=1e-9, atol=1e-9).y[:, -1])
    clean = np.array(states)
    noisy = clean + 0.01 * clean.std(axis=0) * rng.normal(size=clean.shape)
    channels = {"i": noisy[:, 0], "w": noisy[:, 1]}
    return make_record(
        motor(), "motor", time, channels, {"V": volts, "load": load}, hold="zero_order"
    )


def body(free=("C", "G")):
    """A warm body in a room, read by a thermometer; it is 8000 J/K and 13 W/K."""

    def rhs(t, x, u, p):
        return [(u.heater - p.G * (x.T - u.room)) / p.C]

    return spiral.system(
        rhs, states={"T": "K"}, inputs={"heater": "W", "room": "K", "sun": "W/m^2"},
        parameters={"C": (9000.0, "J/K"), "G": (12.0, "W/K")}, observed=["T"], free=free,
    )  # fmt: skip


def warmed(sunlit, seed=0):
    """A record of the body's thermometer, which the sun warms beside what it should read."""
    rng, step, count = np.random.default_rng(seed), 20.0, 800
    time = step * np.arange(count)
    heater = np.repeat(rng.uniform(0, 400, count // 20), 20)
    sun = 300 + 300 * np.convolve(rng.normal(size=count), np.ones(15) / 4, "same").clip(-1, 1)
    room = 293 + 2 * np.sin(time / 3000)
    states = [np.array([295.0])]
    for k in range(count - 1):

        def rate(t, x, k=k):
            return [(heater[k] - 13.0 * (x[0] - room[k])) / 8000.0]

        states.append(solve_ivp(rate, (0, step), states[-1], rtol=1e-9, atol=1e-9).y[:, -1])
    read = np.array(states)[:, 0] + sunlit * sun + 0.05 * rng.normal(size=count)
    inputs = {"heater": heater, "room": room, "sun": sun}
    return make_record(body(), "body", time, {"T": read}, inputs, hold="zero_order")


def coil():
    """A coil in volts and its temperature; its builder forgot that current and light warm it."""

    def rhs(t, x, u, p):
        return [(u.V - p.R * x.i) / p.L, -p.G * (x.T - p.room) / p.C]

    return spiral.system(
        rhs, states={"i": "A", "T": "K"}, inputs={"V": "V", "E": "V/m"},
        parameters={"L": (4.5, "H"), "R": (1.3, "ohm"), "G": (0.9, "W/K"),
                    "C": (30.0, "J/K"), "room": (293.0, "K")},
        observed=["i", "T"], free=["L", "R", "G"],
    )  # fmt: skip


def heated(current=0.0, field=0.0, seed=0):
    """A record of the coil, warmed by the squares of its current and of a field E."""
    rng, step, count = np.random.default_rng(seed), 0.5, 1200
    volts = np.repeat(rng.uniform(-9, 9, count // 20), 20)
    strength = np.repeat(rng.uniform(-2, 2, count // 30), 30)
    states = [np.array([0.0, 293.0])]
    for v, e in zip(volts[:-1], strength[:-1], strict=True):

        def rate(t, x, v=v, e=e):
            heat = current * x[0] ** 2 + field * e**2
            return [(v - 1.2 * x[0]) / 5.0, (heat - 0.8 * (x[1] - 293.0)) / 30.0]

        states.append(solve_ivp(rate, (0, step), states[-1], rtol=1e-9, atol=1e-9).y[:, -1])
    clean = np.array(states)
    noisy = clean + rng.normal(size=clean.shape) * [0.03, 0.2]
    channels = {"i": noisy[:, 0], "T": noisy[:, 1]}
    return make_record(
        coil(), "coil", step * np.arange(count), channels, {"V": volts, "E": strength},
        hold="zero_order",
    )  # fmt: skip


def test_drivers_are_those_that_the_equations_give_no_path():
    assert [place_name(p) for p in motor().by_driver["input"]] == ["i-load", "w-V"]
    assert [place_name(p) for p in motor().by_driver["state"]] == ["i-w"]
    read = [place_name(p) for p in motor().cross_read]
    assert read == ["i-V", "i-load", "i-w", "w-V", "w-load", "w-i"]
    assert [place_name(p) for p in body().by_driver["input"]] == ["T-sun"]


def test_a_path_that_the_model_has_is_no_place_for_another():
    effect = REGISTRY.make("effect", "input_coupling", {"port": "w-load"})
    with pytest.raises(ConfigError, match="one of i-load, w-V"):
        motor().place(effect)


def test_a_spring_is_no_driver_of_the_mass_at_its_other_end():
    """Two masses, a force on the first: the second has no path; positions drive no positions."""
    system = spiral.system(
        lambda t, x, u, p: [x.v, (u.F - p.k * (x.a - x.b)) / p.m, x.w, p.k * (x.a - x.b) / p.m],
        states={"a": "m", "v": "m/s", "b": "m", "w": "m/s"}, inputs={"F": "N"},
        parameters={"m": (1.0, "kg"), "k": (50.0, "N/m")}, observed=["a", "b"],
    )  # fmt: skip
    assert [place_name(p) for p in system.by_driver["input"]] == ["b-F"]
    assert system.by_driver["state"] == ()
    assert [place_name(p) for p in system.cross_read] == ["a-F", "a-b", "b-F", "b-a"]


def slow(*values):
    return pytest.param(*values, marks=pytest.mark.slow)


@pytest.mark.parametrize(
    ("record", "system", "name", "key", "truth"),
    [
        slow(lambda: turned(emf=EMF), motor, "state_coupling@i-w", "gain", -EMF / L),
        slow(lambda: turned(crosstalk=WIRED), motor, "input_coupling@i-load", "gain", -WIRED / L),
        (lambda: warmed(SUN), body, "cross_sensitivity@T-sun", "gain", SUN),
        slow(lambda: heated(current=1.2), coil, "quadratic_state_coupling@T-i", "gain", 1.2 / 30),
        (lambda: heated(field=9.0), coil, "quadratic_input_coupling@T-E", "gain", 9.0 / 30),
    ],
    ids=["back-EMF", "crosstalk", "thermometer in the sun", "Joule heat", "heat of a field"],
)
def test_a_driver_without_a_path_is_named_with_its_size(record, system, name, key, truth):
    run = spiral.discover(record(), system(), holdout=0.3)
    assert run.missing == (name,)
    value, error = run.model.values[f"{name}.{key}"], run.model.errors[f"{name}.{key}"]
    assert value == pytest.approx(truth, abs=3 * error)
    assert error < 0.05 * abs(truth)


def test_nothing_is_missing_where_nothing_is():
    for record, system in ((turned(), motor()), (warmed(0.0), body()), (heated(), coil())):
        run = spiral.discover(record, system, holdout=0.3)
        assert (run.verdict, run.missing) == ("nothing_missing", ())


@pytest.mark.slow
def test_a_known_value_that_is_off_is_named_with_what_it_is():
    """9000 J/K and 12 W/K were given and believed; a loss to the room looks like the latter."""
    run = spiral.discover(warmed(0.0), body(free=()), holdout=0.3)
    assert run.missing == ("other_value@C", "linear_loss@T-room")
    assert "other_value@C (C is 8002 J/K, not 9000)" in run.summary
    assert "linear_loss@T-room (or other_value@G" in run.summary


def test_values_that_are_found_are_not_asked_for():
    """Of C, which is free, and of what a study frees."""
    system = body(free=("C",))
    assert [place_name(p) for p in system.known] == ["G"]
    asked = candidates_for(REGISTRY, seed_model(system), None, everywhere=True)
    assert "other_value@G" in [e.label for e in asked]
    freed = candidates_for(REGISTRY, seed_model(system, freed=("system.G",)), None, everywhere=True)
    assert "other_value@G" not in [e.label for e in freed]


# --- an input whose zero is off -------------------------------------------------------------------


def boost():
    """A boost converter: its duty cycle d multiplies both states; i is hidden."""
    return spiral.system(
        ["Lb*i' = vin - (1 - d)*v - r*i", "Cb*v' = (1 - d)*i - v/Rl"],
        states={"i": "A", "v": {"unit": "V", "start": 24.0}},
        inputs={"d": {"unit": "1", "interpolation": "zero_order"}, "vin": "V"},
        parameters={"Lb": (400e-6, "H"), "r": (0.25, "ohm"), "Cb": (210e-6, "F"),
                    "Rl": (9.0, "ohm")},
        observed=["v"], free=["Lb", "r", "Cb"],
    )  # fmt: skip


def switched(offset, seed, samples=2500, step=2e-5):
    rng, states = np.random.default_rng(seed), [np.array([5.0, 24.0])]
    duty = np.repeat(rng.uniform(0.3, 0.6, samples // 25), 25)
    for d in duty[:-1] + offset:

        def rate(t, x, d=d):
            return [(12 - (1 - d) * x[1] - 0.3 * x[0]) / 440e-6, ((1 - d) * x[0] - x[1] / 9) / 2e-4]

        states.append(solve_ivp(rate, (0, step), states[-1], rtol=1e-9, atol=1e-9).y[:, -1])
    clean = np.array(states)[:, 1]
    seen = clean + 0.01 * clean.std() * rng.normal(size=samples)
    inputs = {"d": duty, "vin": np.full(samples, 12.0)}
    return make_record(boost(), "boost", step * np.arange(samples), {"v": seen}, inputs)


def offset_places(system):
    return [e.port for e in candidates_for(REGISTRY, seed_model(system), None, True)
            if e.plugin_name() == "input_offset"]  # fmt: skip


def test_an_offset_of_an_input_is_tried_where_no_constant_flow_does_the_same():
    """Where it multiplies a state or enters two rates; not a voltage into one current alone."""
    assert offset_places(boost()) == ["d"]
    assert offset_places(motor()) == []
    assert offset_places(REGISTRY.make("system", "oscillator")) == []
    both = spiral.system(
        ["T*a' = u - a", "T*b' = 2*u - b"], states={"a": "1", "b": "1"}, inputs={"u": "1"},
        observed=["a"], parameters={"T": (1.0, "s")},
    )  # fmt: skip
    assert offset_places(both) == ["u"]


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1])
def test_a_gate_driver_that_switches_late_is_named(seed):
    run = spiral.discover(switched(-0.02, seed), boost())
    assert run.missing == ("input_offset@d",)
    found = run.model.estimates()["input_offset@d"]["offset"]
    assert found.estimate == pytest.approx(-0.02, abs=4 * found.se)
    assert found.se < 1e-3
    assert spiral.discover(switched(0.0, seed), boost()).missing == ()
