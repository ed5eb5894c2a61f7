"""The report: one HTML file of a saved run, which opens without a network.

Plotly's script is written into the file once; the equation is MathML; nothing else is fetched.
"""

from __future__ import annotations

from collections.abc import Callable, Container, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from typing import Any

from spiral.io.curves import FINAL, SEED, Curves, read_curves
from spiral.io.storage import SavedRun
from spiral.types.run import estimate_rows
from spiral.view.report import evidence, maps, motion, rotor, text, unknown
from spiral.view.report.mathfont import math_style
from spiral.view.report.style import FONT, Span, add_hover_text

Figure = Any
FREE_RUN = "free_run"


@dataclass(frozen=True)
class ReportFigure:
    """A figure with its name, its heading and its caption."""

    name: str
    heading: str
    caption: str
    figure: Figure


def figures(
    saved: Mapping[str, Any], curves: Curves | None, wanted: Container[str] | None = None
) -> list[ReportFigure]:
    """All figures that the data of a saved run allow, in the order of the report.

    ``wanted`` names those to draw; left out, all.
    """
    result = saved["result"]
    table = estimate_rows(result)
    makers: list[tuple[str, str, str, Callable[[], Figure | None]]] = [
        ("error_falling", "The error falls", text.FALLING,
         lambda: evidence.error_falling(result)),
        ("evidence", "Evidence for each candidate", text.EVIDENCE,
         lambda: evidence.candidates(result)),
        ("unknown", "A force in no catalog", text.UNKNOWN, lambda: unknown.force_curves(result)),
        ("memory", "A force with memory", text.MEMORY, lambda: unknown.force_loops(result)),
        ("coefficients", "Coefficients with their intervals", text.COEFFICIENTS,
         lambda: evidence.coefficients(table)),
    ]  # fmt: skip
    if curves is not None:
        makers = [*_seed_figures(curves), *makers, *_final_figures(curves)]
    report_figures = []
    for name, heading, caption, make in makers:
        figure = make() if wanted is None or name in wanted else None
        if figure is not None:
            report_figures.append(ReportFigure(name, heading, caption, add_hover_text(figure)))
    return report_figures


def zoomed_figure(curves: Curves, name: str, span: Span) -> Figure | None:
    """The free-run figure with its points between two moments; ``None`` for other figures."""
    if name != FREE_RUN:
        return None
    return motion.measured_against_model(curves, curves.tested, maps.first_model(curves), span)


def _seed_figures(c: Curves) -> list[tuple[str, str, str, Callable[[], Figure | None]]]:
    """Figures of the model before anything is added: name, heading, caption, function."""
    model, test = maps.first_model(c), c.tested
    number = c.meta["models"][model].get("record", 0)
    turning = c.get(number, "phase") is not None
    axes = ", frequency, speed, order" if turning else " and frequency"
    against = ", angle, channel" if turning else " and channel"
    return [
        ("before", "Measured against the model as it was", text.BEFORE,
         lambda: motion.measured_against_model(c, test, model)),
        ("where", f"Where it fails: time{axes}", text.WHERE if turning else text.WHEN,
         lambda: maps.where_map(c, number, model)),
        ("amplitude", f"Where it fails: amplitude{against}", text.AMPLITUDE,
         lambda: maps.amplitude_map(c, number)),
        ("missing_force", "The missing force", text.FORCE, lambda: motion.missing_force(c)),
        ("surface", "What the missing force follows", text.SURFACE,
         lambda: maps.force_surface(c, model)),
    ]  # fmt: skip


def _final_figures(c: Curves) -> list[tuple[str, str, str, Callable[[], Figure | None]]]:
    """Figures of the final model: name, heading, caption, function."""
    test = c.tested
    free: list[tuple[str, str, str, Callable[[], Figure | None]]] = []
    turns = c.get_input(test, "speed") is not None
    over = text.WATERFALL if turns else text.WATERFALL_OVER_TIME
    path = text.ORBIT if turns else text.ORBIT_OVER_TIME
    if SEED in c.meta["models"]:
        free = [("free_run", "Free run on the test record", text.FREE,
                 lambda: motion.measured_against_model(c, test, FINAL))]  # fmt: skip
    return [
        *free,
        ("orbit", "Orbit", path, lambda: motion.orbit(c, test)),
        ("bode", "First order over speed", text.BODE, lambda: rotor.bode(c, test)),
        ("polar", "First order, polar", text.POLAR, lambda: rotor.polar(c, test)),
        ("waterfall", "Waterfall", over, lambda: rotor.waterfall(c, test)),
        ("whirl", "Full spectrum", text.WHIRL, lambda: rotor.whirl(c, test)),
        ("correlation", "What is left: is it white?", text.CORRELATION,
         lambda: maps.correlation(c, 0)),
        ("hidden", "States that no sensor sees", text.HIDDEN, lambda: motion.hidden_states(c)),
        ("campbell", "Natural frequencies and damping", text.CAMPBELL,
         lambda: rotor.campbell(c, test)),
    ]  # fmt: skip


def report_html(saved: SavedRun) -> str | None:
    """The report of a saved run as HTML; ``None`` where it has no curves, as jobs of a sweep."""
    curves = read_curves(saved.file.parent)
    return None if curves is None else report_page(saved.data, curves)[0]


