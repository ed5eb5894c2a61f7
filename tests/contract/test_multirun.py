"""``-m`` over any group and value: each job is asked what its overrides say."""

import json

import numpy as np
import pytest

import spiral.inference.compare
from spiral.cli import main
from spiral.types.run import ChannelError, Comparison
from spiral.view.terminal.sweep import format_duration, swept_columns

EMBEDDED = ("experiment=rotor_coastdown", "record.duration=0.2", "test.duration=0.2")
SIMULATED = (
    "system=oscillator", "record=simulation", "record.duration=0.5",
    "record.inputs={force: {noise: 1.0, band: [5, 100]}}",
    "record.values={system.mass: 1, linear_stiffness.stiffness: 4e4, linear_damping.damping: 4}",
)  # fmt: skip
FROM_FILE = ("system=oscillator", "record=csv", "record.time=t")


@pytest.fixture(autouse=True)
def asked(tmp_path, monkeypatch):
    """The problems that jobs were asked; the fit is a stand-in."""
    monkeypatch.chdir(tmp_path)
    rng = np.random.default_rng(0)
    for name in ("a", "b", "c,d"):
        rows = np.column_stack([0.01 * np.arange(300), rng.normal(size=(300, 4))])
        header = "t,x,theta,force,torque"
        np.savetxt(f"{name}.csv", rows, delimiter=",", header=header, comments="")
    found = []

    def compare(problem, progress):
        found.append(problem)
        channels = {c: ChannelError(1e-6, 0.25) for c in problem.model.system.observed}
        return Comparison(problem.model, 0.25, 0.25, channels, 0.02, 1.0, 0.3, 0.01, 64, True)

    monkeypatch.setattr(spiral.inference.compare, "compare", compare)
    return found


def swept(capsys, *words):
    code = main(["compare", *words, "-m", "n_jobs=1", "--json", "-"])
    runs = json.loads(capsys.readouterr().out)["runs"]
    assert code == 0, [row["result"].get("error") for row in runs]
    return runs


def noise_of(problem):
    return tuple(problem.records[0].noise.values())


VALUES = [
    (EMBEDDED, "record.seed=0,1,2", 3, lambda p: p.records[0].sha256),
    (EMBEDDED, "record.noise_level=0.01,0.02", 2, noise_of),
    (EMBEDDED, "test.seed=range(5,8)", 3, lambda p: p.test[0].sha256),
    (SIMULATED, "record.seed=range(0,4)", 4, lambda p: p.records[0].sha256),
    (SIMULATED, "record.noise_level=choice(0.01,0.02)", 2, noise_of),
    (SIMULATED, "holdout=0.2,0.3", 2, lambda p: p.records[0].samples),
    (SIMULATED, "effect=[cubic_stiffness],[clearance]", 2, lambda p: p.model.labels[-1]),
    (SIMULATED, "effect=cubic_stiffness,clearance", 2, lambda p: p.model.labels[-1]),
    (SIMULATED, "effect=[cubic_stiffness,clearance],[]", 2, lambda p: len(p.model.labels)),
    (SIMULATED, "strategy=choice(shooting)", 1, lambda p: 0),
    (SIMULATED, "candidates=[cubic_stiffness],[clearance,coulomb_friction]", 2,
     lambda p: len(p.candidates)),
    (SIMULATED, "settings.level=0.01,0.05", 2, lambda p: p.settings.level),
    (SIMULATED, "values={linear_stiffness.stiffness:1},{linear_stiffness.stiffness:2}", 2,
     lambda p: p.model.values["linear_stiffness.stiffness"]),
    (FROM_FILE, "record.path=a.csv,b.csv", 2, lambda p: p.records[0].sha256),
    (FROM_FILE, "record.path=[a.csv,b.csv],[a.csv]", 2, lambda p: len(p.records)),
    (FROM_FILE, 'record.path="c,d.csv",\'b.csv\'', 2, lambda p: p.records[0].sha256),
    ((*FROM_FILE, "record.path=a.csv"), "record.rows=[0,200],[0,300]", 2,
     lambda p: p.records[0].samples),
    (("record.duration=0.2",), "experiment=rotor_coastdown,rotor_coastdown_text", 2,
     lambda p: p.records[0].sha256),
    (("record=csv", "record.time=t", "record.path=a.csv", "record.channels=null"),
     "system=oscillator,pendulum", 2, lambda p: p.model.system.plugin_name()),
]  # fmt: skip


@pytest.mark.parametrize(
    ("base", "sweep", "count", "seen"), VALUES, ids=[f"{i} {v[1]}" for i, v in enumerate(VALUES)]
)
def test_every_value_reaches_its_job(capsys, asked, base, sweep, count, seen):
    runs = swept(capsys, *base, sweep)
    assert len(runs) == count == len(asked)
    assert len({seen(problem) for problem in asked}) == count


def test_what_differs_becomes_columns():
    jobs = [
        ("system=a", "record.seed=0", "holdout=0.2"),
        ("system=a", "record.seed=1", "holdout=0.2"),
    ]
    assert swept_columns(jobs) == (("record.seed",), ("system=a", "holdout=0.2"))
    assert swept_columns(jobs[:1]) == ((), jobs[0])


@pytest.mark.parametrize(
    ("seconds", "words"), [(4.4, "4 s"), (185, "3 min 05 s"), (7800, "2 h 10 min")]
)
def test_durations_in_words(seconds, words):
    assert format_duration(seconds) == words


@pytest.mark.parametrize("width", [80, 120])
def test_the_table_fits_and_names_what_was_swept(capsys, monkeypatch, width):
    monkeypatch.setenv("COLUMNS", str(width))
    words = ["compare", *EMBEDDED, "record.seed=1,two", "record.noise_level=0.01,0.02", "-m"]
    assert main([*words, "n_jobs=1"]) == 2
    out = capsys.readouterr().out
    heading = next(line for line in out.splitlines() if "exit" in line)
    assert heading.split()[:2] == ["record.seed", "record.noise_level"]
    assert out.count("25.0 %") == 2
    assert "record.seed='two'" in out.replace("\n", "")
    assert "4 of 4 runs done, 2 failed or refused" in out
    table = out.split("record.seed", 1)[1].split("runs done")[0]
    assert max(map(len, table.splitlines())) <= width
