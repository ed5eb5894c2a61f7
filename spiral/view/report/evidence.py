"""Figures of a run's history: the error falling, evidence per candidate, coefficients."""

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
    blank,
    decades,
    words,
)

if TYPE_CHECKING:
    import plotly.graph_objects as go

_FEW, _LABELS = 8, 5  # points of a curve that all have words beside them; else so many of them
_TICKS = 16
_LABEL = 16  # letters of a label's line
_LEAST = 1e-3  # percent, where an error of zero is drawn


def rounds(result: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """The rounds of a saved result; ``add`` has two, ``compare`` and ``diagnose`` one."""
    if result.get("rounds"):
        return list(result["rounds"])
    only = result.get("comparison") or result
    return [{"round": 0, "admitted": [], **only}] if "test_error" in only else []


def error_falling(result: Mapping[str, Any], least: int = 2) -> go.Figure | None:
    """Fit and test error by round, the noise floor below them, the effect admitted at each step.

    Nothing for a history shorter than ``least`` rounds.
    """
    found = rounds(result)
    if len(found) < least or not _known(found):
        return None
    figure = blank(height=430)
    numbers = [r["round"] for r in found]
    names = [_admitted(r) for r in found]
    for key, name, colour, dash in (
        ("fit_error", "fit error", SKY, "dot"),
        ("test_error", "test error", BLUE, "solid"),
    ):
        values = [_percent(r.get(key)) for r in found]
        figure.add_scatter(
            x=numbers, y=values, name=name, mode="lines+markers", customdata=names,
            line={"color": colour, "width": 3, "shape": "hv", "dash": dash}, marker={"size": 10},
            hovertemplate="%{customdata}<br>%{y:.3g} %",
        )  # fmt: skip
    told = _told([_percent(r.get("test_error")) for r in found])
    for index in told:
        number, name, r = numbers[index], names[index], found[index]
        value = _percent(r.get("test_error"))
        at = {"y": 1, "yref": "paper", "yanchor": "top", "font": {"size": 13, "color": VERMILION}}
        if value is not None:
            at = {"y": math.log10(value), "yanchor": "bottom", "yshift": 5, "font": {"size": 13}}
        said = "↑ not finite" if value is None else percent(r["test_error"])
        figure.add_annotation(x=number, text=f"<b>{said}</b><br>{name}", align="left",
                              showarrow=False, xanchor="left", xshift=7, **at)  # fmt: skip
    _floor_and_axes(figure, found, result.get("noise_floor"))
    return figure


def _told(values: Sequence[float | None]) -> list[int]:
    """Which points of a curve have room for their words: all of a few, else where most happens.

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
    apart = len(values) / (_LABELS + 1)  # so that the words of two do not meet
    for i in order:
        if len(chosen) < _LABELS and min(abs(i - c) for c in chosen) >= apart and size[i - 1] > 0:
            chosen.append(i)
    return sorted(chosen)


def _floor_and_axes(figure: Any, found: Sequence[Mapping[str, Any]], share: float | None) -> None:
    floor = _percent(share)
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
    numbers = [r["round"] for r in found]
    ticks = numbers[:: math.ceil(len(numbers) / _TICKS)]
    figure.update_xaxes(title_text="round", tickmode="array", tickvals=ticks,
                        range=[-0.15, numbers[-1] + max(0.8, 0.28 * numbers[-1])])  # fmt: skip
    values = _known(found)
    low, high = min([*values, floor or math.inf]), max(values)
    bottom, top = math.log10(low) - 0.25, math.log10(high)
    span = [bottom, top + max(0.45, 0.2 * (top - bottom))]  # room for the labels of the highest
    figure.update_yaxes(title_text="free-run error (% of the deviation)", type="log",
                        range=span, **decades(*span),
                        minor={"showgrid": True, "gridcolor": "rgba(0,0,0,0.047)"})  # fmt: skip


def _known(found: Sequence[Mapping[str, Any]]) -> list[float]:
    """All errors that are finite, in percent."""
    return [v for r in found for k in ("fit_error", "test_error") if (v := _percent(r.get(k)))]


def _admitted(found: Mapping[str, Any]) -> str:
    names = [words(name) for name in found.get("admitted") or ()]
    gone = [words(name) for name in found.get("retired") or ()]
    let_go = "".join(f"<br>\N{MINUS SIGN} {_wrapped(name)}" for name in gone)
    return "+ " + ",<br>".join(map(_wrapped, names)) + let_go if names else "the seed"


def _wrapped(name: str) -> str:
    """A long name on two lines."""
    return "<br>".join(wrap(name, _LABEL, break_long_words=False))


def _percent(value: Any) -> float | None:
    return None if value is None else max(100 * float(value), _LEAST)


def candidates(result: Mapping[str, Any]) -> go.Figure | None:
    """What each candidate explains of the residual, round by round, alias groups marked."""
    groups = [r for r in rounds(result) if r.get("suggestions")]
    if not groups and result.get("suggestions"):
        groups = [{"round": 0, "suggestions": result["suggestions"]}]
    if not groups:
        return None
    count = len(groups)
    rows = max(len(g["suggestions"]) for g in groups)
    titles = [f"round {g['round']}" for g in groups]
    width = min(count, 2)
    lines = math.ceil(count / width)
    figure = blank(lines, width, 110 + lines * (70 + 34 * rows), subplot_titles=titles,
                   horizontal_spacing=0.3, vertical_spacing=0.3 / lines)  # fmt: skip
    for index, group in enumerate(groups):
        admitted = _next_admitted(result, group)
        _bars(figure, group["suggestions"], admitted, index // width + 1, index % width + 1)
    figure.update_layout(margin={"l": 170, "t": 78}, showlegend=True, barmode="overlay",
                         legend={"y": 1 + 34 / figure.layout.height})  # fmt: skip
    figure.update_xaxes(range=[0, 118 if width == 1 else 150], tickvals=[0, 50, 100])
    for column in range(1, width + 1):
        last = (count - column) // width + 1  # a column may be one shorter
        figure.update_xaxes(title_text="residual explained (%)", row=last, col=column)
    return figure


def _next_admitted(result: Mapping[str, Any], group: Mapping[str, Any]) -> set[str]:
    for other in rounds(result):
        if other["round"] == group["round"] + 1:
            return set(other.get("admitted", ()))
    return set()


def _bars(
    figure: Any, suggestions: Sequence[Mapping[str, Any]], admitted: set[str], row: int,
    column: int,
) -> None:  # fmt: skip
    aliases = {a for s in suggestions if s["effect"] in admitted for a in s.get("aliases", ())}
    kinds = (
        ("admitted", AFTER, lambda name: name in admitted),
        ("cannot be told from it", ORANGE, lambda name: name in aliases),
        ("other candidates", GREY, lambda name: name not in admitted | aliases),
    )
    suggestions = sorted(suggestions, key=_share, reverse=True)
    names = [words(s["effect"]) for s in suggestions][::-1]
    for name, colour, belongs in kinds:
        chosen = [s for s in suggestions if belongs(s["effect"])]
        if not chosen:
            continue
        figure.add_bar(
            y=[words(s["effect"]) for s in chosen], x=[100 * _share(s) for s in chosen],
            orientation="h", marker_color=colour, name=name, legendgroup=name,
            showlegend=name not in {t.name for t in figure.data},
            text=[f"p {_p(_worst(s))}" for s in chosen], textposition="outside",
            hovertext=[s["meaning"] for s in chosen], cliponaxis=False, row=row, col=column,
        )  # fmt: skip
    figure.update_yaxes(categoryorder="array", categoryarray=names, showgrid=False, row=row,
                        col=column)  # fmt: skip


def _share(found: Mapping[str, Any]) -> float:
    """What orders candidates: the share explained, net of its parameters where that is known."""
    net = found.get("net")
    return max(found["explains"] if net is None else net, 0.0)


def _worst(found: Mapping[str, Any]) -> float:
    """The larger of the classical p-value and the robust one, where there is one."""
    return max(found["p_value"] or 0.0, found.get("wald_p_value") or 0.0)


def _p(value: float) -> str:
    if value < 1e-99:
        return "< 1e-99"
    return f"= {value:.2f}" if value >= 0.01 else f"= {value:.0e}"


def _of_a_curve(row: Mapping[str, Any]) -> bool:
    spline = re.fullmatch(r"c\d+(_\w+)?", row["parameter"])
    return row["effect"].startswith("learned_") and spline is not None


def coefficients(table: Sequence[Mapping[str, Any]]) -> go.Figure | None:
    """Every fitted coefficient over its own estimate, with its 95 % interval.

    Those of a curve say nothing one by one; the curve itself is drawn with its band.
    """
    known = [r for r in table if r.get("se") and r.get("estimate") and not _of_a_curve(r)]
    if not known:
        return None
    names = [words(f"{r['effect']}, {r['parameter']}") for r in known][::-1]
    spans = [196 * abs(r["se"] / r["estimate"]) for r in known][::-1]
    clear = [span < 100 for span in spans]
    figure = blank(height=110 + 30 * len(known))
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
