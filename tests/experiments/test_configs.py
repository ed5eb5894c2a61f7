"""Every preset of conf/experiment runs; the Silverbox reaches its figures where the data are."""

import json
import os
from pathlib import Path

import pytest

from spiral.cli import main

ROOT = Path(__file__).parents[2]
PRESETS = sorted(p.stem for p in (ROOT / "conf" / "experiment").glob("*.yaml"))
ESTIMATES = ["rotor_soft_tilt"]  # presets for estimate: nothing is missing from their model
DATA = os.environ.get("SPIRAL_DATA")


@pytest.fixture
def result(tmp_path, monkeypatch, capsys):
    """What a command gives, run in an empty folder."""
    monkeypatch.chdir(tmp_path)

    def result_of(*words: str) -> dict:
        code = main([*words, "tracking.enabled=false", "curves=false", "--json", "-"])
        out, said = capsys.readouterr()
        assert code == 0, said
        return json.loads(out)

    return result_of


def _needs_data(preset: str) -> bool:
    return "SPIRAL_DATA" in (ROOT / "conf" / "experiment" / f"{preset}.yaml").read_text()


NOTHING = ("rotor_nothing_hidden",)
INNOVATION = ("rotor_one_bearing",)
SHORT = ("record.duration=4",)  # what a preset's own duration is, test_config reads


def test_nothing_is_missing_where_nothing_is_hidden(result):
    words = ("discover", f"experiment={NOTHING[0]}", *SHORT)
    found = result(*words, "candidates=[cross_stiffness,cubic_stiffness]")
    assert found["verdict"] == "nothing_missing"


@pytest.mark.parametrize(
    "preset",
    [
        pytest.param(p, marks=[] if p == "rotor_coastdown" else [pytest.mark.slow])
        for p in PRESETS
        if not _needs_data(p) and p not in (*ESTIMATES, *NOTHING, *INNOVATION)
    ],
)
def test_a_preset_runs_in_a_fast_mode(preset, result):
    words = ("discover", f"experiment={preset}", *SHORT)
    found = result(*words, "settings.max_rounds=1", "candidates=[cross_stiffness]")
    assert found["rounds"][1]["admitted"] == ["cross_stiffness"]
    assert found["rounds"][1]["test_error"] < found["rounds"][0]["test_error"]


@pytest.mark.slow
def test_the_innovations_say_which_bearing(result):
    words = ["candidates=[cubic_stiffness@bearing_1,cubic_stiffness@bearing_2]"]
    words += ["record.duration=5", "test.duration=5", "settings.max_rounds=1"]
    found = result("discover", f"experiment={INNOVATION[0]}", *words)
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
def test_silverbox_names_the_cubic_spring_and_reaches_its_figures(result):
    found = result("discover", "experiment=silverbox")
    assert found["rounds"][0]["suggestions"][0]["effect"] == "cubic_stiffness"
    assert found["rounds"][1]["admitted"] == ["cubic_stiffness"]
    spread = found["test"]["x"]["rmse"] / found["test"]["x"]["relative"]
    assert found["rounds"][1]["test_error"] * spread <= 0.50e-3
    assert found["test"]["x"]["rmse"] <= 0.30e-3
    assert all(r["meaning"] for r in found["rounds"][1:])


@pytest.mark.parametrize("preset", ESTIMATES)
def test_a_preset_for_estimate_needs_a_real_observer(preset, result):
    words = (f"experiment={preset}", "record.duration=3", "observer.process_noise=1e-4")
    found = result("estimate", *words)
    for tilt in ("alpha", "beta"):
        assert found["static_baseline"][tilt]["relative"] > 0.2
        assert found["states"][tilt]["relative"] < 0.02
