"""The interface for notebooks and programs: one import, strings or objects, the same answers."""

from dataclasses import replace

import numpy as np
import pytest

import spiral
from spiral.types.errors import ConfigError, SpiralError

TRUTH = {"system.mass": 1.0, "linear_stiffness.stiffness": 4e3, "linear_damping.damping": 4.0,
         "cubic_stiffness.stiffness": 3e9}  # fmt: skip
CANDIDATES = ["cubic_stiffness", "quadratic_damping"]


@pytest.fixture(scope="module")
def record():
    return spiral.simulate(
        "oscillator", 6.0, 400.0, inputs={"force": {"noise": 1.0, "band": [2, 40]}}, values=TRUTH,
        effects=["cubic_stiffness"], noise_level=0.02, seed=1,
    )  # fmt: skip


@pytest.fixture(scope="module")
def run(record):
    return spiral.discover(record, "oscillator", candidates=CANDIDATES)


def test_what_is_fixed_may_be_given_with_its_value(record):
    mass = {"system.mass": 1.25}
    held = spiral.compare(record, "oscillator", fixed=mass).model
    same = spiral.compare(record, "oscillator", fixed=["system.mass"], values=mass).model
    assert held.values["system.mass"] == 1.25
    assert held.estimates() == same.estimates()


def test_the_main_job_takes_one_import(run):
    assert run.verdict == "effect_missing"
    assert run.missing == ("cubic_stiffness",)
    table = run.estimates()
    row = table.loc[("cubic_stiffness", "stiffness")]
    assert abs(row["estimate"] - 3e9) < 4 * row["se"]


def test_a_run_shows_itself(run):
    text, notebook = repr(run), run._repr_markdown_()
    for shown in (text, notebook):
        assert "effect_missing" in shown
        assert "cubic_stiffness" in shown
        assert "Missing was" in shown
    assert len(text.splitlines()) < 8
    assert "array(" not in text
    assert notebook.count("\n|--:") == 1


def test_every_result_prints_a_short_text_and_is_a_table_in_a_notebook(run, record):
    found = spiral.estimate(run, record)
    identified = spiral.identify(record, "oscillator", candidates=CANDIDATES)
    for result in (record, run.model, run.final, found, identified):
        assert "array(" not in repr(result)
        assert len(repr(result)) < 800
    for result in (run.final, found, identified):
        assert "\n| --- |" in result._repr_markdown_()


def test_a_source_by_its_name():
    fields = {"name": "rotor_coastdown", "duration": 0.5, "seed": 3}
    record = spiral.read(fields, "planar_rotor")
    assert (record.samples, set(record.measured)) == (500, {"speed", "phase"})
    with pytest.raises(ConfigError, match="rotor_coastdown"):
        spiral.read({"name": "rotor_coastdwn"}, "planar_rotor")


def test_the_same_record_by_file_gives_the_same_answer(run, record, tmp_path):
    import pandas as pd

    file = tmp_path / "bench.csv"
    columns = {"t": record.time, "q": record.channels["x"] * 1e3, "f": record.inputs["force"]}
    pd.DataFrame(columns).to_csv(file, index=False, float_format="%.17g")
    again = spiral.read(file, "oscillator", time="t", channels={"x": "q"}, inputs={"force": "f"},
                        units={"x": "mm"}, noise=dict(record.noise))  # fmt: skip
    np.testing.assert_allclose(again.channels["x"], record.channels["x"], rtol=1e-12)
    other = spiral.discover(again, "oscillator", candidates=CANDIDATES)
    assert other.missing == run.missing
    for key, value in run.model.values.items():
        assert other.model.values[key] == pytest.approx(value, rel=1e-6)


def test_strings_and_objects_mean_the_same(record):
    from spiral_plugins.systems.oscillator import Oscillator

    by_name = spiral.compare(record, "oscillator")
    by_object = spiral.compare(record, Oscillator())
    by_fields = spiral.compare(record, {"name": "oscillator", "position_unit": "m"})
    assert by_name.as_dict() == by_object.as_dict() == by_fields.as_dict()


