"""An exported program runs as we do: same inputs, same step, same motion, same Jacobians."""

import ast
import ctypes
import importlib.util
import json
import re
import shutil
import subprocess
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
import sympy as sp

import spiral
from spiral.cli import main
from spiral.engine.series import half_step_inputs
from spiral.inference.simulate import integrate
from spiral.io.export.kinds import KINDS
from spiral.io.export.program import Item, identifiers, plain
from spiral.io.registry import load_registry
from spiral.io.storage import save_result
from spiral.physics.compile import compile_model
from spiral.physics.trace import trace
from spiral.types.errors import ConfigError
from spiral.types.model import Model, seed_model
from spiral.types.record import make_record

REGISTRY = load_registry(local=False)
CLOSE = 1e-8
TIME = 0.01 * np.arange(80)
SUBSTEPS = 4
SHAKEN = {"force": np.random.default_rng(1).normal(size=len(TIME))}
SPEED = {"speed": 60 - 30 * TIME, "phase": 60 * TIME - 15 * TIME**2}
PUMPED = {"pump": 2 + np.sign(np.sin(9 * TIME))}
FULL = {"upper": 3.0, "lower": 2.0}
MACHINES = {  # an effect with states of its own and a late, shifted sensor; corners; a rotor; tanks
    "hysteresis": ("oscillator", ("bouc_wen", "offset"), SHAKEN, {"x": 0.3}),
    "corners": ("oscillator", ("clearance", "coulomb_friction"), SHAKEN, {"x": 0.3}),
    "rotor": ("planar_rotor", ("gyroscopic", "crack"), SPEED, {"x": 1e-3}),
    "tanks": ("cascaded_tanks", ("overflow", "sensor_saturation"), PUMPED, FULL),
}


@dataclass(frozen=True)
class Machine:
    model: Model
    inputs: dict
    start: dict
    states: np.ndarray
    readings: np.ndarray

    @property
    def traced(self):
        return trace(self.model.system, self.model.effects)

    @property
    def grid(self):
        """Inputs and time at each half step."""
        system = self.model.system
        quiet = dict(zip(system.observed, self.readings.T, strict=True))
        frame = make_record(system, "planned", TIME, quiet, self.inputs)
        return half_step_inputs(system, frame, SUBSTEPS)

    @property
    def point(self):
        """A state, and the inputs with time behind them, at which Jacobians are compared."""
        u = np.linspace(0.4, 1.3, len(self.traced.inputs))
        return self.states[7] + 0.01, u

    @property
    def jacobians(self):
        """f_x, f_p, h_x, h_p as the fit uses them."""
        traced, (x, u) = self.traced, self.point
        compiled, p = compile_model(traced), self.model.row("", "")
        found = []
        for function, rows in ((compiled.rate, len(x)), (compiled.output, len(traced.channels))):
            by_x, by_p = np.zeros((rows, len(x))), np.zeros((rows, len(p)))
            function(x, u, p, np.empty(rows), by_x, by_p)
            found += [by_x, by_p]
        return found


@pytest.fixture(scope="module", params=MACHINES)
def machine(request):
    name, effects, inputs, start = MACHINES[request.param]
    model = seed_model(
        REGISTRY.make("system", name), tuple(map(REGISTRY.effect_from_label, effects))
    )
    values = {k: 0.2 + 0.1 * i for i, (k, _) in enumerate(model.pairs)}
    model = replace(model, values=values, errors={next(iter(values)): 0.01})
    return Machine(model, inputs, start, *integrate(model, TIME, inputs, start, SUBSTEPS))


def same(found, wanted):
    scale = np.abs(wanted).max() or 1.0
    np.testing.assert_allclose(np.asarray(found).reshape(wanted.shape) / scale, wanted / scale,
                               atol=CLOSE, rtol=0)  # fmt: skip