def report_page(saved: Mapping[str, Any], curves: Curves | None) -> tuple[str, list[str]]:
    """The HTML text, and the names of the figures in it."""
    from plotly.offline import get_plotlyjs

    shown = figures(saved, curves)
    parts = {s.name: _section(s) for s in shown}
    first = [n for n in ("before", "where", "amplitude", "missing_force", "surface") if n in parts]
    second = [n for n in ("evidence", "unknown", "memory", "error_falling") if n in parts]
    third = [n for n in parts if n not in (*first, *second, "coefficients")]
    body = [
        text.report_header(saved, curves),
        text.data_section(saved),
        _chapter("Where the model fails", text.where_sentences(curves), [parts[n] for n in first]),
        _chapter("What is missing", text.rounds_or_suggestions(saved), [parts[n] for n in second]),
        _chapter("The model", text.model_section(saved, curves),
                 [parts[n] for n in ("coefficients",) if n in parts]),
        _chapter("How well it does", text.error_table(saved, curves), [parts[n] for n in third]),
        _chapter("Caveats", text.caveat_section(saved, curves), []),
        _chapter("How to reproduce it", text.reproduction_section(saved), []),
    ]  # fmt: skip
    title = f"spiral {saved['verb']} {saved['run_id']}"
    html = (
        f'<!doctype html><html lang="en"><head><meta charset="utf-8"><title>{escape(title)}</title>'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<style>{_STYLE}{math_style()}</style><script>{get_plotlyjs()}</script></head>"
        f"<body><main>{''.join(body)}</main></body></html>"
    )
    return html, [s.name for s in shown]


def single_figure_page(shown: ReportFigure) -> str:
    """A page with one figure alone, for a picture of it."""
    from plotly.offline import get_plotlyjs

    return (
        f'<!doctype html><html><head><meta charset="utf-8"><style>{_STYLE} main{{margin:0;'
        f'padding:0;max-width:none}}</style><script>{get_plotlyjs()}</script></head><body><main>'
        f"{_plot(shown, bar=False)}</main></body></html>"
    )  # fmt: skip


def _chapter(title: str, words: str, parts: Sequence[str]) -> str:
    return f"<h2>{escape(title)}</h2>{words}{''.join(parts)}" if words or parts else ""


def _section(shown: ReportFigure) -> str:
    return (
        f'<section id="{shown.name}"><h3>{escape(shown.heading)}</h3>{_plot(shown)}'
        f"<p class='caption'>{escape(shown.caption)}</p></section>"
    )


def _plot(shown: ReportFigure, bar: bool = True) -> str:
    config = {"displaylogo": False, "responsive": True, "displayModeBar": "hover" if bar else False,
              "modeBarButtonsToRemove": ["lasso2d", "select2d"]}  # fmt: skip
    return shown.figure.to_html(
        full_html=False, include_plotlyjs=False, config=config, div_id=f"figure-{shown.name}",
        default_height=f"{shown.figure.layout.height}px",
    )  # fmt: skip


_STYLE = (
    f"body{{font:16px/1.55 {FONT};color:#222;background:#fff;margin:0}}"
    "main{max-width:1060px;margin:0 auto;padding:28px 24px 80px}"
    "h1{font-size:30px;line-height:1.2;margin:8px 0 6px}h2{font-size:23px;margin:54px 0 12px;"
    "padding-top:14px;border-top:2px solid #0072B2}h3{font-size:18px;margin:34px 0 6px}"
    ".caption{color:#555;font-size:14.5px;margin:4px 0 22px;max-width:80ch}"
    "figure{margin:14px 0}"
    ".lead{font-size:19px;max-width:70ch}.kind{color:#0072B2;font-weight:600;margin:0}"
    ".points{max-width:75ch;padding-left:1.2em}.points li{margin:.25em 0}"
    ".sentence{border-left:4px solid #D55E00;padding:6px 14px;background:#FBF4EF;font-size:18px}"
    ".note{border-left:4px solid #E69F00;padding:4px 14px;background:#FDF8EC;margin:8px 0}"
    "table{border-collapse:collapse;margin:14px 0;font-size:15px}.wide{overflow-x:auto}"
    "th,td{padding:5px 14px 5px 0;text-align:left;border-bottom:1px solid #DDD;vertical-align:top}"
    "th{font-weight:600;border-bottom:2px solid #888}"
    "td.n,th.n{text-align:right;font-variant-numeric:tabular-nums;white-space:nowrap}"
    "pre,code{font:13.5px/1.5 ui-monospace,'DejaVu Sans Mono',monospace;background:#F5F5F5}"
    "pre{padding:12px 14px;overflow-x:auto}code{padding:1px 4px;overflow-wrap:anywhere}"
    ".equation td{border:0;padding:3px 10px 3px 0;vertical-align:middle}"
    ".equation td.owner{color:#666;font-size:14px}"
    "@page{size:A3;margin:9mm 0}"
    "@media print{section,tr{break-inside:avoid}h2,h3{break-after:avoid}main{padding:0 24px}"
    ".wide{overflow:visible}pre{white-space:pre-wrap}.modebar{display:none!important}}"
)
