"""Contract tests go without MLflow and without curves, except those that are about them."""

import pytest

from spiral.commands import report as reporting
from spiral.io.tracking import track


@pytest.fixture(autouse=True)
def untracked(monkeypatch):
    monkeypatch.setattr(track, "track", lambda *given, **more: track.TrackingResult({}))


@pytest.fixture(autouse=True)
def without_curves(monkeypatch):
    monkeypatch.setattr(reporting, "_comparisons_by_model", lambda parts: {})
