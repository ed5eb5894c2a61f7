"""``experiments/run.py`` is a plain Hydra application around the same configuration."""

import importlib.util
import sys
from pathlib import Path

import spiral.discover
from spiral.run import ChannelError, Comparison, Round, Run
from spiral.storage import load_run

FILE = Path(__file__).parents[2] / "experiments" / "run.py"


def test_overrides_reach_the_study_and_a_run_is_saved(tmp_path, monkeypatch):
    asked = []

    def discover(problem, progress, on_round=None, *resumable):
        asked.append(problem)
        channels = {"x": ChannelError(1.0, 0.5)}
        found = Comparison(problem.model, 0.5, 0.5, channels, 0.02, 1.0, 0.5, 0.0, 64, True)
        return Run("nothing_missing", "whiteness", (Round(0, (), {}, {}, (), found, 0.1),),
                   problem.model, "")  # fmt: skip

    monkeypatch.setattr(spiral.discover, "discover", discover)
    monkeypatch.chdir(tmp_path)
    spec = importlib.util.spec_from_file_location("hydra_application", FILE)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    words = ["experiment=rotor_coastdown", "record.duration=0.2", "effect=[gyroscopic]"]
    monkeypatch.setattr(sys, "argv", ["run.py", *words, f"hydra.run.dir={tmp_path / 'hydra'}"])
    module.main()
    (problem,) = asked
    assert problem.records[0].samples == 200
    assert problem.model.labels[-1] == "gyroscopic"
    assert load_run("latest", tmp_path / "runs").config["experiment"] == "rotor_coastdown"
