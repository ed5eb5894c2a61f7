"""A sketch of a model as SVG: what is recorded, the states, and where effects act.

Three columns: inputs and sensors, states, places with their effects. It takes the colours of the
page that it stands in, and those of the report elsewhere.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from typing import Any

from spiral.types.label import name_of
from spiral.view.report.style import FONT, label_words, typeset_unit

_WIDTH, _MARGIN, _GAP = 940.0, 8.0, 12.0
_LEFT, _MIDDLE, _RIGHT = (8.0, 205.0), (320.0, 168.0), (590.0, 342.0)  # x and width of columns
_LINE, _NODE = 19.0, 46.0
_MOST = 30  # links; more are described in words and not drawn
_INK, _SOFT, _PAPER = "var(--ink,#222)", "var(--soft,#59616b)", "var(--paper,#fff)"
_EDGE, _ADDED, _FILL = "var(--edge,#767f8a)", "var(--chip-edge,#3b8fc4)", "var(--chip,#e5f1f9)"
_ADDED_INK = "var(--chip-ink,#004b76)"


@dataclass
class _Box:
    """A box of one column: lines of text, its top, and the middle that it should be near."""

    key: tuple[str, str]
    lines: list[tuple[str, str]]
    wish: float = 0.0
    top: float = 0.0
    dashed: bool = False
    double: bool = False

    @property
    def height(self) -> float:
        return max(_NODE if self.key[0] == "node" else 30.0, _LINE * len(self.lines) + 12)

    @property
    def middle(self) -> float:
        return self.top + self.height / 2


def sketch(graph: Mapping[str, Any], name: str = "sketch") -> str:
    """The graph of a model (``couplings_of``, as plain data) as SVG; ``name`` is unique on a page.

    Nothing is moved by chance: the same model gives the same picture.
    """
    states = [_Box(("node", n["name"]), _node_lines(n), dashed=not n["measured"])
              for n in graph["nodes"]]  # fmt: skip
    recorded, acting = _input_and_sensor_boxes(graph), _place_boxes(graph)
    total = max(_total_height(states), _total_height(recorded), _total_height(acting))
    step = total / max(len(states), 1)
    for i, box in enumerate(states):
        box.top = _MARGIN + step * (i + 0.5) - box.height / 2
    places = {b.key[1]: b for b in states}
    for box, touched in _boxes_with_states(graph, recorded + acting):
        middles = [places[n].middle for n in touched if n in places]
        box.wish = sum(middles) / len(middles) if middles else _MARGIN + total / 2
    for column in (recorded, acting):
        _stack_boxes(column, total)
    parts = [*_connection_paths(graph, places, recorded, acting)]
    for boxes, (x, width) in ((recorded, _LEFT), (states, _MIDDLE), (acting, _RIGHT)):
        parts += [_box_svg(box, x, width) for box in boxes]
    return _svg_document(graph, parts, total + 2 * _MARGIN, name)


def _svg_document(graph: Mapping[str, Any], parts: Sequence[str], height: float, name: str) -> str:
    """The picture with its name, what it says in words, and the tip of its arrows."""
    said = escape(" ".join(describe_sketch(graph)))
    title = escape(f"Sketch of {label_words(graph['title'])}")
    tip = (
        f'<marker id="{name}-tip" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="9" '
        'markerHeight="9" markerUnits="userSpaceOnUse" orient="auto-start-reverse">'
        f'<path d="M0 0L8 4L0 8z" style="fill:{_EDGE}"/></marker>'
    )
    return (
        f'<svg class="sketch" role="img" aria-labelledby="{name}-title {name}-said" '
        f'viewBox="0 0 {_WIDTH:g} {height:g}" xmlns="http://www.w3.org/2000/svg" '
        f'style="width:100%;min-width:720px;max-width:{_WIDTH:g}px;font-family:{FONT}">'
        f'<title id="{name}-title">{title}</title><desc id="{name}-said">{said}</desc>'
        f"<defs>{tip}</defs>{''.join(parts)}</svg>"
    ).replace("#TIP", f"#{name}-tip")


def sketch_figure(graph: Any) -> str:
    """The sketch of a saved graph as an HTML figure; empty where the graph cannot be drawn."""
    try:
        return f"<figure class='wide'>{sketch(graph)}</figure>"
    except (KeyError, TypeError, ValueError, AttributeError):
        return ""


def describe_sketch(graph: Mapping[str, Any]) -> list[str]:
    """The sketch in sentences."""
    readings = graph.get("readings", ())  # a run that was saved before has none
    behind = {n for r in readings for n in r["touches"]}
    seen = [n["name"] for n in graph["nodes"] if n["measured"]]
    hidden = [n["name"] for n in graph["nodes"] if not n["measured"] and n["name"] not in behind]
    said = [f"Measured: {_join_names(seen)}."] if seen else []
    said += [f"The sensor {label_words(r['name'])} tells of {_join_names(r['touches'])}."
             for r in readings if r["touches"]]  # fmt: skip
    said += [f"Hidden, seen by no sensor: {_join_names(hidden)}."] if hidden else []
    said += [_describe_input(graph, feed) for feed in graph["inputs"]]
    links = graph["links"]
    if len(links) > _MOST:
        said.append(f"{len(links)} pairs are coupled by the system's own equations: not drawn.")
    elif links:
        pairs = [f"{label_words(k['target'])} {'with' if k['mutual'] else 'follows'} "
                 f"{label_words(k['source'])}" for k in links]  # fmt: skip
        said.append(f"Coupled by the system's own equations: {'; '.join(pairs)}.")
    shown = _visible_places(graph)
    said += [_describe_place(p) for p in shown if p["effects"]]
    free = [p["name"] for p in shown if not p["effects"]]
    said += [f"Ports without an effect yet: {_join_names(free)}."] if free else []
    left = len(graph["places"]) - len(shown)
    if left:
        said.append(f"{left} further ports, between two states each, have none.")
    return said


def _describe_input(graph: Mapping[str, Any], feed: Mapping[str, Any]) -> str:
    effects = [e for p in graph["places"] for e in p["effects"]]
    readers = [
        _effect_name(e) for e in effects if {feed["name"], f"{feed['name']}_rate"} & {*e["reads"]}
    ]
    said = [f"acts on {_join_names(feed['into'])}"] if feed["into"] else []
    said += [f"is read by {_join_names(list(dict.fromkeys(readers)))}"] if readers else []
    return f"The input {label_words(feed['name'])} {' and '.join(said) or 'acts on nothing here'}."


def _describe_place(place: Mapping[str, Any]) -> str:
    where = f"{_PLACES[place['kind']]} {label_words(place['name'])}"
    if place["kind"] == "port":
        where += f" ({_join_names(place['touches'])})"
    acting = [f"{_effect_name(e)}{' (added)' if e['added'] else ''}" for e in place["effects"]]
    return f"{where}: {_join_names(acting)}."


def _effect_name(effect: Mapping[str, Any]) -> str:
    """An effect's name without its place."""
    return label_words(name_of(effect["label"]))


