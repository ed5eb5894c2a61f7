"""MLflow is told of the run that a command saved, by a process that nobody waits for.

``python -m spiral.commands.telling`` is that process; its order is JSON on standard input.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from spiral.io.request import Outcome
    from spiral.io.tracking.store import Tracking
    from spiral.io.tracking.track import Tracked


def tell_mlflow(outcome: Outcome) -> Tracked | None:
    """Tell MLflow about the run that was saved, where there is one, after the answer is given."""
    if "run_id" not in outcome.result:
        return None
    from spiral.io.tracking.store import tracking_of

    config, run_id = outcome.parts["config"], outcome.result["run_id"]
    tracking = tracking_of(config)
    if not tracking.enabled:
        return None
    from spiral.io.tracking import background

    if background.waited_for():
        return _in_the_foreground(outcome, tracking)
    earlier = background.last_failure(config["out"])
    if earlier:
        print(f"spiral: an earlier run was saved, but not told to MLflow: {earlier}\n"
              "it is told now; tracking.enabled=false does without", file=sys.stderr)  # fmt: skip
    out = str(Path(config["out"]).expanduser().resolve())
    plugins = outcome.parts["request"].plugins
    order = background.Order(config.get("tracking") or {}, out, run_id, plugins)
    return background.start(order, "spiral.commands.telling")


def _in_the_foreground(outcome: Outcome, tracking: Tracking) -> Tracked:
    from spiral.io.tracking.track import track
    from spiral.view.report.page import report_of
    from spiral.view.terminal.parts import progress

    config = outcome.parts["config"]
    with progress() as tell:
        tell("telling MLflow")
        known, wanted = outcome.parts["registry"], (outcome.result["run_id"],)
        return track(tracking, config["out"], wanted, draw=report_of, registry=known)


def say_told(tracked: Tracked | None, target: str | None) -> None:
    """Where MLflow shows the run, or why it does not know of it."""
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
    """Carry out the order that standard input holds."""
    from spiral.io.tracking.background import Order, carry_out
    from spiral.view.report.page import report_of

    carry_out(Order(**json.load(sys.stdin)), report_of)


if __name__ == "__main__":
    main()
