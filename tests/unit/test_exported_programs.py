"""An exported program runs as we do: same inputs, same step, same motion, same Jacobians."""

import ast
import ctypes
import importlib.util
import json
import re
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import sympy as sp

import spiral
from spiral.cli import main
from spiral.engine.series import stage_inputs
from spiral.io.export.kinds import KINDS
from spiral.io.export.names import sanitise_text
from spiral.io.export.program import ProgramVariable, identifiers
from spiral.io.storage import save_result
from spiral.types.errors import ConfigError
from spiral.types.model import seed_model
from spiral.types.record import make_record
from tests.exported import (
    EVIL,
    MACHINES,
    REGISTRY,
    STEP,
    SUBSTEPS,
    TIME,
    doubles,
    hostile_model,
    machine_of,
    same,
)

TEXTS = [name for name, kind in KINDS.items() if not kind.archive]
needs_a_compiler = pytest.mark.skipif(shutil.which("gcc") is None, reason="no gcc here")


@pytest.fixture(scope="module", params=MACHINES)
def machine(request):
    return machine_of(request.param)


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


def test_the_python_module_takes_noise_from_an_input_as_we_do(tmp_path):
    system = spiral.system(
        ["L*i' = u - R*i"], states={"i": "A"}, observed=["i"],
        inputs={"u": {"unit": "V", "interpolation": "denoised"}},
        parameters={"L": "0.01 H", "R": "2 ohm"},
    )  # fmt: skip
    model = seed_model(system, values={"system.L": 0.01, "system.R": 2.0})
    module = module_of(spiral.export(model, "python"), tmp_path)
    time, rng = np.arange(400) / 1e3, np.random.default_rng(0)
    u = np.sin(60 * time) + 0.05 * rng.normal(size=400)
    record = make_record(system, "r", time, {"i": rng.normal(size=400)}, {"u": u})
    wanted = stage_inputs(system, record, SUBSTEPS)[:, :1]
    same(module.stage_inputs(time, {"u": u}, SUBSTEPS), wanted)
    assert np.abs(wanted[:: 3 * SUBSTEPS, 0] - u).std() > 0.01


HYPERBOLIC = """
equations: ["x' = -a*sinh(x/w)*cosh(x/w) + b*tanh(x/w)"]
states: {x: V}
parameters: {a: 0.7 V/s, b: 0.3 V/s, w: 2 V}
free: [a]
observed: [x]
"""


@pytest.mark.parametrize("kind", TEXTS)
def test_hyperbolic_functions_of_a_file_are_in_every_text(kind, tmp_path):
    """x' of the Python module is that of the formula; the others name the functions."""
    system = REGISTRY.make("system", "equations", {"text": HYPERBOLIC})
    model = replace(seed_model(system), values=dict(system.defaults))
    text = spiral.export(model, kind)
    assert all(name in text for name in ("sinh", "cosh", "tanh"))
    if kind == "python":
        wanted = -0.7 * np.sinh(0.6) * np.cosh(0.6) + 0.3 * np.tanh(0.6)
        same(module_of(text, tmp_path).rhs(0.0, [1.2], []), np.array([wanted]))
    if kind == "c" and shutil.which("gcc"):
        compiled(text, tmp_path)


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


@pytest.mark.parametrize("kind", [*TEXTS, pytest.param("fmu", marks=needs_a_compiler)])
def test_a_saved_run_is_exported(saved, kind, capsys):
    assert main(["export", saved[:20], "--to", kind, "--json", "-"]) == 0
    found = json.loads(capsys.readouterr().out)
    file = Path(found["file"])
    assert file.parent.name == found["run"] == saved
    assert file.name.endswith(KINDS[kind].suffix)
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


def test_a_unit_that_is_none_is_refused():
    model = seed_model(REGISTRY.make("system", "oscillator", {"position_unit": EVIL}))
    with pytest.raises(ConfigError, match="a unit, such as"):
        spiral.export(replace(model, values={k: 1.0 for k, _ in model.pairs}), "python")


def test_identifiers_are_ascii_words_that_differ():
    names = ("a.b", "a@b", "for", "2nd", "*/ x", "température", "part_1")
    items = [ProgramVariable(n, "", sp.Symbol(f"s{i}")) for i, n in enumerate(names)]
    found = list(identifiers(items, ("for",)).values())
    assert found == ["a_b", "a_b_", "for_", "n2nd", "x", "temp_rature", "the_part_1"]


