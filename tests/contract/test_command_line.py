"""The contract of the command line: exit codes, JSON, messages; the steps are stand-ins here."""

import json
import math
import os
import subprocess
import sys
import time
from dataclasses import replace

import numpy as np
import pytest

import spiral.inference.compare
import spiral.inference.diagnose
import spiral.inference.discover
from spiral.cli import main
from spiral.types.run import ChannelError, Comparison, Diagnosis, Round, Run, Suggestion, Where

FIELDS = ("system=oscillator", "record=csv", "record.time=t", "record.channels={x: a}",
          "record.inputs={force: f}")  # fmt: skip


@pytest.fixture(autouse=True)
def place(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "100")
    rng = np.random.default_rng(0)
    rows = np.column_stack([0.01 * np.arange(300), rng.normal(size=(300, 2))])
    np.savetxt("a.csv", rows, delimiter=",", header="t,a,f", comments="")
    return tmp_path


OWN = (*FIELDS, "record.path=a.csv")


def comparison(model, error=0.25, converged=True):
    keys = [k for k, _ in model.pairs]
    fitted = replace(
        model, values={k: 1.5 + i for i, k in enumerate(keys)}, errors=dict.fromkeys(keys, 0.01)
    )
    channels = {c: ChannelError(1e-6, error) for c in model.system.observed}
    return Comparison(
        fitted, error, error, channels, 0.02, math.nan, 0.3, 0.01, 64, converged, ("a note",)
    )


SUGGESTION = Suggestion(
    "cubic_stiffness", "Stiffness that grows.", ("clearance",), 1e-120, 99.0, 1e-50, 0.97
)


@pytest.fixture
def steps(monkeypatch):
    """Stand-ins for the steps; returns the problems they were asked."""
    asked = []

    def compare(problem, progress):
        asked.append(problem)
        progress("fitting")
        return comparison(problem.model)

    def diagnose(problem, progress):
        asked.append(problem)
        where = Where(channel="x", sentence="It fails at large amplitude.", time_s=(0.0, 1.0))
        found = comparison(problem.model)
        return Diagnosis("effect_missing", found, (SUGGESTION,), where, "Add it.", 64)

    def discover(problem, progress, on_round=None, *resumable):
        asked.append(problem)
        effect = next(e for e in problem.candidates if e.label == "cubic_stiffness")
        before, after = comparison(problem.model), comparison(problem.model.add(effect), 0.03)
        rounds = (
            Round(0, (), {}, {}, (), before, 0.5),
            Round(1, (effect.label,), {effect.label: ("clearance",)}, {"rub": "too small"},
                  (SUGGESTION,), after, 0.7, meaning=effect.meaning()),
        )  # fmt: skip
        for item in rounds:
            on_round(item)
        return Run("effect_missing", "whiteness", rounds, after.model, "Done.",
                   summary="Missing was cubic_stiffness.")  # fmt: skip

    def add(problem, effects, progress):
        asked.append(problem)
        model = problem.model
        for effect in effects:
            model = model.add(effect)
        before, after = comparison(problem.model), comparison(model, 0.03)
        run = Run("effect_missing", "max_rounds", (Round(0, (), {}, {}, (), after, 0.1),),
                  after.model, "")  # fmt: skip
        return before, after, run

    monkeypatch.setattr(spiral.inference.compare, "compare", compare)
    monkeypatch.setattr(spiral.inference.diagnose, "diagnose", diagnose)
    monkeypatch.setattr(spiral.inference.discover, "discover", discover)
    monkeypatch.setattr(spiral.inference.discover, "add", add)
    return asked


def run_json(capsys, *words):
    code = main([*words, "--json", "-"])
    out = capsys.readouterr().out
    return code, json.loads(out, parse_constant=lambda word: pytest.fail(word))


def test_compare_keys(capsys, steps):
    code, result = run_json(capsys, "compare", *OWN)
    assert code == 0
    assert {"fit_error", "test_error", "channels", "chi2_per_dof", "whiteness_p"} <= set(result)
    assert result["channels"]["x"] == {"rmse": 1e-6, "relative": 0.25}
    assert result["chi2_per_dof"] is None  # NaN


