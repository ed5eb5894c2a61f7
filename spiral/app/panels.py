"""Parts of the study page as HTML text: numbers, candidates, tables; inserted text is escaped."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

from spiral.app import horizon_errors
from spiral.app.study import LEARNED, Study, StudyState
from spiral.types.formatting import capitalised, digits, error_percent, number, percent, probability
from spiral.view.report import text
from spiral.view.report.style import label_title, label_words, typeset_formula
from spiral.view.terminal.preview import is_test_held_out
from spiral.view.terminal.preview import quiet_test_warning as quiet_test_words

_BOTH = "the larger of the classical p-value and the robust one"
_NET = (
    "Share of the residual that it explains on the windows that ranked all candidates, less the "
    "share of pure noise that as many free parameters explain; the list is in this order"
)
_LONG = 2.0  # s, from which it is said how long a step took
PRELIMINARY = (
    "<b>Preliminary:</b> by one-step predictions, nothing is refitted yet. The best are refitted "
    "now, which may change shares and order. <i>Add</i> comes with the final list."
)
_INDEX = re.compile(r"(?<=[^\W\d_])_([A-Za-z\d]{1,2}(?:,[a-z])?)(?![A-Za-z\d])")
_FAR = 3.0  # times the noise, above which a free run misses more than noise
ENDINGS = {
    "whiteness": "Nothing more is missing: what is left is white noise.",
    "no_candidate": "No further effect of the list is confirmed; below is how much each explains.",
    "diverged": "The model diverges even on short windows. Check units and signs of the channels, "
    "or undo.",
    "not_identifiable": "This record cannot tell the model's own effects apart.",
}


_NAMES = (("displacements, as", ["x"]), ("velocities, as", ["x_rate"]), ("of any axis", ["q", "v"]))


def formula_help(about: Mapping[str, Any]) -> str:
    """What a formula of one's own may name on this machine."""
    known = "".join(
        f"<br>{escape(kind)}: {', '.join(f'<code>{escape(n)}</code>' for n in names)}"
        for kind, names in about.get("names") or _NAMES
        if names
    )
    return (
        f"<p class='soft' style='margin-bottom:10px'>A formula may name {known}<br>Every other "
        "name is a coefficient that the fit finds; a spring is <code>-k*q</code>. One inside a "
        "function, such as the width of a friction <code>-F*tanh(v/w)</code>, needs a value. "
        "Formulas that differ are named: <code>x: -k*y; y: k*x</code>.</p>"
    )


def caveats_note(said: Sequence[str]) -> str:
    """The caveats of a verdict as a list; empty where there are none."""
    if not said:
        return ""
    items = "".join(f"<li>{escape(capitalised(one))}</li>" for one in said)
    return f'<div class="note caveats" id="caveats"><b>Caveats</b><ul>{items}</ul></div>'


def ending_message(study: Study, turn: StudyState) -> str:
    """The message where no candidate is confirmed: what that means."""
    said = ENDINGS.get(turn.verdict) or escape(turn.advice)
    if turn.verdict == "not_identifiable":
        said += f" {escape(turn.advice)}"
    error, floor = turn.result.get("test_error"), study.noise_floor
    if turn.verdict == "whiteness" and error and floor and error > _FAR * floor:
        said += f" The free run on the test record still misses by {percent(error)}, though: such a"
        said += " model may be right and its motion hard to predict, or the test record differs."
    if turn.memory:
        said += f" <b>{escape(turn.memory)}</b> Its loop is drawn under <i>Missing force</i>."
    if turn.shape:
        said += f" What is left: {escape(turn.shape[:1].lower() + turn.shape[1:])}"
    return said


def has_learnable_curve(study: Study, turn: StudyState) -> bool:
    """Whether the curve of what is left can be offered as an effect, and is not yet."""
    asked = any(o.partition("=")[0] == LEARNED for o in study.overrides)
    return bool(turn.shape) and turn.verdict == "no_candidate" and not asked


