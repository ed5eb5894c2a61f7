"""Hide physics that is in no catalog, and see what is said of it.

python -m experiments.unknown_physics.run [--only CASE ...] [--seeds 5] [--jobs 2]
    [--out runs/unknown_physics]

Rows are kept as they end (rows.jsonl); the same command takes up what is there.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
from joblib import Parallel, delayed, parallel_config

from experiments.hidden_effects.cases import installed
from experiments.unknown_physics.cases import CASES, coverage, problem
from spiral.inference.discover import discover

Row = dict[str, Any]
NEAR = 1.5  # noise floors


def study(name: str, seed: int) -> Row:
    """One study with ``settings.learned=true``; ``seconds`` are of one processor."""
    case, clock = CASES[name], time.process_time()
    run = discover(problem(name, installed(), seed, learned=True))
    row: Row = {
        "case": name,
        "seed": seed,
        "verdict": run.verdict,
        "stopped": run.stopped,
        "admitted": [x for r in run.rounds for x in r.admitted],
        "final": [x for x in run.model.labels if x not in run.rounds[0].comparison.model.labels],
        "before": run.rounds[0].comparison.test_error / run.final.noise_floor,
        "after": run.final.test_error / run.final.noise_floor,
    }
    row |= _said(case.learned, run.unknown, name)
    return {**row, "seconds": time.process_time() - clock}


def _said(learned: str, unknown: Any, name: str) -> Row:
    case = CASES[name]
    if not unknown or not learned:
        return {"curve": (unknown or {}).get("effect"), "named": False, "shape": False}
    named = unknown["effect"] == learned and unknown["state"] == case.state
    covered = coverage(case, unknown) if named else None
    return {
        "curve": unknown["effect"],
        "sentence": unknown["sentence"],
        "named": named,
        "shape": unknown["parity"] == case.parity and unknown["smooth"] == case.smooth,
        "band": None if covered is None else covered.whole,
        "pointwise": None if covered is None else covered.pointwise,
    }


def summary(rows: list[Row]) -> list[Row]:
    """A line for each case."""
    found = []
    for name in dict.fromkeys(r["case"] for r in rows):
        mine = [r for r in rows if r["case"] == name]
        bands = [r for r in mine if r.get("band") is not None]
        after = [r["after"] for r in mine]
        found.append({
            "case": name,
            "studies": len(mine),
            "named": sum(r["named"] for r in mine),
            "shape": sum(r["named"] and r["shape"] for r in mine),
            "band": sum(r["band"] >= 0.95 for r in bands),
            "pointwise": float(np.mean([r["pointwise"] for r in bands])) if bands else None,
            "learned": sum(any(x.startswith("learned_") for x in r["final"]) for r in mine),
            "near": sum(x <= NEAR for x in after),
            "before": float(np.median([r["before"] for r in mine])),
            "after": float(np.median(after)),
            "worst": float(np.max(after)),
            "seconds": float(np.median([r["seconds"] for r in mine])),
        })  # fmt: skip
    return found


def table(rows: list[Row]) -> str:
    """The summary in Markdown."""
    lines = [
        "| hidden | studies | state named | parity and kink | in the band | pointwise 95 % | "
        "learned, kept | error before | after (worst) | within 1.5 | s |",
        "|---|---|---|---|---|---|---|---|---|---|---|",
    ]
    for g in summary(rows):
        hidden = bool(CASES[g["case"]].learned)
        said = [str(g[k]) if hidden else "-" for k in ("named", "shape", "band")]
        point = "-" if g["pointwise"] is None else f"{100 * g['pointwise']:.0f} %"
        lines.append(
            f"| {g['case']} | {g['studies']} | {' | '.join(said)} | {point} | {g['learned']} | "
            f"{g['before']:.3g} | {g['after']:.3g} ({g['worst']:.3g}) | {g['near']} | "
            f"{g['seconds']:.0f} |"
        )
    return "\n".join(lines)


def rows_of(names: list[str], seeds: int, file: Path, workers: int) -> list[Row]:
    """Rows of all studies; those that an earlier start left are taken, the others computed."""
    kept = [json.loads(x) for x in file.read_text().splitlines()] if file.exists() else []
    known = {(r["case"], r["seed"]) for r in kept}
    wanted = [(n, s) for n in names for s in range(seeds)]
    rows = [r for r in kept if (r["case"], r["seed"]) in wanted]
    left = [j for j in wanted if j not in known]
    with file.open("a") as out, parallel_config("loky", inner_max_num_threads=1):
        running = Parallel(n_jobs=workers, return_as="generator_unordered")(
            delayed(study)(*job) for job in left
        )
        for number, row in enumerate(running, 1):
            rows.append(row)
            out.write(json.dumps(row) + "\n")
            out.flush()
            print(f"{number} of {len(left)}: {row['case']}, seed {row['seed']}, "
                  f"{row['after']:.3g} floors", file=sys.stderr)  # fmt: skip
    return sorted(rows, key=lambda r: wanted.index((r["case"], r["seed"])))


def tell(rows: list[Row], folder: Path) -> None:
    """One run of MLflow: the figures of each case as metrics, rows and table as artifacts."""
    from spiral.io.tracking.store import Tracking, open_store, use_store

    with (
        open_store(Tracking(experiment="unknown_physics"), folder.parent) as store,
        use_store(store),
    ):
        number = store.client.create_run(store.experiment, run_name=folder.name).info.run_id
        store.client.log_param(number, "studies", len(rows))
        for group in summary(rows):
            at = group.pop("case").replace(",", "").replace(" ", "_")
            for key, value in group.items():
                if value is not None and np.isfinite(value):
                    store.client.log_metric(number, f"{key}.{at}", float(value))
        for file in sorted(folder.iterdir()):
            store.client.log_artifact(number, str(file))
        store.client.set_terminated(number)


def main(words: list[str] | None = None) -> list[Row]:
    """Run the studies, print and keep the table, tell MLflow; returns the rows."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", nargs="*", choices=list(CASES), help="all when left out")
    parser.add_argument("--seeds", type=int, default=5, help="records of each case")
    parser.add_argument("--jobs", type=int, default=-1, help="processes; -1: every processor")
    parser.add_argument("--out", default="runs/unknown_physics", help="folder of the results")
    parser.add_argument("--no-tracking", action="store_true", help="do not tell MLflow")
    given, clock = parser.parse_args(words), time.perf_counter()
    folder = Path(given.out)
    folder.mkdir(parents=True, exist_ok=True)
    names = given.only or list(CASES)
    rows = rows_of(names, given.seeds, folder / "rows.jsonl", given.jobs)
    (folder / "summary.md").write_text(table(rows) + "\n")
    print(table(rows))
    print(f"{len(rows)} studies in {time.perf_counter() - clock:.0f} s")
    if not given.no_tracking:
        tell(rows, folder)
    return rows


if __name__ == "__main__":
    main()
