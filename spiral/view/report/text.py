"""The words and tables of a report."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

import numpy as np

from spiral.io.curves import SEED, Curves
from spiral.types.formatting import number, percent, plus_minus, probability, sentences
from spiral.types.run import RANDOM_OR_MISSING, UNTOLD, estimate_rows
from spiral.view.report.evidence import result_rounds
from spiral.view.report.markup import safe_mathml
from spiral.view.report.sketch import sketch_figure
from spiral.view.report.style import label_title, label_words, scale_to_prefix, typeset_unit
from spiral.view.terminal.shell import option_lines

Saved = Mapping[str, Any]

_SHORT = 5120  # samples under which a test has few blocks
_NO_CURVES = (
    "This run kept no curves (a sweep's job, or curves=false), so the figures of series are left "
    "out; spiral compare run=ID makes a run that has them."
)

BEFORE = (
    "Free run from the state estimated on the first seconds (grey, not scored); no later reading "
    "is used. "
    "Dotted: the noise, ±1.96 standard deviations."
)
WHERE = (
    "Energy of the free-run error over that of the noise; a right model leaves it dark. Right: "
    "resampled at equal angles, so that what turns with the rotor is a horizontal line."
)
WHEN = "Energy of the free-run error over that of the noise; a right model leaves it dark."
AMPLITUDE = "Root mean square of the error in units of the noise; a perfect model lies at 1."
FORCE = (
    "All that a model does not explain, as a force: a random walk estimated with the states by a "
    "smoother, with its 95 % band. It has the unit of the forces of effects."
)
SURFACE = (
    "Mean of the missing force in bins of each state, and the middle half of its values. A curve "
    "with a shape shows that the force depends on the state; a flat one, that it does not."
)
FALLING = (
    "Errors round by round on a logarithmic scale, of free runs or, where these tell nothing, one "
    "sample ahead; the test record took no part in any choice."
)
UNKNOWN = (
    "A force that no effect with a name explains, against the state it follows: the line is what "
    "is left of it beside the model's own effects, the band contains the whole curve with 95 % "
    "probability. Bars "
    "show how often each value was visited."
)
MEMORY = (
    "What is missing beside a spring and a damper, over some periods around the largest motion: a "
    "force without memory would follow one line in both directions. Its size comes from the model "
    "that tests for memory, not from an effect of the catalog."
)
EVIDENCE = (
    "Bars in orange cannot be told from the effect admitted, on this record. p is the larger of "
    "the classical value and the robust one."
)
COEFFICIENTS = "Standard errors are from samples that did not select the effects."
FREE = BEFORE
ORBIT = "The turns of largest motion; dots mark the passing of the once-per-turn mark."
ORBIT_OVER_TIME = "One reading over the other where the motion is largest."
BODE = (
    "Least squares over slices of four turns. The lag is that of the peak behind the rotor's mark, "
    "growing downwards: a rotor passes 90° more of it at a critical speed. Run-out is subtracted "
    "only where the record says so (record.slow_roll)."
)
POLAR = (
    "The vector of the first order as the speed changes, from zero lag to the right, lag growing "
    "clockwise; numbers are rpm. Each loop is a resonance."
)
WATERFALL = "Each line is the spectrum of a slice, raised to its speed; dotted: orders 1 to 3."
WATERFALL_OVER_TIME = "Each line is the spectrum of a slice of the record, raised to its time."
WHIRL = (
    "Spectrum of x + i y, forward in the sense of rotation to the right; below, of slices of the "
    "measured record, each raised to its speed."
)
CORRELATION = "Dotted: the 95 % bounds of a white residual."
HIDDEN = "Smoothed with the final model and its missing force, with their 95 % bands."
CAMPBELL = (
    "Eigenvalues of the final model at rest, phase zero; dotted: orders 1 and 2. Dots: the "
    "strongest lines of slices of the measured test record, the larger the stronger."
)


def html_table(
    columns: Sequence[str], rows: Sequence[Sequence[Any]], right: Sequence[str] = ()
) -> str:
    """An HTML table; columns named in ``right`` are numbers."""
    kind = [' class="n"' if c in right else "" for c in columns]
    head = "".join(f"<th{k}>{escape(c)}</th>" for c, k in zip(columns, kind, strict=True))
    body = "".join(
        "<tr>"
        + "".join(f"<td{k}>{escape(str(v))}</td>" for v, k in zip(row, kind, strict=True))
        + "</tr>"
        for row in rows
    )
    return f'<div class="wide" tabindex="0"><table><tr>{head}</tr>{body}</table></div>'


def report_header(saved: Saved, curves: Curves | None) -> str:
    """The head of the page: what the run found, in a headline and a sentence."""
    result, config = saved["result"], saved["config"]
    system = config.get("system") or (saved.get("model") or {}).get("system") or {}
    what = config.get("experiment") or system.get("name")
    moment = f"{saved['created'][:16].replace('T', ' ')} UTC"
    told = " · ".join(filter(None, (f"spiral {saved['verb']}", what and str(what), moment)))
    return f'<p class="kind">{escape(told)}</p><h1>{escape(_headline(result))}</h1>' + _lead(
        _outcome(result)
    )


def _lead(text: str) -> str:
    """A verdict: its first sentence, and a list of the others."""
    (head, under), *others = sentences(text) or [("", ())]
    items = _list_items(under) + "".join(
        f"<li>{escape(point)}{f'<ul>{_list_items(below)}</ul>' if below else ''}</li>"
        for point, below in others
    )
    listed = f'<ul class="points">{items}</ul>' if items else ""
    return f'<p class="lead">{escape(head)}</p>{listed}'


def _list_items(clauses: Sequence[str]) -> str:
    return "".join(f"<li>{escape(clause)}</li>" for clause in clauses)


def _words_with_aliases(effect: str, others: Sequence[str]) -> str:
    words = [label_words(x) for x in others]
    return f"{label_words(effect)} (or {', '.join(words)})" if words else label_words(effect)


def _headline(result: Mapping[str, Any]) -> str:
    admitted = [e for r in result_rounds(result) for e in r.get("admitted", ())]
    effects = result.get("missing", admitted)  # runs of older versions name what they admitted
    if effects:
        alike = {k: v for r in result_rounds(result) for k, v in (r.get("aliases") or {}).items()}
        return f"Missing: {', '.join(_words_with_aliases(e, alike.get(e, ())) for e in effects)}"
    for words in (UNTOLD, RANDOM_OR_MISSING):
        if str(result.get("summary", "")).startswith(words):
            return words
    if result.get("stopped") == "max_seconds":
        return "The search ended before all candidates were tried"
    verdicts = {
        "effect_missing": "An effect is missing",
        "nothing_missing": "Nothing is missing",
        "not_identifiable": "This record cannot tell",
        "unknown_structure": "Something is missing that no known effect explains",
    }
    return verdicts.get(str(result.get("verdict")), "The model against measurements")


def _outcome(result: Mapping[str, Any]) -> str:
    done = result_rounds(result)
    if result.get("summary"):
        return f"{result['summary']} {result.get('advice') or ''}".strip()
    if not done:
        return str(result.get("advice", ""))
    first, last = done[0]["test_error"], done[-1]["test_error"]
    words = f"Free-run error {percent(last)}"
    if len(done) > 1:
        words = f"The free-run error on the test record falls from {percent(first)} to "
        words += percent(last)
    floor = result.get("noise_floor") or (result.get("comparison") or {}).get("noise_floor")
    if floor is not None:
        words += f"; the noise alone makes {percent(floor)}"
    return f"{words}. {result.get('advice') or ''}".strip()


def data_section(saved: Saved) -> str:
    """The records, and what was done to them."""
    rows = [
        (part, r["name"], r["samples"], f"{r['samples'] / r['rate']:.4g}", f"{r['rate']:.6g}")
        for part, records in saved["data"].items()
        for r in records
    ]
    columns = ("part", "record", "samples", "length (s)", "rate (Hz)")
    rows = [("fitted" if p == "records" else p, *rest) for p, *rest in rows]
    return "<h2>The data</h2>" + html_table(columns, rows, columns[2:])


def where_sentences(curves: Curves | None) -> str:
    """Where the model failed, and where the final one still does."""
    if curves is None:
        return f'<p class="note">{escape(_NO_CURVES)}</p>'
    models = {m: a for m, a in curves.meta["models"].items() if "where" in a}
    words = []
    for name, about in models.items():
        said = about["where"]["sentence"]
        if len(models) > 1:
            said = ("Before: " if name == SEED else "Now: ") + said
        words.append(f'<p class="sentence">{escape(said)}</p>')
    return "".join(words)


def rounds_or_suggestions(saved: Saved) -> str:
    """Rounds and what they admitted, or the ranked suggestions of a diagnosis."""
    result = saved["result"]
    done = result_rounds(result)
    if len(done) > 1:
        columns = ("round", "added", "fit error", "test error", "chi2/dof", "whiteness p")
        rows = [
            (r["round"], ", ".join(r["admitted"]) or "the model as it was", percent(r["fit_error"]),
             percent(r["test_error"]), number(r["chi2_per_dof"]), probability(r["whiteness_p"]))
            for r in done
        ]  # fmt: skip
        return html_table(columns, rows, columns[2:])
    if not result.get("suggestions"):
        return ""
    columns = ("effect", "meaning", "explains", "p", "test error with it")
    rows = [
        (s["effect"], s["meaning"], percent(s["explains"]), probability(s["p_value"]),
         percent(s.get("test_error_after")))
        for s in result["suggestions"]
    ]  # fmt: skip
    return html_table(columns, rows, columns[2:])


def model_section(saved: Saved, curves: Curves | None) -> str:
    """A sketch of the model, its equation and the table of its parameters."""
    if curves is None:
        return coefficients_table(saved["result"])
    drawn = sketch_figure(curves.meta.get("sketch"))
    signs = curves.meta.get("signs")
    return drawn + coefficients_table(
        saved["result"], curves.meta["mathml"], signs if isinstance(signs, dict) else None
    )


def coefficients_table(
    result: Mapping[str, Any],
    mathml: Sequence[Mapping[str, Any]] = (),
    signs: Mapping[str, str] | None = None,
) -> str:
    """Every parameter with its standard error, under the equation where there is one.

    ``signs`` says of coefficients by full name what is doubtful about their sign.
    """
    rows = [
        (
            label_words(r["effect"]),
            _parameter_label(r, signs or {}),
            plus_minus(r["estimate"], r.get("se")),
            _format_ratio(r.get("t")),
            typeset_unit(r["unit"] or "1") or "1",
        )
        for r in estimate_rows(result)
    ]
    columns = ("effect", "parameter", "estimate ± se", "t", "unit")
    shown = _equation_table(mathml) if mathml else ""
    return shown + (html_table(columns, rows, columns[2:4]) if rows else "")


def _parameter_label(row: Mapping[str, Any], signs: Mapping[str, str]) -> str:
    """A parameter's name, and what is doubtful about its sign."""
    said = signs.get(f"{row['effect']}.{row['parameter']}")
    return label_words(row["parameter"]) + (f" ({said})" if said else "")