def test_compare_shows_what_was_understood(capsys, steps, place):
    """Each series with its extent, unit and noise; units, columns and conversions in words."""
    values = np.loadtxt(place / "a.csv", delimiter=",", skiprows=1)
    words = (*OWN, "record.units={x: um}", "record.noise={x: 1e-8}")
    _, result = run_json(capsys, "compare", *words)
    fit, test = result["records"]
    assert (fit["part"], fit["samples"], test["part"], test["samples"]) == ("fit", 240, "test", 60)
    assert fit["rate"] == pytest.approx(100.0)
    x, force = fit["series"]
    assert (x["name"], x["unit"], x["noise"], x["noise_declared"]) == ("x", "m", 1e-8, True)
    assert x["highest"] == pytest.approx(1e-6 * values[:240, 1].max())
    assert force["deviation"] == pytest.approx(values[:240, 2].std())
    assert main(["compare", *words]) == 0
    out = capsys.readouterr().out
    for told in ("x from 'a' in um", "100 Hz", "declared", "lowest"):
        assert told in out
    assert out.count("x from 'a' in um") == 1


def test_diagnose_keys(capsys, steps):
    code, result = run_json(capsys, "diagnose", *OWN)
    assert code == 0
    assert {"verdict", "suggestions", "where", "advice"} <= set(result)
    (suggestion,) = result["suggestions"]
    assert {
        "effect", "aliases", "p_value", "statistic", "explains",
        "test_error_before", "test_error_after", "meaning",
    } <= set(suggestion)  # fmt: skip
    assert {
        "time_s", "frequency_hz", "speed_rad_s", "order", "amplitude", "channel", "sentence",
    } <= set(result["where"])  # fmt: skip


def test_discover_keys_and_saved_run(capsys, steps, place):
    code, result = run_json(capsys, "discover", *OWN)
    assert code == 0
    assert {"verdict", "stopped", "rounds", "model", "test", "run_id"} <= set(result)
    last = result["rounds"][-1]
    assert {
        "admitted", "aliases", "fit_error", "test_error", "chi2_per_dof", "horizon",
        "whiteness_p", "seconds",
    } <= set(last)  # fmt: skip
    number = result["model"]["effects"]["cubic_stiffness"]["stiffness"]
    assert set(number) == {"estimate", "se", "t", "unit"}
    assert (place / "runs" / result["run_id"] / "run.json").is_file()


def test_add_keys_and_a_run_taken_up(capsys, steps):
    code, result = run_json(capsys, "add", "cubic_stiffness", *OWN)
    assert code == 0
    assert {"before", "after", "model", "run_id"} <= set(result)
    code, _ = run_json(capsys, "compare", "run=latest")
    assert code == 0
    assert set(steps[-1].model.labels) == {"linear_stiffness", "linear_damping", "cubic_stiffness"}
    assert steps[-1].model.values["cubic_stiffness.stiffness"] > 1
    assert steps[-1].records[0].sha256 == steps[0].records[0].sha256
    code, _ = run_json(capsys, "add", "clearance", f"run={result['run_id']}")
    assert code == 0
    code, error = run_json(capsys, "add", "cubic_stiffness", "run=latest")
    assert code == 2
    assert "which the model has" in error["error"]["given"]


def test_runs_lie_where_out_says(capsys, steps, place):
    _, result = run_json(capsys, "discover", *OWN, "out=mine")
    assert (place / "mine" / result["run_id"] / "run.json").is_file()
    assert run_json(capsys, "compare", "run=latest", "out=mine")[0] == 0
    assert run_json(capsys, "compare", "run=latest")[0] == 2


def test_json_to_a_file_beside_the_summary(capsys, steps, place):
    assert main(["compare", *OWN, "--json", "result.json"]) == 0
    assert json.loads((place / "result.json").read_text())["test_error"] == 0.25
    assert "test error" in capsys.readouterr().out


@pytest.mark.parametrize("stopped", ["not_identifiable", "diverged"])
def test_an_honest_refusal_is_exit_3(capsys, steps, monkeypatch, stopped):
    def discover(problem, progress, on_round=None, *resumable):
        rounds = (Round(0, (), {}, {}, (), comparison(problem.model), 0.5),)
        return Run("not_identifiable", stopped, rounds, problem.model, "Sweep the speed.")

    monkeypatch.setattr(spiral.inference.discover, "discover", discover)
    code, result = run_json(capsys, "discover", *OWN)
    assert code == 3
    assert result["error"]["try"] == "Sweep the speed."
    assert result["rounds"]
    assert main(["discover", *OWN]) == 3
    assert "Sweep the speed." in capsys.readouterr().out


def test_a_comparison_that_does_not_converge_is_exit_3(capsys, steps, monkeypatch):
    monkeypatch.setattr(
        spiral.inference.compare,
        "compare",
        lambda p, progress: comparison(p.model, converged=False),
    )
    code, result = run_json(capsys, "compare", *OWN)
    assert code == 3
    assert set(result["error"]) == {"given", "expected", "try"}
    assert result["fit_error"] == 0.25


