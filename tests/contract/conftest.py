"""Contract tests go without MLflow, except those that are about it."""

import pytest

from spiral.tracking import track


@pytest.fixture(autouse=True)
def untracked(monkeypatch):
    monkeypatch.setattr(track, "track", lambda *given, **more: track.Tracked({}))
