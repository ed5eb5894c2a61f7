"""One look for all figures: colours that the colour-blind tell apart, units, thinning.

The palette is that of Okabe and Ito (2008).
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any

import numpy as np

Array = np.ndarray

BLACK, ORANGE, SKY, GREEN = "#222222", "#E69F00", "#56B4E9", "#009E73"
BLUE, VERMILION, PURPLE, GREY = "#0072B2", "#D55E00", "#CC79A7", "#8A8A8A"
CYCLE = (BLUE, VERMILION, GREEN, PURPLE, ORANGE, SKY, BLACK)
MEASURED, BEFORE, AFTER = BLACK, VERMILION, BLUE
MAP = "Cividis"
RPM = 30 / np.pi
POINTS = 3000  # of a curve that is drawn
FONT = "system-ui, 'Segoe UI', Roboto, 'Helvetica Neue', Arial, sans-serif"

_PREFIXES = ((1e-12, "p"), (1e-9, "n"), (1e-6, "µ"), (1e-3, "m"), (1.0, ""), (1e3, "k"), (1e6, "M"))
_PREFIXED = ("m", "N", "V", "A", "Pa", "rad", "g", "W")
_SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def scale_to_prefix(unit: str, *values: Array) -> tuple[float, str]:
    """A factor and the unit that goes with it, so that numbers are neither tiny nor huge.

    A length of 5e-5 m is drawn as 50 µm: (1e6, "µm"). Units that take no prefix stay.
    """
    finite = [v[np.isfinite(v)] for v in map(np.asarray, values)]
    largest = max((float(np.abs(v).max()) for v in finite if v.size), default=0.0)
    first, rest = re.match(r"([A-Za-zµ]*)(.*)", unit).groups()  # type: ignore[union-attr]
    if first not in _PREFIXED or not largest:
        return 1.0, typeset_unit(unit)
    size, prefix = next((p for p in reversed(_PREFIXES) if largest >= p[0]), _PREFIXES[0])
    return 1.0 / size, typeset_unit(f"{prefix}{first}{rest}")


def have_one_unit(channels: Sequence[Mapping[str, Any]]) -> bool:
    """Whether all channels are in one unit, so that their readings can be put together."""
    return len({c["unit"] for c in channels}) == 1


def typeset_unit(unit: str) -> str:
    """``m/s^2`` as ``m/s²``; nothing for a pure number."""
    text = re.sub(r"\^(-?\d+)", lambda m: m.group(1).translate(_SUPERSCRIPT), unit)
    return "" if text == "1" else text.replace("*", "·")


_SYMBOLS = {
    "W": "Ω", "theta": "θ", "tau": "τ", "alpha": "\N{GREEK SMALL LETTER ALPHA}", "beta": "β",
    "xi": "ξ", "pi": "π",
}  # fmt: skip


_PROPER = {
    "bouc wen": "Bouc-Wen", "coulomb": "Coulomb", "fmu": "FMU", "iwan": "Iwan",
    "jenkins": "Jenkins", "lugre": "LuGre", "rk4": "RK4", "silverbox": "Silverbox",
    "stribeck": "Stribeck",
}  # fmt: skip
"""Names of people and of makes among the words of labels, as they are written."""
_PROPER_WORDS = re.compile(rf"\b({'|'.join(_PROPER)})\b")


def label_words(label: str) -> str:
    """``cross_stiffness@bearing_2`` as ``cross stiffness at bearing 2``; names as written."""
    words = label.replace("@", " at ").replace("_", " ")
    return _PROPER_WORDS.sub(lambda m: _PROPER[m.group()], words)


def label_title(label: str) -> str:
    """``cross_stiffness`` as ``Cross stiffness``: what a sentence begins with."""
    words = label_words(label)
    return words[:1].upper() + words[1:]


def typeset_formula(meaning: str) -> str:
    """A meaning with its formula as one writes it: ``k W^2 q`` as ``k Ω² q``, with true minus."""
    text = meaning
    for plain, symbol in _SYMBOLS.items():
        text = re.sub(rf"(?<![A-Za-z]){plain}(?![A-Za-z])", symbol, text)
    minus = "\N{MINUS SIGN}"
    text = re.sub(r"(?<![\w)])-(?=[\w|(])| - ", lambda m: m.group().replace("-", minus), text)
    return typeset_unit(text).replace("·", "*").replace(")_+", ")₊")


def axis_title(name: str, unit: str) -> str:
    """An axis title: ``x (µm)``."""
    return f"{name} ({unit})" if unit else name


Span = tuple[float, float] | None
"""The visible range of an axis; all of it with ``None``."""


def thin_curve(x: Array, y: Array, points: int = POINTS, span: Span = None) -> tuple[Array, Array]:
    """At most ``points`` points that look like all: lowest and highest of each stretch, in order.

    x and y are (samples,). Peaks survive, whatever the length. Where a ``span`` of an increasing x
    is looked at, it has that many points to itself, and what lies outside a few.
    """
    if span is not None:
        first, last = np.searchsorted(x, span)
        first, last = max(first - 1, 0), min(last + 1, len(x))
        parts = ((slice(0, first), POINTS // 10), (slice(first, last), points),
                 (slice(last, len(x)), POINTS // 10))  # fmt: skip
        pieces = [thin_curve(x[part], y[part], most) for part, most in parts if len(x[part])]
        return tuple(map(np.concatenate, zip(*pieces, strict=True)))  # type: ignore[return-value]
    count = points // 2
    if len(y) <= points:
        return x, y
    edges = np.linspace(0, len(y), count + 1).astype(int)
    size = int(np.diff(edges).max())
    at = np.minimum(edges[:-1, None] + np.arange(size), edges[1:, None] - 1)
    block = np.where(np.isfinite(y), y, 0.0)[at]
    both = np.stack([at[np.arange(count), np.argmin(block, 1)],
                     at[np.arange(count), np.argmax(block, 1)]], 1)  # fmt: skip
    chosen = np.unique(np.concatenate([[0], both.ravel(), [len(y) - 1]]))
    return x[chosen], y[chosen]


def blank_figure(rows: int = 1, columns: int = 1, height: int = 420, **options: Any) -> Any:
    """An empty figure in the house look; ``options`` as of Plotly's ``make_subplots``."""
    from plotly.subplots import make_subplots

    figure = make_subplots(rows, columns, **options)
    figure.update_layout(template=_plotly_template(), height=height)
    return figure


