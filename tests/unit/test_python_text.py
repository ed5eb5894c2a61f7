"""The program that the page offers does what the study's overrides do."""

from dataclasses import replace

import numpy as np
import pytest

import spiral
from spiral.app.python_text import non_default_options, program_text
from spiral.app.study import Study, StudyState
from spiral.inference.compare import compare
from spiral.io.config import build_problem, compose
from tests.scenes import registry

KNOWN = registry()
YAML = """
equations: ["m*x'' + c*x' + k*x = force"]
states: {x: m}
inputs: {force: N}
parameters: {m: 1.0 kg, c: N*s/m, k: N/m}
observed: [x]
"""


def study(*overrides, added=()):
    turns = tuple(
        StudyState(i, name, parent=i - 1 if i else None) for i, name in enumerate(("", *added))
    )
    told = non_default_options(compose(overrides, KNOWN), KNOWN)
    return Study("20260101-000000-abc", "bench", overrides, "", turns, len(added), program=told)


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    """A hardening spring, 3 s at 400 Hz, with a test file beside it."""
    folder = tmp_path_factory.mktemp("bench")
    for seed in (1, 2):
        record = spiral.simulate(
            "oscillator", 3.0, 400.0, inputs={"force": {"noise": 1.0, "band": [2, 40]}},
            values={"system.mass": 1.0, "linear_stiffness.stiffness": 4e3,
                    "linear_damping.damping": 4.0, "cubic_stiffness.stiffness": 3e9},
            effects=["cubic_stiffness"], noise_level=0.02, seed=seed,
        )  # fmt: skip
        table = np.column_stack([record.time, 1e3 * record.channels["x"], record.inputs["force"]])
        np.savetxt(folder / f"it's {seed}.csv", table, "%.9g", delimiter=",",
                   header="t,probe,force", comments="")  # fmt: skip
    (folder / "own.yaml").write_text(YAML)
    return folder


@pytest.mark.parametrize("system", ["oscillator", "own.yaml"])
def test_the_program_gives_the_errors_of_the_overrides(bench, system):
    """Records, units, rows, a test file, choices and what was added."""
    name = str(bench / system) if system.endswith("yaml") else system
    files = [str(bench / f"it's {seed}.csv").replace("'", "\\'") for seed in (1, 2)]
    given = study(
        f"system={name}", "record=file", f"record.path='{files[0]}'", "record.time=t",
        "record.channels={x: probe}", "record.units={x: mm}", "record.rows=[0,1000]",
        f"test.path='{files[1]}'", "test.settle=0.2",
        "candidates=[cubic_stiffness,quadratic_damping]", added=("cubic_stiffness",),
    )  # fmt: skip
    text = program_text(given, bench)
    names = {}
    exec(text, names)  # what a person would run
    config = compose((*given.overrides, "effect=[cubic_stiffness]"), KNOWN)
    wanted = compare(build_problem(config, KNOWN))
    assert names["found"].comparison.test_error == pytest.approx(wanted.test_error, rel=1e-9)
    assert names["record"].samples == 1000
    assert names["test"].samples == 1200  # its own rows, all of them


def test_an_embedded_record_is_read_by_its_name():
    text = program_text(study("experiment=rotor_coastdown"), "runs")
    names = {}
    exec(text.partition("found =")[0], names)
    assert (names["record"].name, names["test"].name) == (
        "rotor_coastdown, seed 11", "rotor_coastdown, seed 1011",
    )  # fmt: skip


def test_a_formula_of_ones_own_has_the_saved_model_instead(bench):
    given = study("experiment=rotor_coastdown", "effect.soft.expression=-k3*q**3")
    assert program_text(given, bench) == ""  # before it is saved
    saved = replace(given, turns=(StudyState(0, run_id="20260101-000000-abc"),))
    assert "spiral.load('20260101-000000-abc', " in program_text(saved, bench)