def test_add_goes_on_from_a_run(run):
    before, after, more = spiral.add(run, "quadratic_damping")
    assert more.model.labels == (*run.model.labels, "quadratic_damping")
    assert after.test_error == pytest.approx(before.test_error, rel=0.05)
    with pytest.raises(ConfigError, match="which the model has"):
        spiral.add(run, "cubic_stiffness")
    with pytest.raises(ConfigError, match="without its records"):
        spiral.add(replace(run, question=None), "quadratic_damping")


def test_hidden_states_and_richness(run, record):
    found = spiral.estimate(run, record)
    assert found.states["x_rate"].relative < 0.05
    assert spiral.identify(record, "oscillator", candidates=CANDIDATES).verdict == "identifiable"


def test_figures_and_report_are_functions_of_a_run(run, tmp_path):
    falling = spiral.plot.error_falling(run)
    assert falling is not None
    assert len(falling.data) >= 2
    drawn = spiral.plot.figures(run)
    assert {"error_falling", "evidence", "coefficients", "free_run"} <= set(drawn)
    file = spiral.report(run, tmp_path / "report.html")
    assert "cubic" in file.read_text(encoding="utf-8")
    assert "cubic_stiffness" in spiral.export(run)
    assert "\\begin{align*}" in spiral.export(run, "latex")


@pytest.mark.parametrize(("call", "hint"), [
    (lambda r: spiral.discover(r, "oscilator"), "'oscillator'"),
    (lambda r: spiral.discover(r, "oscillator", holdot=0.3), "'holdout'"),
    (lambda r: spiral.compare(r, "oscillator", effects=["cubic_stifness"]), "'cubic_stiffness'"),
    (lambda r: spiral.discover(r, "oscillator", strategy="shoting"), "'shooting'"),
    (lambda r: spiral.discover(r, "oscillator", settings={"levl": 0.1}), "'level'"),
    (lambda r: spiral.discover(r, "oscillator", holdout=0.99), "0.02 and 0.9"),
    (lambda r: spiral.read("nowhere.csv", "oscillator"), "nowhere.csv"),
    (lambda r: spiral.simulate("oscillator", 1.0, 100.0, inputs={"forc": 0.0}), "'force'"),
    (lambda r: spiral.export(spiral.Model, "latx"), "'latex'"),
    (lambda r: spiral.discover("oscillator", r), "the record first"),
    (lambda r: spiral.discover([r, 3.0], "oscillator"), "a float where a record belongs"),
    (lambda r: spiral.discover("record.csv", "oscillator"), "spiral.read("),
    (lambda r: spiral.discover(r, r), "a Record where a system belongs"),
])  # fmt: skip
def test_a_wrong_choice_is_refused_in_words(record, call, hint):
    with pytest.raises(SpiralError) as error:
        call(record)
    assert hint in str(error.value)


@pytest.mark.parametrize("what", ["report", "add", "figures"])
def test_what_needs_a_run_says_so(what, tmp_path):
    calls = {
        "report": lambda: spiral.report(object(), tmp_path / "report.html"),
        "add": lambda: spiral.add(object(), "cubic_stiffness"),
        "figures": lambda: spiral.plot.figures(object()),
    }
    with pytest.raises(SpiralError, match="a run, as"):
        calls[what]()


def test_what_is_added_by_hand_and_does_nothing_is_not_called_missing(run):
    _, _, more = spiral.add(run, "coulomb_friction")
    assert (more.verdict, more.missing) == ("nothing_missing", ())
    assert "does not determine coulomb_friction" in more.summary


def test_a_system_prints_what_it_is():
    system = spiral.system(
        ["m*x'' + c*x' + k*x = F"], states={"x": "m"}, inputs={"F": "N"}, observed=["x"],
        parameters={"m": "2 kg", "c": "3 N*s/m", "k": "400 N/m"}, free=["c", "k"],
    )  # fmt: skip
    lines = [" ".join(line.split()) for line in str(system).splitlines()]
    assert "x m measured" in lines
    assert "x_rate m/s hidden" in lines
    assert "m kg known, 2" in lines
    assert "k N/m to be found, from 400" in lines
    assert "| x | m | measured |" in system._repr_markdown_()
