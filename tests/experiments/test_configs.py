"""Every preset of conf/experiment runs; the Silverbox reaches its figures where the data are."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PRESETS = sorted(p.stem for p in (ROOT / "conf" / "experiment").glob("*.yaml"))
ESTIMATES = ["rotor_soft_tilt"]  # presets for estimate: nothing is missing from their model
DATA = os.environ.get("SPIRAL_DATA")


def _discover(preset: str, folder: Path, *more: str) -> dict:
    done = subprocess.run(
        [sys.executable, "-m", "spiral", "discover", f"experiment={preset}", *more, "--json", "-"],
        cwd=folder,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def _needs_data(preset: str) -> bool:
    return "SPIRAL_DATA" in (ROOT / "conf" / "experiment" / f"{preset}.yaml").read_text()


NOTHING = ("rotor_nothing_hidden",)
INNOVATION = ("rotor_one_bearing",)


def test_nothing_is_missing_where_nothing_is_hidden(tmp_path):
    found = _discover(NOTHING[0], tmp_path, "candidates=[cross_stiffness,cubic_stiffness]")
    assert found["verdict"] == "nothing_missing"


@pytest.mark.parametrize(
    "preset",
    [p for p in PRESETS if not _needs_data(p) and p not in (*ESTIMATES, *NOTHING, *INNOVATION)],
)
def test_a_preset_runs_in_a_fast_mode(preset, tmp_path):
    found = _discover(preset, tmp_path, "settings.max_rounds=1", "candidates=[cross_stiffness]")
    assert found["rounds"][1]["admitted"] == ["cross_stiffness"]
    assert found["rounds"][1]["test_error"] < found["rounds"][0]["test_error"]


@pytest.mark.slow
def test_the_innovations_say_which_bearing(tmp_path):
    words = ["candidates=[cubic_stiffness@bearing_1,cubic_stiffness@bearing_2]"]
    words += ["record.duration=5", "test.duration=5", "settings.max_rounds=1"]
    found = _discover(INNOVATION[0], tmp_path, *words)
    assert found["rounds"][1]["admitted"] == ["cubic_stiffness@bearing_2"]
    first, second = found["rounds"][0]["suggestions"][:2]
    assert (first["aliases"], second["effect"]) == ([], "cubic_stiffness@bearing_1")
    fitted = found["model"]["effects"]["cubic_stiffness@bearing_2"]["stiffness"]
    assert abs(fitted["estimate"] - 3.122e11) < 5 * fitted["se"] < 0.05 * 3.122e11


@pytest.mark.slow
@pytest.mark.skipif(
    not DATA or not (Path(DATA or ".") / "silverbox" / "SNLS80mV.csv").exists(),
    reason="silverbox/SNLS80mV.csv is not under SPIRAL_DATA",
)
def test_silverbox_names_the_cubic_spring_and_reaches_its_figures(tmp_path):
    found = _discover("silverbox", tmp_path)
    assert found["rounds"][0]["suggestions"][0]["effect"] == "cubic_stiffness"
    assert found["rounds"][1]["admitted"] == ["cubic_stiffness"]
    spread = found["test"]["x"]["rmse"] / found["test"]["x"]["relative"]
    assert found["rounds"][1]["test_error"] * spread <= 0.50e-3
    assert found["test"]["x"]["rmse"] <= 0.30e-3
    assert all(r["meaning"] for r in found["rounds"][1:])


@pytest.mark.parametrize("preset", ESTIMATES)
def test_a_preset_for_estimate_needs_a_real_observer(preset, tmp_path):
    words = [f"experiment={preset}", "record.duration=6", "observer.process_noise=1e-4"]
    command = [sys.executable, "-m", "spiral", "estimate", *words, "--json", "-"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    for tilt in ("alpha", "beta"):
        assert found["static_baseline"][tilt]["relative"] > 0.2
        assert found["states"][tilt]["relative"] < 0.02
