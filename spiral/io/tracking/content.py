"""What is logged of a saved run, as plain data: metrics by step, parameters, tags, tables."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from spiral.types.run import estimate_rows

FIGURES = (
    "test_error", "fit_error", "noise_floor", "chi2_per_dof", "whiteness_p", "whiteness_effect",
    "horizon", "seconds",
)  # fmt: skip
"""Figures of a round that become metrics, with the round as step."""

TIME = "t"
RUN, PLUGINS = "run", "plugins"  # artifacts of a served model

_LONGEST = 5000  # characters of a parameter or tag that every store takes
_LONGEST_NAME = 200
_NO_NAME = ("experiment=", "out=", "n_jobs=", "sweep.", "tracking.", "run=")
_REFUSED = re.compile(r"[^\w./ :-]")  # characters that MLflow takes in no name

Saved = Mapping[str, Any]
Metric = tuple[str, float, int]
"""(name, value, step)."""


def saved_rounds(saved: Saved) -> list[Mapping[str, Any]]:
    """The rounds of a saved run; a verb that fits once has one."""
    result = saved["result"]
    if result.get("rounds"):
        return list(result["rounds"])
    only = result.get("comparison") or result
    return [{"round": 0, "admitted": [], **only}] if "test_error" in only else []


def round_metrics(round_row: Mapping[str, Any]) -> list[Metric]:
    """The figures of one round, its number as step."""
    step = int(round_row.get("round", 0))
    return [(k, v, step) for k in FIGURES if (v := _finite_float(round_row.get(k))) is not None]


def study_metrics(saved: Saved) -> list[Metric]:
    """All metrics of a study: its rounds' figures, then what it ended with."""
    done = saved_rounds(saved)
    listed = [m for r in done for m in round_metrics(r)]
    last = max((step for _, _, step in listed), default=0)
    for name, value in _final_metrics(saved["result"], _added_effects(saved)):
        number = _finite_float(value)
        if number is not None:
            listed.append((metric_name(name), number, last))
    return listed


def _added_effects(saved: Saved) -> set[str]:
    """Effects beyond the seed: admitted by the loop, added by hand, or configured."""
    labels = {label for r in saved_rounds(saved) for label in r.get("admitted", ())}
    config = saved["config"]
    return labels | set(config.get("effect") or ()) | set(config.get("seed") or ())


def _final_metrics(result: Mapping[str, Any], added: set[str]) -> Iterator[tuple[str, Any]]:
    for row in estimate_rows(result):
        if row["effect"] in added:  # whole terms are a table: metrics are for what is compared
            yield f"t.{row['effect']}.{row['parameter']}", row["t"]
    for channel, errors in (result.get("test") or result.get("channels") or {}).items():
        for kind, value in errors.items():
            yield f"test_{kind}.{channel}", value
    if result.get("rounds"):
        yield "admitted", sum(len(r["admitted"]) for r in result["rounds"])
    for kind in ("before", "after"):
        if kind in result:
            yield f"test_error_{kind}", result[kind].get("test_error")
    if "noise_floor" in result:
        yield "noise_floor", result["noise_floor"]
    yield from _state_metrics(result)


