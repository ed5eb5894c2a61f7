"""FMUs as systems: they compute what their equations do, and run only where the user named them."""

import json
import pickle
import shutil
import threading
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from spiral_plugins.systems.fmu import Fmu

import spiral
from experiments.fmu.build import fmu, native, system
from experiments.fmu.kinds import CASES, KINDS
from spiral.io.programs import programs_named
from spiral.io.registry import NO_FOLDER, load_registry
from spiral.io.storage import model_data, rebuild_model
from spiral.io.testing import check_system, failed
from spiral.physics.compile import compile_model
from spiral.physics.outside import fmi
from spiral.physics.signatures import SystemMotion, _injection_gain_along
from spiral.physics.trace import trace
from spiral.types.errors import ConfigError, SpiralError
from spiral.types.label import parameter_of
from spiral.types.model import seed_model
from spiral.types.placement import input_columns
from tests.scenes import evaluated

pytest.importorskip("fmpy", reason="FMPy is not installed")
OF = {f"{c.kind}_{c.way}": c for c in CASES}
SHOWN = ["quarter_car_3", "quarter_car_C", "cylinder_2", "cylinder_C"]


@pytest.fixture(scope="module")
def opened(tmp_path_factory):
    """Name -> file, the FMU as a system, and its equations."""
    if shutil.which("gcc") is None:
        pytest.skip("no gcc here")
    folder, found = tmp_path_factory.mktemp("fmu"), {}
    for name in SHOWN:
        case, kind = OF[name], KINDS[OF[name].kind]
        file = fmu(case, kind, folder)
        found[name] = file, system(case, kind, file), native(kind)
    return found


@pytest.mark.parametrize("name", SHOWN)
def test_rates_and_slopes_are_those_of_the_equations(opened, name):
    """With a force through an input, slopes by all states and parameters."""
    _, model, due = opened[name]
    effect = load_registry(NO_FOLDER).effect_from_label("cubic_stiffness")
    values, count = {"cubic_stiffness.stiffness": 4e6}, len(due.parameters)
    rng = np.random.default_rng(3)
    own = [s.name for s in due.states]
    mine = [model.rate_name(n.removesuffix("_rate")) if n.endswith("_rate") else n for n in own]
    at = [[s.name for s in model.states].index(n) for n in mine]
    for _ in range(3):
        x, u = rng.normal(size=len(own)) * 0.01, [0.02, 0.3]
        f, by_x, by_p = evaluated(due, (effect,), values, (x, u))
        g, by_y, by_q = evaluated(model, (effect,), values, (x[np.argsort(at)], u))
        assert g[at] == pytest.approx(f, rel=1e-9, abs=1e-9)
        size = np.abs(by_x).max(axis=1, keepdims=True)
        assert np.all(np.abs(by_y[np.ix_(at, at)] - by_x) <= 1e-6 * size)
        columns = [*range(count), -1]  # of the machine, and of the effect
        least = 1e-6 * (np.abs(by_p) + size / 1e3)[:, columns]
        assert np.all(np.abs(by_q[at][:, columns] - by_p[:, columns]) <= least)


@pytest.mark.parametrize("name", SHOWN)
def test_an_fmu_is_a_system(opened, name):
    """What its description says; it passes the checks of every system."""
    _, model, due = opened[name]
    kind = KINDS[OF[name].kind]
    assert [p.name for p in model.ports] == [p.name for p in due.ports]
    assert {p.force_unit for p in model.ports} == set(kind.forces.values())
    assert model.observed == kind.observed
    assert [i.name for i in model.inputs] == [kind.input[0]]
    assert not failed(check_system(model))
    told = fmi.DIRECTIONAL if OF[name].way != "C" else fmi.DIFFERENCE
    whole = model.wrapped.program.whole
    assert whole[whole[fmi.Slot.KINDS]] == told


def test_threads_do_not_disturb_each_other(opened):
    """Eight threads ask one FMU for different arguments, parameters too."""
    program = opened["quarter_car_C"][1].wrapped.program
    points = np.random.default_rng(5).uniform(1, 2, size=(8, 400, len(program.arguments)))
    columns = range(len(program.arguments))
    due = [program.values_and_slopes(p, columns) for p in points]
    found = [None] * 8

    def ask(i):
        found[i] = program.values_and_slopes(points[i], columns)

    threads = [threading.Thread(target=ask, args=(i,)) for i in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for (values, slopes), (v, s) in zip(due, found, strict=True):
        assert np.array_equal(values, v)
        assert np.array_equal(slopes, s)


def test_another_process_opens_the_file_again(opened):
    _, model, _ = opened["cylinder_C"]
    again = pickle.loads(pickle.dumps(model))
    assert again == model
    assert again.wrapped is model.wrapped  # in this process the same


def spoilt(file, folder, change):
    """A copy of an FMU with other members: name, bytes -> name, bytes, or nothing."""
    target = folder / "spoilt.fmu"
    with zipfile.ZipFile(file) as source, zipfile.ZipFile(target, "w") as copy:
        for name in source.namelist():
            kept = change(name, source.read(name))
            if kept is not None:
                copy.writestr(*kept)
    return target


def _elsewhere(name, data):
    return name.replace("binaries/linux64", "binaries/win64").replace(".so", ".dll"), data


def _no_library(name, data):
    return name, b"no library" if name.startswith("binaries") else data


def _no_exchange(name, data):
    return name, data.replace(b"ModelExchange", b"CoSimulation")


def _no_description(name, data):
    return None if name == "modelDescription.xml" else (name, data)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (_elsewhere, ["binaries for win64", "one for"]),
        (_no_library, ["does not start", "Failed to load"]),
        (_no_exchange, ["co-simulation alone", "model exchange"]),
        (_no_description, ["modelDescription.xml"]),
    ],
)
def test_a_broken_or_foreign_fmu_is_refused_in_words(opened, tmp_path, change, said):
    place = Path.cwd()
    file = spoilt(opened["cylinder_C"][0], tmp_path, change)
    with pytest.raises(SpiralError) as caught:
        spiral.system(str(file), ports={"x": "F_x"})
    for words in said:
        assert words in str(caught.value)
    assert Path.cwd() == place


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"ports": {"x": "F"}}, ["an input 'F'", "F_x"]),
        ({"ports": {"P": "F_x"}}, ["a port at P", "whose rate is no state"]),
        ({"ports": {"x": "u"}}, ["the input u as a force on x", "acts on P"]),
        ({"observed": ["q"]}, ["observed: q"]),
        ({"free": ["q"]}, ["free 'q'"]),
        ({"mass": {"x": "m"}}, ["and mass"]),
    ],
)
def test_names_that_an_fmu_has_not_are_refused(opened, given, said):
    with pytest.raises(ConfigError) as caught:
        spiral.system(str(opened["cylinder_C"][0]), **given)
    for words in said:
        assert words in str(caught.value)


