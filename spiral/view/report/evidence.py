"""Figures of a run's rounds: falling errors, evidence of each candidate, coefficients."""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Mapping, Sequence
from textwrap import wrap
from typing import TYPE_CHECKING, Any

from spiral.types.formatting import percent
from spiral.view.report.style import (
    AFTER,
    BEFORE,
    BLUE,
    GREY,
    ORANGE,
    SKY,
    VERMILION,
    blank_figure,
    decade_ticks,
    label_words,
)

if TYPE_CHECKING:
    import plotly.graph_objects as go

_FEW, _LABELS = 8, 5  # up to 8 points of a curve are all labelled, of more only 5
_TICKS = 16
_LABEL = 16  # letters of a label's line
_LINES = 38  # pixels of a label's height
_WIDTH = 115  # pixels of a label's width
_AROUND = 100  # pixels above and below the axes
_LAST = 0.22  # share of the width, at least, that is left for the label of the last step
_LEFT = 0.15  # rounds to the left of the first
_LEAST = 1e-3  # percent, where an error of zero is drawn


def result_rounds(result: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """The rounds of a saved result; ``add`` has two, ``compare`` and ``diagnose`` one."""
    if result.get("rounds"):
        return list(result["rounds"])
    only = result.get("comparison") or result
    return [{"round": 0, "admitted": [], **only}] if "test_error" in only else []


def error_falling(
    result: Mapping[str, Any], least: int = 2, width: float = 700, height: int = 430
) -> go.Figure | None:
    """Fit and test error by round, the noise floor below them, the effect admitted at each step.

    Nothing for a history shorter than ``least`` rounds. Labels are placed for axes of ``width``
    pixels in a figure of ``height``. Errors are those of free runs; one sample ahead where a free
    run is no test of the final model.
    """
    history, what = _telling_errors(result_rounds(result))
    if len(history) < least or not _finite_errors(history):
        return None
    figure = blank_figure(height=height)
    numbers = [r["round"] for r in history]
    names = [_step_label(r) for r in history]
    _draw_errors(figure, history, numbers, names)
    errors = [_as_percent(r.get("test_error")) for r in history]
    told = _labelled_points(errors)
    first, last, *span = _draw_floor_and_axes(figure, history, result.get("noise_floor"), width)
    figure.update_yaxes(title_text=f"{what} (% of the deviation)")
    scale = width / (last - first), (height - _AROUND) / (span[1] - span[0])
    at = [(numbers[i], None if (v := errors[i]) is None else math.log10(v)) for i in told]
    for index, shift in zip(told, _label_shifts(at, *scale), strict=True):
        number, name, r, value = numbers[index], names[index], history[index], errors[index]
        at = {"y": 1, "yref": "paper", "yanchor": "top", "font": {"size": 13, "color": VERMILION}}
        if value is not None:
            at = {
                "y": math.log10(value),
                "yanchor": "bottom",
                "yshift": 5 + shift,
                "font": {"size": 13},
            }
        said = "↑ not finite" if value is None else percent(r["test_error"])
        figure.add_annotation(x=number, text=f"<b>{said}</b><br>{name}", align="left",
                              showarrow=False, xanchor="left", xshift=7, **at)  # fmt: skip
    return figure


def _draw_errors(
    figure: Any, history: Sequence[Mapping[str, Any]], numbers: list[int], names: list[str]
) -> None:
    """Draw fit and test errors over the rounds."""
    for key, name, colour, dash in (
        ("fit_error", "fit error", SKY, "dot"),
        ("test_error", "test error", BLUE, "solid"),
    ):
        values = [_as_percent(r.get(key)) for r in history]
        if not any(values):
            continue
        figure.add_scatter(
            x=numbers, y=values, name=name, mode="lines+markers", customdata=names,
            line={"color": colour, "width": 3, "shape": "hv", "dash": dash}, marker={"size": 10},
            hovertemplate="%{customdata}<br>%{y:.3g} %",
        )  # fmt: skip


def _telling_errors(
    history: list[Mapping[str, Any]],
) -> tuple[list[Mapping[str, Any]], str]:
    """The rounds with the errors that tell of their models, and what these are."""
    ahead = [
        next((h["error"] for h in r.get("unseen") or () if h.get("samples") == 1), None)
        for r in history
    ]
    last = history[-1].get("details") or {} if history else {}
    if not last.get("carried_away") or None in ahead:
        return history, "free-run error"
    told = zip(history, ahead, strict=True)
    return [{**r, "fit_error": None, "test_error": e} for r, e in told], "error one sample ahead"


def _labelled_points(values: Sequence[float | None]) -> list[int]:
    """Indices of the points that get a label: all of a few, else where the curve changes most.

    Of many: the first, the last, those that are not finite, and after the largest changes.
    """
    if len(values) <= _FEW:
        return list(range(len(values)))
    size = [
        math.inf if b is None or a is None else abs(math.log(b / a))
        for a, b in itertools.pairwise(values)
    ]
    order = sorted(range(1, len(values) - 1), key=lambda i: size[i - 1], reverse=True)
    chosen = [0, len(values) - 1]
    apart = len(values) / (_LABELS + 1)  # so that labels do not overlap
    for i in order:
        if len(chosen) < _LABELS and min(abs(i - c) for c in chosen) >= apart and size[i - 1] > 0:
            chosen.append(i)
    return sorted(chosen)


def _label_shifts(
    points: Sequence[tuple[float, float | None]], across: float, up: float
) -> list[float]:
    """Pixels by which each label stands above its point, so that none overlaps one to its right.

    ``points`` are (round, log10 of the error), ``across`` and ``up`` pixels for one of each.
    """
    shifts: list[float] = []
    placed: list[tuple[float, float]] = []  # left end and bottom of the labels so far, in pixels
    for x, y in reversed(points):
        left, bottom = x * across, 0.0 if y is None else y * up
        at = bottom
        for other in sorted(b for a, b in placed if a - left < _WIDTH):
            at = other + _LINES if abs(other - at) < _LINES else at
        shifts.insert(0, at - bottom)
        if y is not None:
            placed.append((left, at))
    return shifts


def _draw_floor_and_axes(
    figure: Any, history: Sequence[Mapping[str, Any]], share: float | None, width: float
) -> tuple[float, float, float, float]:
    """Draw them; returns first and last round and lowest and highest log10 that are in view."""
    floor = _as_percent(share)
    if floor:
        figure.add_hline(floor, line={"color": GREY, "dash": "dash", "width": 2})
        figure.add_annotation(
            x=0,
            xref="paper",
            xanchor="left",
            y=math.log10(floor),
            yanchor="top",
            showarrow=False,
            text=f" noise floor {percent(share)}",
            font={"size": 13, "color": "#555"},
        )
    numbers = [r["round"] for r in history]
    ticks = numbers[:: math.ceil(len(numbers) / _TICKS)]
    label = max(_LAST, _WIDTH / width)
    rounds = (-_LEFT, numbers[-1] + max(0.8, label / (1 - label) * (numbers[-1] + _LEFT)))
    figure.update_xaxes(title_text="round", tickmode="array", tickvals=ticks,
                        range=list(rounds))  # fmt: skip
    values = _finite_errors(history)
    low, high = min([*values, floor or math.inf]), max(values)
    bottom, top = math.log10(low) - 0.25, math.log10(high)
    span = (bottom, top + max(0.45, 0.2 * (top - bottom)))  # room for the labels of the highest
    figure.update_yaxes(type="log", range=list(span), **decade_ticks(*span),
                        minor={"showgrid": True, "gridcolor": "rgba(0,0,0,0.047)"})  # fmt: skip
    return (*rounds, *span)


def _finite_errors(history: Sequence[Mapping[str, Any]]) -> list[float]:
    """All errors that are finite, in percent."""
    return [v for r in history for k in ("fit_error", "test_error") if (v := _as_percent(r.get(k)))]


def _step_label(entry: Mapping[str, Any]) -> str:
    names = [label_words(name) for name in entry.get("admitted") or ()]
    gone = [label_words(name) for name in entry.get("retired") or ()]
    let_go = "".join(f"<br>\N{MINUS SIGN} {_wrap_label(name)}" for name in gone)
    return "+ " + ",<br>".join(map(_wrap_label, names)) + let_go if names else "as it was"


def _wrap_label(name: str) -> str:
    """A long name on two lines."""
    return "<br>".join(wrap(name, _LABEL, break_long_words=False))


def _as_percent(value: Any) -> float | None:
    return None if value is None else max(100 * float(value), _LEAST)


def candidates(result: Mapping[str, Any]) -> go.Figure | None:
    """What each candidate explains of the residual, round by round, alias groups marked."""
    groups = [r for r in result_rounds(result) if r.get("suggestions")]
    if not groups and result.get("suggestions"):
        groups = [{"round": 0, "suggestions": result["suggestions"]}]
    if not groups:
        return None
    count = len(groups)
    rows = max(len(g["suggestions"]) for g in groups)
    titles = [f"round {g['round']}" for g in groups]
    width = min(count, 2)
    lines = math.ceil(count / width)
    figure = blank_figure(lines, width, 110 + lines * (70 + 34 * rows), subplot_titles=titles,
                   horizontal_spacing=0.3, vertical_spacing=0.3 / lines)  # fmt: skip
    for index, group in enumerate(groups):
        admitted = _next_admitted(result, group)
        _draw_candidate_bars(
            figure, group["suggestions"], admitted, index // width + 1, index % width + 1
        )
    figure.update_layout(margin={"l": 170, "t": 78}, showlegend=True, barmode="overlay",
                         legend={"y": 1 + 34 / figure.layout.height})  # fmt: skip
    figure.update_xaxes(range=[0, 118 if width == 1 else 150], tickvals=[0, 50, 100])
    for column in range(1, width + 1):
        last = (count - column) // width + 1  # a column may be one shorter
        figure.update_xaxes(title_text="residual explained (%)", row=last, col=column)
    return figure


def _next_admitted(result: Mapping[str, Any], group: Mapping[str, Any]) -> set[str]:
    for other in result_rounds(result):
        if other["round"] == group["round"] + 1:
            return set(other.get("admitted", ()))
    return set()


def _draw_candidate_bars(
    figure: Any, suggestions: Sequence[Mapping[str, Any]], admitted: set[str], row: int,
    column: int,
) -> None:  # fmt: skip
    aliases = {a for s in suggestions if s["effect"] in admitted for a in s.get("aliases", ())}
    kinds = (
        ("admitted", AFTER, lambda name: name in admitted),
        ("cannot be told from it", ORANGE, lambda name: name in aliases),
        ("other candidates", GREY, lambda name: name not in admitted | aliases),
    )
    suggestions = sorted(suggestions, key=_ranking_share, reverse=True)
    names = [label_words(s["effect"]) for s in suggestions][::-1]
    for name, colour, belongs in kinds:
        chosen = [s for s in suggestions if belongs(s["effect"])]
        if not chosen:
            continue
        figure.add_bar(
            y=[label_words(s["effect"]) for s in chosen],
            x=[100 * _ranking_share(s) for s in chosen],
            orientation="h",
            marker_color=colour,
            name=name,
            legendgroup=name,
            showlegend=name not in {t.name for t in figure.data},
            text=[f"p {_p_value_text(_larger_p_value(s))}" for s in chosen],
            textposition="outside",
            hovertext=[s["meaning"] for s in chosen],
            cliponaxis=False,
            row=row,
            col=column,
        )
    figure.update_yaxes(categoryorder="array", categoryarray=names, showgrid=False, row=row,
                        col=column)  # fmt: skip


def _ranking_share(suggestion: Mapping[str, Any]) -> float:
    """The share explained that orders candidates, net of the number of parameters where known."""
    net = suggestion.get("net")
    return max(suggestion["explains"] if net is None else net, 0.0)


def _larger_p_value(suggestion: Mapping[str, Any]) -> float:
    """The larger of the classical p-value and the robust one, where there is one."""
    return max(suggestion["p_value"] or 0.0, suggestion.get("wald_p_value") or 0.0)


def _p_value_text(value: float) -> str:
    if value < 1e-99:
        return "< 1e-99"
    return f"= {value:.2f}" if value >= 0.01 else f"= {value:.0e}"


def _is_curve_coefficient(row: Mapping[str, Any]) -> bool:
    spline = re.fullmatch(r"c\d+(_\w+)?", row["parameter"])
    return row["effect"].startswith("learned_") and spline is not None


def coefficients(table: Sequence[Mapping[str, Any]]) -> go.Figure | None:
    """Every fitted coefficient over its own estimate, with its 95 % interval.

    Those of a curve say nothing one by one; the curve itself is drawn with its band.
    """
    known = [r for r in table if r.get("se") and r.get("estimate") and not _is_curve_coefficient(r)]
    if not known:
        return None
    names = [label_words(f"{r['effect']}, {r['parameter']}") for r in known][::-1]
    spans = [196 * abs(r["se"] / r["estimate"]) for r in known][::-1]
    clear = [span < 100 for span in spans]
    figure = blank_figure(height=110 + 30 * len(known))
    for keep, colour, name in ((True, BLUE, "95 % interval"), (False, VERMILION, "holds zero")):
        at = [i for i, c in enumerate(clear) if c is keep]
        if at:
            figure.add_scatter(
                x=[0.0] * len(at), y=[names[i] for i in at], mode="markers", name=name,
                error_x={"array": [min(spans[i], 400) for i in at], "thickness": 2.5, "width": 5},
                marker={"color": colour, "size": 9},
            )  # fmt: skip
    figure.add_vline(-100, line={"color": BEFORE, "dash": "dot", "width": 1})
    wide = min(max(spans) * 1.15, 420)
    figure.update_xaxes(title_text="deviation from the estimate (%); zero lies at -100 %",
                        range=[-wide, wide])  # fmt: skip
    figure.update_yaxes(categoryorder="array", categoryarray=names)
    figure.update_layout(margin={"l": 260})
    return figure