def module_of(text, folder, name="exported"):
    """A module from its text, imported as a user would."""
    file = folder / f"{name}.py"
    file.write_text(text, encoding="utf-8")
    spec = importlib.util.spec_from_file_location(name, file)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_python_module_runs_as_we_do(machine, tmp_path):
    module = module_of(spiral.export(machine.model, "python"), tmp_path)
    states, readings = module.simulate(TIME, machine.inputs, machine.start, substeps=SUBSTEPS)
    same(states, machine.states)
    same(readings, machine.readings)
    x, u = machine.point
    slopes = (*module.jacobian(u[-1], x, u), *module.readings_jacobian(u[-1], x, u))
    for found, wanted in zip(slopes, machine.jacobians, strict=True):
        same(found, wanted)
    many = module.rhs(0.1, np.column_stack([x, 2 * x]), np.column_stack([u, u]))
    same(many[:, 1], module.rhs(0.1, 2 * x, u))
    assert machine.model.values == module.PARAMETERS
    assert [k for k, e in module.STANDARD_ERRORS.items() if e] == list(machine.model.errors)
    known = machine.model.unit
    assert all(module.UNITS[k] == known(k) for k in module.PARAMETERS)


@pytest.fixture(scope="module")
def hysteresis():
    """A model that has all values, for what is not about its motion."""
    effect = REGISTRY.effect_from_label("bouc_wen")
    model = seed_model(REGISTRY.make("system", "oscillator"), (effect,))
    return replace(model, values={k: 1.0 + i for i, (k, _) in enumerate(model.pairs)})


@pytest.fixture
def saved(hysteresis, tmp_path, monkeypatch):
    """The id of a saved run, whose folder of runs lies in the working folder."""
    monkeypatch.chdir(tmp_path)
    return save_result("discover", {}, hysteresis, {}, {}, REGISTRY, "runs")


@pytest.mark.parametrize("kind", KINDS)
def test_a_saved_run_is_exported(saved, kind, capsys):
    assert main(["export", saved[:20], "--to", kind, "--json", "-"]) == 0
    found = json.loads(capsys.readouterr().out)
    file = Path(found["file"])
    assert file.parent.name == found["run"] == saved
    assert file.suffix == KINDS[kind].suffix
    assert file.stat().st_size == found["bytes"] > 100
    assert main(["export", "latest", "--to", kind, "--out", f"own{file.suffix}"]) == 0
    assert "the model of run" in capsys.readouterr().out
    assert Path(f"own{file.suffix}").stat().st_size == found["bytes"]


@pytest.mark.parametrize(
    "words",
    [
        ["latest"],
        ["latest", "--to", "fortran"],
        ["nowhere", "--to", "python"],
        ["latest", "run=latest", "--to", "python"],
        ["latest", "rnu=1", "--to", "python"],
        ["latest", "--to", "python", "--out", "no/such/folder/a.py"],
    ],
)
def test_what_cannot_be_exported_is_said(saved, words, capsys):
    assert main(["export", *words]) == 2
    told = capsys.readouterr().err
    assert "given:" in told
    assert "expected:" in told


def test_a_model_without_values_is_refused():
    with pytest.raises(ConfigError, match=r"no value for system\.mass"):
        spiral.export(seed_model(REGISTRY.make("system", "oscillator")), "python")


def test_identifiers_are_ascii_words_that_differ():
    names = ("a.b", "a@b", "for", "2nd", "*/ x", "température", "part_1")
    items = [Item(n, "", sp.Symbol(f"s{i}")) for i, n in enumerate(names)]
    found = list(identifiers(items, ("for",)).values())
    assert found == ["a_b", "a_b_", "for_", "n2nd", "x", "temp_rature", "the_part_1"]


EVIL = '"; import os \\\n*/ evil() /* \'\'\'"""\r\u2028 %} ??/ \\input{evil} <evil> ]]> $(evil)'