def _format_ratio(t: float | None) -> str:
    """An estimate over its standard error: ``1220``, ``-3.41``."""
    if t is None:
        return "given"
    return f"{t:.0f}" if 100 <= abs(t) < 1e6 else number(t, 3)


def _equation_table(equations: Sequence[Mapping[str, Any]]) -> str:
    rows = []
    for item in equations:
        for index, term in enumerate(item["terms"]):
            name = safe_mathml(item["left"])
            left = f"<math><mrow>{name}<mo>=</mo></mrow></math>" if index == 0 else ""
            body = f'<math display="inline"><mrow>{safe_mathml(term["math"])}</mrow></math>'
            rows.append(
                f"<tr><td>{left}</td><td>{body}</td>"
                f'<td class="owner">{escape(label_words(term["owner"]))}</td></tr>'
            )
    return f'<div class="wide" tabindex="0"><table class="equation">{"".join(rows)}</table></div>'


def format_with_unit(value: float | None, unit: str) -> str:
    """``20.04 µm`` for 2.004e-5 m."""
    if value is None:
        return "not finite"
    factor, name = scale_to_prefix(unit, np.array([value]))
    return f"{number(factor * value)} {name}".strip()


def error_table(saved: Saved, curves: Curves | None) -> str:
    """Errors of each channel on the test record, in its unit where the curves know it."""
    result = saved["result"]
    last = result.get("test") or result.get("channels")
    last = last or (result.get("comparison") or result.get("after") or {}).get("channels") or {}
    units = {} if curves is None else {c["name"]: c["unit"] for c in curves.meta["channels"]}
    rows = [
        (name, format_with_unit(v["rmse"], units.get(name, "")), percent(v["relative"]))
        for name, v in last.items()
    ]
    columns = ("channel", "rms error", "of its deviation")
    return html_table(columns, rows, columns[1:]) if rows else ""


