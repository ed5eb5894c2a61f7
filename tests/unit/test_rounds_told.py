"""The terminal's table of rounds, and what a process says of numbers that run away."""

import subprocess
import sys
from types import SimpleNamespace

from spiral.commands.report import run_and_save_curves
from spiral.io.request import Outcome
from spiral.types.run import Round
from spiral.view.terminal.study import _admission_text, _left_out_lines

STILL = "nothing moves at state c in these records: its {} has no scale"
LEFT_OUT = {
    "root_loss@c": STILL.format("width"),
    "mains_hum": "the sample rate of these records cannot show it",
    "saturating_loss@c": STILL.format("half"),
}


def test_what_was_left_out_of_the_whole_study_is_told_once_by_reason():
    refused = {**LEFT_OUT, "gain": "its sign is implausible"}
    rounds = tuple(Round(n, (), {}, refused, (), None, 0.0, left_out=LEFT_OUT) for n in range(3))
    for item in rounds:
        assert _admission_text(item).plain.split("\n")[1:] == [
            "refused gain: its sign is implausible"
        ]
    assert _left_out_lines(SimpleNamespace(rounds=rounds)) == [
        "left out: root_loss@c, saturating_loss@c: nothing moves at state c in these records",
        "left out: mains_hum: the sample rate of these records cannot show it",
    ]


def test_what_a_round_refuses_for_reasons_of_its_own_stays_there():
    """A candidate may be left out at first and refused by a test later."""
    refused = {"mains_hum": "it explains nothing of what the other half shows"}
    item = Round(1, (), {}, refused, (), None, 0.0, left_out=LEFT_OUT)
    assert "refused mains_hum: it explains nothing" in _admission_text(item).plain


def test_a_fit_that_diverged_has_no_curves_and_says_so():
    told = []
    final = SimpleNamespace(fit_error=float("nan"))
    run = SimpleNamespace(rounds=(SimpleNamespace(comparison=final),))
    outcome = Outcome(3, {"run_id": "r"}, {"run": run})
    study = SimpleNamespace(config={"curves": True, "out": "runs"}, tell=told.append)
    assert run_and_save_curves(study, lambda given: outcome) is outcome  # type: ignore[arg-type]
    assert told == ["no curves for the report: the fit diverged"]


def test_no_warning_of_an_overflow_reaches_the_terminal():
    program = (
        "import numpy as np, spiral.cli as c\n"
        "def main():\n    np.float64(1e308) * np.float64(10.0)\n    return 0\n"
        "c.main = main\nc.entry()"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True,
                          check=False)  # fmt: skip
    assert (done.returncode, done.stderr) == (0, "")
