"""Contract tests go without MLflow and without curves, except those that are about them."""

import pytest

from spiral.tracking import track
from spiral.verbs import report as reporting


@pytest.fixture(autouse=True)
def untracked(monkeypatch):
    monkeypatch.setattr(track, "track", lambda *given, **more: track.Tracked({}))


@pytest.fixture(autouse=True)
def without_curves(monkeypatch):
    monkeypatch.setattr(reporting, "_compared", lambda parts: {})