def test_texts_end_no_comment_and_no_string():
    marks = ('"', "\\", "*/", "/*", "\n", "\r", "\u2028", "'''", "??")
    assert not any(mark in sanitise_text(EVIL) for mark in marks)


def test_a_hostile_name_stays_a_text_in_python(tmp_path):
    text = spiral.export(hostile_model(), "python")
    calls = {ast.unparse(n.func) for n in ast.walk(ast.parse(text)) if isinstance(n, ast.Call)}
    assert "evil" not in calls
    module = module_of(text, tmp_path)
    assert f"cubic_stiffness#{EVIL}.stiffness" in module.PARAMETERS
    assert module.rhs(0.0, [2.0, 0.0], [0.0])[1] == -2 - 8


STRICT = ("-std=c99", "-O1", "-Wall", "-Wextra", "-Werror", "-pedantic")


def compiled(text, folder):
    """The functions of a C file, by gcc without a single warning."""
    (folder / "model.c").write_text(text, encoding="utf-8")
    command = ["gcc", *STRICT, "-shared", "-fPIC", "-o", "model.so", "model.c", "-lm"]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return ctypes.CDLL(str(folder / "model.so"))


@needs_a_compiler
def test_the_c_file_runs_as_we_do(machine, tmp_path):
    library = compiled(spiral.export(machine.model, "c"), tmp_path)
    name = machine.model.system.plugin_name()
    call = {f: getattr(library, f"{name}_{f}") for f in (
        "step", "readings", "jacobian", "readings_jacobian")}  # fmt: skip
    p = ctypes.byref(ctypes.c_double.in_dll(library, f"{name}_estimates"))
    double = ctypes.c_double
    grid = machine.grid
    u = np.ascontiguousarray(grid[:, :-1])
    x, y = machine.states[0].copy(), np.empty(machine.readings.shape[1])
    states, readings = [], []
    for k in range(SUBSTEPS * (len(TIME) - 1) + 1):
        if k % SUBSTEPS == 0:
            call["readings"](double(grid[3 * k, -1]), doubles(x), doubles(u[3 * k]), p, doubles(y))
            states.append(x.copy())
            readings.append(y.copy())
        if 3 * k + 2 < len(u):
            rows = u[3 * k : 3 * k + 3]
            call["step"](double(grid[3 * k, -1]), double(STEP), doubles(rows), p, doubles(x))
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
def test_a_hostile_name_compiles(tmp_path):
    compiled(spiral.export(hostile_model(), "c"), tmp_path)


def test_the_casadi_file_runs_as_we_do(machine, tmp_path):
    pytest.importorskip("casadi", reason="CasADi is not installed")
    module = module_of(spiral.export(machine.model, "casadi"), tmp_path, "exported_casadi")
    p = list(module.PARAMETERS.values())
    grid, x, states = machine.grid, machine.states[0], []
    for k in range(SUBSTEPS * (len(TIME) - 1)):
        if k % SUBSTEPS == 0:
            states.append(np.array(x).ravel())
        x = module.step(grid[3 * k, -1], STEP, x, grid[3 * k : 3 * k + 3, :-1].T, p)
    same(np.array(states), machine.states[:-1])
    x, u = machine.point
    given = (u[-1], x, u[:-1], p)
    slopes = (*module.jacobian(*given), *module.readings_jacobian(*given))
    for found, wanted in zip(slopes, machine.jacobians, strict=True):
        same(found.full(), wanted)
    same(module.readings(*given).full(), machine.values(*machine.point)[1])


MATLAB = {".*": "*", "./": "/", ".^": "**", "~=": "!=", "&": " and ", "|": " or ", "~": " not "}
CHOICES = {"pick": lambda condition, first, second: first if condition else second}


def calculated(lines, marks, known):
    """Lines NAME = EXPRESSION; of another language, whose operators are replaced by Python's."""
    names = {**vars(np), **CHOICES, **known}
    for line in lines:
        name, _, text = line.strip().rstrip(";").partition(" = ")
        for theirs, ours in marks.items():
            text = text.replace(theirs, ours)
        names[name] = eval(text, {}, names)
    return names


