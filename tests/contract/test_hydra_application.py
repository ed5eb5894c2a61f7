"""``experiments/run.py`` is a plain Hydra application around the same configuration."""

import importlib.util
import sys
from pathlib import Path

import numpy as np
import pytest

import spiral.inference.discover
from spiral.io.storage import load_run, run_ids
from spiral.types.run import ChannelError, Comparison, Round, Run

FILE = Path(__file__).parents[2] / "experiments" / "run.py"


@pytest.fixture
def asked(monkeypatch, tmp_path):
    """The problems it was asked; the loop is a stand-in."""
    found_problems = []

    def discover(problem, progress, on_round=None, *resumable):
        found_problems.append(problem)
        channels = {"x": ChannelError(1.0, 0.5)}
        found = Comparison(problem.model, 0.5, 0.5, channels, 0.02, 1.0, 0.5, 0.0, 64, True)
        return Run("nothing_missing", "whiteness", (Round(0, (), {}, {}, (), found, 0.1),),
                   problem.model, "")  # fmt: skip

    monkeypatch.setattr(spiral.inference.discover, "discover", discover)
    monkeypatch.chdir(tmp_path)
    return found_problems


def run_application(monkeypatch, *words):
    spec = importlib.util.spec_from_file_location("hydra_application", FILE)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    monkeypatch.setattr(sys, "argv", ["run.py", *words])
    module.main()


def test_overrides_reach_the_study_and_a_run_is_saved(tmp_path, monkeypatch, asked):
    words = ["experiment=rotor_coastdown", "record.duration=0.2", "effect=[gyroscopic]"]
    run_application(monkeypatch, *words, f"hydra.run.dir={tmp_path / 'hydra'}")
    (problem,) = asked
    assert problem.records[0].samples == 200
    assert problem.model.labels[-1] == "gyroscopic"
    assert load_run("latest", tmp_path / "runs").config["experiment"] == "rotor_coastdown"


SWEPT = [
    ("experiment=rotor_coastdown record.duration=0.2 record.seed=range(0,3)", 3),
    ("experiment=rotor_coastdown record.duration=0.2 record.noise_level=0.01,0.02", 2),
    ("experiment=rotor_coastdown record.duration=0.2 effect=[gyroscopic],[crack,rub]", 2),
    ("experiment=rotor_coastdown,rotor_coastdown_text ++record.duration=0.2", 2),
    ("system=oscillator,pendulum record=csv record.time=t record.path=a.csv", 2),
    ("system=oscillator record=csv record.time=t record.path=a.csv,b.csv strategy=shooting", 2),
]


@pytest.mark.parametrize(("words", "count"), SWEPT, ids=[w for w, _ in SWEPT])
def test_hydra_sweeps_over_groups_and_values(tmp_path, monkeypatch, asked, words, count):
    rng = np.random.default_rng(0)
    for name in "ab":
        rows = np.column_stack([0.01 * np.arange(300), rng.normal(size=(300, 4))])
        header = "t,x,theta,force,torque"
        np.savetxt(f"{name}.csv", rows, delimiter=",", header=header, comments="")
    run_application(monkeypatch, "-m", *words.split(), f"hydra.sweep.dir={tmp_path / 'hydra'}")
    assert len(asked) == count
    seen = {(p.records[0].sha256, p.model.labels) for p in asked}
    assert len(seen) == count
    assert len(run_ids(tmp_path / "runs")) == count