@lru_cache(maxsize=1)
def _plotly_template() -> Any:
    """The house look as a template, which the browser applies: many times faster than by axis."""
    import plotly.graph_objects as go

    axis = {
        "showgrid": True, "gridcolor": "rgba(0,0,0,0.094)", "zeroline": False, "linecolor": "#555",
        "showline": True, "ticks": "outside", "tickcolor": "#555", "automargin": True,
        "title": {"standoff": 8},
    }  # fmt: skip
    legend = {"orientation": "h", "x": 0, "y": 1.0, "yanchor": "bottom", "font": {"size": 13}}
    look = {
        "font": {"family": FONT, "size": 14, "color": "#222"}, "colorway": CYCLE,
        "paper_bgcolor": "white", "plot_bgcolor": "white", "hovermode": "closest",
        "margin": {"l": 70, "r": 24, "t": 46, "b": 56}, "legend": legend,
        "xaxis": axis, "yaxis": axis,
    }  # fmt: skip
    return go.layout.Template(layout=look)


def decade_ticks(low: float, high: float) -> dict[str, Any]:
    """The ticks of a logarithmic axis: decades, or 1, 2, 5 where there are few; log10 of both.

    Those few are written out: Plotly writes 20 as 2 beside its decade, which may be out of view.
    """
    if high - low > 1.7:
        return {"dtick": 1}
    powers = range(math.floor(low), math.ceil(high))
    values = [m * 10.0**p for p in powers for m in (1, 2, 5)]
    return {"tickvals": values, "ticktext": [f"{v:g}" for v in values]}


def draw_line(
    figure: Any, x: Array, y: Array, name: str, colour: str, row: int = 1, column: int = 1,
    **more: Any,
) -> None:  # fmt: skip
    """A curve, thinned, or as it is within a ``span``; its name appears once in the legend."""
    import plotly.graph_objects as go

    span = more.pop("span", None)
    thin_x, thin_y = thin_curve(np.asarray(x), np.asarray(y), span=span)
    thin_x = thin_x.astype(np.float32) if span is None else thin_x  # neighbours stay apart
    style = {"color": colour, "width": more.pop("width", 1.4), "dash": more.pop("dash", None)}
    shown = more.pop("showlegend", name not in {t.name for t in figure.data})
    mode = more.pop("mode", "lines")
    trace = go.Scatter(
        x=thin_x, y=thin_y.astype(np.float32), name=name, mode=mode,
        line=style, legendgroup=name, showlegend=shown, **more,
    )  # fmt: skip
    figure.add_trace(trace, row=row, col=column)


