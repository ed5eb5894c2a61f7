"""Figures in a narrow window: pictures side by side come to stand one below the other."""

from __future__ import annotations

import copy
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from textwrap import wrap
from typing import Any

from nicegui import app, ui

_KEY = "narrow"  # the event, and what the storage of a tab of the browser keeps of it
_TITLE, _TITLE_FONT = 34, 13  # letters of a line of a horizontal axis' title, and their size
_GAP = 84  # pixels between two pictures, with ticks and title of the upper one's axis
_TOP, _BOTTOM = 46, 56  # pixels of the margins where a figure says nothing
_AXIS = re.compile(r"[xy]axis\d*")
_WATCH = """const narrow = matchMedia('(max-width: 600px)');
narrow.addEventListener('change', () => emitEvent('narrow', narrow.matches));
if (narrow.matches) emitEvent('narrow', true);"""


def watch_width(draw_anew: Callable[[], None]) -> None:
    """Have the browser tell whether its window is narrow; ``draw_anew`` when that has changed."""

    def on_change(event: Any) -> None:
        if bool(event.args) != is_narrow():
            app.storage.client[_KEY] = bool(event.args)
            draw_anew()

    ui.on(_KEY, on_change)
    ui.run_javascript(_WATCH)


def is_narrow() -> bool:
    """Whether the window of the tab that is drawn is narrow."""
    return bool(app.storage.client.get(_KEY, False))


@dataclass(frozen=True)
class _Block:
    """Pictures that stay together: of a column, from ``low`` to ``high`` of the figure's height.

    ``bottom`` are the pixels below them in the figure of one column.
    """

    column: int
    low: float
    high: float
    bottom: float = 0.0


def fit_narrow(data: Mapping[str, Any]) -> Mapping[str, Any]:
    """A figure for a narrow window: one column of pictures, titles of axes small and wrapped."""
    figure = copy.deepcopy(dict(data))
    for name, axis in figure["layout"].items():
        title = (axis.get("title") or {}).get("text") if _AXIS.fullmatch(name) else None
        if title:
            axis["title"].setdefault("font", {})["size"] = _TITLE_FONT
            lines = wrap(title, _TITLE, break_long_words=False)
            axis["title"]["text"] = "<br>".join(lines) if name[0] == "x" else title
    return stack_columns(figure)


def stack_columns(data: Mapping[str, Any]) -> Mapping[str, Any]:
    """A figure whose pictures stand one below the other, each as wide as the figure.

    Pictures of a column that share their horizontal axis stay together. A figure of one column is
    returned as it is.
    """
    starts = _column_starts(data["layout"])
    if len(starts) < 2:
        return data
    figure = copy.deepcopy(dict(data))
    layout = figure["layout"]
    margin = layout.get("margin") or {}
    around = margin.get("t", _TOP) + margin.get("b", _BOTTOM)
    inner = layout["height"] - around
    blocks, whole = _stack_blocks(_blocks_by_axis(layout, starts), inner)

    def moved(share: float, block: _Block) -> float:
        return (block.bottom + (share - block.low) * inner) / whole

    _move_annotations(layout, starts, list(blocks.values()), moved)
    for name, block in blocks.items():
        axis = layout[name]
        if name[0] == "x":
            axis["domain"] = [0.0, 1.0]
        else:
            axis["domain"] = [moved(share, block) for share in axis["domain"]]
            _label_alone(layout, axis)
    for trace in figure["data"]:
        if "colorbar" in trace:
            block = blocks["yaxis" + (trace.get("yaxis") or "y")[1:]]
            middle, share = (block.low + block.high) / 2, (block.high - block.low) * inner / whole
            trace["colorbar"] |= {"y": moved(middle, block), "len": share}
    if "y" in (layout.get("legend") or {}):
        layout["legend"]["y"] = 1 + (layout["legend"]["y"] - 1) * inner / whole
    layout["height"] = whole + around
    return figure


def _column_starts(layout: Mapping[str, Any]) -> list[float]:
    """Where columns of pictures begin, as shares of the width, from the left."""
    return sorted({_start(axis) for name, axis in layout.items() if _is_placed(name, axis)})


def _is_placed(name: str, axis: Any) -> bool:
    """Whether an entry of a layout is a horizontal axis that has a place of its own."""
    return bool(_AXIS.fullmatch(name)) and name[0] == "x" and bool(axis.get("domain"))


def _start(axis: Mapping[str, Any]) -> float:
    return round(axis["domain"][0], 6)


def _blocks_by_axis(layout: Mapping[str, Any], starts: list[float]) -> dict[str, _Block]:
    """The block of every axis by its name in the layout: its picture, or all of its column."""
    across = {name: axis for name, axis in layout.items() if _is_placed(name, axis)}
    linked = any(axis.get("matches") for axis in across.values())
    blocks = {}
    for name, axis in across.items():
        upright = "yaxis" + (axis.get("anchor") or "y")[1:]
        ends = (0.0, 1.0) if linked else layout[upright]["domain"]
        blocks[name] = blocks[upright] = _Block(starts.index(_start(axis)), *ends)
    return blocks


def _stack_blocks(blocks: Mapping[str, _Block], inner: float) -> tuple[dict[str, _Block], float]:
    """The blocks one below the other, rows first, and the pixels that they take together."""
    bottoms: dict[_Block, float] = {}
    whole = -float(_GAP)
    for block in sorted(set(blocks.values()), key=lambda b: (b.high, -b.column)):
        bottoms[block] = whole + _GAP
        whole = bottoms[block] + (block.high - block.low) * inner
    placed = {name: replace(block, bottom=bottoms[block]) for name, block in blocks.items()}
    return placed, whole


def _move_annotations(
    layout: Mapping[str, Any], starts: list[float], blocks: list[_Block],
    moved: Callable[[float, _Block], float],
) -> None:  # fmt: skip
    """Move titles of pictures, which are placed by shares of the figure, with their pictures."""
    for one in layout.get("annotations") or ():
        if (one.get("xref"), one.get("yref")) != ("paper", "paper"):
            continue
        column = sum(start <= one["x"] for start in starts) - 1
        near = min((b for b in blocks if b.column == column), key=lambda b: abs(b.high - one["y"]))
        one |= {"x": 0.5, "y": moved(one["y"], near)}


def _label_alone(layout: Mapping[str, Any], axis: dict[str, Any]) -> None:
    """Give an axis the numbers and the title that it shared with the one to its left."""
    shared = layout.get(f"yaxis{(axis.get('matches') or 'y')[1:]}") if axis.get("matches") else None
    if shared is not None:
        axis["showticklabels"] = True
        axis.setdefault("title", copy.deepcopy(shared.get("title") or {}))
