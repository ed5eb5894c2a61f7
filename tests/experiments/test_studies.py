"""Studies in pieces: each in its own process, taken up again, and what a scoreboard shows."""

import time
from functools import partial
from types import SimpleNamespace

from experiments.studies.outcomes import named
from experiments.studies.pieces import Job, finish, kept
from experiments.studies.scoreboard import board

SLEEP = 60.0


def work(what):
    if what == "fail":
        raise ValueError("no such spring")
    if what == "spin":
        until = time.process_time() + SLEEP
        while time.process_time() < until:
            pass
    return {"what": what}


def job(what, code="a"):
    return Job(
        {"system": what, "case": "null", "half": "tune"}, {"code": code}, partial(work, what)
    )


def test_studies_end_each_in_its_own_way_and_are_taken_up(tmp_path, capsys):
    file = tmp_path / "rows.jsonl"
    rows = finish([job(w) for w in ("good", "fail", "spin")], file, limit=2.0, workers=2)
    assert [r["outcome"] for r in rows] == ["done", "failed", "timeout"]
    assert "no such spring" in rows[1]["error"]
    with file.open("a") as out:
        out.write('{"job": "cut o')
    assert len(kept(file)) == 3
    file.write_text("".join(f"{line}\n" for line in file.read_text().splitlines()[:3]))
    capsys.readouterr()
    again = finish([job("good"), job("good", "b")], file, limit=3.0, workers=1)
    assert "2 studies, 1 there already" in capsys.readouterr().err
    assert len(again) == 2


def test_cases_of_one_version_are_told_apart(tmp_path, capsys):
    """A case whose version is called ``case`` too, as every bench has it."""
    file = tmp_path / "rows.jsonl"
    made_of = {"code": "a", "case": "version"}
    jobs = [Job({"system": "s", "case": c}, made_of, partial(work, c)) for c in ("one", "two")]
    finish(jobs[:1], file, limit=3.0, workers=1)
    capsys.readouterr()
    assert [r["what"] for r in finish(jobs, file, limit=3.0, workers=1)] == ["one", "two"]
    assert "2 studies, 1 there already" in capsys.readouterr().err


def row(half, case, **more):
    found = {
        "key": {"system": "crane", "case": case, "seed": 0, "half": half},
        "outcome": "done", "first": True, "invented": [], "admitted": ["cubic_stiffness"],
        "hidden": ["cubic_stiffness"], "chi2": 1.0, "error_se": 0.5, "error_relative": 0.01,
        "verdict": "effect_missing", "seconds": 1.0, "after": 0.02, "floor": 0.01,
    }  # fmt: skip
    return {**found, **more}


def test_the_report_half_shows_rates_but_no_case():
    """Wilson's interval of 1 in 2 is 9.5 to 90.5 %; a study that timed out has missed."""
    late = {"key": row("report", "hard")["key"], "outcome": "timeout"}
    told = board([row("report", "hidden"), late])
    assert "50.0% (9.5% to 90.5%), n = 2" in told
    assert "1 timed out" in told
    assert "crane" not in told
    assert "crane" in board([row("report", "hidden")], details=True)
    assert "crane" in board([row("tune", "hidden")])


def admitted(*names, aliases=()):
    return SimpleNamespace(
        admitted=names, aliases={names[0]: aliases} if names else {}, suggestions=()
    )


def test_the_imperfection_may_come_before_what_is_hidden():
    run = SimpleNamespace(rounds=[admitted(), admitted("delay"), admitted("cubic_stiffness")])
    assert not named(run, ("cubic_stiffness",))["first"]
    found = named(run, ("cubic_stiffness",), also=("delay",))
    assert found["first"]
    assert found["invented"] == []


def test_an_alias_group_counts_as_what_it_holds():
    run = SimpleNamespace(rounds=[admitted(), admitted("lag", aliases=("hidden_mode", "delay"))])
    found = named(run, ("hidden_mode",))
    assert found["first"]
    assert not found["alone"]
    assert named(run, ())["invented"] == ["lag"]
    assert named(run, (), also=("delay",))["invented"] == []