def test_the_matlab_file_says_what_is_integrated(machine):
    """MATLAB and Octave are not here: the file's expressions are calculated by Python instead."""
    text = spiral.export(machine.model, "matlab")
    values = dict(re.findall(r"model\.parameters\.(\w+) = (\S+);", text))
    assert list(map(float, values.values())) == list(machine.model.row("", ""))
    x, u = machine.point
    p = SimpleNamespace(**{k: float(v) for k, v in values.items()})
    known = {"x": lambda i: x[i - 1], "u": lambda i: u[i - 1], "p": p, "t": u[-1]}

    def body(name):
        lines = re.search(rf"= {name}\(.*?\n%.*?\n(.*?)\nend", text, re.DOTALL)[1].splitlines()
        return calculated([line for line in lines if "zeros(" not in line], MATLAB, known)

    for name, array, wanted in zip(("rhs", "readings"), "fy", machine.values(x, u), strict=True):
        found = body(name)
        same(np.array([found[f"{array}({i + 1})"] for i in range(len(wanted))]), wanted)
    slopes = [body(name) for name in ("jacobian", "readings_jacobian") for _ in range(2)]
    arrays = ("by_x", "by_p") * 2
    for found, array, wanted in zip(slopes, arrays, machine.jacobians, strict=True):
        places = np.ndindex(*wanted.shape)
        same(np.array([found.get(f"{array}({i + 1}, {j + 1})", 0) for i, j in places]), wanted)


@pytest.mark.skipif(shutil.which("octave-cli") is None, reason="no Octave here")
def test_octave_runs_the_matlab_file(machine, tmp_path):
    name = machine.model.system.plugin_name()
    spiral.export(machine.model, "matlab", tmp_path / f"{name}.m")
    x, u = machine.point
    ask = (
        f"m = {name}(); printf('%.17g ', m.rhs({u[-1]}, {x.tolist()}, {u.tolist()}, m.parameters))"
    )
    done = subprocess.run(
        ["octave-cli", "--eval", ask], cwd=tmp_path, capture_output=True, text=True, check=True
    )
    same(np.array(done.stdout.split(), float), machine.values(*machine.point)[0])


def test_the_modelica_model_says_what_is_integrated(machine):
    """No Modelica tool is here: the equations are calculated by Python instead."""
    text = spiral.export(machine.model, "modelica")
    values = dict(re.findall(r"parameter Real (\w+).*? = (\S+) \"", text))
    assert list(map(float, values.values())) == list(machine.model.row("", ""))
    x, u = machine.point
    states = re.findall(r"^  Real (\w+)\(.*fixed = true\)", text, re.MULTILINE)
    inputs = re.findall(r"^  input Real (\w+)", text, re.MULTILINE)
    outputs = re.findall(r"^  output Real (\w+)", text, re.MULTILINE)
    known = {k: float(v) for k, v in values.items()} | {"time": u[-1]}
    known |= dict(zip(states, x, strict=True)) | dict(zip(inputs, u, strict=False))
    marks = {"noEvent(if ": "pick(", "(if ": "pick(", " then ": ", ", " else ": ", ", "^": "**",
             "<>": "!="}  # fmt: skip
    found = calculated(text.split("equation\n")[1].split("end ")[0].splitlines(), marks, known)
    rates, readings = machine.values(*machine.point)
    same(np.array([found[f"der({s})"] for s in states]), rates)
    same(np.array([found[o] for o in outputs]), readings)


@pytest.mark.parametrize("kind", TEXTS)
def test_a_hostile_name_is_nowhere_code(kind, tmp_path):
    """Outside comments and strings its words are at most parts of an identifier."""
    file = spiral.export(hostile_model(), kind, tmp_path / "model")
    text = file.read_text(encoding="utf-8")
    assert "\u2028" not in text
    comments = {"c": r"/\*.*?\*/", "modelica": r'/\*.*?\*/|"[^"\n]*"',
                "latex": r"\\text\{(\\.|[^}])*\}",
                "matlab": r"%[^\n]*|'(''|[^'\n])*'"}  # fmt: skip
    if kind in comments:
        left = re.sub(comments[kind], "", text, flags=re.DOTALL)
        assert not re.search(r"\bevil\b", left)
        assert r"\input" not in text
