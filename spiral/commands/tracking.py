"""Log the run that a command saved to MLflow, in a process that the command does not wait for.

``python -m spiral.commands.tracking`` is that process; its order is JSON on standard input.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from spiral.io.request import Outcome
    from spiral.io.tracking.store import Tracking
    from spiral.io.tracking.track import TrackingResult


def log_run_to_mlflow(outcome: Outcome) -> TrackingResult | None:
    """Log the saved run, if any, to MLflow: in the background unless the environment says wait."""
    if "run_id" not in outcome.result:
        return None
    from spiral.io.tracking.store import tracking_options

    config, run_id = outcome.parts["config"], outcome.result["run_id"]
    tracking = tracking_options(config)
    if not tracking.enabled:
        return None
    from spiral.io.tracking import background

    if background.is_foreground():
        return _log_in_foreground(outcome, tracking)
    earlier = background.take_last_failure(config["out"])
    if earlier:
        print(f"spiral: an earlier run was saved, but not told to MLflow: {earlier}\n"
              "it is told now; tracking.enabled=false does without", file=sys.stderr)  # fmt: skip
    out = str(Path(config["out"]).expanduser().resolve())
    plugins = outcome.parts["request"].plugins
    order = background.LogRequest(config.get("tracking") or {}, out, run_id, plugins)
    return background.start_process(order, "spiral.commands.tracking")


def _log_in_foreground(outcome: Outcome, tracking: Tracking) -> TrackingResult:
    from spiral.io.tracking.track import track
    from spiral.view.report.html import report_html
    from spiral.view.terminal.parts import progress_line

    config = outcome.parts["config"]
    with progress_line() as tell:
        tell("telling MLflow")
        known, wanted = outcome.parts["registry"], (outcome.result["run_id"],)
        return track(tracking, config["out"], wanted, draw=report_html, registry=known)


def print_tracking_outcome(tracked: TrackingResult | None, target: str | None) -> None:
    """Print where MLflow shows the run, or why it could not be logged."""
    if tracked is None:
        return
    if tracked.failure is not None:
        print(
            f"spiral: saved, but not told to MLflow ({tracked.uri}): {tracked.failure}\n"
            "the next start tells it; tracking.enabled=false does without",
            file=sys.stderr,
        )
    elif tracked.page and target != "-":
        print(f"  {tracked.page}\n      this run beside others, in MLflow's page")


def main() -> None:
    """Log the run that the order on standard input names."""
    from spiral.io.tracking.background import LogRequest, execute_order
    from spiral.view.report.html import report_html

    execute_order(LogRequest(**json.load(sys.stdin)), report_html)


if __name__ == "__main__":
    main()
