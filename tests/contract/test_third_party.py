"""A package of someone else's, installed with pip: listed, checked, fitted, swept."""

import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from spiral.cli import main

FIXTURE = Path(__file__).parents[1] / "fixtures" / "third_party"
EFFECT = "fifth_power_stiffness"
RECORD = (
    "system=oscillator", "record=simulation", "record.duration=2", "record.rate=500",
    f"record.effects=[{EFFECT}]",
    "record.inputs={force: {noise: 1.0, band: [2, 30]}}",
    "record.values={system.mass: 1, linear_stiffness.stiffness: 4e3, linear_damping.damping: 4,"
    f" {EFFECT}.stiffness: 1e14}}",
)  # fmt: skip


@pytest.fixture(scope="module")
def installed(tmp_path_factory):
    """A folder with the package in it, built from a copy and without network."""
    source = tmp_path_factory.mktemp("third_party") / "source"
    shutil.copytree(FIXTURE, source, ignore=shutil.ignore_patterns("__pycache__"))
    target = source.parent / "installed"
    command = [
        sys.executable, "-m", "pip", "install", "--quiet", "--no-index", "--no-deps",
        "--no-build-isolation", "--target", str(target), str(source),
    ]  # fmt: skip
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return target


@pytest.fixture
def beside(installed, tmp_path, monkeypatch):
    """The package where this process and those that it starts find it; nothing of it stays."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PYTHONPATH", str(installed))
    monkeypatch.delenv("SPIRAL_PLUGINS", raising=False)
    monkeypatch.setenv("COLUMNS", "100")
    monkeypatch.syspath_prepend(installed)
    yield
    for name, module in list(sys.modules.items()):
        if Path(getattr(module, "__file__", None) or "/").is_relative_to(installed):
            del sys.modules[name]


@pytest.fixture
def spiral(beside, capsys):
    """Runs the command line beside the package; gives exit code and JSON."""

    def run(*words):
        capsys.readouterr()
        code = main([*words, "--json", "-"])
        return code, json.loads(capsys.readouterr().out)

    return run


def test_it_is_listed_with_its_package_and_version_and_passes_its_check(spiral):
    code, result = spiral("plugins", EFFECT)
    assert code == 0
    (found,) = result["plugins"]
    assert (found["origin"], found["version"]) == ("spiral-fifth-power", "0.3.0")
    assert found["parameters"] == {"stiffness": "force/position^5"}
    assert spiral("check", EFFECT)[0] == 0


def test_it_is_in_the_help_of_its_group(beside, capsys):
    for words, seen in ((("discover", "--help"), EFFECT), (("discover", "--help", "effect"),
                        "[spiral-fifth-power 0.3.0]"), (("compare", "--help", EFFECT),
                        "stiffness (force/position^5)")):  # fmt: skip
        assert main(words) == 0
        assert seen in capsys.readouterr().out


def test_it_is_fitted_and_swept(spiral):
    """By workers in processes of their own."""
    words = ("compare", *RECORD, "record.seed=1,2", f"effect=[{EFFECT}],[]")
    code, result = spiral(*words, "-m", "n_jobs=2", "strategy=shooting", "tracking.enabled=false")
    assert code == 0
    assert len(result["runs"]) == 4
    for one, other in zip(result["runs"][::2], result["runs"][1::2], strict=True):
        assert {f"effect=[{EFFECT}]"} == set(one["overrides"]) - set(other["overrides"])
        assert one["result"]["test_error"] < 0.5 * other["result"]["test_error"]


def test_a_process_of_its_own_finds_it(beside):
    command = [sys.executable, "-m", "spiral", "plugins", EFFECT, "--json", "-"]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert json.loads(done.stdout)["plugins"][0]["origin"] == "spiral-fifth-power"


def test_without_the_package_its_name_is_refused(capsys):
    assert main(["check", EFFECT]) == 2
    assert "expected: the name of a plugin" in capsys.readouterr().err
