"""A package of someone else's, installed with pip: listed, checked, fitted, swept."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

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
def spiral(installed, tmp_path):
    """Runs the command line beside the package; gives exit code and JSON."""
    environment = {**os.environ, "PYTHONPATH": str(installed), "OMP_NUM_THREADS": "1"}
    environment.pop("SPIRAL_PLUGINS", None)

    def run(*words):
        command = [sys.executable, "-m", "spiral", *words, "--json", "-"]
        done = subprocess.run(
            command, capture_output=True, text=True, check=False, cwd=tmp_path, env=environment
        )
        assert done.stdout, done.stderr
        return done.returncode, json.loads(done.stdout)

    return run


def test_it_is_listed_with_its_package_and_version_and_passes_its_check(spiral):
    code, result = spiral("plugins", EFFECT)
    assert code == 0
    (found,) = result["plugins"]
    assert (found["origin"], found["version"]) == ("spiral-fifth-power", "0.3.0")
    assert found["parameters"] == {"stiffness": "force/position^5"}
    assert spiral("check", EFFECT)[0] == 0


def test_it_is_in_the_help_of_its_group(installed, tmp_path):
    environment = {**os.environ, "PYTHONPATH": str(installed), "COLUMNS": "100"}
    for words, seen in ((("discover", "--help"), EFFECT), (("discover", "--help", "effect"),
                        "[spiral-fifth-power 0.3.0]"), (("compare", "--help", EFFECT),
                        "stiffness (force/position^5)")):  # fmt: skip
        done = subprocess.run(
            [sys.executable, "-m", "spiral", *words],
            capture_output=True, text=True, check=True, cwd=tmp_path, env=environment,
        )  # fmt: skip
        assert seen in done.stdout


@pytest.mark.slow
def test_it_is_fitted_and_swept(spiral):
    words = ("compare", *RECORD, "record.seed=1,2", f"effect=[{EFFECT}],[]")
    code, result = spiral(*words, "-m", "n_jobs=2", "strategy=shooting", "tracking.enabled=false")
    assert code == 0
    assert len(result["runs"]) == 4
    for one, other in zip(result["runs"][::2], result["runs"][1::2], strict=True):
        assert {f"effect=[{EFFECT}]"} == set(one["overrides"]) - set(other["overrides"])
        assert one["result"]["test_error"] < 0.5 * other["result"]["test_error"]


def test_without_the_package_its_name_is_refused(spiral, monkeypatch, tmp_path):
    done = subprocess.run(
        [sys.executable, "-m", "spiral", "check", EFFECT],
        capture_output=True, text=True, check=False, cwd=tmp_path,
    )  # fmt: skip
    assert done.returncode == 2
    assert "expected: the name of a plugin" in done.stderr
