"""What MLflow knows of a run: parent and rounds, figures by step, data, plugins, a model."""

import json
import os
import sqlite3
import time
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from spiral.cli import main
from spiral.commands import tracking
from spiral.io.storage import FILE, load_run, read_run, run_ids
from spiral.io.tracking import background
from spiral.io.tracking.content import flat_parameters, metric_name
from spiral.io.tracking.store import (
    URI_VARIABLE,
    Store,
    Tracking,
    import_mlflow,
    open_store,
    use_store,
)
from spiral.io.tracking.track import MARK, FailedJob, track
from tests.sweep_jobs import RECORD

STUDY = ("discover", "experiment=rotor_coastdown", "record.duration=4", "settings.max_rounds=2",
         "strategy=shooting", "candidates=[cross_stiffness,cubic_stiffness]")  # fmt: skip
BEFORE = os.environ.get(URI_VARIABLE)


@pytest.fixture(autouse=True)
def untracked():
    """These tests are about MLflow: nothing is put in its place."""


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """One real study, tracked in a fresh folder, an exported run id in the way."""
    folder = tmp_path_factory.mktemp("tracked")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        patch.delenv("MLFLOW_TRACKING_URI", raising=False)
        patch.setenv("MLFLOW_RUN_ID", "0123456789abcdef0123456789abcdef")
        assert main([*STUDY, "--json", "result.json"]) == 0
    return folder


@pytest.fixture(scope="module")
def result(place):
    return json.loads((place / "result.json").read_text())


@pytest.fixture(scope="module")
def client(place):
    import_mlflow()
    from mlflow import MlflowClient

    return MlflowClient(tracking_uri=f"sqlite:///{place / 'runs' / 'mlflow.db'}")


@pytest.fixture(scope="module")
def parent(client, result):
    return only(client, f"tags.`spiral.run_id` = '{result['run_id']}'")


def only(client, query):
    (run,) = client.search_runs([client.get_experiment_by_name("spiral").experiment_id], query)
    return run


def children(client, parent):
    query = f"tags.`mlflow.parentRunId` = '{parent.info.run_id}'"
    return client.search_runs([parent.info.experiment_id], query, order_by=["start_time"])


def test_the_error_of_every_round_is_a_metric_with_the_round_as_step(client, parent, result):
    history = client.get_metric_history(parent.info.run_id, "test_error")
    seen = {m.step: m.value for m in history}
    assert seen == {r["round"]: r["test_error"] for r in result["rounds"]}
    assert len(seen) == 3
    assert seen[2] < seen[1] < seen[0]


def test_every_round_is_a_child_that_says_what_it_admitted(client, parent, result):
    found = children(client, parent)
    assert [r.data.tags["spiral.admitted"] for r in found] == [
        ", ".join(r["admitted"]) for r in result["rounds"]
    ]
    assert [r.data.metrics["chi2_per_dof"] for r in found] == [
        r["chi2_per_dof"] for r in result["rounds"]
    ]
    assert all(r.info.status == "FINISHED" for r in found)
    assert "round.json" in {f.path for f in client.list_artifacts(found[1].info.run_id)}


def test_terms_come_with_t_and_standard_error(client, parent, result):
    (effect,) = result["rounds"][1]["admitted"]
    name, told = next(iter(result["model"]["effects"][effect].items()))
    assert parent.data.metrics[f"t.{effect}.{name}"] == told["t"]
    table = pd.read_parquet(client.download_artifacts(parent.info.run_id, "terms.parquet"))
    row = table[(table["effect"] == effect) & (table["parameter"] == name)].iloc[0]
    assert {k: row[k] for k in told} == told


def test_a_run_is_named_by_what_tells_it_from_others(parent):
    own = "duration=4 max_rounds=2 strategy=shooting candidates=[cross_stiffness,cubic_stiffness]"
    assert parent.info.run_name == f"{own} discover rotor_coastdown"


