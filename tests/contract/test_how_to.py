"""The how-to pages: every block of code in them is run, in order, in an empty folder."""

import json
import os
import re
import shlex
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest

from spiral.cli import main

PAGES = Path(__file__).parents[2] / "docs" / "how-to"
BLOCK = re.compile(r"^```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)


@pytest.mark.parametrize("page", ["own-effect.md", "own-system.md", "../../README.md"])
def test_every_block_runs(page, tmp_path):
    folder = Path(sys.executable).parent
    environment = {**os.environ, "PATH": f"{folder}{os.pathsep}{os.environ['PATH']}"}
    environment.pop("SPIRAL_PLUGINS", None)
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
            command = ["bash", "-euo", "pipefail", "-c", text]
            done = subprocess.run(
                command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False
            )
            assert done.returncode == 0, f"{text}\n{done.stdout}\n{done.stderr}"


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
    assert names["states"]["x_rate"].relative < 0.05


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
