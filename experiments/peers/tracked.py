"""Rows of the comparison: kept on disk as they come, told to MLflow, put together over seeds.

In MLflow a case at one noise is a run, and every method on every record a child of it.
"""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from experiments.peers.cases import HIDDEN
from spiral.io.tracking.store import Store, Tracking, open_store
from spiral.io.writing import to_json, write_whole

Row = dict[str, Any]
FILE = "rows.json"


def name_of(row: Row) -> str:
    """What tells a row from all others."""
    return f"{row['case']} {row['noise']:g} {row['duration']:g} s, {row['method']}, {row['seed']}"


def kept(out: Path) -> list[Row]:
    """Rows that an earlier start has left."""
    file = out / FILE
    return json.loads(file.read_text(encoding="utf-8")) if file.is_file() else []


def keep(out: Path, rows: list[Row]) -> None:
    """All rows so far, written whole."""
    out.mkdir(parents=True, exist_ok=True)
    write_whole(out / FILE, to_json(rows))


def tell(out: Path, rows: Iterable[Row]) -> None:
    """Log the rows that MLflow does not know yet, and the medians of their case."""
    with open_store(Tracking(experiment="peers"), out) as store:
        groups: dict[str, list[Row]] = {}
        for row in rows:
            case = f"{row['case']}, noise {row['noise']:g}, {row['duration']:g} s"
            groups.setdefault(case, []).append(row)
        for case, members in groups.items():
            parent = _run(store, case, {"spiral.peers": case})
            for row in members:
                _child(store, parent, row)
            for group in summary(members):
                label = group["method"].replace(" ", "_")
                for figure in ("test_error", "seconds", "false"):
                    if np.isfinite(group[figure]):
                        store.client.log_metric(parent, f"{label}.{figure}", group[figure])


def _child(store: Store, parent: str, row: Row) -> None:
    known = store.client.search_runs([store.experiment], _tagged("spiral.row", name_of(row)))
    if known:
        return
    tags = {"spiral.row": name_of(row), "mlflow.parentRunId": parent}
    number = _run(store, f"{row['method']}, seed {row['seed']}", tags)
    for key in ("method", "case", "noise", "seed", "duration"):
        store.client.log_param(number, key, row[key])
    for key, value in _figures(row).items():
        if np.isfinite(value):
            store.client.log_metric(number, key, value)
    store.client.log_dict(number, json.loads(to_json(row)), "row.json")
    store.client.set_terminated(number, "FINISHED")


def _run(store: Store, name: str, tags: dict[str, str]) -> str:
    """The run with the first of the tags, made where there is none."""
    key, value = next(iter(tags.items()))
    for found in store.client.search_runs([store.experiment], _tagged(key, value)):
        return found.info.run_id
    run = store.client.create_run(store.experiment, tags=tags, run_name=name)
    if "mlflow.parentRunId" not in tags:
        store.client.set_terminated(run.info.run_id, "FINISHED")
    return run.info.run_id


def _tagged(key: str, value: str) -> str:
    return f"tags.`{key}` = '{value}'"


def _figures(row: Row) -> dict[str, float]:
    found = {"test_error": _number(row["test_error"]), "seconds": row["seconds"]}
    if row["named"]:
        found["hidden_found"] = float(sum(h in row["found"] for h in HIDDEN))
    if "false" in row:
        found["false_terms"] = float(len(row["false"]))
        found |= {f"error.{k}": _number(v) for k, v in row["errors"].items()}
    return found


def _number(value: float | None) -> float:
    return np.nan if value is None else float(value)


def summary(rows: Iterable[Row]) -> list[dict[str, Any]]:
    """For each case, noise and method: medians over seeds, and how often each coupling is found."""
    groups: dict[tuple[Any, ...], list[Row]] = {}
    for row in rows:
        key = (row["case"], row["noise"], row["duration"], row["method"])
        groups.setdefault(key, []).append(row)
    found = []
    for (case, noise, duration, method), mine in groups.items():
        errors = {k: [r["errors"].get(k, np.nan) for r in mine if "errors" in r]
                  for k in mine[0].get("errors", {})}  # fmt: skip
        found.append({
            "case": case, "noise": noise, "duration": duration, "method": method,
            "records": len(mine),
            "couplings": {h: sum(h in r["found"] for r in mine) for h in HIDDEN}
            if mine[0]["named"] else {},
            "false": float(np.mean([len(r["false"]) for r in mine if "false" in r] or [np.nan])),
            "errors": {k: float(np.median(v)) for k, v in errors.items()},
            "test_error": float(np.median([_number(r["test_error"]) for r in mine])),
            "seconds": float(np.median([r["seconds"] for r in mine])),
        })  # fmt: skip
    return found


def table(rows: Iterable[Row]) -> str:
    """The summary as a table in Markdown."""
    short = [h.split("_")[0] for h in HIDDEN]
    lines = [
        f"| case | noise | method | records | {' | '.join(short)} | false terms | test error | s |",
        "|---" * (7 + len(HIDDEN)) + "|",
    ]
    for group in summary(rows):
        cells = []
        for hidden in HIDDEN:
            errors = [v for k, v in group["errors"].items() if k.startswith(f"{hidden}.")]
            times = group["couplings"].get(hidden)
            off = f", {errors[0]:+.1%}" if errors and times else ""
            cells.append("-" if times is None else f"{times}/{group['records']}{off}")
        false = "-" if np.isnan(group["false"]) else f"{group['false']:.1f}"
        lines.append(
            f"| {group['case']} | {group['noise']:.3g} | {group['method']} | {group['records']} | "
            f"{' | '.join(cells)} | {false} | {group['test_error']:.3g} | {group['seconds']:.0f} |"
        )
    return "\n".join(lines)