@pytest.mark.parametrize("verdict", ["nothing_missing", "unknown_structure"])
def test_nothing_and_unknown_are_exit_0(capsys, steps, monkeypatch, verdict):
    def diagnose(problem, progress):
        return Diagnosis(verdict, comparison(problem.model), (), Where(), "", 64)

    monkeypatch.setattr(spiral.inference.diagnose, "diagnose", diagnose)
    assert run_json(capsys, "diagnose", *OWN)[0] == 0


BAD = [
    (["discovr"], "'discover'"),
    (["discover", "systm=a"], "'system'"),
    (["compare", *OWN, "record.pth=b"], "'path'"),
    (["compare", *FIELDS, "record.path=b.csv"], "a.csv"),
    (["compare", *OWN, "record.channels={x: tt}"], "'t'"),
    (["compare", *OWN, "cubic_stiffness"], "spiral add"),
    (["add", *OWN], "spiral plugins"),
    (["add", "cubic_stifness", *OWN], "'cubic_stiffness'"),
    (["compare", "run=latest"], "discover first"),
    (["compare", *OWN, "--jsn=3"], "--help"),
    (["compare", *OWN, "record.rate=1,2"], "-m"),
    (["compare", *OWN, "--plugins", "nowhere"], "--plugins"),
    (["plugins", "cubic_stifness"], "'cubic_stiffness'"),
    (["simulate", *OWN], ""),
    (["simulate", *OWN, "--out", "a.xlsx"], ""),
    (["discover", *OWN, "gate=[partial_f]"], "strategy=paper gate=[partial_f]"),
    (["diagnose", *OWN, "learner=boosted_trees"], "learner is one of paper"),
    (["discover", *OWN, "strategy=innovation", "paper.points=2000"], "points is one of paper"),
    (["discover", *OWN, "derivative=savitzky_golay"], "leave it out"),
    (["identify", *OWN, "learner.epochs=3"], "not an option of strategy=likelihood"),
    (["discover", *OWN, "strategy=shooting", "strategy.rivls=3"], "'rivals'"),
    (["discover", *OWN, "strategy=shooting", "strategy.rivals=-1"], "at least 0"),
    (["discover", *OWN, "strategy=paper", "gate=[innovation]"], "strategy=innovation gate="),
    (["discover", *OWN, "settings.phase_knot=2"], "never looks at"),
    (["compare", *OWN, "strategy=shooting", "settings.share=0.2"], "never looks at"),
    (["compare", *OWN, "--json"], "--help"),
]


@pytest.mark.parametrize(("words", "hint"), BAD, ids=[" ".join(w)[-40:] for w, _ in BAD])
def test_bad_input_is_one_message_and_exit_2(capsys, steps, words, hint):
    assert main(words) == 2
    told = capsys.readouterr()
    assert told.out == ""
    assert "Traceback" not in told.err
    assert "given:" in told.err
    assert "expected:" in told.err
    assert hint in told.err


@pytest.mark.parametrize("words", [b[0] for b in BAD[:-1]], ids=[" ".join(b[0])[-40:] for b in BAD[:-1]])  # fmt: skip  # noqa: E501
def test_bad_input_in_json(capsys, steps, words):
    code, result = run_json(capsys, *words)
    assert code == 2
    assert set(result["error"]) == {"given", "expected", "try"}


def test_progress_is_on_standard_error(capsys, steps):
    assert main(["discover", *OWN, "--json", "-"]) == 0
    told = capsys.readouterr()
    json.loads(told.out)
    assert "reading the records" in told.err
    assert "round 1: + cubic_stiffness" in told.err


def test_discover_is_readable_at_a_glance(capsys, steps):
    assert main(["discover", *OWN]) == 0
    out = capsys.readouterr().out
    for words in ("Rounds", "cubic_stiffness", "cannot be told from: clearance", "25.0 %", "3.00 %",
                  "refused rub: too small", "x'' =", "1.500 ± 0.010", "Missing was", "Next",
                  "spiral diagnose run="):  # fmt: skip
        assert words in out


@pytest.mark.parametrize("width", [60, 80, 120, 200])
def test_tables_fit_the_width(capsys, steps, monkeypatch, width):
    monkeypatch.setenv("COLUMNS", str(width))
    assert main(["discover", *OWN]) == 0
    table = capsys.readouterr().out.split("Rounds")[1].split("Model")[0]
    assert max(len(line) for line in table.splitlines()) <= width


def test_the_next_command_can_be_typed(capsys, steps):
    import shlex

    assert main(["diagnose", *OWN]) == 0
    out = capsys.readouterr().out
    assert "1. " in out or "cubic_stiffness" in out
    command = next(line for line in out.splitlines() if "spiral add" in line)
    assert main(shlex.split(command)[1:]) == 0
    assert "before" in capsys.readouterr().out


