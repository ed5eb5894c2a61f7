"""The notebooks: each runs from top to bottom in an empty folder and finds what it says."""

import importlib.util
from pathlib import Path

import pytest

pytest.importorskip("nbclient", reason="nbclient is in the dev extra")
pytest.importorskip("jupytext", reason="jupytext is in the dev extra")

DOCS = Path(__file__).parents[2] / "docs"
SAID = {
    "own_file": ["Missing were cubic_stiffness, coulomb_friction", "States of oscillator"],
    "own_system": ["Missing was fading_friction", "States of carriage", "grip"],
    "rotor": ["cross_stiffness, cubic_stiffness, gyroscopic", "What is left is white noise"],
}
"""What stands among the outputs of each."""
SHORT = {
    "own_file": SAID["own_file"],
    "own_system": SAID["own_system"],
}
"""The same on a shorter record."""


def _notebooks():
    spec = importlib.util.spec_from_file_location("notebooks", DOCS / "tools" / "notebooks.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def _texts(notebook):
    for cell in notebook.cells:
        for output in cell.get("outputs", ()):
            data = output.get("data", {})
            yield output.get("text", "") + data.get("text/markdown", data.get("text/plain", ""))


def test_every_notebook_is_listed():
    assert {path.stem for path in (DOCS / "notebooks").glob("*.py")} == set(SAID)


@pytest.mark.slow
@pytest.mark.parametrize("name", SAID)
def test_a_notebook_runs(name):
    _is_as_said(SAID[name], DOCS / "notebooks" / f"{name}.py")


# The rotor has 14 000 samples and every candidate of the catalog: some 45 s of one core.
@pytest.mark.parametrize(("name", "whole", "part"), [
    pytest.param("own_file", "duration=12.0", "duration=3.0", marks=pytest.mark.slow),
    ("own_system", "duration=8.0", "duration=3.0"),
])  # fmt: skip
def test_a_notebook_runs_on_a_shorter_record(name, whole, part, tmp_path):
    text = (DOCS / "notebooks" / f"{name}.py").read_text(encoding="utf-8")
    assert whole in text
    (tmp_path / f"{name}.py").write_text(text.replace(whole, part), encoding="utf-8")
    _is_as_said(SHORT[name], tmp_path / f"{name}.py")


def _is_as_said(said, path):
    shown = "\n".join(_texts(_notebooks().run(path))).replace("\\_", "_")
    for text in said:
        assert text in shown
