"""The view of a browser tab, encoded in its address: a link opens the same view.

``?turn=3&tab=Model&zoom=free_run.xaxis:8.1:9.2&beside=0,3``: the step, the tab of the figures, the
ranges of zoomed axes, and the steps that are compared. Text of an address is checked like any
other input: what it names that is not there is left out.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from urllib.parse import quote

View = dict[str, float]
"""Ranges of a figure's axes as Plotly tells them: ``xaxis.range[0]`` and so on."""

_ZOOM = re.compile(r"([a-z_]{1,40})\.([xy]axis\d{0,2}):([-+.\de]{1,24}):([-+.\de]{1,24})")
_MOST = 60  # axes


@dataclass(frozen=True)
class Address:
    """The view that an address asks for; ``views`` by the name of the figure."""

    turn: int | None = None
    tab: str = ""
    views: Mapping[str, View] = field(default_factory=dict)
    beside: tuple[int, ...] = ()


def parse_address(turn: str = "", tab: str = "", zoom: str = "", beside: str = "") -> Address:
    """The view that the parts of an address ask for."""
    views: dict[str, View] = {}
    for part in zoom.split(",")[:_MOST]:
        match = _ZOOM.fullmatch(part)
        ends = _finite_numbers(match[3], match[4]) if match else ()
        if match and ends:
            view = views.setdefault(match[1], {})
            view |= {f"{match[2]}.range[{i}]": end for i, end in enumerate(ends)}
    serials = tuple(int(s) for s in beside.split(",") if s.isdecimal() and len(s) < 7)
    known = int(turn) if turn.isdecimal() and len(turn) < 7 else None
    return Address(known, tab, views, serials)


def format_address(at: Address) -> str:
    """The part of an address after the name of the study."""
    parts = [] if at.turn is None else [f"turn={at.turn}"]
    if at.tab:
        parts.append(f"tab={quote(at.tab)}")
    zooms = [z for name, view in at.views.items() for z in _format_zooms(name, view)]
    if zooms:
        parts.append("zoom=" + ",".join(zooms))
    if at.beside:
        parts.append("beside=" + ",".join(map(str, at.beside)))
    return "?" + "&".join(parts)


def _format_zooms(name: str, view: Mapping[str, float]) -> Iterable[str]:
    for axis in dict.fromkeys(key.partition(".")[0] for key in view):
        ends = [view.get(f"{axis}.range[{i}]") for i in (0, 1)]
        if all(isinstance(end, int | float) for end in ends):
            yield f"{name}.{axis}:{ends[0]:.7g}:{ends[1]:.7g}"


def _finite_numbers(*texts: str) -> tuple[float, ...]:
    """The texts as numbers; empty where one is not a finite number."""
    try:
        values = tuple(map(float, texts))
    except ValueError:
        return ()
    return values if all(map(math.isfinite, values)) else ()