def _state_metrics(result: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    """Figures of a reconstruction: the errors of every state, and the filter's own."""
    for prefix, part in (("", "states"), ("static_", "static_baseline")):
        for state, errors in (result.get(part) or {}).items():
            for kind, value in errors.items() if isinstance(errors, Mapping) else ():
                yield f"{prefix}{kind}.{state}", value
    for name in ("nis_mean", "mu", "condition", "rank", "samples_needed", "seconds"):
        if isinstance(result.get(name), int | float) and not isinstance(result.get(name), bool):
            yield name, result[name]


def suggestion_rows(saved: Saved) -> list[dict[str, Any]]:
    """One row for each candidate of each round, with its evidence."""
    result = saved["result"]
    groups = [(r.get("round", 0), r.get("suggestions", ())) for r in saved_rounds(saved)]
    if result.get("suggestions"):
        groups = [(0, result["suggestions"])]
    return [
        {"round": number, **{k: _table_cell(v) for k, v in row.items()}}
        for number, ranking in groups
        for row in ranking
    ]


def flat_parameters(config: Mapping[str, Any]) -> dict[str, str]:
    """The composed configuration, flat: ``record.seed`` -> ``11``; empty values left out."""
    return {
        metric_name(key): str(value)[:_LONGEST]
        for key, value in _flatten(config)
        if value is not None and value != "" and value != [] and value != {}
    }


def _flatten(value: Any, key: str = "") -> Iterator[tuple[str, Any]]:
    if isinstance(value, Mapping) and value:
        for name, inner in value.items():
            yield from _flatten(inner, f"{key}.{name}".lstrip("."))
    else:
        yield key, value


def run_tags(saved: Saved) -> dict[str, str]:
    """What a run is found by."""
    result = saved["result"]
    effects = ((result.get("model") or {}).get("effects")) or {}
    data = [r["sha256"] for group in saved["data"].values() for r in group]
    named = {
        "spiral.run_id": saved["run_id"],
        "spiral.verb": saved["verb"],
        "spiral.sweep": (saved["config"].get("sweep") or {}).get("id"),
        "spiral.verdict": result.get("verdict"),
        "spiral.stopped": result.get("stopped"),
        "spiral.effects": ", ".join(effects),
        "spiral.data": ", ".join(data),
        "mlflow.note.content": markdown_summary(saved),
        "mlflow.source.name": f"spiral {saved['verb']}",
    }
    return {k: str(v)[:_LONGEST] for k, v in named.items() if v}


def run_name(saved: Saved) -> str:
    """What tells a run from others, first: ``seed=3 noise_level=0.05 discover rotor_coastdown``."""
    config = saved["config"]
    what = config.get("experiment") or (config.get("system") or {}).get("name") or ""
    given = [t for t in saved.get("overrides", ()) if not t.lstrip("+~").startswith(_NO_NAME)]
    own = [t.partition("=")[0].rpartition(".")[2] + "=" + t.partition("=")[2] for t in given]
    return " ".join([*own, saved["verb"], what]).strip()[:_LONGEST_NAME]


def round_name(round_row: Mapping[str, Any]) -> str:
    """``round 2: cubic_stiffness``."""
    number = round_row.get("round", 0)
    admitted = ", ".join(round_row.get("admitted", ())) or ("seed" if number == 0 else "nothing")
    return f"round {number}: {admitted}"


def markdown_summary(saved: Saved) -> str:
    """The run in Markdown, as MLflow's page shows it: outcome, rounds, terms."""
    result = saved["result"]
    lines = [f"`spiral {saved['verb']}`, saved as `{saved['run_id']}`", ""]
    outcome = [str(result[k]) for k in ("verdict", "stopped", "advice") if result.get(k)]
    lines += [". ".join(outcome), ""] if outcome else []
    done = saved_rounds(saved)
    if done:
        lines += ["| round | admitted | test error | chi2/dof |", "|---|---|---|---|"]
    for r in done:
        name = round_name(r).partition(": ")[2]
        figures = f"{_format_figure(r.get('test_error'))} | {_format_figure(r.get('chi2_per_dof'))}"
        lines.append(f"| {r.get('round', 0)} | {name} | {figures} |")
    table = estimate_rows(result)
    if table:
        lines += [
            "",
            "| effect | parameter | estimate | se | t | unit |",
            "|---|---|---|---|---|---|",
        ]
        lines += [
            f"| {r['effect']} | {r['parameter']} | {_format_figure(r['estimate'])} "
            f"| {_format_figure(r['se'])} | {_format_figure(r['t'])} | {r['unit']} |"
            for r in table
        ]
    return "\n".join(lines)


def metric_name(name: str) -> str:
    """A name that MLflow takes: ``cubic_stiffness@bearing_2`` with a colon for the ``@``."""
    return _REFUSED.sub("_", name.replace("@", ":"))


def rows_to_columns(rows: Sequence[Mapping[str, Any]]) -> dict[str, list[Any]]:
    """Rows as columns, for a table."""
    names = list(dict.fromkeys(k for row in rows for k in row))
    return {name: [row.get(name) for row in rows] for name in names}


def _table_cell(value: Any) -> Any:
    return ", ".join(map(str, value)) if isinstance(value, list | tuple) else value


def _finite_float(value: Any) -> float | None:
    if value is None or isinstance(value, bool | str):
        return None
    return float(value) if math.isfinite(value) else None


def _format_figure(value: Any) -> str:
    return "" if value is None else f"{value:.4g}"