def test_sweep_rows_in_order_with_a_failed_one(capsys, steps):
    code, result = run_json(
        capsys, "compare", *FIELDS, "record.path=a.csv,b.csv", "holdout=0.2,0.3", "n_jobs=1", "-m"
    )
    assert code == 2
    assert [r["exit"] for r in result["runs"]] == [0, 0, 2, 2]
    assert [r["overrides"][-2] for r in result["runs"]] == ["holdout=0.2", "holdout=0.3"] * 2
    assert result["runs"][0]["result"]["test_error"] == 0.25
    assert "error" in result["runs"][2]["result"]


def test_sweep_summary_and_defects(capsys, steps, monkeypatch):
    def broken(problem, progress):
        raise ZeroDivisionError("a defect")

    monkeypatch.setattr(spiral.inference.compare, "compare", broken)
    assert main(["compare", *OWN, "holdout=0.2,0.3", "n_jobs=1", "-m"]) == 1
    out = capsys.readouterr().out
    assert "a defect" in out
    assert "holdout" in out
    assert "0.3" in out


def test_sweep_in_processes_gives_the_serial_rows(capsys):
    """Real workers: rows come in the sweep's order, each with its own message."""
    words = ["compare", *FIELDS, "record.path=b.csv,c.csv,d.csv,e.csv", "-m"]
    code, serial = run_json(capsys, *words, "n_jobs=1")
    assert (code, len(serial["runs"])) == (2, 4)
    _, parallel = run_json(capsys, *words, "n_jobs=2")
    for one, other, name in zip(serial["runs"], parallel["runs"], "bcde", strict=True):
        assert one["result"] == other["result"]
        assert f"{name}.csv" in one["result"]["error"]["given"]


SIMULATED = (
    "system=oscillator", "record=simulation", "record.duration=0.5",
    "record.inputs={force: {noise: 1.0, band: [5, 100]}}",
    "record.values={system.mass: 1, linear_stiffness.stiffness: 4e4, linear_damping.damping: 4}",
)  # fmt: skip


@pytest.mark.parametrize("ending", ["csv", "parquet"])
def test_a_simulated_file_reads_back(capsys, steps, ending):
    code, result = run_json(capsys, "simulate", *SIMULATED, "--out", f"made.{ending}")
    assert code == 0
    assert result["files"][0]["units"] == {"time": "s", "x": "m", "force": "N"}
    code, _ = run_json(capsys, "compare", *result["read_back"])
    assert code == 0
    (record,), (test,) = steps[-1].records, steps[-1].test
    assert record.samples + test.samples == 500
    assert record.noise["x"] > 0


def test_what_reads_a_file_back_names_the_systems_file_and_not_its_text(capsys, tmp_path):
    (tmp_path / "own.yaml").write_text(
        "equations: [\"m*x'' + k*x = F\"]\nstates: {x: m}\ninputs: {F: N}\n"
        "parameters: {m: 2.0 kg, k: 4e4 N/m}\nfree: [k]\nobserved: [x]\n"
    )
    system = f"system={tmp_path / 'own.yaml'}"
    given = (system, "record=simulation", "record.inputs={F: {constant: 1}}", "record.duration=0.5")
    _, result = run_json(capsys, "simulate", *given, "--out", str(tmp_path / "made.csv"))
    own = [word for word in result["read_back"] if word.startswith("system")]
    assert own == ["system=equations", f"system.path={tmp_path / 'own.yaml'}"]


def test_simulate_says_how_to_read_it_back(capsys, steps):
    import shlex

    assert main(["simulate", *SIMULATED, "--out", "made.csv"]) == 0
    out = capsys.readouterr().out
    command = next(line for line in out.splitlines() if "spiral discover" in line)
    assert main(["compare", *shlex.split(command)[2:]]) == 0


def test_a_saved_model_can_be_simulated(capsys, steps):
    run_json(capsys, "add", "cubic_stiffness", *OWN)
    code, result = run_json(
        capsys, "simulate", "run=latest", "record.duration=0.2", "record.noise_level=0",
        "record.inputs={force: {chirp: 1.0, band: [5, 50]}}", "--out", "made.csv",
    )  # fmt: skip
    assert code == 0
    assert result["files"][0]["rows"] == 200