def caveat_section(saved: Saved, curves: Curves | None) -> str:
    """What limits the result: aliases, refusals, short records, changes of the data."""
    result = saved["result"]
    notes = [said for r in result_rounds(result) for said in _round_caveats(r)]
    notes += [
        f"{label_title(s['effect'])} cannot be told from "
        f"{', '.join(map(label_words, s['aliases']))}."
        for s in result.get("suggestions", ())
        if s.get("aliases")
    ]
    notes += [
        f"These look alike on this record: {', '.join(g)}." for g in result.get("alias_groups", ())
    ]
    if result.get("verdict") == "not_identifiable" or result.get("stopped") == "diverged":
        notes.append(f"Refused ({result.get('stopped') or result['verdict']}): {result['advice']}")
    notes += _data_caveats(saved)
    if curves is None:
        notes.append(_NO_CURVES)
    if not notes:
        notes = ["None: no look-alikes, no refusal, no short record, no change of the data."]
    return "".join(f'<p class="note">{escape(said)}</p>' for said in dict.fromkeys(notes))


def _round_caveats(r: Saved) -> list[str]:
    notes = ambiguity_notes(r)
    notes += [
        f"Round {r['round']}: {label_words(effect)} was refused: {reason}."
        for effect, reason in (r.get("rejected") or {}).items()
    ]
    notes += [
        f"Round {r['round']}: {label_words(effect)} was removed: superfluous beside later findings."
        for effect in r.get("retired", ())
    ]
    return notes


