"""Parameters that follow a state, an input or time: right as effects, and named where they act."""

from types import SimpleNamespace

import numpy as np
import pytest
import sympy as sp
from scipy.integrate import solve_ivp
from scipy.linalg import expm
from spiral_plugins.effects.learned import LearnedChange
from spiral_plugins.effects.varying import (
    ArrheniusChange,
    ExponentialChange,
    InverseQuadraticChange,
    LinearChange,
    MagnitudeChange,
    PeakChange,
    PeriodicChange,
    PowerChange,
    QuadraticChange,
    SaturatingChange,
    SwitchedChange,
)

import spiral
from spiral.inference.evidence.scales import largest_port_motion, shape_scale, states_along_records
from spiral.inference.problem import silent
from spiral.inference.unknown.forcecurve import _share_of_mean
from spiral.io.export.equation import equation_text
from spiral.physics.signatures import SystemMotion, signatures
from spiral.physics.trace import trace
from spiral.types.model import seed_model
from spiral.types.placement import at_every_place, fits
from spiral.types.record import make_record
from tests.scenes import registry

OSCILLATOR = registry().make("system", "oscillator")
SAMPLES, STEP, HELD = 1000, 5.0, 40  # samples, s, samples for which power and flow stay
FORMS = [
    (LinearChange, {"slope": 0.3, "reference": 0.5}, lambda v: 1 + 0.3 * (v - 0.5)),
    (
        QuadraticChange,
        {"slope": 0.3, "curvature": -0.1, "reference": 0.0},
        lambda v: 1 + 0.3 * v - 0.1 * v * v,
    ),
    (
        MagnitudeChange,
        {"slope": 0.3, "unit": 2.0},
        lambda v: 1 + 0.3 * (np.hypot(v, 0.02) - 0.02),
    ),
    (
        PeriodicChange,
        {"cosine": 0.3, "sine": -0.2, "count": 3.0},
        lambda v: 1 + 0.3 * np.cos(3 * v) - 0.2 * np.sin(3 * v),
    ),
    (PowerChange, {"exponent": 0.8, "unit": 2.0}, lambda v: np.hypot(v / 2, 0.01) ** 0.8),
    (ExponentialChange, {"rate": -0.4, "reference": 1.0}, lambda v: np.exp(-0.4 * (v - 1.0))),
    (
        ArrheniusChange,
        {"activation": 2.0, "reference": 1.5},
        lambda v: np.exp(2 * (1 / 1.5 - 1 / v)),
    ),
    (InverseQuadraticChange, {"curvature": 0.4}, lambda v: 1 / (1 + 0.4 * v * v)),
    (
        SaturatingChange,
        {"change": 0.5, "scale": 0.7, "reference": 0.2},
        lambda v: 1 + 0.5 * np.tanh((v - 0.2) / 0.7),
    ),
    (
        SwitchedChange,
        {"change": 0.5, "point": 0.8, "width": 1e-3, "reference": 0.2},
        lambda v: 1 + 0.5 * (v > 1),
    ),
    (
        PeakChange,
        {"change": 2.2, "point": 0.8, "width": 0.3, "reference": 0.2},
        lambda v: 1 + 2.2 * np.exp(-(((v - 1.0) / 0.3) ** 2)),
    ),
]


def heater():
    """Cc Tc' = P - h (Tc - Tw), Cw Tw' = h (Tc - Tw) - g Tw: the core Tc is hidden."""

    def rhs(t, x, u, p):
        passed = p.h * (x.Tc - x.Tw)
        return (u.P - passed) / p.Cc, (passed - p.g * x.Tw) / p.Cw

    return spiral.system(
        rhs,
        states={"Tc": {"unit": "K", "like": "Tw"}, "Tw": "K"},
        inputs={"P": {"unit": "W", "interpolation": "zero_order"},
                "q": {"unit": "kg/s", "interpolation": "zero_order"}},
        observed=["Tw"],
        parameters={"h": (33.0, "W/K"), "g": (11.0, "W/K"), "Cc": (4000.0, "J/K"),
                    "Cw": (9500.0, "J/K")},
        free=["h", "g", "Cw"],
    )  # fmt: skip


