"""The verb ``estimate``: keys of its JSON, files, exit codes; small records, real filters."""

import json

import numpy as np
import pandas as pd
import pytest

from spiral.cli import main

VALUES = "values={system.mass: 1, linear_stiffness.stiffness: 400, linear_damping.damping: 0.8}"
OWN = ("system=oscillator", "record=csv", "record.path=a.csv", VALUES)
SIMULATED = (
    "system=oscillator", "record=simulation", VALUES, "record.duration=4", "record.rate=200",
    "record.values={system.mass: 1, linear_stiffness.stiffness: 400, linear_damping.damping: 0.8}",
    "record.inputs={force: {noise: 1.0, band: [1, 8]}}", "record.noise_level=0.05",
)  # fmt: skip


@pytest.fixture(autouse=True)
def place(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "80")
    return tmp_path


def run_json(capsys, *words):
    code = main([*words, "--json", "-"])
    return code, json.loads(capsys.readouterr().out, parse_constant=pytest.fail)


def test_keys_where_the_truth_is_known(capsys):
    code, result = run_json(capsys, "estimate", *SIMULATED, "observer.process_noise=0.001")
    assert code == 0
    assert {"states", "nis_mean", "static_baseline", "seconds"} <= set(result)
    for state in ("x", "x_rate"):
        found = result["states"][state]
        assert {"rmse", "relative", "correlation", "coverage_95"} <= set(found)
        assert 0 < found["relative"] < 0.05  # under the noise
    (record,) = result["records"]
    assert record["nis"]["bounds"][0] < record["nis"]["mean"] < record["nis"]["bounds"][1]
    assert record["nees"]["mean"] > 0
    assert len(record["nis_bands"]) == 6
    assert 0.9 < record["prediction"]["x"] < 1.2
    assert record["whiteness_p"] > 0.001
    assert result["observability"]["rank"] == result["observability"]["states"] == 2


def test_own_file_gives_states_with_bands_as_csv_and_parquet(capsys):
    assert main(["simulate", *SIMULATED, "--out", "a.csv"]) == 0
    capsys.readouterr()
    words = ("estimate", *OWN, "observer=rts", "observer.process_noise=0.001", "--out", "states")
    code, result = run_json(capsys, *words)
    assert code == 0
    assert "relative" not in result["states"]["x_rate"]  # no truth, no error
    assert result["states"]["x_rate"]["deviation"] > 0
    assert [f["file"] for f in result["files"]] == ["states.csv", "states.parquet"]
    table = pd.read_csv("states.csv")
    assert list(table) == ["time", "x", "x_low", "x_high", "x_rate", "x_rate_low", "x_rate_high"]
    assert len(table) == 800
    assert np.all(table.x_rate_low < table.x_rate)
    assert np.all(table.x_rate < table.x_rate_high)
    assert np.allclose(pd.read_parquet("states.parquet"), table)


def test_terminal_shows_the_static_map_beside_each_result(capsys):
    words = ["experiment=rotor_coastdown", "system=tilting_rotor", "record.duration=3"]
    assert main(["estimate", *words, "observer.process_noise=0.001"]) == 0
    shown = capsys.readouterr().out
    assert "static" in shown
    row = next(line for line in shown.splitlines() if line.startswith("alpha "))
    assert row.count("%") == 3  # error, static map, share inside the band
    assert "NIS" in shown
    assert "observability rank 8 of 8" in shown


def test_unknown_parameters_are_fitted_first(capsys):
    words = [w for w in SIMULATED if w is not VALUES]
    code, result = run_json(capsys, "estimate", *words, "observer.process_noise=0.001")
    assert code == 0
    fitted = result["calibration"]["model"]["effects"]["linear_stiffness"]["stiffness"]
    mass = result["calibration"]["model"]["system"]["mass"]["estimate"]
    assert fitted["estimate"] / mass == pytest.approx(400, rel=0.05)
    assert result["states"]["x_rate"]["relative"] < 0.1


def test_divergence_is_exit_3_with_the_stable_window(capsys):
    wrong = VALUES.replace("stiffness: 400", "stiffness: -40000")
    words = [wrong if w is VALUES else w for w in SIMULATED]
    code, result = run_json(capsys, "estimate", *words, "observer.process_noise=0.0")
    assert code == 3
    assert result["records"][0]["diverged"]
    assert 0 <= result["records"][0]["stable_s"][1] < 4
    assert {"given", "expected", "try"} <= set(result["error"])


@pytest.mark.parametrize(
    ("word", "hint"),
    [
        ("observer=efk", "ekf"),
        ("observer.process_noise={observd: 0.1}", "observed"),
        ("observer.track=[linear_stiffness.stifness]", "linear_stiffness.stiffness"),
        ("observer=static", "hidden coordinates"),
    ],
)
def test_bad_input_is_exit_2_and_names_what_is_near(capsys, word, hint):
    code, result = run_json(capsys, "estimate", *SIMULATED, word)
    assert code == 2
    assert hint in result["error"]["expected"] + result["error"]["try"]
