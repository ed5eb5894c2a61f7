"""Saved runs: whole or not at all, found by name, and taken up again."""

import json
import math
import os
from datetime import UTC, datetime, timedelta

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from spiral.io import storage
from spiral.io.config import build_problem, compose
from spiral.io.registry import load_registry
from spiral.io.run_id import new_run_id
from spiral.io.storage import load_run, run_ids, save_run
from spiral.io.writing import to_json
from spiral.types.errors import ConfigError, InputError
from spiral.types.run import ChannelError, Comparison, Round, Run

REGISTRY = load_registry()
OVERRIDES = ("experiment=rotor_coastdown", "record.duration=0.2", "effect=[rub]", "free=[rub.gap]")


@pytest.fixture(scope="module")
def study():
    config = compose(OVERRIDES, REGISTRY)
    return config, build_problem(config, REGISTRY)


def made(problem):
    from dataclasses import replace

    keys = [k for k, _ in problem.model.pairs]
    values = {k: 1.0 + i for i, k in enumerate(keys)}
    model = replace(problem.model, values=values, errors=dict.fromkeys(keys, 0.1))
    channels = {"x": ChannelError(1e-6, 0.02), "y": ChannelError(1e-6, math.nan)}
    comparison = Comparison(model, 0.1, math.inf, channels, 0.02, 1.0, 0.5, 0.0, 64, True)
    rounds = (Round(0, (), {}, {}, (), comparison, 1.0),)
    return Run("nothing_missing", "whiteness", rounds, model, "advice")


def saved(study, folder):
    config, problem = study
    data = {"records": problem.records, "test": problem.test}
    return save_run(made(problem), config, data, REGISTRY, folder)


def test_a_run_comes_back_as_it_was(study, tmp_path):
    run = saved(study, tmp_path)
    found = load_run("latest", tmp_path)
    assert found.run_id == run.run_id
    model = found.model(REGISTRY)
    assert model == run.model
    assert found.config == json.loads(to_json(study[0]))
    assert found.data["data"]["records"][0]["sha256"] == study[1].records[0].sha256
    assert found.data["plugins"]["system/planar_rotor"]
    assert found.result["rounds"][0]["test_error"] is None  # infinity


def test_a_run_is_taken_up_again(study, tmp_path):
    run = saved(study, tmp_path)
    base = load_run(run.run_id[:12], tmp_path).as_config()
    again = build_problem(compose((), REGISTRY, base), REGISTRY).model
    assert set(again.labels) == set(run.model.labels)
    assert dict(again.values) == dict(run.model.values)
    assert again.freed == run.model.freed
    more = build_problem(compose(("effect=[gyroscopic]",), REGISTRY, base), REGISTRY).model
    assert set(more.labels) == {*run.model.labels, "gyroscopic"}
    less = build_problem(compose(("without=[rub]",), REGISTRY, base), REGISTRY).model
    assert set(less.labels) == set(run.model.labels) - {"rub"}
    with pytest.raises(ConfigError, match="one of them"):
        compose(("experiment=silverbox",), REGISTRY, base)


def test_latest_and_prefixes(study, tmp_path):
    first, second = saved(study, tmp_path), saved(study, tmp_path)
    assert run_ids(tmp_path) == sorted([first.run_id, second.run_id])
    assert load_run(first.run_id, tmp_path).run_id == first.run_id
    with pytest.raises(ConfigError, match="2 runs start with"):
        load_run(first.run_id[:6], tmp_path)
    with pytest.raises(ConfigError) as caught:
        load_run(first.run_id[:-1] + "zz", tmp_path)
    assert first.run_id in caught.value.try_


def test_no_runs_and_no_folder(tmp_path):
    for folder in (tmp_path, tmp_path / "nowhere"):
        with pytest.raises(ConfigError, match="a saved run in"):
            load_run("latest", folder)


@pytest.mark.parametrize("text", ["", "{}", "[1]", '{"format": 99, "run_id": "a"}', "\x00"])
def test_a_broken_file_is_told(tmp_path, text):
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "run.json").write_text(text)
    with pytest.raises(InputError):
        load_run("latest", tmp_path)


def test_a_plugin_that_is_gone_is_named(study, tmp_path):
    saved(study, tmp_path)
    found = load_run("latest", tmp_path)
    found.data["model"]["effects"][0]["name"] = "lost_spring"
    with pytest.raises(ConfigError, match="lost_spring"):
        found.model(REGISTRY)


def test_an_interrupted_write_leaves_nothing(study, tmp_path, monkeypatch):
    kept = saved(study, tmp_path)

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(storage.os, "fsync", full)
    with pytest.raises(InputError, match="No space left"):
        saved(study, tmp_path)
    assert run_ids(tmp_path) == [kept.run_id]
    assert [p for p in tmp_path.rglob("*.tmp")] == []  # noqa: C416


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_a_folder_that_cannot_be_written(study, tmp_path):
    tmp_path.chmod(0o500)
    with pytest.raises(InputError, match="folder of runs"):
        saved(study, tmp_path / "in")


def test_a_file_in_the_folders_place(study, tmp_path):
    (tmp_path / "runs").write_text("")
    with pytest.raises(InputError, match="folder of runs"):
        saved(study, tmp_path / "runs")


def test_ids_sort_by_time():
    start = datetime(2025, 1, 31, 23, 59, 59, 999000, tzinfo=UTC)
    ids = [new_run_id(start + timedelta(milliseconds=7 * i)) for i in range(50)]
    assert ids == sorted(ids)
    back = start - timedelta(days=400)  # a clock that was set back
    for _ in range(3):
        ids.append(new_run_id(back, ids))
    assert sorted(ids) == ids
    assert new_run_id(start, ["run.json", "99991231-235959-999", "77777777-777777-777"]) < ids[1]
    assert len({new_run_id(start) for _ in range(20)}) > 15


PLAIN = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(),
    lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner) | st.tuples(inner),
    max_leaves=12,
)


@settings(max_examples=60, deadline=None)
@given(value=PLAIN)
def test_json_never_holds_nan_or_infinity(value):
    def refuse(word):
        raise AssertionError(word)

    json.loads(to_json(value), parse_constant=refuse)
