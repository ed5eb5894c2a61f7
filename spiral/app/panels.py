"""Pieces of the page as HTML text: numbers, candidates, tables. All that is put in is escaped."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

from spiral.app.study import LEARNED, Study, Turn
from spiral.types.formatting import number, percent, probability
from spiral.view.report import text
from spiral.view.report.style import symbols, words

_BOTH = "the larger of the classical p-value and the robust one"
_FAR = 3.0  # times the noise, above which a free run misses more than noise
ENDINGS = {
    "whiteness": "Nothing more is missing: what is left is white noise.",
    "no_candidate": "No further effect passes the gates; the list below says how far each comes.",
    "diverged": "The model runs away from the record even on short windows. Check units and signs "
    "of the channels, or undo.",
    "not_identifiable": "This record cannot tell the model's own effects apart.",
}


FORMULA = (
    "<p class='soft' style='margin-bottom:10px'>A formula of displacements (<code>x</code>), "
    "velocities (<code>x_rate</code>), the axis at hand (<code>q</code>, <code>v</code>) and "
    "inputs (<code>speed</code>, <code>phase</code>). Every other name is a coefficient that the "
    "fit finds; a spring is <code>-k*q</code>. One inside a function, as the width of a friction "
    "<code>-F*tanh(v/w)</code>, needs a value.</p>"
)


def ending(study: Study, turn: Turn) -> str:
    """What it means that nothing passes the gates."""
    said = ENDINGS.get(turn.verdict, turn.advice)
    error, floor = turn.result.get("test_error"), study.noise_floor
    if turn.verdict == "whiteness" and error and floor and error > _FAR * floor:
        said += f" The free run on the test record still misses by {percent(error)}, though: such a"
        said += " model may be right and its motion hard to predict, or the test record differs."
    if turn.shape:
        said += f" What is left: {escape(turn.shape[:1].lower() + turn.shape[1:])}"
    return said


def learnable(study: Study, turn: Turn) -> bool:
    """Whether the curve of what is left can be offered as an effect, and is not yet."""
    asked = any(o.partition("=")[0] == LEARNED for o in study.overrides)
    return bool(turn.shape) and turn.verdict == "no_candidate" and not asked


def headline(study: Study) -> str:
    """The error on data the fit never saw: now, before, and what noise alone makes."""
    line = study.line
    if not line:
        return '<p class="label">Free-run error on the test record</p><div class="number">…</div>'
    now, first = (line[i].result.get("test_error") for i in (-1, 0))
    before = f"<small> from {percent(first)}</small>" if len(line) > 1 else ""
    floor = study.noise_floor
    noise = f" Noise alone makes {percent(floor)}." if floor is not None else ""
    return (
        '<p class="label">Free-run error on the test record</p>'
        f'<div class="number" id="error-now">{_shown(now)}{before}</div>'
        f'<p class="soft">Share of each channel\'s deviation; this record chose nothing.{noise}</p>'
    )


def _shown(error: float | None) -> str:
    return "not finite" if error is None else percent(error)


def chips(study: Study) -> str:
    """The effects of the model: the seed's, and those added in their order."""
    if not study.line:
        return ""
    model = study.line[-1].result.get("model") or {}
    added = [t.added for t in study.line if t.added]
    seed = [e for e in model.get("effects", {}) if e not in added]
    found = [f'<span class="chip">{escape(words(e))}</span>' for e in seed]
    found += [f'<span class="chip added">+ {escape(words(e))}</span>' for e in added]
    return f'<div class="chips">{"".join(found)}</div>'


def channels(turn: Turn, units: Mapping[str, str]) -> str:
    """Errors of each channel in its unit, chi2 and whiteness of the fit."""
    rows = [
        (name, text.sized(v["rmse"], units.get(name, "")), _shown(v["relative"]))
        for name, v in (turn.result.get("channels") or {}).items()
    ]
    table = text.table(("channel", "rms error", "of its deviation"), rows,
                       ("rms error", "of its deviation"))  # fmt: skip
    chi2 = turn.result.get("chi2_per_dof")
    fit = "" if chi2 is None else f"χ² per degree of freedom {number(chi2, 3)}; "
    fit += (
        f"whiteness p {probability(turn.result.get('whiteness_p'))}; windows of "
        f"{turn.result.get('horizon')} samples"
    )
    return plain(table) + f'<p class="soft" style="font-size:13.5px;margin-top:6px">{fit}</p>'


