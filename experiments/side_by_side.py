"""The same loop on the same record with two kinds of evidence, side by side: ``make published``.

python -m experiments.side_by_side [RUNS] [OVERRIDE...]

Takes the latest run of the default strategy from the folder of runs, asks the paper's evidence
about the same record (its run is kept in the folder ``published`` inside), and prints what each
found.
"""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path
from typing import Any

from experiments.evidence import TRUTH, row
from spiral.commands.perform import perform
from spiral.io.request import Request
from spiral.io.storage import FILE, LATEST, load_run


def main() -> None:
    """Run the published evidence and print both."""
    folder = sys.argv[1] if len(sys.argv) > 1 else "runs"
    trajectories = row(dict(load_run(LATEST, folder).data))
    print("\nThe same record and loop with the published evidence: differentiated data, a network,")
    print("projection onto a library, Gates 1 and 2 (strategy=paper) ...", flush=True)
    clock = time.perf_counter()
    overrides = (
        f"experiment={trajectories['experiment']}",
        f"record.seed={trajectories['seed']}",
        "strategy=paper",
        f"out={folder}/published",
        *sys.argv[2:],
    )
    outcome = perform(Request("discover", (), overrides), lambda message: None)
    seconds = time.perf_counter() - clock
    saved = Path(folder) / "published" / outcome.result["run_id"] / FILE
    published = row(json.loads(saved.read_text(encoding="utf-8")))
    published["seconds"] = seconds
    print("\n".join(lines(trajectories, published)))


def lines(trajectories: dict[str, Any], published: dict[str, Any]) -> list[str]:
    """One line for each coupling of the hidden tilt, then false terms, error and time."""
    both = (trajectories, published)
    text = [f"\n{'':<32}{'trajectories':>26}{'published':>26}"]
    for key, truth in TRUTH.items():
        name = key.split(".")[0]
        cells = "".join(f"{_found(r, key, truth):>26}" for r in both)
        text.append(f"{f'{name} ({truth:.4g})':<32}{cells}")
    text.append(
        f"{'terms that are not there':<32}" + "".join(f"{len(r['false']):>26}" for r in both)
    )
    errors = "".join(f"{_percent(r['test_error']):>26}" for r in both)
    text.append(f"{'test error':<32}{errors}")
    text.append(f"{'seconds':<32}" + "".join(f"{r['seconds']:>26.0f}" for r in both))
    text.append("in brackets: the projection of the full machine; t with Newey-West errors where")
    text.append("published. Why they differ: experiments/noise/README.md")
    return text


def _found(found: dict[str, Any], key: str, truth: float) -> str:
    coupling = found["couplings"].get(key)
    if coupling is None:
        return "not found"
    return f"{coupling['ratio'] * truth:.4g} (t = {coupling['t']:.3g})"


def _percent(value: float | None) -> str:
    return "diverges" if value is None else f"{100 * value:.3g} %"


if __name__ == "__main__":
    main()