def headline(study: Study) -> str:
    """The error on data the fit never saw: now, before, and what noise alone makes."""
    line = study.line
    if not line:
        return '<p class="label">Free-run error on the test record</p><div class="number">…</div>'
    now, first = (line[i].result.get("test_error") for i in (-1, 0))
    kind = "one-line" if now is not None else "words"
    value = f'<span class="{kind}">{escape(error_percent(now))}</span>'
    before = f"<small> from {escape(percent(first))}</small>" if len(line) > 1 else ""
    floor = study.noise_floor
    noise = f" Noise alone makes {escape(percent(floor))}." if floor is not None else ""
    return (
        '<p class="label">Free-run error on the test record</p>'
        f'<div class="number" id="error-now">{value}{before}</div>'
        '<p class="soft">As a share of each channel\'s standard deviation, on data that no fit and '
        f"no choice has seen.{noise}</p>" + quiet_test_warning(study.records)
    )


def error_announcement(turn: StudyState) -> str:
    """The free-run error as a sentence for screen readers."""
    return f"Free-run error on the test record: {error_percent(turn.result.get('test_error'))}"


def quiet_test_warning(records: Sequence[Mapping[str, Any]]) -> str:
    """A warning where the test record hardly moves what the fitted one moves; else empty."""
    said = quiet_test_words(records)
    return f'<p class="note quiet">{escape(said)}</p>' if said else ""


def effect_chips(study: Study) -> str:
    """The model's effects: the seed's, and those added; below them, effects removed again."""
    if not study.line:
        return ""
    model = study.line[-1].result.get("model") or {}
    seed = [e for e in model.get("effects", {}) if e not in study.added]
    items = [f'<span class="chip">{escape(label_words(e))}</span>' for e in seed]
    items += [f'<span class="chip added">+ {escape(label_words(e))}</span>' for e in study.added]
    gone = ", ".join(label_words(e) for e in study.gone)
    said = f"Removed: {gone}, superfluous beside later findings."
    left = f'<p class="soft gone">{escape(said)}</p>' if gone else ""
    return f'<div class="chips">{"".join(items)}</div>{left}'


def channel_error_table(turn: StudyState, units: Mapping[str, str]) -> str:
    """Errors of each channel in its unit, chi2 and whiteness of the fit."""
    rows = [
        (name, text.format_with_unit(v["rmse"], units.get(name, "")), error_percent(v["relative"]))
        for name, v in (turn.result.get("channels") or {}).items()
    ]
    table = text.html_table(("channel", "rms error", "of its deviation"), rows,
                       ("rms error", "of its deviation"))  # fmt: skip
    chi2 = turn.result.get("chi2_per_dof")
    fit = "" if chi2 is None else f"χ² per degree of freedom {digits(chi2)}; "
    fit += (
        f"whiteness <span class='formula'>p {escape(probability(turn.result.get('whiteness_p')))};"
        f"</span> fitted over {turn.result.get('horizon') or '-'} samples at a time"
    )
    return (
        restyle_table(table) + f'<p class="soft" style="font-size:13.5px;margin-top:6px">{fit}</p>'
    )


def divergence_warning(turn: StudyState) -> str:
    """A warning where the free run diverges (its error is not finite); else empty."""
    if turn.result.get("test_error") is not None:
        return ""
    model = f"With {label_words(turn.added)} the model" if turn.added else "The model"
    said = "Undo, or add another effect" if turn.added else "Check units and signs of the channels"
    return (
        f"<div id='astray'><b>{escape(model)} runs away from the record</b> when it runs freely: "
        f"its error is not finite. {said}; nothing is lost."
        "</div>"
    )


def series_units(summaries: Sequence[Mapping[str, Any]]) -> dict[str, str]:
    """The unit of every series of the records, each by its first."""
    rows = [series for record in summaries for series in record["series"]]
    return {s["name"]: s["unit"] for s in reversed(rows)}


def restyle_table(table: str) -> str:
    """A table of the report with the page's CSS class."""
    return table.replace("<table>", '<table class="plain">', 1)


def left_out_note(wrong: Sequence[Mapping[str, str]]) -> str:
    """Columns that are not offered, as a text stands among their numbers; empty without any."""
    items = "".join(f"<li>{error_message(one)}</li>" for one in wrong)
    return (
        f'<div class="note caveats" id="left-out">Left out:<ul>{items}</ul></div>' if items else ""
    )