def test_plugins_list(capsys):
    code, result = run_json(capsys, "plugins", "source", "cubic_stiffness")
    assert code == 0
    names = [p["name"] for p in result["plugins"]]
    assert names == [
        "cubic_stiffness",
        "csv",
        "file",
        "order_table",
        "rotor_coastdown",
        "simulation",
    ]
    assert result["plugins"][0]["meaning"].startswith("Stiffness that grows")
    assert result["plugins"][0]["parameters"] == {"stiffness": "force/position^3"}
    assert main(["plugins"]) == 0
    assert "planar_rotor" in capsys.readouterr().out


def test_a_kind_beside_a_name_of_it_says_what_the_name_is(capsys):
    _, result = run_json(capsys, "plugins", "effect", "rub")
    assert [p["name"] for p in result["plugins"]] == ["rub"]


def test_an_effect_asked_for_shows_its_parameters_and_where_it_acts(capsys):
    assert main(["plugins", "tilting_rotor"]) == 0
    told = capsys.readouterr().out
    assert "forces act at: disk, bearing_1, bearing_2" in told
    assert "hidden" in told
    assert "phase_origin" in told
    assert main(["plugins", "mutual_flow", "rub", "input_delay"]) == 0
    shown = " ".join(capsys.readouterr().out.split())
    assert "rate force/position^2 one for each axis" in shown
    assert "acts on states of first order, two together in g/l, mol/l, 1/l" in shown
    assert "acts at a port of 2 axes" in shown
    assert "does what delay or sensor_lag does elsewhere" in shown


def test_a_plugin_asked_for_shows_its_fields(capsys):
    _, result = run_json(capsys, "plugins", "csv")
    (found,) = result["plugins"]
    assert set(found["field_meanings"]) == set(found["fields"])
    assert found["field_meanings"]["rate"].startswith("samples per s")
    assert main(["plugins", "file"]) == 0
    out = capsys.readouterr().out
    assert "probe_angles" in out
    assert "counterclockwise" in out


def test_a_broken_plugin_is_reported(capsys, place):
    (place / "mine").mkdir()
    (place / "mine" / "broken.py").write_text("1 / 0")
    assert main(["plugins", "--plugins", "mine"]) == 0
    out = capsys.readouterr().out
    assert "broken.py" in out
    assert "ZeroDivisionError" in out
    assert "cubic_stiffness" in out


def test_help_answers_within_a_second_and_imports_nothing_heavy():
    code = (
        "import sys; from spiral.cli import main\n"
        "try: main(['--help'])\n"
        "except SystemExit: pass\n"
        "heavy = {'numpy','sympy','numba','pint','scipy','pandas','hydra','rich','joblib'}\n"
        "sys.exit(', '.join(heavy & set(sys.modules)) or 0)"
    )
    started = time.perf_counter()
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False, env=os.environ
    )
    assert done.returncode == 0, done.stderr
    assert time.perf_counter() - started < 1.0
    for verb in ("discover", "compare", "diagnose", "add", "simulate", "plugins", "check", "new"):
        assert verb in done.stdout


def test_no_verb_prints_help(capsys):
    assert main([]) == 0
    assert "spiral discover experiment=rotor_coastdown" in capsys.readouterr().out


def test_a_machine_that_only_its_controller_holds_is_compared(tmp_path, capsys):
    """Its free run leaves all bounds with the true values, too: it is told one sample ahead."""
    rng, x, rows = np.random.default_rng(3), 0.0, []
    for k in range(1500):
        u = -30.0 * (x - 0.3 * np.sin(0.01 * k)) + 2 * rng.normal()
        rows.append((0.01 * k, x + 0.003 * rng.normal(), u))
        x = np.exp(0.2) * x + (np.exp(0.2) - 1) / 20 * u
    head = "t,x,u"
    np.savetxt(tmp_path / "a.csv", rows, delimiter=",", header=head, comments="", fmt="%.8g")
    (tmp_path / "model.yaml").write_text(
        'equations: ["x\' = a*x + u"]\nstates: {x: m}\n'
        "inputs: {u: {unit: m/s, interpolation: zero_order}}\n"
        "parameters: {a: 15 1/s}\nfree: [a]\nobserved: [x]\n"
    )
    model, file = tmp_path / "model.yaml", tmp_path / "a.csv"
    asked = ["compare", f"system={model}", "record=csv", f"record.path={file}", f"out={tmp_path}",
             "record.rows=[0,1000]", "test=csv", f"test.path={file}",
             "test.rows=[1000,1500]"]  # fmt: skip
    assert main(asked) == 0
    told = " ".join(capsys.readouterr().out.split())
    assert "one sample ahead the model is told" in told
    assert main(["plugins", str(model)]) == 0
    told = " ".join(capsys.readouterr().out.split())
    assert "x m measured" in told
    assert "flows act on: x" in told