def test_configuration_data_and_plugins_are_kept(client, parent, place, result):
    assert parent.data.params["record.duration"] == "4"
    assert parent.data.params["settings.max_rounds"] == "2"
    saved = read_run(place / "runs" / result["run_id"] / FILE)
    hashes = [r["sha256"] for group in saved.data["data"].values() for r in group]
    assert parent.data.tags["spiral.data"] == ", ".join(hashes)
    digests = {i.dataset.digest for i in client.get_run(parent.info.run_id).inputs.dataset_inputs}
    assert digests == {h[:36] for h in hashes}
    names = {f.path for f in client.list_artifacts(parent.info.run_id)}
    assert {"config.yaml", "plugins.json", "run.json", "terms.json", "suggestions.json",
            "report.html"} <= names  # fmt: skip
    file = client.download_artifacts(parent.info.run_id, "plugins.json")
    plugins = json.loads(Path(file).read_text(encoding="utf-8"))
    assert plugins["system/planar_rotor"].startswith("spiral-po")


def test_the_served_model_predicts_a_new_record(client, parent, place, result):
    import mlflow

    from spiral.io.config import build_problem
    from spiral.io.registry import load_registry

    saved = load_run(result["run_id"], place / "runs")
    problem = build_problem(saved.config, load_registry())
    test = problem.test[0]
    table = pd.DataFrame({"t": test.time, **test.channels, **test.inputs})
    uri = f"sqlite:///{place / 'runs' / 'mlflow.db'}"
    with use_store(Store(client, parent.info.experiment_id, uri)):
        model = mlflow.pyfunc.load_model(f"runs:/{parent.info.run_id}/model")
    predicted = model.predict(table, params={"settle": 0.4})
    first = round(0.4 / test.dt)
    for channel in ("x", "y"):
        missed = (predicted[channel] - table[channel]).to_numpy()[first:]
        spread = np.std(table[channel].to_numpy()[first:])
        assert np.sqrt(np.mean(missed**2)) / spread == pytest.approx(
            result["test"][channel]["relative"],
            rel=1e-3,  # its noise is estimated here
        )


def test_a_run_is_logged_once(client, parent, place, result):
    again = track(Tracking(), place / "runs", (result["run_id"],))
    assert again.runs == {result["run_id"]: parent.info.run_id}
    assert only(client, f"tags.`spiral.run_id` = '{result['run_id']}'")


def test_half_a_run_left_by_a_killed_process_is_replaced(client, place, result, parent):
    folder = place / "runs" / result["run_id"]
    kept = (folder / MARK).read_text()
    (folder / MARK).unlink()
    found = track(Tracking(model=False), place / "runs")  # the next start catches up
    assert found.failure is None
    new = only(client, f"tags.`spiral.run_id` = '{result['run_id']}'")
    assert new.info.run_id != parent.info.run_id
    assert len(children(client, new)) == 3
    assert not children(client, parent)
    client.delete_run(new.info.run_id)
    client.restore_run(parent.info.run_id)
    (folder / MARK).write_text(kept)


def test_the_environment_is_as_it_was_after_a_model_is_logged(place, result):
    assert os.environ.get(URI_VARIABLE) == BEFORE


def copy_of(place, result, folder):
    """The saved run in a folder with no store yet."""
    target = folder / "runs" / result["run_id"]
    target.mkdir(parents=True)
    (target / FILE).write_bytes((place / "runs" / result["run_id"] / FILE).read_bytes())
    return folder / "runs"