def draw_band(
    figure: Any, x: Array, middle: Array, spread: Array, name: str, colour: str,
    row: int = 1, column: int = 1,
) -> None:  # fmt: skip
    """A curve with its 95 % band of 1.96 standard deviations, both of one name in the legend."""
    import plotly.graph_objects as go

    step = max(1, len(x) // POINTS)
    part = slice(None, None, step)
    low, high = (middle - 1.96 * spread)[part], (middle + 1.96 * spread)[part]
    outline = np.concatenate([x[part], x[part][::-1]])
    figure.add_trace(
        go.Scatter(
            x=outline.astype(np.float32),
            y=np.concatenate([high, low[::-1]]).astype(np.float32),
            fill="toself",
            fillcolor=transparent_colour(colour),
            line={"width": 0},
            hoverinfo="skip",
            name=f"{name}, 95 %",
            legendgroup=name,
            mode="lines",
            showlegend=False,
        ),
        row=row,
        col=column,
    )
    draw_line(figure, x, middle, name, colour, row, column)


def add_hover_text(figure: Any) -> Any:
    """The figure with hover texts: names and units of the axes, for every trace."""
    layout = figure.to_plotly_json()["layout"]
    for trace in figure.data:
        if trace.hovertemplate or trace.hoverinfo == "skip" or not hasattr(trace, "hovertemplate"):
            continue
        x, y = (_axis_label(layout, getattr(trace, f"{d}axis") or d, d) for d in "xy")
        lines = [f"<b>{trace.name}</b>"] if trace.name else []
        digits = ("", "") if trace.type == "bar" else (":.6g", ":.4g")  # a bar may have a name
        lines += [f"{x}: %{{x{digits[0]}}}", f"{y}: %{{y{digits[1]}}}"]
        if trace.type == "heatmap":
            lines.append(f"{trace.colorbar.title.text}: %{{z:.3g}}")
        trace.hovertemplate = "<br>".join(lines) + "<extra></extra>"
    return figure


def _axis_label(layout: Mapping[str, Any], name: str, letter: str) -> str:
    """The title of an axis, or of one linked with it; its letter where none has a title."""

    def axis_layout(axis: str) -> Mapping[str, Any]:
        return layout.get(f"{letter}axis{axis[1:]}") or {}

    group = axis_layout(name).get("matches") or name
    others = [f"{letter}{k.removeprefix(f'{letter}axis')}" for k in layout
              if k.startswith(f"{letter}axis")]  # fmt: skip
    alike = [a for a in others if group in (a, axis_layout(a).get("matches"))]
    titles = [(axis_layout(a).get("title") or {}).get("text") for a in (name, *alike)]
    label = next(filter(None, titles), letter)
    return re.sub(r"<[^>]*>|;.*", " ", label).strip()


def transparent_colour(colour: str, alpha: float = 0.28) -> str:
    """A hex colour made transparent, as ``rgba(...)``."""
    red, green, blue = (int(colour[i : i + 2], 16) for i in (1, 3, 5))
    return f"rgba({red},{green},{blue},{alpha})"


def decibels(power: Array) -> Array:
    """10 lg of a ratio of powers."""
    return 10 * np.log10(np.maximum(power, 1e-30))


def decibel_map(x: Array, y: Array, level: Array, top: float, title: str) -> Any:
    """A heat map of decibels, 40 dB below ``top`` and not below zero; level is (y, x)."""
    import plotly.graph_objects as go

    low = max(top - 40.0, 0.0)
    return go.Heatmap(
        x=x.astype(np.float32), y=y.astype(np.float32), zmin=low, zmax=top, colorscale=MAP,
        z=np.maximum(level, low).astype(np.float32),
        colorbar={"title": {"text": title, "side": "right"}, "thickness": 14, "x": 1.0},
    )  # fmt: skip
