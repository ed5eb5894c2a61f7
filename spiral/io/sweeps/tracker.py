"""The rows of a sweep into MLflow, one by one as they end, by the sweep's own process alone."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from spiral.io.tracking import track as studies
from spiral.io.tracking.store import Draw, Tracking
from spiral.io.tracking.track import FailedJob, TrackingResult

if TYPE_CHECKING:
    from spiral.io.registry import Registry
    from spiral.io.sweeps.sweep import SweepRow

_WAITS = 3  # rows that may fail before the rest is left to the end


@dataclass
class SweepTracker:
    """Logs every row as it ends; ``finish`` logs those that could not be logged then."""

    tracking: Tracking
    out: str | os.PathLike[str]
    tell: Callable[[str], None]
    draw: Draw | None = None
    registry: Registry | None = None
    left: list[FailedJob] = field(default_factory=list)
    failures: int = 0

    def on_row(self, sweep_id: str, number: int, row: SweepRow) -> None:
        """Log one row; where the store fails, the sweep goes on without it."""
        wanted = (row.run_id,) if row.run_id else ()
        failed = FailedJob(sweep_id, number, row.overrides, row.result.get("error") or {})
        jobs = (failed,) if row.exit and not wanted else ()
        if self.failures < _WAITS:
            tracked = studies.track(
                self.tracking,
                self.out,
                wanted,
                jobs,
                catch_up=False,
                draw=self.draw,
                registry=self.registry,
            )
            if tracked.failure is None:
                return
            self.failures += 1
            self.tell(f"job {number + 1} is kept, but MLflow did not take it: {tracked.failure}")
        self.left += jobs

    def finish(self) -> TrackingResult:
        """Log what is left: once more, at the end."""
        left = tuple(self.left)
        return studies.track(
            self.tracking, self.out, (), left, draw=self.draw, registry=self.registry
        )