def test_a_locked_database_is_said_and_caught_up_by_the_next_start(place, result, tmp_path):
    out = copy_of(place, result, tmp_path)
    with open_store(Tracking(model=False), out):
        pass  # made and migrated
    lock = sqlite3.connect(out / "mlflow.db", isolation_level=None)
    lock.execute("BEGIN EXCLUSIVE")
    impatient = f"sqlite:///{out / 'mlflow.db'}?timeout=0.5"
    said = track(Tracking(uri=impatient, model=False), out, (result["run_id"],))
    assert "locked" in str(said.failure)
    assert not (out / result["run_id"] / MARK).exists()
    assert read_run(out / result["run_id"] / FILE).run_id == result["run_id"]
    lock.execute("ROLLBACK")
    lock.close()
    assert track(Tracking(model=False), out).failure is None
    assert (out / result["run_id"] / MARK).exists()


def test_the_uri_of_the_environment_is_honoured(place, result, tmp_path, monkeypatch):
    out = copy_of(place, result, tmp_path)
    monkeypatch.setenv("MLFLOW_TRACKING_URI", f"sqlite:///{tmp_path / 'elsewhere.db'}")
    assert track(Tracking(model=False), out, (result["run_id"],)).failure is None
    assert (tmp_path / "elsewhere.db").exists()
    assert not (out / "mlflow.db").exists()


def test_an_unreachable_server_loses_nothing_and_little_time(place, result, tmp_path):
    out = copy_of(place, result, tmp_path)
    began = time.monotonic()
    said = track(Tracking(uri="http://me:secret@127.0.0.1:9"), out, (result["run_id"],))
    assert time.monotonic() - began < 10  # MLflow's client alone tries for minutes
    assert "no answer from http://me:***@127.0.0.1:9" in str(said.failure)
    assert read_run(out / result["run_id"] / FILE)


def until(reached, seconds=120.0):
    end = time.monotonic() + seconds
    while not reached():
        assert time.monotonic() < end, "MLflow was not told"
        time.sleep(0.1)


def test_a_process_of_its_own_tells_mlflow_and_the_next_command_what_it_could_not(
    tmp_path, monkeypatch, capsys
):
    """A server that is down: said by the next command, whose process tells both runs."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv(background.WAIT_VARIABLE)
    monkeypatch.setattr(tracking, "_log_in_foreground", None)
    # A file of the folder that a command is called in is no module of the process.
    (tmp_path / "mlflow.py").write_text("raise RuntimeError('it ran')")
    words = ["compare", *RECORD, "strategy=shooting", "tracking.model=false"]
    address = "http://me:secret@127.0.0.1:9"
    assert main([*words, f"tracking.uri={address}"]) == 0
    assert "MLflow" not in capsys.readouterr().err
    until((tmp_path / "runs" / background.FAILURE).is_file)
    assert main(words) == 0
    said = capsys.readouterr().err
    assert "not told to MLflow: no answer from http://me:***@127.0.0.1:9" in said
    runs = run_ids("runs")
    until(lambda: all((tmp_path / "runs" / name / MARK).is_file() for name in runs))
    assert len(runs) == 2
    assert not (tmp_path / "runs" / background.FAILURE).exists()


def test_what_a_failure_says_is_one_plain_line(tmp_path):
    """The folder of runs may be anyone's."""
    assert background.take_last_failure(tmp_path) == ""
    said = json.dumps({"failure": "\x1b[31mred\n\nline" + "x" * 10_000})
    (tmp_path / background.FAILURE).write_text(said)
    assert background.take_last_failure(tmp_path)[:20] == "[31mred linexxxxxxxx"
    (tmp_path / background.FAILURE).write_text(said[:1000])
    assert background.take_last_failure(tmp_path) == ""
    (tmp_path / background.FAILURE).unlink()
    (tmp_path / background.FAILURE).symlink_to(Path(__file__))
    assert background.take_last_failure(tmp_path) == ""


def test_runs_saved_after_an_order_are_left_to_their_own_commands(place, result, tmp_path):
    """They may still write their curves."""
    out = copy_of(place, result, tmp_path)
    later = out / f"9{result['run_id'][1:]}"
    later.mkdir()
    (later / FILE).write_bytes((out / result["run_id"] / FILE).read_bytes())
    assert track(Tracking(model=False), out, (result["run_id"],)).failure is None
    assert not (later / MARK).exists()
    assert track(Tracking(model=False), out).failure is None
    assert (later / MARK).exists()