def test_only_a_file_that_the_user_named_is_run(opened):
    """A saved run names an FMU; a registry without the user's word does not open it."""
    file, model, _ = opened["quarter_car_C"]
    saved = json.loads(json.dumps(model_data(seed_model(model))))
    with pytest.raises(ConfigError, match="runs with your rights"):
        rebuild_model(saved, load_registry(NO_FOLDER))
    named = programs_named([f"system={file}", "record=csv"])
    assert named == programs_named([f"system.path={file}"]) == {str(file)}
    registry = replace(load_registry(NO_FOLDER), programs=named)
    assert rebuild_model(saved, registry).system == model


def test_a_file_that_changed_is_told(opened, tmp_path):
    _, model, _ = opened["quarter_car_C"]
    saved = model_data(seed_model(model))["system"]
    other = tmp_path / "other.fmu"
    shutil.copy(opened["cylinder_C"][0], other)
    with pytest.raises(SpiralError, match="SHA-256"):
        Fmu(path=str(other), sha256=saved["sha256"])


def test_a_model_around_a_program_is_text_and_no_code(opened):
    """The effect as an equation; C cannot hold an FMU."""
    model = seed_model(opened["quarter_car_C"][1])
    effect = load_registry(NO_FOLDER).effect_from_label("cubic_stiffness@b_w")
    model = model.add(effect, {"cubic_stiffness@b_w.stiffness": 2.0})
    text = spiral.export(model, "text")
    assert "b'' = f[v_b]" in text.replace("v_b'", "b''")
    assert "df[v_b]/dF_b" in text
    with pytest.raises(ConfigError, match="around the program"):
        spiral.export(model, "c")


@pytest.mark.slow
@pytest.mark.parametrize("name", ["quarter_car_3", "cylinder_C"])
def test_what_is_hidden_behind_an_fmu_is_named(opened, name):
    """As in experiments/fmu, by all effects that fit."""
    from experiments.fmu.__main__ import asked, record

    case, kind = OF[name], KINDS[OF[name].kind]
    run, _ = asked(record(case, kind), opened[name][1], kind)
    assert run.missing == (case.effect,)


@pytest.mark.parametrize("name", ["quarter_car_3", "cylinder_C"])
def test_scores_know_that_a_force_goes_through_an_input(opened, name):
    """The slope of the rates by a force: the program's own, and not 1 over the mass around it."""
    model, rng = opened[name][1], np.random.default_rng(4)
    x, u = 0.1 * rng.normal(size=len(model.states)), rng.normal(size=len(input_columns(model)))
    given = {p.name: p.start for p in model.parameters}
    values = given | {parameter_of(k): v for k, v in model.defaults.items()}
    seen = np.zeros((1, len(model.observed)))
    gain = _injection_gain_along(SystemMotion(model, x[None], u[None], 0 * x[None], seen, values))
    names = [i.name for i in model.injections]
    for port in (p for p in model.ports if p.axes == (p.name,)):
        load = load_registry(NO_FOLDER).effect_from_label(f"constant_load@{port.name}")
        key = f"{load.label}.force"
        still, pushed = (evaluated(model, (load,), {key: f}, (x, u))[0] for f in (0.0, 1.0))
        slope = gain[0, :, names.index(port.name)]
        assert slope == pytest.approx(pushed - still, rel=1e-4, abs=1e-9)  # by differences
        assert np.any(slope)


def test_an_acceleration_of_an_fmu_is_a_channel(opened):
    """The rate of a state as the program tells it, a force through an input within it."""
    file, model, _ = opened["quarter_car_3"]
    velocity, given = model.rate_name("b"), {"ports": {"b": model.wrapped.pushed[0][1]}}
    told = spiral.system(str(file), observed=["b", f"body = {velocity}'"], **given)
    assert told.observed == ("b", "body")
    assert told.unit_of("body") == told.readings[0].unit
    assert not failed(check_system(told))
    effect = load_registry(NO_FOLDER).effect_from_label("cubic_stiffness@b")
    x, u = np.array([0.02, -0.01, 0.3, 0.1]), [0.02, 0.3]
    rates = evaluated(told, (effect,), {"cubic_stiffness@b.stiffness": 4e6}, (x, u))[0]
    traced = trace(told, (effect,))
    compiled = compile_model(traced)
    values = [4e6 if k.startswith("cubic") else p.start for k, p in
              zip(traced.keys, traced.parameters, strict=True)]  # fmt: skip
    readings = np.empty(2)
    compiled.output_value(x, np.array(u), np.array(values), readings)
    assert readings[1] == pytest.approx(rates[traced.states.index(velocity)], rel=1e-12)
