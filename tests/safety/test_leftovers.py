"""What fails leaves nothing behind, and costs little time."""

import time

import numpy as np
import pytest

from spiral.io import curves
from spiral.io.curves import Curves, write_curves
from spiral.io.tracking.store import Tracking, opened
from spiral.types.errors import InputError


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
        opened(Tracking(uri="http://127.0.0.1:9"), tmp_path),
    ):
        raise AssertionError
    assert time.monotonic() - began < 20  # importing MLflow takes most of it
