"""Prediction errors on unseen data by horizon, before and after a step, as HTML text.

Each horizon has a word (better, same, worse), an arrow and a colour, so that each of them
alone tells it. All that is put in is escaped.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

from spiral.app.study import StudyState
from spiral.types.formatting import error_percent, join_words, percent
from spiral.view.report.style import label_words

Rows = Sequence[Mapping[str, Any]]
"""Changes at each horizon, or errors alone, as a round in the JSON output has them."""

_ARROWS = {"better": "↓", "same": "≈", "worse": "↑"}
_HINT = (
    "Share of each channel's deviation, on the test record. Predictions start from a filter that "
    "has seen only what was measured before; ± is the paired standard error of the change."
)


def horizon_label(row: Mapping[str, Any]) -> str:
    """How far ahead, in words: ``next sample``, ``0.1 s ahead``, ``free run``."""
    if row["horizon"] == "ahead":
        return f"{row['seconds']:.2g} s ahead"
    return {"one_sample": "next sample", "free_run": "free run"}[row["horizon"]]


def worse_horizons(changes: Rows) -> list[str]:
    """The horizons at which a step predicts worse, in words."""
    return [horizon_label(row) for row in changes if row["judged"] == "worse"]


def horizon_error_table(turn: StudyState) -> str:
    """Table of a turn's errors at every horizon; of an added effect before, after, and judged."""
    changes = turn.result.get("changes") or ()
    if changes:
        head = ("on unseen data", "before", "now", "<span class='unseen'>change</span>")
        rows = [
            (
                horizon_label(c),
                error_percent(c["before"]),
                error_percent(c["after"]),
                _judgement_label(c),
            )
            for c in changes
        ]
    else:
        head = ("on unseen data", "error")
        rows = [
            (horizon_label(h), error_percent(h["error"])) for h in turn.result.get("unseen") or ()
        ]
    if not rows:
        return ""
    cells = "".join(
        f"<tr><td>{escape(first)}</td>"
        + "".join(f'<td class="n">{cell}</td>' for cell in rest)
        + "</tr>"
        for first, *rest in rows
    )
    names = f"<th>{head[0]}</th>" + "".join(f'<th class="n">{name}</th>' for name in head[1:])
    return f'<table class="plain" id="horizons" title="{_HINT}"><tr>{names}</tr>{cells}</table>'


def worse_step_note(turn: StudyState) -> str:
    """One sentence where a step made predictions worse; nothing where it did not."""
    where = worse_horizons(turn.result.get("changes") or ())
    if not where:
        return ""
    return (
        f"<b>Worse on data it did not see:</b> with {escape(label_words(turn.added))} the model "
        f"predicts worse: {escape(join_words(where))}."
    )


def trial_changes(changes: Rows) -> str:
    """What a candidate would do, tried on the test record, on one line for each horizon."""
    lines = [
        f"<span>{escape(horizon_label(c))}</span>"
        f"<span>{error_percent(c['before'])} → {error_percent(c['after'])}</span>"
        f"{_judgement_label(c)}"
        for c in changes
    ]
    return f'<div class="tried" title="{_HINT}">{"".join(lines)}</div>' if lines else ""


def _judgement_label(row: Mapping[str, Any]) -> str:
    said, spread = row["judged"], row["standard_error"]
    about = "" if spread is None else f' title="± {percent(spread)}"'
    return f'<span class="judged {said}"{about}>{_ARROWS[said]} {said}</span>'
