"""Right-hand sides that cannot be traced: compiled, their slopes by differences."""

import json
import warnings

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import spiral
from spiral.io.registry import NO_FOLDER, load_registry
from spiral.io.storage import model_data, rebuild_model
from spiral.types.errors import ConfigError
from spiral.types.model import seed_model
from spiral.types.record import make_record
from tests.scenes import evaluated

TABLE_X, TABLE_F = np.array([-1.0, 0.0, 2.0]), np.array([-3.0, 0.0, 8.0])
SECTIONS = {"states": {"x": "m", "v": "m/s"}, "inputs": {"F": "N"}, "observed": ["x"],
            "parameters": {"m": (2.0, "kg"), "c": (1.5, "N*s/m")}, "mass": {"x": "m"}}  # fmt: skip


def decides(t, x, u, p):
    force = u.F - np.interp(x.x, TABLE_X, TABLE_F)
    if x.v > 0:
        force -= p.c * x.v
    return [x.v, force / p.m]


def fills(t, x, u, p):
    found = np.zeros(2)
    found[0] = x[1]
    found[1] = np.sin(3.0 * t) + u.F / p.m
    return found


def compiled_function(rhs, **changed):
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        found = spiral.system(rhs, **{**SECTIONS, **changed})
    assert any("compiled code" in str(w.message) for w in told)
    return found


def test_a_function_with_a_decision_and_a_table_is_compiled():
    """Values are the function's own, slopes those of the piece that holds."""
    model = compiled_function(decides)
    assert [c.name for c in model.coordinates] == ["x"]
    assert [(p.name, p.force_unit) for p in model.ports] == [("x", "N")]
    f, a, b = evaluated(model, at=([0.5, 0.3], [0.7, 0.0]))
    assert f == pytest.approx([0.3, (0.7 - 2.0 - 1.5 * 0.3) / 2])
    assert a == pytest.approx(np.array([[0, 1], [-4.0 / 2, -1.5 / 2]]), abs=1e-6)
    assert b[1] == pytest.approx([-f[1] / 2, -0.3 / 2], abs=1e-6)
    _, a, b = evaluated(model, at=([-0.5, -0.3], [0.7, 0.0]))
    assert a == pytest.approx(np.array([[0, 1], [-3.0 / 2, 0]]), abs=1e-6)
    assert b[1, 1] == 0.0


def test_arrays_times_and_forces():
    """A force at the port adds force over mass; the time is the record's."""
    model = compiled_function(fills)
    load = load_registry(NO_FOLDER).effect_from_label("constant_load")
    f, _, b = evaluated(model, (load,), {"constant_load.force": 3.0}, ([0.1, 0.2], [0.4, 0.6]))
    assert f == pytest.approx([0.2, np.sin(1.8) + 0.4 / 2 + 3.0 / 2])
    assert b[1, -1] == pytest.approx(0.5)


def imports(t, x, u, p):
    import json

    force = json.loads("1.0")
    return [x.v, force if x.x > 0 else -force]


@pytest.mark.parametrize(
    ("rhs", "said"),
    [
        (imports, ["Numba cannot compile"]),
        (lambda t, x: {"x": x.v, "v": 1.0 if x.x > 0 else 0.0}, ["a mapping", "as a list"]),
        (lambda t, x: [1.0 if x.x > 0 else 0.0], ["1 values"]),
        (lambda t, x, u, p: [x.v, 1.0 if x.x > 0 else p.q], ["a decision", "if x.x > 0 else p.q"]),
    ],
)
def test_what_cannot_be_compiled_either_is_said(rhs, said):
    with pytest.raises(ConfigError) as caught:
        spiral.system(rhs, **SECTIONS)
    for words in said:
        assert words in str(caught.value)


def test_a_function_is_not_made_again_from_a_saved_run():
    saved = json.loads(json.dumps(model_data(seed_model(compiled_function(decides)))))
    assert saved["system"]["function"].endswith(".decides")
    with pytest.raises(ConfigError, match="which no file holds"):
        rebuild_model(saved, load_registry(NO_FOLDER))


def test_a_function_with_a_decision_to_a_verdict():
    """SciPy's right-hand side with a one-sided stop as ``if``; a stiffening spring is hidden."""
    time = np.arange(1600) / 400
    drive = np.convolve(np.random.default_rng(1).normal(size=1600), np.ones(8), "same")

    def rhs(t, x, u, p):
        pull = p.k * x.x
        if x.x > 0.005:
            pull += 800.0 * (x.x - 0.005)
        return [x.v, (u.F - p.c * x.v - pull) / p.m]

    def machine(t, x):
        pull = 420 * x[0] + 4e5 * x[0] ** 3 + 800 * max(x[0] - 0.005, 0.0)
        return [x[1], (np.interp(t, time, drive) - 1.6 * x[1] - pull) / 2.0]

    x = solve_ivp(machine, (0, time[-1]), [0, 0], t_eval=time, rtol=1e-8, max_step=1 / 400).y[0]
    x = x + 0.01 * x.std() * np.random.default_rng(2).normal(size=x.size)
    known = {"m": (2.0, "kg"), "c": (1.0, "N*s/m"), "k": (400, "N/m")}
    model = compiled_function(rhs, parameters=known, free=["c", "k"])
    record = make_record(model, "bench", time, {"x": x}, {"F": drive})
    run = spiral.discover(
        record, model, candidates=["cubic_stiffness", "quadratic_damping", "coulomb_friction"]
    )
    assert run.verdict == "effect_missing"
    assert run.missing == ("cubic_stiffness",)
    key = "cubic_stiffness.stiffness"
    assert abs(run.model.values[key] - 4e5) < 4 * run.model.errors[key]