def progress_words(what: str, words: str, lasted: float) -> str:
    """What is under way, and the seconds that the last such step took, where that is long.

    Labels of effects are words here as everywhere on the page.
    """
    said = f"{what}: {words.replace('_', ' ')}" if words else what
    return f"{said} (the last such step took {lasted:.0f} s)" if lasted >= _LONG else said


def units_note(taken: Sequence[str]) -> str:
    """A note on units that nobody gave (``record_setup.units_taken``); empty without any."""
    if not taken:
        return ""
    said = f"No unit is given; taken as the system has them: {', '.join(taken)}."
    return (
        f'<div class="note" id="units-taken" style="margin-top:10px">{escape(said)} Another one '
        "goes into the field beside its column.</div>"
    )


def candidate_title(row: Mapping[str, Any]) -> str:
    """A candidate's name and meaning."""
    return (
        f'<div class="name">{escape(label_words(row["effect"]))}</div>'
        f'<div class="meaning">{effect_meaning(row["meaning"])}</div>'
    )


def effect_meaning(said: str) -> str:
    """A meaning whose formula is not broken where it fits into a line."""
    name, colon, formula = typeset_formula(said).rpartition(": ")
    if "=" not in formula or not colon:
        return _lower_indices(typeset_formula(said))
    return f'{_lower_indices(name)}: <span class="formula">{_lower_indices(formula)}</span>'


def _lower_indices(said: str) -> str:
    """Text as HTML, with the indices of its letters below: ``F_i``, ``k_x``, ``F_c,i``."""
    return _INDEX.sub(r"<sub>\1</sub>", escape(said))


def candidate_evidence(row: Mapping[str, Any]) -> str:
    """A candidate's share of the residual explained (a bar), and the larger of its p-values."""
    net = row.get("net")
    share = max(0.0, min(1.0, (row["explains"] if net is None else net) or 0.0))
    worst = max(row["p_value"] or 0.0, row["wald_p_value"] or 0.0)
    return (
        f'<span class="share" title="{_NET}">explains {percent(share)}</span>'
        f'<div class="meter"><i style="width:{100 * share:.1f}%"></i></div>'
        f'<span title="{_BOTH}">p {probability(worst)}</span>'
    )


def ranking_order_note(turn: StudyState) -> str:
    """What orders the candidates, and why the proposed one stands where it does."""
    said = "Ordered by the share of what the model misses that each explains, all on the same data."
    effects = [row["effect"] for row in turn.candidates or ()]
    first = next((e for e in effects if e in turn.proposed), None)
    above = effects[: effects.index(first)] if first else []
    if above:
        names = horizon_errors.join_words([label_words(e) for e in above])
        said += (
            f" {label_title(first or '')} is proposed although {names} "
            f"{'explains' if len(above) == 1 else 'explain'} more there: other data, "
            "which took no part in this order, decide."
        )
    return escape(said)


def proposal_message(turn: StudyState) -> tuple[str, str]:
    """What the trial on the test record says of the proposed effect: a sentence and its kind.

    The kind is ``worse``, ``fine``, ``trying`` (not known yet) or nothing where none is proposed.
    """
    if not turn.proposed:
        return "", ""
    name = label_words(turn.proposed[0])
    passes = f"<b>{escape(name)}</b> is confirmed on data that took no part in its choice"
    if turn.preview.get("effect") not in turn.proposed:
        return f"{passes}; what it does on the test record is not known yet.", "trying"
    where = horizon_errors.worse_horizons(turn.preview["changes"])
    if where:
        horizons = horizon_errors.join_words(where)
        said = f"{passes}, but predicts the test record <b>worse</b>: {horizons}."
        return f"{said} Something else may be missing, or the test record differs.", "worse"
    return f"{passes}, and predicts the test record no worse at any horizon.", "fine"


def indistinguishable_note(others: Sequence[str]) -> str:
    """A sentence on the effects that this record cannot tell from a candidate."""
    names = ", ".join(label_words(o) for o in others)
    return f"This record cannot tell it from <b>{escape(names)}</b>."


def trial_result(turn: StudyState, effect: str) -> Mapping[str, Any]:
    """What came of trying an effect on the test record; nothing where it was not tried."""
    if turn.preview.get("effect") == effect:
        return {**turn.preview, **turn.trials.get(effect, {})}
    return turn.trials.get(effect, {})


