"""Curves by the likelihood, values that were left behind, and values that keep their sign."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from spiral_plugins.strategies.likelihood import Likelihood
from spiral_plugins.systems.cascaded_tanks import CascadedTanks
from spiral_plugins.systems.oscillator import Oscillator

import spiral
from spiral.inference.evidence.enlarge import study_with, transfer_fit_state, with_variants
from spiral.inference.likelihood.candidates import second_basin_candidates
from spiral.inference.problem import Problem, silent
from spiral.inference.simulate import simulate
from spiral.inference.strategies.likelihood import curves
from spiral.inference.strategies.likelihood.accepted import AcceptedCandidate
from spiral.inference.strategies.likelihood.admission import offer_effects
from spiral.inference.strategies.likelihood.benefit import Refusal
from spiral.inference.strategies.likelihood.whole_fit import _drop_unused_variants
from spiral.physics.learned import LEVELS, basis
from spiral.types.model import seed_model
from spiral.types.record import make_record
from tests.scenes import effect, registry

DT = 0.02


def _steps(rng, samples, most):
    """Values held for a second each, uniform up to ``most``."""
    each = round(1 / DT)
    return np.repeat(rng.uniform(0.2, 1.0, samples // each + 1) * most, each)[:samples]


def _simulated(rates, begin, drive, noise, rng):
    time = np.arange(len(drive)) * DT
    run = solve_ivp(
        lambda t, x: rates(x, drive[min(int(t / DT + 1e-9), len(drive) - 1)]),
        (0, time[-1]), begin, t_eval=time, rtol=1e-8, max_step=DT,
    )  # fmt: skip
    seen = run.y[0]
    return time, seen + noise * seen.std() * rng.normal(size=len(seen))


def _leaky(t, x, u, p):
    return [(u.e - x.v) / (p.R * p.C)]


@pytest.mark.slow
def test_effects_that_stand_in_for_a_curve_are_not_named():
    """A loss that grows exponentially, offered those that grow with the root and the square."""
    rng = np.random.default_rng(2)
    drive = _steps(rng, 1800, 2.0)

    def true(x, e):
        return [(e - x[0]) / 0.3 - 0.02 * (np.exp(x[0] / 0.15) - 1)]

    time, seen = _simulated(true, [0.0], drive, 0.005, rng)
    system = spiral.system(
        _leaky, states={"v": "V"}, inputs={"e": {"unit": "V", "interpolation": "zero_order"}},
        parameters={"R": (1.0, "ohm"), "C": (0.3, "F")}, observed=["v"], free=["C"],
    )  # fmt: skip
    record = make_record(system, "leak", time, {"v": seen}, {"e": drive})
    run = spiral.discover(
        record, system, candidates=["root_loss@v", "quadratic_loss@v"], settings={"max_rounds": 2},
        strategy={"name": "likelihood", "laws": False},
    )  # fmt: skip
    shape = run.unknown
    assert run.verdict == "unknown_structure"
    assert run.missing == ()
    assert shape["effect"] == "learned_loss@v"
    assert shape["test_error"] < 0.1 * run.rounds[0].comparison.test_error
    curve = shape["curves"][0]
    at, flow, band = (np.array(curve[k]) for k in ("at", "force", "band"))
    truth = -0.02 * (np.exp(at / 0.15) - 1)
    weight = np.array(curve["visited"])
    line = np.polyfit(at, flow - truth, 1, w=np.sqrt(weight))  # what the resistor can take over
    inside = np.abs(flow - truth - np.polyval(line, at)) <= 2 * band + 0.02 * np.ptp(truth)
    assert np.mean(inside[weight > 0]) > 0.9


def test_an_effect_is_found_from_the_values_given_where_the_fit_has_left_them():
    """Two compartments and an enzyme: without it the exchange runs one way, far from its values."""
    rng = np.random.default_rng(2)
    dose = np.zeros(600)
    for start in range(5, 600, 120):
        dose[start : start + 10] = 60 * rng.uniform(0.5, 1.5)
    time, dt = np.arange(600) * 0.1, 0.1

    def true(t, x):
        u = dose[min(int(t / dt + 1e-9), 599)]
        loss = 2.0 * x[0] / (1.5 + x[0])
        return [u / 5 - 0.45 * x[0] + 0.2 * x[1] - loss, 0.3 * x[0] - 0.2 * x[1]]

    seen = solve_ivp(true, (0, time[-1]), [0, 0], t_eval=time, rtol=1e-8, max_step=dt).y[0]
    seen = seen + 0.03 * seen.std() * rng.normal(size=600)

    def rhs(t, x, u, p):
        return [u.d / p.V - (p.k12 + p.ke) * x.a + p.k21 * x.b, p.k12 * x.a - p.k21 * x.b]

    values = {"V": (5.7, "m^3"), "k12": (0.25, "1/s"), "k21": (0.22, "1/s"), "ke": (0.13, "1/s")}
    system = spiral.system(
        rhs, states={"a": "kg/m^3", "b": "kg/m^3"},
        inputs={"d": {"unit": "kg/s", "interpolation": "zero_order"}},
        parameters=values, observed=["a"], free=list(values),
    )  # fmt: skip
    record = make_record(system, "dose", time, {"a": seen}, {"d": dose})
    run = spiral.discover(record, system, candidates=["saturating_loss@a", "linear_loss@b"])
    assert run.missing == ("saturating_loss@a",)
    found = run.model.estimates()["system"]["k12"]
    assert abs(found.estimate - 0.3) < 3 * found.se


def _parameters(**given):
    system = spiral.system(
        _leaky, states={"v": "V"}, inputs={"e": "V"}, observed=["v"],
        parameters={"R": (1.0, "ohm"), "C": given}, free=["C"],
    )  # fmt: skip
    return {p.name: (p.lower, p.upper) for p in system.parameters}["C"]


def test_a_free_value_keeps_the_sign_that_it_was_given():
    assert _parameters(value=0.3, unit="F") == (0.0, None)
    assert _parameters(value=-0.3, unit="F") == (None, 0.0)
    assert _parameters(value=0.3, unit="F", lower=-1.0) == (-1.0, None)
    assert _parameters(value=0.3, unit="F", lower=None) == (None, None)


@pytest.mark.parametrize(("most", "knots"), [(0, 5), (1, 9)])
def test_the_last_coefficients_are_a_spline_on_fewer_knots(most, knots):
    """Third derivatives jump at so many knots only."""
    z = np.linspace(-1.0, 1.0, 20001)
    rows = np.array(basis(z))[[i for i, level in enumerate(LEVELS.values()) if level <= most]]
    assert len(rows) == knots
    bend = np.diff(np.random.default_rng(0).normal(size=knots) @ rows, 2)
    jumps = np.abs(np.diff(bend, 2)) > 1e-6 * np.ptp(bend)
    assert 1 <= np.sum(np.diff(np.flatnonzero(jumps)) > 5) + 1 <= knots


@pytest.mark.parametrize("spoils", [False, True])
def test_knots_that_spoil_unseen_data_are_not_added(monkeypatch, spoils):
    """A curve that few readings hold at its ends may leave all bounds in a test record."""
    coarse, fine = (SimpleNamespace(refitted=name) for name in ("coarse", "fine"))
    variant = SimpleNamespace(label="learned")
    rival = SimpleNamespace(label="learned", ranked=SimpleNamespace(variant=variant))
    passing = (AcceptedCandidate(rival, (), coarse), (SimpleNamespace(tried=()), None))
    monkeypatch.setattr(curves, "_refine_knots", lambda whole, label, progress: fine)
    monkeypatch.setattr(curves, "_as_curve_fit", lambda whole, label: whole)
    monkeypatch.setattr(curves, "describe_curve", lambda fit, label, listed: fit.refitted)
    monkeypatch.setattr(curves, "suggestions", lambda *_: ())
    refusal = Refusal("the error on unseen data grows", grows=True) if spoils else None
    asked = []
    curve = curves._missing_curve(passing, lambda w: asked.append(w) or refusal, silent)
    assert asked == [fine]
    assert curve.refitted == curve.shape == ("coarse" if spoils else "fine")


def test_curves_are_raced_among_themselves():
    """Not beside candidates that zero amplitude does not show, which are started from afar."""
    time = 4.0 * np.arange(500)
    values = {
        "pump.gain": 0.05,
        "outlets.upper": 0.06,
        "outlets.lower": 0.055,
        "outlets.width": 0.1,
    }
    model = seed_model(CascadedTanks(), values=values)
    pump = {"pump": 3 + np.sin(time / 90)}
    record = simulate(model, time, pump, 0.02, np.random.default_rng(0))
    problem = Problem(
        model, (record,), (), candidates=(effect("overflow"),),
        dictionary=registry().dictionary(CascadedTanks()), strategy=Likelihood(),
    )  # fmt: skip
    begun = Likelihood().begin(problem, silent)
    assert second_basin_candidates(begun.assembly, begun.fit_state, [])
    curves = offer_effects(begun.assembly, problem.dictionary)
    assert {v.original for v in curves.offered} == set(problem.dictionary)
    assert not second_basin_candidates(curves, begun.fit_state, [])
    overflow = next(v for v in begun.assembly.offered if v.original.label == "overflow")
    own = with_variants(curves, [overflow, curves.offered[0]])
    state = transfer_fit_state(begun.fit_state, begun.assembly, own)
    state = replace(state, labels=(*state.labels, overflow.label))
    narrow, left = _drop_unused_variants(
        own, state
    )  # what was admitted is no longer offered, and stays
    assert [v.label for v in narrow.variants] == [overflow.label]
    assert left.values.shape[1] == len(narrow.study.keys)


def test_a_study_of_some_effects_has_no_others():
    """A state of one effect, asked of a study that has another, which was let go."""
    values = {
        "system.mass": 1.0,
        "linear_stiffness.stiffness": 400.0,
        "linear_damping.damping": 2.0,
    }
    model = seed_model(Oscillator(), values=values)
    force = {"force": np.sin(20 * np.arange(400) / 100)}
    record = simulate(model, np.arange(400) / 100, force, 0.02, np.random.default_rng(0))
    wanted = ("cubic_stiffness", "quadratic_damping")
    problem = Problem(
        model, (record,), (), candidates=tuple(map(effect, wanted)), strategy=Likelihood()
    )
    begun = Likelihood().begin(problem, silent)
    offered = {v.original.label: v for v in begun.assembly.offered}
    first, second = (offered[name] for name in wanted)
    both = with_variants(begun.assembly, [first])
    own = with_variants(begun.assembly, [second])
    state = transfer_fit_state(begun.fit_state, begun.assembly, own)
    assert study_with(both, (*state.labels, second.label)).study.keys == own.study.keys
