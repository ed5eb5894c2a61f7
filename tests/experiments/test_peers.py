"""The comparison with other methods, in a fast mode: one short record, every method."""

import numpy as np
import pytest

from experiments.peers import run, tracked
from experiments.peers.cases import HIDDEN, Answer, Case, free_run, scored
from experiments.peers.delays import embedded, in_delays
from experiments.peers.regressions import regressed, table
from experiments.peers.run import ALL, answer, line
from spiral.io.registry import load_registry
from tests.scenes import PROJECTION

REGISTRY = load_registry(None)
SHORT = Case("rotor", 0.02, 11, 4.0)
ONE_ROUND = ("settings.max_rounds=1", "candidates=[cross_stiffness]")


@pytest.fixture(scope="module")
def problem():
    return SHORT.problem(REGISTRY)


TRUTH = {**PROJECTION, "speed_stiffness.coefficient": np.nan, "cross_damping.damping": np.nan}
TRUTH |= {"linear_damping.damping_x": 3.5, "linear_damping.damping_y": 2.1}


@pytest.mark.slow
def test_the_truth_is_the_projection() -> None:
    truth = SHORT.truth()
    assert set(truth) >= set(TRUTH) - {"cross_damping.damping"}
    for key, value in PROJECTION.items():
        assert truth[key] == pytest.approx(value, rel=1e-2)


def test_a_free_run_of_the_true_coefficients_ends_at_the_noise() -> None:
    case = Case("nothing", 0.02, 11, 4.0)
    problem, truth = case.problem(REGISTRY), case.truth()
    assert free_run(problem, truth, {}) < 0.03
    assert free_run(problem, {**truth, "linear_stiffness.stiffness_x": 9000.0}, {}) > 0.3


def test_scores_count_what_is_not_true_and_what_is_missing() -> None:
    found = {"rub.stiffness": 1.0, "gyroscopic.coefficient": 2.4e-3}
    row = scored(SHORT, Answer("any", found), TRUTH)
    assert row["false"] == ["rub"]
    assert row["errors"]["gyroscopic.coefficient"] == pytest.approx(-0.5, abs=0.01)
    assert row["errors"]["cross_stiffness.stiffness"] == -1.0
    assert "1 of 3" in line(row)


def some_rows(seeds=(11, 12)) -> list[dict]:
    answers = {11: {"gyroscopic.coefficient": 4.9e-3}, 12: {"rub.stiffness": 1.0}}
    return [
        {**scored(Case("rotor", 0.02, s, 4.0), Answer("any", answers[s], 0.1 * s), TRUTH),
         "duration": 4.0}
        for s in seeds
    ]  # fmt: skip


def test_rows_are_kept_and_put_together_over_seeds(tmp_path) -> None:
    rows = some_rows()
    tracked.keep(tmp_path, rows)
    assert tracked.kept(tmp_path) == rows
    assert len({tracked.name_of(r) for r in rows}) == 2
    (group,) = tracked.summary(rows)
    assert group["couplings"] == {"cross_stiffness": 0, "cubic_stiffness": 0, "gyroscopic": 1}
    assert (group["false"], group["test_error"]) == (0.5, pytest.approx(1.15))
    assert "| 1/2, " in tracked.table(rows)


def test_what_is_there_is_not_done_again(tmp_path, monkeypatch) -> None:
    told = []
    monkeypatch.setattr(tracked, "tell", lambda out, rows: told.extend(rows))
    monkeypatch.setattr(run, "row", lambda method, case: some_rows((case.seed,))[0])
    cases = [Case("rotor", 0.02, s, 4.0) for s in (11, 12)]
    assert len(run.collected(cases[:1], ["any"], tmp_path, 1)) == 1
    monkeypatch.setattr(run, "row", lambda method, case: {**some_rows((12,))[0], "again": 1})
    both = run.collected(cases, ["any"], tmp_path, 1)
    assert [(r["seed"], r.get("again")) for r in both] == [(11, None), (12, 1)]


@pytest.mark.slow
def test_mlflow_has_a_parent_for_the_case_and_a_child_for_each_row_once(tmp_path) -> None:
    from mlflow import MlflowClient

    for rows in (some_rows((11,)), some_rows(), some_rows()):
        tracked.tell(tmp_path, rows)
    client = MlflowClient(f"sqlite:///{tmp_path / 'mlflow.db'}")
    found = client.search_runs([client.get_experiment_by_name("peers").experiment_id])
    children = [r for r in found if "mlflow.parentRunId" in r.data.tags]
    (parent,) = [r for r in found if r not in children]
    assert len(children) == 2
    assert {r.data.tags["mlflow.parentRunId"] for r in children} == {parent.info.run_id}
    assert parent.data.metrics["any.test_error"] == pytest.approx(1.15)
    assert {r.data.metrics["hidden_found"] for r in children} == {0.0, 1.0}


@pytest.mark.parametrize("method", ["pysindy sr3"])
def test_pysindy_finds_the_large_couplings_in_the_same_library(problem, method) -> None:
    row = scored(SHORT, regressed(method, problem, (0.01,)), TRUTH)
    assert {"cross_stiffness", "cubic_stiffness"} <= set(row["found"])
    assert abs(row["errors"]["cross_stiffness.stiffness"]) < 0.1
    assert row["test_error"] < 2


def test_columns_are_shared_by_both_equations_and_scaled(problem) -> None:
    found = table(problem)
    assert len(found.columns) == len(found.target) == 2
    norms = np.sqrt(np.mean(np.array(found.columns) ** 2, axis=(0, 1)))
    assert np.allclose(norms, 1.0)


def test_delay_coordinates_give_the_signal_back() -> None:
    time = 1e-2 * np.arange(600)
    y = np.column_stack([np.sin(3 * time), 2 + np.cos(3 * time)])
    embedding = embedded(y, 4)
    assert np.allclose(embedding.back(embedding(y)), y[embedding.span :], atol=1e-6)


@pytest.mark.parametrize("method", ["havok"])
def test_delay_methods_predict_and_name_nothing(problem, method) -> None:
    row = scored(SHORT, in_delays(method, problem), TRUTH)
    assert 0 < row["test_error"] < 1.5
    assert "false" not in row


@pytest.mark.slow
def test_shooting_stands_in_the_same_table(problem) -> None:
    row = scored(SHORT, answer("shooting", SHORT, problem, ONE_ROUND), TRUTH)
    assert [h for h in HIDDEN if h in row["found"]] == ["cross_stiffness"]
    assert row["false"] == []


@pytest.mark.slow
@pytest.mark.parametrize("method", ALL)
def test_every_method_answers(problem, method) -> None:
    row = scored(SHORT, answer(method, SHORT, problem, ONE_ROUND), TRUTH)
    assert row["seconds"] > 0
    assert method in line(row)
