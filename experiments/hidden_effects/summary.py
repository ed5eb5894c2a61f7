"""Rates with their intervals, tables, heat maps, and the run in MLflow."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from experiments.studies.rates import Row, number_told, rate, rate_told

_GROUPS = (("all identifiable", ()), ("by strength and noise", ("strength", "noise")),
           ("by system, strength and noise", ("system", "strength", "noise")))  # fmt: skip


def figures(rows: Sequence[Row]) -> dict[str, Any]:
    """What is reported of one group of hidden-effect rows."""
    errors = [r["error_se"] for r in rows if r["error_se"] is not None]
    hits = [r for r in rows if r["first"]]
    return {
        "first": rate(rows, lambda r: r["first"]),
        "top3": rate(rows, lambda r: r["top"]),
        "false": rate(rows, lambda r: bool(r["invented"])),
        "fall": _median([r["before"] / r["after"] for r in hits if r["after"]]),
        "over_floor": _median([r["after"] / r["floor"] for r in hits]),
        "near_floor": rate(hits, lambda r: r["after"] <= 1.2 * r["floor"]),
        "coefficient_error_se": _median(np.abs(errors)),
        "within_2_se": rate(errors, lambda e: abs(e) <= 2),  # type: ignore[arg-type]
        "seconds": _median([r["seconds"] for r in rows]),
    }


def _median(values: Any) -> float | None:
    return float(np.median(values)) if len(values) else None


def summary(rows: Sequence[Row]) -> dict[str, Any]:
    """Every figure: identifiable cases, those that are not, and null records."""
    hidden = [r for r in rows if r["hidden"]]
    known = [r for r in hidden if r["identifiable"]]
    unknown = [r for r in hidden if not r["identifiable"]]
    nulls = [r for r in rows if not r["hidden"]]
    medium = [r for r in known if (r["strength"], r["noise"]) == ("medium", 0.02)]
    parts = {title: _grouped(known, keys) for title, keys in _GROUPS}
    quiet = ("nothing_missing", "unknown_structure", "not_identifiable")
    return {
        "medium_2_percent": figures(medium),
        **parts,
        "not_identifiable": {
            "named_or_nothing": rate(unknown, lambda r: r["first"] or not r["admitted"]),
            "verdicts": {v: sum(r["verdict"] == v for r in unknown) for v in
                         sorted({r["verdict"] for r in unknown})},
        },
        "null": {
            "false": rate(nulls, lambda r: bool(r["admitted"])),
            "by": {
                f"{s} {n}": rate([r for r in nulls if (r["system"], r["noise"]) == (s, n)],
                                 lambda r: bool(r["admitted"]))
                for s, n in sorted({(r["system"], r["noise"]) for r in nulls})
            },
            "quiet": rate(nulls, lambda r: r["verdict"] in quiet),
        },
        "missed": [_miss(r) for r in medium if not r["first"]],
        "by effect": _grouped(known, ("system", "hidden")),
    }  # fmt: skip


def _miss(row: Row) -> Row:
    return {k: row[k] for k in ("system", "hidden", "seed", "verdict", "admitted", "suggested")}


def _grouped(rows: Sequence[Row], keys: tuple[str, ...]) -> dict[str, Any]:
    names = sorted({tuple(r[k] for k in keys) for r in rows}, key=str)
    return {
        " ".join(map(str, n)) or "all": figures([r for r in rows if tuple(r[k] for k in keys) == n])
        for n in names
    }


_COLUMNS = (
    "case", "studies", "first", "top 3", "false admissions", "error falls by",
    "test error / floor", "within 1.2 floors", "coefficient error (se)", "within 2 se", "s",
)  # fmt: skip


def table(found: dict[str, Any]) -> str:
    """The tables in Markdown."""
    lines = []
    for title in ("all identifiable", "by strength and noise", "by system, strength and noise"):
        lines += [f"\n**{title}**\n", f"| {' | '.join(_COLUMNS)} |", "|" + "---|" * len(_COLUMNS)]
        for name, row in found[title].items():
            cells = [rate_told(row[k]) for k in ("first", "top3", "false")]
            cells += [
                number_told(row["fall"]),
                number_told(row["over_floor"]),
                rate_told(row["near_floor"]),
            ]
            cells += [number_told(row["coefficient_error_se"]), rate_told(row["within_2_se"])]
            cells.append(number_told(row["seconds"]))
            lines.append(f"| {name} | {row['first']['count']} | {' | '.join(cells)} |")
    null, unseen = found["null"], found["not_identifiable"]["named_or_nothing"]
    lines += [f"\nNull records: something admitted in {rate_told(null['false'])} of "
              f"{null['false']['count']}.", f"Not identifiable: named, or nothing admitted, in "
              f"{rate_told(unseen)} of {unseen['count']}."]  # fmt: skip
    return "\n".join(lines)


def heat_map(rows: Sequence[Row], system: str) -> Any:
    """First-rank rate of one system: effects down, strength and noise across."""
    import plotly.graph_objects as go

    own = [r for r in rows if r["system"] == system and r["hidden"]]
    order = {"weak": 0, "medium": 1, "strong": 2}
    across = sorted({(r["strength"], r["noise"]) for r in own}, key=lambda k: (order[k[0]], k[1]))
    down = sorted({r["hidden"] for r in own}, reverse=True)
    cells = [[_cell(own, effect, *place) for place in across] for effect in down]
    figure = go.Figure(
        go.Heatmap(
            z=[[c[0] for c in line] for line in cells],
            text=[[c[1] for c in line] for line in cells],
            x=[f"{s}<br>{100 * n:g} % noise" for s, n in across], y=down, texttemplate="%{text}",
            zmin=0, zmax=1, colorscale="Viridis", colorbar={"title": "first-rank rate"},
        )
    )  # fmt: skip
    figure.update_layout(
        title=f"{system}: how often the hidden effect (or its alias group) comes first; "
        "( ) not identifiable",
        height=160 + 26 * len(down), width=1100, margin={"l": 190, "t": 60},
    )  # fmt: skip
    return figure


def _cell(own: Sequence[Row], effect: str, strength: str, noise: float) -> tuple[Any, str]:
    rows = [r for r in own if (r["hidden"], r["strength"], r["noise"]) == (effect, strength, noise)]
    if not rows:
        return None, ""
    share = sum(r["first"] for r in rows) / len(rows)
    text = f"{100 * share:.0f}"
    return share, text if rows[0]["identifiable"] else f"({text})"


def conclude(rows: list[Row], folder: Path, seconds: float, tracked: bool) -> dict[str, Any]:
    """Write summary.json, summary.md and the heat maps, print the table, tell MLflow."""
    found = {**summary(rows), "seconds": seconds, "studies": len(rows)}
    (folder / "summary.json").write_text(json.dumps(found, indent=1))
    (folder / "summary.md").write_text(table(found) + "\n")
    for system in sorted({r["system"] for r in rows}):
        page = heat_map(rows, system).to_html(include_plotlyjs=True)
        (folder / f"{system}.html").write_text(page, encoding="utf-8")
    print(table(found))
    for miss in found["missed"]:
        print("missed:", json.dumps(miss))
    print(f"{len(rows)} studies in {seconds:.0f} s; tables and heat maps in {folder}")
    if tracked:
        _tell(found, folder)
    return found


def _tell(found: dict[str, Any], folder: Path) -> None:
    """One run of MLflow: the rates as metrics, rows, tables and heat maps as artifacts."""
    from spiral.io.tracking.store import Tracking, open_store, use_store

    with (
        open_store(Tracking(experiment="hidden_effects"), folder.parent) as store,
        use_store(store),
    ):
        number = store.client.create_run(store.experiment, run_name=folder.name).info.run_id
        store.client.log_param(number, "studies", found["studies"])
        for name, value in _metrics(found):
            store.client.log_metric(number, name, value)
        for file in sorted(folder.iterdir()):
            store.client.log_artifact(number, str(file))
        store.client.set_terminated(number)


def _metrics(found: dict[str, Any]) -> list[tuple[str, float]]:
    pairs = [("seconds", found["seconds"]), ("null_false", found["null"]["false"]["rate"])]
    for title in ("all identifiable", "by strength and noise"):
        for group, row in found[title].items():
            at = group.replace(" ", ".")
            pairs += [(f"{k}.{at}", row[k]["rate"]) for k in ("first", "top3", "false")]
            pairs += [(f"{k}.{at}", row[k]) for k in ("fall", "over_floor", "seconds")]
    return [(k, float(v)) for k, v in pairs if v is not None]