def plan_table(plan_data: Mapping[str, Any]) -> str:
    """Planned tests with the chance that each tells effects apart, and what to do."""
    rows = [
        (row["test"], "-" if row["failure"] else percent(row["probability"]))
        for row in plan_data["rows"]
    ]
    table = text.html_table(("test", "tells them apart"), rows, ("tells them apart",))
    advice = f"<p class='soft' style='margin-top:6px'>{escape(plan_data['advice'])}</p>"
    return restyle_table(table) + advice


def error_message(error: Mapping[str, str]) -> str:
    """An error as lines: what was given, what was expected, what to try."""
    lines = [f"<b>{escape(error['given'])}</b>"]
    if error.get("expected"):
        lines.append(f"Expected: {escape(error['expected'])}")
    if error.get("try"):
        lines.append(f"Try: {escape(error['try'])}")
    return "<br>".join(lines)


def contrast_table(rows: Sequence[Mapping[str, Any]], windows: int) -> str:
    """Effects side by side, each refitted alone: one row for each figure, all on the same data."""
    figures = [
        (horizon_errors.horizon_label(h), [error_percent(r["unseen"][i]["error"]) for r in rows])
        for i, h in enumerate(rows[0]["unseen"])
    ]
    figures += [
        ("fitted record, free run", [error_percent(r["fit_error"]) for r in rows]),
        (f"χ²/dof, over {windows} samples", [digits(r["chi2_per_dof"]) for r in rows]),
    ]
    columns = ("error on", *(label_words(r["effect"]) for r in rows))
    return restyle_table(
        text.html_table(columns, [(name, *cells) for name, cells in figures], columns[1:])
    )


def model_table(turn: StudyState) -> str:
    """The equation and its coefficients with their standard errors."""
    signs = turn.result.get("signs") or {}
    return restyle_table(text.coefficients_table(turn.result, turn.equation, signs))


def sign_warnings(signs: Mapping[str, str]) -> str:
    """Coefficients whose sign a passive machine does not have; nothing where there is none."""
    rows = [
        f"<li>{escape(label_words(k.rpartition('.')[2]))}: {escape(v)}</li>"
        for k, v in signs.items()
    ]
    return f"<ul class='signs'>{''.join(rows)}</ul>" if rows else ""


def test_split_note(records: Sequence[Mapping[str, Any]]) -> str:
    """Where the test record comes from, in a sentence."""
    tests = [r["name"] for r in records if r["part"] == "test"]
    if not is_test_held_out(records):
        return f"No fit sees the test record: {horizon_errors.join_words(tests)}."
    where = "The last part" if len(tests) == 1 else f"The last part of each of {len(tests)} records"
    where = f"The end of each of {len(tests)} blocks" if "(block " in tests[0] else where
    return f"{where} is kept apart as the test record: no fit sees it."


def records_table(summaries: Sequence[Mapping[str, Any]]) -> str:
    """What was understood of the records; those of a part together."""
    spans: dict[tuple[str, str, str], tuple[float, float]] = {}
    for record in summaries:
        for series in record["series"]:
            key = (record["part"], series["name"], series["unit"])
            low, high = spans.get(key, (series["lowest"], series["highest"]))
            spans[key] = min(low, series["lowest"]), max(high, series["highest"])
    rows = [
        (part, name, f"{number(low)} … {number(high)}", unit)
        for (part, name, unit), (low, high) in spans.items()
    ]
    columns = ("part", "series", "range", "unit")
    sizes = "; ".join(_record_size([r for r in summaries if r["part"] == part], part)
                      for part in dict.fromkeys(r["part"] for r in summaries))  # fmt: skip
    return f'<p class="soft">{escape(sizes)}</p>' + restyle_table(
        text.html_table(columns, rows, ("range",))
    )


def _record_size(records: Sequence[Mapping[str, Any]], part: str) -> str:
    """How much a part holds: ``fit: 9600 samples at 1000 Hz, 9.6 s``."""
    samples = sum(r["samples"] for r in records)
    seconds = sum(r["samples"] / r["rate"] for r in records)
    several = f" in {len(records)} records" if len(records) > 1 else ""
    rates = ", ".join(dict.fromkeys(f"{r['rate']:.6g}" for r in records))
    return f"{part}: {samples} samples at {rates} Hz, {seconds:.4g} s{several}"
