"""What the paper's evidence finds on the rotor, pinned where it does not flatter it; its table."""

import json

import pytest

from experiments.evidence import TRUTH, gates_told, load, row, summary, table
from experiments.side_by_side import lines
from spiral.commands.perform import perform
from spiral.io.request import Request

SHORT = ("experiment=rotor_coastdown", "record.duration=3", "record.start_hz=25",
         "record.stop_hz=10", "curves=false")  # fmt: skip
PAPER = ("strategy=paper", *SHORT, "library=core", "paper.points=20000", "learner.epochs=20")


def ran(folder, *overrides):
    request = Request("discover", (), (*overrides, f"out={folder}"))
    return perform(request, lambda message: None).result


def test_a_table_is_made_of_saved_runs(tmp_path):
    """One run with each strategy, grouped; the figures are those of the runs' own results."""
    few = ("strategy=shooting", "candidates=[cross_stiffness,cubic_stiffness]",
           "settings.max_rounds=2")  # fmt: skip
    results = {"paper": ran(tmp_path, *PAPER), "shooting": ran(tmp_path, *SHORT, *few)}
    rows = {r["strategy"]: r for r in load(tmp_path)}
    assert set(rows) == {"paper", "shooting"}
    for name, found in rows.items():
        assert found["test_error"] == results[name]["rounds"][-1]["test_error"]
        for key, coupling in found["couplings"].items():
            owner, parameter = key.split(".")
            value = results[name]["model"]["effects"][owner][parameter]["estimate"]
            assert coupling["ratio"] == pytest.approx(value / TRUTH[key])
    assert rows["shooting"]["couplings"]["cross_stiffness.stiffness"]["ratio"] > 0
    beside = lines(rows["shooting"], rows["paper"])
    assert beside[0].split() == ["trajectories", "published"]
    assert sum("not found" in line or "t = " in line for line in beside) == len(TRUTH)
    text = table(list(rows.values()), ["strategy"])
    assert [line.split("|")[1].strip() for line in text[2:]] == ["paper", "shooting"]
    assert summary([rows["paper"], rows["paper"]])["runs"] == 2


def test_diagnose_asks_the_strategy_that_was_chosen(tmp_path):
    """Its suggestions are those of the loop's first round by the same evidence."""
    request = Request("diagnose", (), (*PAPER, f"out={tmp_path}"))
    diagnosis = perform(request, lambda message: None).result
    first = ran(tmp_path, *PAPER, "settings.max_rounds=1")["rounds"][0]
    assert first["suggestions"]
    same = ("effect", "p_value", "statistic", "explains")
    told = [{k: s[k] for k in same} for s in diagnosis["suggestions"]]
    assert told == [{k: s[k] for k in same} for s in first["suggestions"]]


def test_gates_are_told_by_what_they_lack():
    assert gates_told(()) == "none"
    assert gates_told(["partial_f", "hac_t"]).startswith("without ljung_box, bonferroni_t")
    assert gates_told(["partial_f", "hac_t"]).endswith("with hac_t")


@pytest.mark.slow
def test_at_two_percent_noise_the_paper_finds_two_couplings_and_not_the_gyroscopic(tmp_path):
    """Seed 11: nine times the coefficient with the wrong sign, or nothing; trajectories find it."""
    paper = row(_saved(tmp_path / "a", "experiment=rotor_coastdown", "strategy=paper"))
    shooting = row(_saved(tmp_path / "b", "experiment=rotor_coastdown"))
    for key in ("cross_stiffness.stiffness", "cubic_stiffness.stiffness"):
        assert paper["couplings"][key]["ratio"] == pytest.approx(1.0, abs=0.1)
    wrong = paper["couplings"].get("gyroscopic.coefficient", {"ratio": 0.0})["ratio"]
    assert abs(wrong - 1) > 0.5
    assert paper["false"]
    assert paper["pass_rate"] > 0.5
    assert paper["test_error"] > 2 * paper["noise_floor"]
    assert shooting["couplings"]["gyroscopic.coefficient"]["ratio"] == pytest.approx(1.0, abs=0.05)
    assert shooting["false"] == []
    assert shooting["test_error"] < 1.05 * shooting["noise_floor"]


@pytest.mark.slow
def test_where_nothing_is_hidden_the_paper_still_admits_terms(tmp_path):
    paper = row(_saved(tmp_path / "a", "experiment=rotor_nothing_hidden", "strategy=paper"))
    shooting = row(_saved(tmp_path / "b", "experiment=rotor_nothing_hidden"))
    assert paper["false"]
    assert paper["test_error"] > paper["seed_error"]
    assert shooting["false"] == []
    assert shooting["rounds"] == 0


def _saved(folder, *overrides):
    ran(folder, *overrides)
    return json.loads(next(folder.glob("*/run.json")).read_text())