_PLACES = {
    "port": "At the port", "flow": "Flow of", "input": "On the", "sensor": "On the",
    "parameter": "Changing parameter, with what it follows:",
}  # fmt: skip


def _join_names(names: Sequence[str]) -> str:
    *first, last = [label_words(n) for n in names]
    return f"{', '.join(first)} and {last}" if first else last


def _node_lines(node: Mapping[str, Any]) -> list[tuple[str, str]]:
    unit = typeset_unit(node["unit"])
    kind = "coordinate" if node["coordinate"] else "state"
    seen = "measured" if node["measured"] else "hidden"
    return [(f"{label_words(node['name'])}{f' ({unit})' if unit else ''}", "head"),
            (f"{kind}, {seen}", "soft")]  # fmt: skip


def _input_and_sensor_boxes(graph: Mapping[str, Any]) -> list[_Box]:
    """Inputs, then sensors; an effect on either stands in its box."""
    acts = {(p["kind"], p["name"]): p for p in graph["places"]}
    readings = graph.get("readings", ())
    boxes = []
    for feed in graph["inputs"]:
        unit = typeset_unit(feed["unit"])
        lines = [(f"{label_words(feed['name'])}{f' ({unit})' if unit else ''}", "head"),
                 ("input", "soft")]  # fmt: skip
        place = acts.get(("input", f"input {feed['name']}"))
        boxes.append(_Box(("input", feed["name"]), lines + _effect_lines(place)))
    taken: set[str] = set()
    for place in graph["places"]:
        if place["kind"] == "sensor":
            told = [r["name"] for r in readings if r["name"] in place["channels"]]
            names = _join_names(told or place["touches"] or [place["name"]])
            lines = [(f"sensor {'' if told else 'of '}{names}", "head"), *_effect_lines(place)]
            boxes.append(_Box(("sensor", place["name"]), lines, double=True))
            taken |= {*told} or {*place["touches"]}
    for node in graph["nodes"]:
        if node["measured"] and node["name"] not in taken:
            lines = [(f"sensor of {label_words(node['name'])}", "head")]
            boxes.append(_Box(("sensor of", node["name"]), lines, double=True))
    for reading in (r for r in readings if r["name"] not in taken):
        unit = typeset_unit(reading["unit"])
        head = f"{label_words(reading['name'])}{f' ({unit})' if unit else ''}"
        lines = [(head, "head"), ("sensor", "soft")]
        boxes.append(_Box(("reading", reading["name"]), lines, double=True))
    return boxes


