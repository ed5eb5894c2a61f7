"""The README's five minutes: on a short record, and (slow) as written."""

import json
import re
from itertools import pairwise
from pathlib import Path

import pytest

from spiral.cli import main

ROOT = Path(__file__).parents[2]
# tests/contract shows both: what MLflow is told (test_tracking), the curves (test_report).
WITHOUT = ("tracking.enabled=false", "curves=false")


def _commands() -> list[list[str]]:
    text = (ROOT / "README.md").read_text()
    block = re.search(r"## Five minutes by hand.*?```\n(.*?)```", text, re.DOTALL)
    assert block is not None
    return [line.split()[1:] for line in block[1].splitlines()]


def test_the_tutorial_of_the_site_takes_the_same_steps():
    text = (ROOT / "docs" / "tutorial.md").read_text(encoding="utf-8")
    steps = [line.split()[1:] for line in text.splitlines() if line.startswith("spiral ")]
    assert [s for s in steps if s[0] not in ("discover", "report")] == _commands()


SHORT = (  # of 14 s, and of the catalog what is hidden and what looks like it
    "record.duration=3", "test.duration=3",
    "candidates=[cross_stiffness,cubic_stiffness,gyroscopic,cross_damping,rub,clearance,"
    "coulomb_friction,quadratic_damping]",
)  # fmt: skip


@pytest.fixture(
    scope="module",
    params=[
        pytest.param(SHORT, id="short", marks=pytest.mark.slow),
        pytest.param((), id="as written", marks=pytest.mark.slow),
    ],
)
def results(request, tmp_path_factory):
    found = []
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(tmp_path_factory.mktemp("tutorial"))
        for words in _commands():
            own = () if "run=latest" in words else request.param  # a run brings its records
            assert main([*words, *own, *WITHOUT, "--json", "found.json"]) == 0
            found.append((words, json.loads(Path("found.json").read_text())))
    return found


def test_the_tutorial_has_its_six_steps(results):
    assert [w[0] for w, _ in results] == ["compare", "diagnose", "add", "add", "diagnose", "add"]


def test_diagnose_names_what_is_then_added(results):
    first = results[1][1]["suggestions"][0]
    assert first["effect"] == results[2][0][1] == "cross_stiffness"
    assert results[1][1]["verdict"] == "effect_missing"
    assert first["test_error_after"] < first["test_error_before"]
    assert results[4][1]["suggestions"][0]["effect"] == results[5][0][1] == "gyroscopic"


def test_the_error_falls_at_every_step_down_to_the_noise(results):
    """A model that lacks something is fitted roughly, and its noise in more than one way.

    So what a step begins with is what the last one ended with only to a tenth.
    """
    steps = [r for w, r in results if w[0] == "add"]
    for step in steps:
        assert step["after"]["test_error"] < step["before"]["test_error"]
    for earlier, later in pairwise(steps):
        assert later["before"]["test_error"] == pytest.approx(
            earlier["after"]["test_error"], rel=0.1
        )
    last = steps[-1]["after"]
    assert last["test_error"] <= 1.5 * last["noise_floor"]
    assert set(steps[-1]["model"]["effects"]) >= {
        "cross_stiffness",
        "cubic_stiffness",
        "gyroscopic",
    }