def record_of(system, conductance, seed, noise=0.01, samples=SAMPLES, held=HELD):
    """A record of the heater, exact for held inputs, with white noise on Tw."""
    rng = np.random.default_rng(seed)
    power, flow = (np.repeat(rng.uniform(low, high, samples // held), held)
                   for low, high in ((200, 1500), (0.2, 1.5)))  # fmt: skip
    states, x = np.zeros((samples, 2)), np.zeros(2)
    for k in range(samples):
        states[k] = x
        if k % held == 0:
            h = conductance(flow[k])
            rates = np.zeros((3, 3))  # the third state is one
            rates[0] = -h / 4000, h / 4000, power[k] / 4000
            rates[1] = h / 9000, -(h + 12) / 9000, 0
            over = expm(rates * STEP)
        x = over[:2, :2] @ x + over[:2, 2]
    seen = states[:, 1] + noise * states[:, 1].std() * rng.normal(size=samples)
    time = np.arange(samples) * STEP
    return make_record(system, f"seed {seed}", time, {"Tw": seen}, {"P": power, "q": flow})


@pytest.mark.parametrize(
    ("kind", "values", "factor"), FORMS, ids=lambda x: getattr(x, "__name__", "")
)
def test_the_factor_is_its_equation_and_one_where_nothing_changes(kind, values, factor):
    v = np.linspace(0.2, 1.9, 60)  # no grid point at the switch
    at = SimpleNamespace(position=(v,))
    still = {p.name: 0.0 if p.role == "amplitude" else values[p.name] for p in kind.parameters}
    np.testing.assert_allclose(
        kind().factor(at, None, SimpleNamespace(**values)), factor(v), rtol=1e-5, atol=1e-9
    )
    np.testing.assert_allclose(
        kind().factor(at, None, SimpleNamespace(**still)), np.ones(60), rtol=0, atol=0
    )


def melting(seed, peak=2.2, samples=2400, noise=0.01):
    """Cb T' = P - h (T - Tw), Cw Tw' = h (T - Tw) - g (Tw - Ta): a hidden buffer melts at 317 K."""
    rng = np.random.default_rng(seed)
    power = np.repeat(rng.uniform(0, 16, samples // 60), 60)
    time = np.arange(samples) * 3.0

    def rate(t, x, heat):
        capacity = 110 * (1 + peak * np.exp(-(((x[0] - 317) / 4) ** 2)))
        passed = 0.9 * (x[0] - x[1])
        return [(heat - passed) / capacity, (passed - 0.5 * (x[1] - 298)) / 210]

    x, states = np.array([305.0, 302.0]), []
    for k in range(samples):
        states.append(x)
        x = solve_ivp(rate, (0, 3.0), x, "DOP853", args=(power[k],), rtol=1e-9).y[:, -1]
    buffer, wall = np.array(states).T
    system = spiral.system(
        ["C*T' = P - h*(T - Tw)", "Cw*Tw' = h*(T - Tw) - g*(Tw - Ta)"],
        states={"T": {"unit": "K", "start": 305.0}, "Tw": {"unit": "K", "start": 302.0}},
        inputs={"P": {"unit": "W", "interpolation": "zero_order"}},
        parameters={"C": (120.0, "J/K"), "h": (0.8, "W/K"), "g": (0.5, "W/K"),
                    "Cw": (210.0, "J/K"), "Ta": (298.0, "K")},
        free=["C", "h"], observed=["Tw"],
    )  # fmt: skip
    seen = wall + noise * wall.std() * rng.normal(size=samples)
    assert buffer.min() < 313
    assert buffer.max() > 321
    return system, make_record(system, f"seed {seed}", time, {"Tw": seen}, {"P": power})


def test_points_of_a_change_are_tried_within_what_a_variable_covers():
    """Of temperatures in K: counted from their middle, in shares of how far they go from it."""
    system, record = melting(0)
    states = np.column_stack([np.linspace(300, 322, 50), np.linspace(300, 310, 50)])
    largest = largest_port_motion(system, (record,), [states])
    port = system.place(PeakChange(port="C-T"))
    assert largest[f"{port.name}.middle"] == pytest.approx(311)
    assert largest[f"{port.name}.spread"] == pytest.approx(11)
    for kind in (SwitchedChange, PeakChange):
        shapes = {p.name: p for p in kind.parameters}
        point, width, reference = (
            [g * shape_scale(shapes[n], largest, port) for g in shapes[n].grid]
            for n in ("point", "width", "reference")
        )
        assert reference == [pytest.approx(311)]
        assert all(300 < 311 + x < 322 for x in point)
        assert all(0 < w < 11 for w in width)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2])
def test_a_hidden_buffer_that_melts_is_named_with_its_temperature(seed):
    system, record = melting(seed)
    result = spiral.discover(record, system)
    assert result.missing == ("peak_change@C-T",)
    values = result.model.values
    place = values["peak_change@C-T.reference"] + values["peak_change@C-T.point"]
    assert place == pytest.approx(317, abs=0.5)
    assert values["peak_change@C-T.change"] == pytest.approx(2.2, rel=0.1)
    system, record = melting(seed, peak=0.0)
    assert spiral.discover(record, system).verdict == "nothing_missing"


def test_the_traced_model_is_the_system_with_the_parameter_times_the_factor():
    system = heater()
    plain, varied = trace(system, ()), trace(system, (LinearChange(port="h-Tc"),))
    at = dict(zip(varied.keys, varied.p, strict=True))
    beyond = varied.x[0] - at["linear_change@h-Tc.reference"]
    acting = at["system.h"] * (1 + at["linear_change@h-Tc.slope"] * beyond)
    swap = {s: at[k] for k, s in zip(plain.keys, plain.p, strict=True)} | {
        plain.p[plain.keys.index("system.h")]: acting
    }
    for before, after in zip(plain.rate, varied.rate, strict=True):
        assert sp.simplify(sp.sympify(before).subs(swap, simultaneous=True) - after) == 0


def test_a_parameter_of_a_seeds_effect_varies_too_and_the_equation_says_so():
    effect = LinearChange(port="linear_stiffness.stiffness-time")
    model = seed_model(OSCILLATOR).add(effect, {f"{effect.label}.slope": -0.01})
    traced = trace(OSCILLATOR, model.effects)
    x, time = traced.x[0], traced.u[traced.inputs.index("time")]
    assert sp.diff(traced.rate[1], x, time) != 0
    assert effect.label in equation_text(model)


def test_the_equation_shows_a_parameter_where_a_reading_has_it_and_no_rounding():
    """A resistance that follows the temperature, in a loss and in the voltage that is read."""
    cell = spiral.system(
        ["C*T' = R*I^2 - G*(T - Ta)"], states={"T": "K"}, inputs={"I": "A", "Ta": "K"},
        parameters={"C": (62.7, "J/K"), "R": (0.024, "ohm"), "G": (0.53, "W/K"),
                    "s": (1e-3, "V/K")},
        observed=["U = s*T + R*I", "T"],
    )  # fmt: skip
    text = equation_text(seed_model(cell).add(LinearChange(port="R-T"), {}))
    readings = text[text.index("reading of U") : text.index("reading of T")]
    assert "linear_change@R-T" in readings
    values = {"arrhenius_change@R-T.activation": -2000.0, "arrhenius_change@R-T.reference": 300.0}
    warm = equation_text(seed_model(cell).add(ArrheniusChange(port="R-T"), values))
    assert "exp(2000 T/(T² + 0.0009))" in warm
    loss = seed_model(cell).add(LinearChange(port="G-I"), {"linear_change@G-I.slope": 0.0512})
    lines = [line for line in equation_text(loss).splitlines() if "linear_change" in line]
    assert len(lines) == 1
    assert "e-1" not in lines[0]


def test_the_slope_along_a_motion_is_the_derivative_of_the_traced_model():
    system, rng = heater(), np.random.default_rng(1)
    states, inputs = rng.normal(size=(7, 2)) + 3, np.abs(rng.normal(size=(7, 3))) + 0.1
    values = {"h": 30.0, "g": 12.0, "Cc": 4000.0, "Cw": 9000.0}
    effect = ExponentialChange(port="h-q")
    traced = trace(system, (effect,))
    symbols = [*traced.x, *traced.u, *traced.p]
    amplitude = traced.p[traced.keys.index(f"{effect.label}.rate")]
    h = traced.p[traced.keys.index("system.h")]
    rows = [[*x, *u, *values.values(), 0.0, 0.3] for x, u in zip(states, inputs, strict=True)]
    assert [k.rpartition(".")[2] for k in traced.keys] == [*values, "rate", "reference"]

    def along(symbol, scale=1.0):
        slopes = sp.lambdify(symbols, [sp.diff(r, symbol) for r in traced.rate], "numpy")
        return np.array([slopes(*row) for row in rows]) * scale

    motion = SystemMotion(
        system, states, inputs, along(h), states[:, 1:], values,
        by_parameter={"system.h": (along(h, 30.0), np.zeros((7, 1)))},
    )  # fmt: skip
    pushes, readings = signatures(motion, effect, {"reference": 0.3})
    np.testing.assert_allclose(pushes[:, :, 0], along(amplitude), rtol=1e-6)
    assert not readings.any()


def test_every_form_stands_at_every_parameter_and_what_it_may_follow():
    system = heater()
    places = {e.port for e in at_every_place(system, LinearChange()) if fits(system, e)}
    assert places == {
        f"{p}-{v}" for p in ("h", "g", "Cc", "Cw") for v in ("Tc", "Tw", "P", "q", "time")
    }
    warm = {e.port for e in at_every_place(system, ArrheniusChange()) if fits(system, e)}
    assert warm == {f"{p}-{v}" for p in ("h", "g", "Cc", "Cw") for v in ("Tc", "Tw")}
    labels = {e.label for e in registry().candidates(system, everywhere=True)}
    assert not any("_change@" in label for label in labels)  # no candidates of the first rounds


def winding(lowest):
    """A winding that warms a case, in K above ``lowest``: the winding's temperature is hidden."""
    return spiral.system(
        ["Cw*Tw' = R*I^2 - g*(Tw - Tc)", "Cc*Tc' = g*(Tw - Tc) - h*(Tc - Ta)"],
        states={"Tw": {"unit": "K", "like": "Tc"}, "Tc": "K"}, observed=["Tc"],
        inputs={"I": {"unit": "A", "interpolation": "zero_order"}, "Ta": "K"},
        parameters={"Cw": (80.0, "J/K"), "Cc": (400.0, "J/K"), "g": (1.3, "W/K"),
                    "h": (0.6, "W/K"), "R": (1.2, "ohm")},
        free=["Cc", "g", "h"],
    )  # fmt: skip


def warmed(system, lowest, samples=1500):
    """Read every 5 s: R = 1.2 (1 + 3.9e-3 (Tw - 20 degC)), noise of 0.05 K."""
    rng = np.random.default_rng(1)
    current = np.repeat(rng.choice([0, 3, 5, 7, 8.0], samples // 50), 50)
    outside = 293 + 0.5 * np.sin(np.arange(samples) / 300) - lowest
    x, states = np.full(2, 293 - lowest), []
    for u, ta in zip(current, outside, strict=True):
        states.append(x)
        for _ in range(10):
            r = 1.2 * (1 + 3.9e-3 * (x[0] - 293 + lowest))
            passed = 1.3 * (x[0] - x[1])
            rate = np.array([(r * u**2 - passed) / 80, (passed - 0.6 * (x[1] - ta)) / 420])
            x = x + 0.5 * rate
    seen = np.array(states)[:, 1] + 0.05 * rng.normal(size=samples)
    return make_record(
        system, "winding", 5.0 * np.arange(samples), {"Tc": seen}, {"I": current, "Ta": outside}
    )


@pytest.mark.parametrize(("lowest", "middle"), [(0.0, pytest.approx(400, rel=0.15)), (293.0, 0.0)])
def test_what_is_far_from_zero_is_counted_from_its_middle(lowest, middle):
    """A temperature in K is, one above the surroundings is not: a known value holds at its zero."""
    system = winding(lowest)
    record = warmed(system, lowest)
    model = seed_model(system, values=system.defaults)
    largest = largest_port_motion(system, (record,), states_along_records(model, (record,)))
    assert largest["parameter R with Tw.middle"] == middle
    assert largest["parameter R with I.middle"] == 0.0


@pytest.mark.slow
def test_a_known_resistance_tells_at_which_temperature_it_holds():
    """Copper, given at 20 degC, along a winding that reaches 280 degC and that nobody measures."""
    system = winding(0.0)
    run = spiral.discover(warmed(system, 0.0), system, progress=silent)
    assert run.missing == ("linear_change@R-Tw",)
    told = run.model.estimates()["linear_change@R-Tw"]
    assert abs(told["slope"].estimate - 3.9e-3) < 3 * told["slope"].se
    assert abs(told["reference"].estimate - 293) < 3 * told["reference"].se


@pytest.mark.slow
def test_a_conductance_that_grows_with_a_power_of_the_flow_is_named():
    system = heater()
    fit, test = (record_of(system, lambda q: 30 * q**0.8, seed) for seed in (1, 2))
    run = spiral.discover(fit, system, test=test, progress=silent)
    assert run.missing == ("power_change@h-q",)
    assert "only in combination" not in run.summary  # of the unit and h one is held
    told = run.model.estimates()["power_change@h-q"]["exponent"]
    assert abs(told.estimate - 0.8) < 3 * told.se
    assert run.rounds[-1].comparison.test_error < 1.1 * run.rounds[-1].comparison.noise_floor


def waves(flow):
    """A conductance that is of none of the forms: nearly two waves over the flow."""
    return 33.0 * (1 + 0.4 * np.sin(2 * np.pi * flow / 0.7))


@pytest.fixture(scope="module")
def wavy():
    system = heater()
    record = record_of(system, waves, 3, samples=3000, held=20)
    return spiral.discover(record, system, progress=silent, settings={"learned": True})


@pytest.mark.slow
def test_a_parameter_that_follows_a_variable_by_no_known_form_is_told_as_a_curve(wavy):
    last, shape = wavy.rounds[-1].comparison, wavy.rounds[-2].details["unknown"]
    assert wavy.missing == ("learned_change@h-q",)
    assert shape["sentence"] == "A change of h that follows q: smooth."
    assert last.test_error < 1.1 * last.noise_floor < 0.3 * wavy.rounds[0].comparison.test_error


@pytest.mark.slow
def test_the_curve_of_a_parameter_is_its_value_over_its_mean(wavy):
    (curve,) = wavy.rounds[-2].details["unknown"]["curves"]
    at, told, band, weight = (np.array(curve[k]) for k in ("at", "force", "band", "visited"))
    true = waves(at) / (weight @ waves(at)) - 1
    assert np.max(np.abs(told - true)) < 0.03
    assert 0.003 < np.median(band) < 0.03


def test_a_share_of_the_mean_has_the_slopes_of_its_differences():
    rng = np.random.default_rng(5)
    factor, weight = rng.uniform(0.5, 2.0, 7), rng.dirichlet(np.ones(7))
    share, slopes = _share_of_mean(factor, weight)
    assert abs(weight @ share) < 1e-14
    np.testing.assert_allclose(_share_of_mean(3 * factor, weight)[0], share, rtol=1e-12)
    moved = [(_share_of_mean(factor + h, weight)[0] - _share_of_mean(factor - h, weight)[0]) / 2e-6
             for h in 1e-6 * np.eye(7)]  # fmt: skip
    np.testing.assert_allclose(slopes, np.transpose(moved), atol=1e-8)


def test_a_curve_of_a_parameter_is_one_where_the_variable_is_zero_and_never_negative():
    effect, rng = LearnedChange(), np.random.default_rng(6)
    names = [p.name for p in effect.parameters if p.name != "span"]
    assert len(names) == 20
    values = SimpleNamespace(span=1.0, **dict(zip(names, rng.normal(size=20), strict=True)))
    at = SimpleNamespace(position=(np.array([0.0, *rng.normal(size=200)]),))
    factor = effect.factor(at, None, values)
    assert abs(factor[0] - 1) < 1e-12
    assert np.all(factor > 0)


def test_a_steady_conductance_varies_with_nothing():
    system = heater()
    fit, test = (record_of(system, lambda q: 30.0, seed) for seed in (3, 4))
    assert spiral.discover(fit, system, test=test, progress=silent).verdict == "nothing_missing"


def test_a_search_that_may_take_no_time_ends_with_what_is_known():
    system = heater()
    record = record_of(system, lambda q: 30 * q**0.8, 1)
    run = spiral.discover(record, system, settings={"seconds": 1e-3}, progress=silent)
    assert (run.stopped, run.missing, len(run.rounds)) == ("max_seconds", (), 1)
    assert "ended after 0.001 s" in run.summary
    assert "settings.seconds" in run.advice


def _tube(seed, count=3000, dt=0.02):
    """An X-ray tube whose filament emits less and less; nobody measures how hot it is."""
    system = spiral.system(
        ["cth*T' = P - em*sg*Af*T^4", "C*V' = (Ug - V)/Rs - Ia"],
        let={"Ia": "A0*Af*T^2*exp(-W/T)"}, constants={"sg": "5.670e-8 W/m^2/K^4"},
        states={"T": {"unit": "K", "start": 2250.0}, "V": "V"},
        inputs={"P": {"unit": "W", "interpolation": "zero_order"}, "Ug": "V"},
        parameters={"cth": (8.0e-3, "J/K"), "em": (0.37, "1"), "Af": (2.06e-5, "m^2"),
                    "A0": (6.6e5, "A/m^2/K^2"), "W": (52500.0, "K"), "C": (5.0e-7, "F"),
                    "Rs": (5.0e5, "ohm")},
        free=["cth", "em", "A0", "C", "Rs"], observed=["V", "Ia"],
    )  # fmt: skip
    rng, steps, time = np.random.default_rng(seed), 40, dt * np.arange(count)
    power = 11.3 + np.repeat(rng.uniform(-1.5, 1.5, count // 50), 50)
    ground = 60e3 + 8e3 * np.sin(0.9 * time) + 5e3 * np.sin(3.1 * time + 1.0)
    x, seen = np.array([2230.0, 55e3]), []
    for k in range(count):
        seen.append((x[1], _emission(x[0], time[k])))
        for j in range(steps):
            x = x + dt / steps * np.array([
                (power[k] - 0.36 * 5.670e-8 * 2e-5 * x[0] ** 4) / 8.5e-3,
                ((ground[k] - x[1]) / 5.2e5 - _emission(x[0], time[k] + j * dt / steps)) / 5.5e-7,
            ])  # fmt: skip
    seen = np.array(seen)
    seen = seen + [0.01, 0.015] * seen.std(axis=0) * rng.normal(size=seen.shape)
    channels, inputs = {"V": seen[:, 0], "Ia": seen[:, 1]}, {"P": power, "Ug": ground}
    return system, make_record(system, f"seed {seed}", time, channels, inputs)


def _emission(temperature, time):
    """Richardson's current in A, its constant 6e5 A/m^2/K^2 at first, 110 s to 1/e."""
    return 6e5 * 2e-5 * np.exp(-time / 110) * temperature**2 * np.exp(-52500 / temperature)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2])
def test_a_parameter_that_drifts_is_told_from_others_that_would(seed):
    """While its drift is missing, an emissivity that grows with time scores as well."""
    system, record = _tube(seed)
    run = spiral.discover(record, system, candidates=["linear_loss", "hidden_store", "offset"])
    assert run.missing == ("exponential_change@A0-time",)
    rate = run.model.estimates()["exponential_change@A0-time"]["rate"]
    assert rate.estimate == pytest.approx(-1 / 110, abs=3 * rate.se)