def _place_boxes(graph: Mapping[str, Any]) -> list[_Box]:
    """Ports and flows with their effects; a port without any is a place where one may act."""
    boxes = []
    for place in _visible_places(graph):
        if place["kind"] in ("port", "flow"):
            kind = "port" if place["kind"] == "port" else "flow of"
            empty = "" if place["effects"] else ": no effect yet"
            lines = [(f"{kind} {label_words(place['name'])}{empty}", "soft" if empty else "head")]
            lines += _effect_lines(place)
            boxes.append(_Box((place["kind"], place["name"]), lines, dashed=bool(empty)))
    return boxes


def _visible_places(graph: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """Places that are drawn: all, or without empty ones between two states where these are many."""
    many = len(graph["places"]) > 2 * len(graph["nodes"]) + 2
    return [p for p in graph["places"] if p["effects"] or not (many and len(p["touches"]) > 1)]


def _effect_lines(place: Mapping[str, Any] | None) -> list[tuple[str, str]]:
    lines = []
    for effect in place["effects"] if place else ():
        more = f" (reads {_join_names(effect['reads'])})" if effect["reads"] else ""
        lines.append((f"{_effect_name(effect)}{more}", "added" if effect["added"] else "effect"))
        hidden = len(effect["own"])
        if hidden:
            lines.append((f"has {hidden} hidden states" if hidden > 1 else "has a hidden state",
                          "soft"))  # fmt: skip
    return lines


def _boxes_with_states(
    graph: Mapping[str, Any], boxes: Sequence[_Box]
) -> list[tuple[_Box, Sequence[str]]]:
    """Each box with the states that it should stand beside."""
    into = {("input", f["name"]): f["into"] for f in graph["inputs"]}
    into |= {(p["kind"], p["name"]): p["touches"] for p in graph["places"] if p["kind"] != "input"}
    into |= {("reading", r["name"]): r["touches"] for r in graph.get("readings", ())}
    return [(b, into.get(b.key, (b.key[1],))) for b in boxes]


def _total_height(boxes: Sequence[_Box]) -> float:
    return sum(b.height + _GAP for b in boxes)


def _stack_boxes(boxes: list[_Box], total: float) -> None:
    """Place boxes near their wished middles without overlap, all within the column."""
    boxes.sort(key=lambda b: b.wish)
    end = _MARGIN
    for box in boxes:
        box.top = max(end, box.wish - box.height / 2)
        end = box.top + box.height + _GAP
    end = _MARGIN + total
    for box in reversed(boxes):
        box.top = min(box.top, end - box.height)
        end = box.top - _GAP


def _connection_paths(
    graph: Mapping[str, Any],
    states: Mapping[str, _Box],
    recorded: Sequence[_Box],
    acting: Sequence[_Box],
) -> list[str]:
    """Connections: arrows in from inputs, out to sensors; couplings; effects at their places."""
    left, right = _MIDDLE[0], _MIDDLE[0] + _MIDDLE[1]
    edge = _LEFT[0] + _LEFT[1]
    paths = []
    for box, touched in _boxes_with_states(graph, recorded):
        for name in (n for n in touched if n in states):
            if box.key[0] == "input":
                ends = (edge, box.middle, left, states[name].middle - 7)
            else:
                ends = (left, states[name].middle + 7, edge, box.middle)
            paths.append(_curve_path(*ends, tip=True))
    if len(graph["links"]) <= _MOST:
        paths += [_coupling_path(k, states, right) for k in graph["links"]]
    for box, touched in _boxes_with_states(graph, acting):
        paths += [
            _curve_path(right, states[n].middle, _RIGHT[0], box.middle)
            for n in touched
            if n in states
        ]
    return paths


def _curve_path(x: float, y: float, to_x: float, to_y: float, tip: bool = False) -> str:
    bend = (x + to_x) / 2
    end = ' marker-end="url(#TIP)"' if tip else ""
    return (
        f'<path d="M{x:g} {y:g}C{bend:g} {y:g} {bend:g} {to_y:g} {to_x:g} {to_y:g}"{end} '
        f'style="fill:none;stroke:{_EDGE};stroke-width:1.4"/>'
    )


def _coupling_path(link: Mapping[str, Any], states: Mapping[str, _Box], x: float) -> str:
    """An arc beside the states from the source to the target, with a tip at each that follows."""
    a, b = (states[link[end]] for end in ("source", "target"))
    down = 1 if b.top > a.top else -1
    y, to_y = a.middle + 9 * down, b.middle - 9 * down
    out = x + 24 + min(0.14 * abs(to_y - y), 52)
    start = 'marker-start="url(#TIP)" ' if link["mutual"] else ""
    return (
        f'<path d="M{x:g} {y:g}C{out:g} {y:g} {out:g} {to_y:g} {x:g} {to_y:g}" '
        f'{start}marker-end="url(#TIP)" style="fill:none;stroke:{_EDGE};stroke-width:2.4"/>'
    )


def _box_svg(box: _Box, x: float, width: float) -> str:
    """A box with its text; what was added stands out in weight and colour, and has a plus."""
    dash = ";stroke-dasharray:5 4" if box.dashed else ""
    frame = f"fill:{_PAPER};stroke:{_EDGE};stroke-width:1.4{dash}"
    round_ = 14 if box.key[0] == "node" else 5
    parts = [_rectangle_svg(x, box.top, width, box.height, round_, frame)]
    if box.double:
        parts.append(_rectangle_svg(x + 3, box.top + 3, width - 6, box.height - 6, 3,
                           f"fill:none;stroke:{_EDGE};stroke-width:0.8"))  # fmt: skip
    centre = box.key[0] == "node"
    at, anchor = (x + width / 2, "middle") if centre else (x + 12, "start")
    first = box.middle - _LINE * (len(box.lines) - 1) / 2 + 4.5
    for i, (text, kind) in enumerate(box.lines):
        y = first + _LINE * i
        if kind == "added":
            parts.append(_rectangle_svg(x + 6, y - 14, width - 12, _LINE - 1, 8,
                               f"fill:{_FILL};stroke:{_ADDED};stroke-width:1"))  # fmt: skip
            text = f"+ {text}"
        letters = int((width - 22) / _LETTER[kind])
        short = text if len(text) <= letters else f"{text[: letters - 1]}…"
        parts.append(
            f'<text x="{at:g}" y="{y:g}" text-anchor="{anchor}" style="{_STYLES[kind]}">'
            f"{escape(short)}</text>"
        )
    return "".join(parts)


_LETTER = {"head": 8.0, "soft": 6.5, "effect": 6.8, "added": 7.8}  # width of a letter, at most
_STYLES = {
    "head": f"font-size:14px;font-weight:650;fill:{_INK}",
    "soft": f"font-size:12.5px;fill:{_SOFT}",
    "effect": f"font-size:13px;fill:{_INK}",
    "added": f"font-size:13px;font-weight:650;fill:{_ADDED_INK}",
}


def _rectangle_svg(
    x: float, y: float, width: float, height: float, radius: float, style: str
) -> str:
    return (
        f'<rect x="{x:g}" y="{y:g}" width="{width:g}" height="{height:g}" rx="{radius:g}" '
        f'style="{style}"/>'
    )