def astray(turn: Turn) -> str:
    """What it means that a free run leaves all bounds; nothing where it does not."""
    if turn.result.get("test_error") is not None:
        return ""
    model = f"With {words(turn.added)} the model" if turn.added else "The model"
    said = "Undo, or add another effect" if turn.added else "Check units and signs of the channels"
    return (
        f"<div class='note' id='astray' style='margin-top:12px'><b>{escape(model)} runs away from "
        f"the record</b> when it runs freely: its error is not finite. {said}; nothing is lost."
        "</div>"
    )


def units(found: Sequence[Mapping[str, Any]]) -> dict[str, str]:
    """The unit of every series of the records, each by its first."""
    rows = [series for record in found for series in record["series"]]
    return {s["name"]: s["unit"] for s in reversed(rows)}


def plain(table: str) -> str:
    """A table of the report in the page's look."""
    return table.replace("<table>", '<table class="plain">', 1)


def candidate(found: Mapping[str, Any]) -> str:
    """Name and meaning."""
    return (
        f'<div class="name">{escape(words(found["effect"]))}</div>'
        f'<div class="meaning">{meaning(found["meaning"])}</div>'
    )


def meaning(said: str) -> str:
    """A meaning whose formula is not broken where it fits into a line."""
    name, colon, formula = symbols(said).rpartition(": ")
    if "=" not in formula or not colon:
        return escape(symbols(said))
    return f'{escape(name)}: <span class="formula">{escape(formula)}</span>'


def evidence(found: Mapping[str, Any]) -> str:
    """How much of the residual it explains, and how sure that is."""
    share = max(0.0, min(1.0, found["explains"] or 0.0))
    worst = max(found["p_value"] or 0.0, found["wald_p_value"] or 0.0)
    return (
        f'<div class="meter"><i style="width:{100 * share:.1f}%"></i></div>'
        f'<span>explains {percent(share)}</span><span title="{_BOTH}">p {probability(worst)}</span>'
    )


def alike(others: Sequence[str]) -> str:
    """What this record cannot tell apart from it."""
    names = ", ".join(words(o) for o in others)
    return f"This record cannot tell it from <b>{escape(names)}</b>."


def trouble(error: Mapping[str, str]) -> str:
    """Given, expected, try."""
    lines = [f"<b>{escape(error['given'])}</b>"]
    if error.get("expected"):
        lines.append(f"Expected: {escape(error['expected'])}")
    if error.get("try"):
        lines.append(f"Try: {escape(error['try'])}")
    return "<br>".join(lines)


def contrast(rows: Sequence[Mapping[str, Any]]) -> str:
    """Effects side by side, each refitted alone."""
    columns = ("effect", "test error", "fit error", "χ²/dof")
    cells = [
        (words(r["effect"]), _shown(r["test_error"]), _shown(r["fit_error"]),
         number(r["chi2_per_dof"], 3))
        for r in rows
    ]  # fmt: skip
    return plain(text.table(columns, cells, columns[1:]))


def model(turn: Turn) -> str:
    """The equation and its coefficients with their standard errors."""
    return plain(text.coefficients_table(turn.result, turn.equation))


def records(found: Sequence[Mapping[str, Any]]) -> str:
    """What was understood of the records."""
    rows = [
        (record["part"], series["name"],
         f"{number(series['lowest'])} … {number(series['highest'])}", series["unit"])
        for record in found for series in record["series"]
    ]  # fmt: skip
    columns = ("part", "series", "range", "unit")
    sizes = "; ".join(
        f"{r['part']}: {r['samples']} samples at {r['rate']:.6g} Hz, "
        f"{r['samples'] / r['rate']:.4g} s"
        for r in found
    )
    return f'<p class="soft">{escape(sizes)}</p>' + plain(text.table(columns, rows, ("range",)))