@pytest.fixture(scope="module")
def hostile():
    """A model as a run.json of anyone may name its parts: a label that holds code."""
    effect = REGISTRY.effect_from_label("cubic_stiffness", {"variant": EVIL})
    model = seed_model(REGISTRY.make("system", "oscillator"), (effect,))
    return replace(model, values={k: 1.0 for k, _ in model.pairs})


def test_texts_end_no_comment_and_no_string():
    marks = ('"', "\\", "*/", "/*", "\n", "\r", "\u2028", "'''", "??")
    assert not any(mark in plain(EVIL) for mark in marks)


def test_a_hostile_name_stays_a_text_in_python(hostile, tmp_path):
    text = spiral.export(hostile, "python")
    calls = {ast.unparse(n.func) for n in ast.walk(ast.parse(text)) if isinstance(n, ast.Call)}
    assert "evil" not in calls
    module = module_of(text, tmp_path)
    assert f"cubic_stiffness#{EVIL}.stiffness" in module.PARAMETERS
    assert module.rhs(0.0, [2.0, 0.0], [0.0])[1] == -2 - 8


needs_a_compiler = pytest.mark.skipif(shutil.which("gcc") is None, reason="no gcc here")
STRICT = ("-std=c99", "-O1", "-Wall", "-Wextra", "-Werror", "-pedantic")


def compiled(text, folder):
    """The functions of a C file, by gcc without a single warning."""
    (folder / "model.c").write_text(text, encoding="utf-8")
    command = ["gcc", *STRICT, "-shared", "-fPIC", "-o", "model.so", "model.c", "-lm"]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return ctypes.CDLL(str(folder / "model.so"))


def doubles(array):
    return array.ctypes.data_as(ctypes.POINTER(ctypes.c_double))


@needs_a_compiler
def test_the_c_file_runs_as_we_do(machine, tmp_path):
    library = compiled(spiral.export(machine.model, "c"), tmp_path)
    name = machine.model.system.plugin_name()
    call = {f: getattr(library, f"{name}_{f}") for f in (
        "step", "readings", "jacobian", "readings_jacobian")}  # fmt: skip
    p = ctypes.byref(ctypes.c_double.in_dll(library, f"{name}_estimates"))
    double = ctypes.c_double
    grid, step = machine.grid, (TIME[1] - TIME[0]) / SUBSTEPS
    u = np.ascontiguousarray(grid[:, :-1])
    x, y = machine.states[0].copy(), np.empty(machine.readings.shape[1])
    states, readings = [], []
    for k in range(SUBSTEPS * (len(TIME) - 1) + 1):
        if k % SUBSTEPS == 0:
            call["readings"](double(grid[2 * k, -1]), doubles(x), doubles(u[2 * k]), p, doubles(y))
            states.append(x.copy())
            readings.append(y.copy())
        if 2 * k + 2 < len(u):
            rows = u[2 * k : 2 * k + 3]
            call["step"](double(grid[2 * k, -1]), double(step), doubles(rows), p, doubles(x))
    same(states, machine.states)
    same(readings, machine.readings)
    x, u = machine.point
    wanted = machine.jacobians
    found = [np.full_like(w, np.nan) for w in wanted]
    call["jacobian"](double(u[-1]), doubles(x), doubles(u), p, *map(doubles, found[:2]))
    call["readings_jacobian"](double(u[-1]), doubles(x), doubles(u), p, *map(doubles, found[2:]))
    for one, other in zip(found, wanted, strict=True):
        same(one, other)
    errors = ctypes.c_double.in_dll(library, f"{name}_standard_errors").value
    assert errors == next(iter(machine.model.errors.values()))


@needs_a_compiler
def test_a_hostile_name_stays_a_comment_in_c(hostile, tmp_path):
    text = spiral.export(hostile, "c")
    compiled(text, tmp_path)
    assert not re.search(r"\bevil\b", re.sub(r"/\*.*?\*/", "", text, flags=re.DOTALL))