def ambiguity_notes(r: Saved) -> list[str]:
    """Sentences on what a round's record cannot tell apart or could not have found."""
    notes = [
        f"{label_title(effect)} cannot be told from "
        f"{', '.join(map(label_words, others))} on this record."
        for effect, others in (r.get("aliases") or {}).items()
        if others
    ]
    notes += [
        f"{label_title(effect)} could not have been found: on this record "
        f"{', '.join(map(label_words, owners))} would explain it as well."
        for effect, owners in ((r.get("details") or {}).get("not_separable") or {}).items()
    ]
    if r.get("second_order"):
        notes.append(
            f"{', '.join(map(label_words, r['admitted']))} is of second order: it may stand for "
            "the remainder of an effect transmitted by a hidden state."
        )
    return notes


def _data_caveats(saved: Saved) -> list[str]:
    notes = []
    for records in saved["data"].values():
        for r in records:
            file = re.split(r" \((?:last|block) ", r["name"])[
                0
            ]  # the part kept apart was read as the rest was
            notes += [n if n.startswith(f"{file}:") else f"{file}: {n}" for n in r.get("notes", ())]
            if r["samples"] < _SHORT:
                notes.append(f"{r['name']} is short ({r['samples']} samples): its tests rest on "
                             f"few blocks.")  # fmt: skip
    if not saved["data"].get("test"):
        notes.append("There is no test record: the errors are of the data that were fitted.")
    return notes


def reproduction_section(saved: Saved) -> str:
    """The command, the versions, the hashes of the data."""
    given = option_lines(saved.get("overrides", ()))
    # The effects of ``add`` come before its overrides.
    names = [e for r in result_rounds(saved["result"]) for e in r.get("admitted", ())]
    named = " " + " ".join(names) if saved["verb"] == "add" else ""
    hashes = [
        (part, r["name"], r["sha256"]) for part, group in saved["data"].items() for r in group
    ]
    used = {saved["model"]["system"]["name"], *(e["name"] for e in saved["model"]["effects"])}
    plugins = [(k, v) for k, v in saved["plugins"].items() if k.split("/")[-1] in used]
    return (
        f"<pre>spiral {escape(saved['verb'])}{escape(named)}{escape(given)}</pre>"
        + html_table(("part", "record", "SHA-256 of its numbers"), hashes)
        + html_table(("plugin", "from"), plugins)
        + f"<p>Run <code>{escape(saved['run_id'])}</code>; the composed configuration is in its "
        "run.json.</p>"
    )
