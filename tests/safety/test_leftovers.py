"""What fails leaves nothing behind, and costs little time."""

import time
from datetime import datetime, timedelta

import numpy as np
import pytest

from spiral.io import curves, run_id
from spiral.io.curves import Curves, write_curves
from spiral.io.storage import load_run, run_ids
from spiral.io.tracking import store
from spiral.io.tracking.store import Tracking, open_store
from spiral.types.errors import InputError
from tests.safety.conftest import saved


def test_curves_that_cannot_be_written_leave_no_file(tmp_path, monkeypatch):
    def full(trial, **arrays):
        trial.write_bytes(b"half")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(curves.np, "savez_compressed", full)
    with pytest.raises(OSError, match="No space left"):
        write_curves(Curves({}, {"a": np.zeros(3)}), tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_a_server_that_does_not_run_is_tried_once_and_shortly(tmp_path):
    """It cost four and a half minutes."""
    began = time.monotonic()
    with (
        pytest.raises(InputError, match="no answer from http://127"),
        open_store(Tracking(uri="http://127.0.0.1:9"), tmp_path),
    ):
        raise AssertionError
    assert time.monotonic() - began < 20  # importing MLflow takes most of it


def test_a_database_of_mlflow_is_made_whole_or_not_at_all(tmp_path, monkeypatch):
    """A disk that was full while it was made left one that could never be opened again."""

    def full(source, target):
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(store.os, "replace", full)
        with pytest.raises(OSError, match="No space left"), open_store(Tracking(), tmp_path):
            raise AssertionError
    assert [p.name for p in tmp_path.iterdir()] == [store.LOCK]
    with open_store(Tracking(), tmp_path) as found:
        assert found.client.get_experiment(found.experiment).name == "spiral"


class Yesterday(datetime):
    """A clock that was set back."""

    @classmethod
    def now(cls, zone=None):
        return datetime.now(zone) - timedelta(days=1)


def test_latest_is_the_run_saved_last_though_the_clock_was_set_back(
    question, tmp_path, monkeypatch
):
    first = saved(question, tmp_path).name
    monkeypatch.setattr(run_id, "datetime", Yesterday)
    second = saved(question, tmp_path).name
    assert load_run("latest", tmp_path).run_id == second
    assert run_ids(tmp_path) == [first, second]
