"""The how-to pages: every block of code in them is run, in order, in an empty folder."""

import json
import os
import re
import shlex
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest

from spiral.cli import main

PAGES = Path(__file__).parents[2] / "docs" / "how-to"
BLOCK = re.compile(r"^```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)


@pytest.fixture(autouse=True)
def without_curves():
    """Pages are run as a reader runs them, MLflow apart (test_tracking.py)."""


@pytest.mark.parametrize("page", [
    pytest.param("own-effect.md", marks=pytest.mark.slow), "own-system.md", "../../README.md",
])  # fmt: skip
def test_every_block_runs(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    folder = Path(sys.executable).parent
    monkeypatch.setenv("PATH", f"{folder}{os.pathsep}{os.environ['PATH']}")
    monkeypatch.delenv("SPIRAL_PLUGINS", raising=False)
    blocks = BLOCK.findall((PAGES / page).read_text(encoding="utf-8"))
    assert {"bash", "python"} <= {language for language, _ in blocks}
    for language, text in blocks:
        if language == "python":
            if not text.startswith("# plugins/"):
                continue  # a part of a file that is there
            file = tmp_path / text.splitlines()[0].removeprefix("# ")
            file.parent.mkdir(exist_ok=True)
            file.write_text(text, encoding="utf-8")
        elif language == "toml":
            tomllib.loads(text)
        else:
            assert language == "bash"
            run_as_typed(text)


def run_as_typed(text):
    """A block's commands; those of ``spiral`` run in this process, which has its imports.

    The shell itself reads the words, with its quotes, and hands them back.
    """
    for command in text.replace("\\\n", " ").splitlines():
        if command.partition(" ")[0] == "spiral":
            words = _by_the_shell(f"printf '%s\\0' {command}").split("\0")[1:-1]
            assert main(words) == 0, command
        else:
            _by_the_shell(command)


def _by_the_shell(text):
    command = ["bash", "-euo", "pipefail", "-c", text]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"{text}\n{done.stdout}\n{done.stderr}"
    return done.stdout


def _followed(page):
    """A page's blocks in order, in one process and the current folder; the names they leave."""
    names: dict = {}
    for language, text in BLOCK.findall((PAGES / page).read_text(encoding="utf-8")):
        if language == "python":
            exec(text, names)
        elif language in ("yaml", "xml"):
            name = re.sub(r"^(# |<!-- )| -->$", "", text.splitlines()[0])
            Path(name).write_text(text, encoding="utf-8")
        elif language == "bash":
            assert main(shlex.split(text.replace("\\\n", " "))[1:]) == 0
    return names


@pytest.mark.slow
def test_the_page_about_a_model_of_ones_own_runs(tmp_path, monkeypatch):
    """A right-hand side and a CSV, then the same model as a file: the hidden spring is named."""
    monkeypatch.chdir(tmp_path)
    names = _followed("own-model.md")
    assert names["run"].missing == ("cubic_stiffness",)
    assert names["again"].missing == ("cubic_stiffness",)
    assert [p.name for p in names["beam"].ports] == ["drive", "middle", "tip", "span"]
    assert "120 degrees of freedom reduced to 8" in names["beam"].report
    found = json.loads(Path("verdict.json").read_text(encoding="utf-8"))
    assert found["rounds"][1]["admitted"] == ["cubic_stiffness"]
    stiffness = found["model"]["effects"]["cubic_stiffness"]["stiffness"]
    assert abs(stiffness["estimate"] - 4e5) < 4 * stiffness["se"]


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("gcc") is None, reason="no gcc here")
def test_the_page_about_fmus_runs(tmp_path, monkeypatch):
    """An FMU is made, measured and opened: the hidden spring is named, from Python and as typed."""
    pytest.importorskip("fmpy", reason="FMPy is not installed")
    monkeypatch.chdir(tmp_path)
    names = _followed("fmu.md")
    assert names["run"].missing == ("cubic_stiffness@b_w",)
    found = json.loads(Path("verdict.json").read_text(encoding="utf-8"))
    assert found["rounds"][1]["admitted"] == ["cubic_stiffness@b_w"]


def test_the_page_about_robots_runs(tmp_path, monkeypatch):
    """MuJoCo moves an arm with dry friction hidden: it is named at its joint."""
    pytest.importorskip("mujoco", reason="MuJoCo is not installed")
    monkeypatch.chdir(tmp_path)
    names = _followed("robot.md")
    assert names["run"].missing == ("coulomb_friction@elbow",)
    level = names["run"].model.values["coulomb_friction@elbow.level"]
    assert level == pytest.approx(0.02, rel=0.05)
    found = json.loads(Path("verdict.json").read_text(encoding="utf-8"))
    assert found["rounds"][1]["admitted"] == ["coulomb_friction@elbow"]


def test_the_page_about_many_simulations_runs(tmp_path, monkeypatch):
    """Intervals of a bootstrap hold the truth about as often as they say (300 each: +- 4 %)."""
    pytest.importorskip("jax", reason="JAX is not installed (the extra gpu)")
    monkeypatch.chdir(tmp_path)
    names = _followed("batch.md")
    assert np.all(np.abs(names["covered"] - 0.95) < 0.04)
    assert names["batch"].jacobian.shape == (300, 1200, 1, 3)


def test_fields_of_a_record_that_pages_name_are_there():
    """In the README and the how-to pages; ``test.settle`` and the group itself are no fields."""
    from spiral.io.registry import load_registry
    from spiral.types.fields import field_names

    registry = load_registry(local=False)
    sources = (registry.entry("source", n).plugin for n in registry.names("source"))
    known = {name for plugin in sources for name in field_names(plugin)}
    for page in (*PAGES.glob("*.md"), PAGES.parents[1] / "README.md"):
        named = set(re.findall(r"\brecord\.(\w+)", page.read_text(encoding="utf-8")))
        assert named <= known, f"{page.name}: {named - known}"
    told = set(re.findall(r"\brecord\.(\w+)", (PAGES / "own-data.md").read_text("utf-8")))
    assert set(field_names(registry.entry("source", "csv").plugin)) <= told | {"time", "path"}


def test_the_page_about_python_runs():
    """Its blocks, in order, in one process; the effect that it hides is found."""
    text = (PAGES / "python.md").read_text(encoding="utf-8")
    blocks = [code for language, code in BLOCK.findall(text) if language == "python"]
    names: dict = {}
    for code in blocks:
        exec(code, names)
    assert names["run"].missing == ("cubic_stiffness",)
    assert names["states"].states["x_rate"].relative < 0.05
    assert set(names["states"].series()) >= {"time", "x_rate", "x_rate_low", "x_rate_high"}


def test_the_page_about_exports_runs(tmp_path, monkeypatch, capsys):
    """In one process: its commands, then its program: its free run is the record less noise."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    text = (PAGES / "export.md").read_text(encoding="utf-8")
    names: dict = {}
    for language, code in BLOCK.findall(text):
        if language == "python":
            exec(code, names)
            continue
        for line in code.replace("\\\n", "").splitlines():
            assert main([*shlex.split(line)[1:], "--json", "-"]) == 0
    assert (tmp_path / "model.py").is_file()
    told = [
        json.loads(part)
        for part in re.findall(r"^\{$.*?^\}$", capsys.readouterr().out, re.M | re.S)
    ]
    assert told[-1]["file"].endswith("oscillator.c")
    assert np.std(names["left"]) < 0.02 * np.std(names["readings"])