def test_a_failed_job_is_a_failed_run_and_told_again_is_still_one(tmp_path):
    job = FailedJob("s1", 3, ("holdout=2",), {"given": "holdout=2", "expected": "a share"})
    for _ in range(2):
        assert track(Tracking(), tmp_path, failed=(job,)).failure is None
    import_mlflow()
    from mlflow import MlflowClient

    client = MlflowClient(tracking_uri=f"sqlite:///{tmp_path / 'mlflow.db'}")
    run = only(client, "tags.`spiral.sweep` = 's1'")
    assert run.info.status == "FAILED"
    assert "holdout=2" in run.data.tags["spiral.error"]


def test_a_password_is_never_shown():
    store = Tracking(uri="postgresql+psycopg://me:secret@db.example:5432/mlflow")
    assert "secret" not in store.page("runs")
    assert store.resolve_uri("runs").count("secret") == 1
    assert "me:***@db.example:5432/mlflow" in store.page("runs")


def test_names_and_values_fit_every_store():
    assert metric_name("t.cubic_stiffness@bearing_2.k") == "t.cubic_stiffness:bearing_2.k"
    flat = flat_parameters({"a": {"b": [1, 2], "c": None}, "d": "x" * 9000})
    assert flat["a.b"] == "[1, 2]"
    assert set(flat) == {"a.b", "d"}
    assert len(flat["d"]) == 5000


def test_a_bad_tracking_field_is_refused_before_anything_is_computed(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["compare", "experiment=rotor_coastdown", "tracking.enabeld=false"]) == 2
    assert "enabled" in capsys.readouterr().err


def test_figures_of_a_filter_are_metrics_beside_the_static_map(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    words = ["estimate", "experiment=rotor_coastdown", "system=tilting_rotor", "record.duration=2"]
    assert main([*words, "tracking.model=false", "--json", "found.json"]) == 0
    found = json.loads((tmp_path / "found.json").read_text())
    with open_store(Tracking(), tmp_path / "runs") as store:
        run = only(store.client, f"tags.`spiral.run_id` = '{found['run_id']}'")
    for name in ("alpha", "beta"):
        assert run.data.metrics[f"relative.{name}"] == found["states"][name]["relative"]
        static = found["static_baseline"][name]["relative"]
        assert run.data.metrics[f"static_relative.{name}"] == static
        assert found["states"][name]["relative"] < static
    assert run.data.metrics["nis_mean"] == found["nis_mean"]


@pytest.mark.slow
def test_a_sweep_is_tracked_by_the_parent_alone_and_failed_jobs_with_it(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    words = ["compare", *RECORD]
    swept = ["record.seed=1,2", "holdout=0.2,2", "n_jobs=2", "-m", "--json", "rows.json"]
    assert main([*words, *swept]) == 2
    rows = json.loads((tmp_path / "rows.json").read_text())
    import_mlflow()
    from mlflow import MlflowClient

    client = MlflowClient(tracking_uri=f"sqlite:///{tmp_path / 'runs' / 'mlflow.db'}")
    number = client.get_experiment_by_name("spiral").experiment_id
    sweep = rows["sweep"]["id"]
    found = client.search_runs([number], f"tags.`spiral.sweep` = '{sweep}'")
    done = {r.data.tags["spiral.run_id"]: r for r in found if r.info.status == "FINISHED"}
    assert len(found) == 4
    assert sum(r.info.status == "FAILED" for r in found) == 2
    for row in (r for r in rows["runs"] if r["exit"] == 0):
        run = done[row["result"]["run_id"]]
        assert f"record.seed={run.data.params['record.seed']}" in row["overrides"]
        assert run.data.metrics["test_error"] == row["result"]["test_error"]
