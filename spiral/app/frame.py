"""What all pages share: the bar at the top, figures, messages, the command line's equivalent."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from html import escape
from pathlib import Path
from typing import Any

from nicegui import ui

from spiral.app import panels
from spiral.app.session import Scene, Session
from spiral.app.study import Study
from spiral.app.stylesheet import STYLE
from spiral.io.export.kinds import KINDS
from spiral.types.errors import SpiralError
from spiral.view.report import sketch
from spiral.view.report.mathfont import math_style
from spiral.view.report.pictures import browser
from spiral.view.report.style import BLUE
from spiral.view.terminal.shell import option_lines

_COPY = """(event) => navigator.clipboard.writeText(
  event.target.closest(".command").querySelector("code").textContent)"""
CLEAR = "rgba(0,0,0,0)"  # the card behind a figure shows, light or dark
_CONFIG = {
    "displaylogo": False, "responsive": True, "displayModeBar": "hover", "scrollZoom": False,
    "modeBarButtonsToRemove": ["lasso2d", "select2d", "autoScale2d"],
}  # fmt: skip


@contextmanager
def bar(crumb: str) -> Iterator[None]:
    """The bar at the top; what is built inside stands at its right."""
    ui.page_title(f"{crumb} - SPIRAL" if crumb else "SPIRAL")
    ui.add_css(STYLE + math_style())
    ui.colors(primary=BLUE, negative="#B23A00", positive="#007A5A")
    with ui.element("header").classes("bar"), ui.element("div").classes("bar-inner"):
        ui.link("SPIRAL", "/").classes("mark")
        if crumb:
            ui.html(f"<h1 class='crumb'>{escape(crumb)}</h1>", sanitize=False).classes("crumb")
        else:
            ui.element("div").classes("crumb")
        yield


@contextmanager
def progress_bar() -> Iterator[None]:
    """A strip under the bar that stays in sight."""
    strip = ui.element("div").classes("bar").style("top:57px;border:0;z-index:19")
    with strip, ui.element("div").classes("bar-inner").style("min-height:0"):
        yield


def drawn(data: Mapping[str, Any]) -> dict[str, Any]:
    """A figure that is as wide as its place, as the browser's Plotly takes it."""
    layout = {**data["layout"], "autosize": True, "uirevision": "kept",
              "paper_bgcolor": CLEAR, "plot_bgcolor": CLEAR,
              "modebar": {"bgcolor": CLEAR, "color": "#767f8a", "activecolor": BLUE}}  # fmt: skip
    layout.pop("width", None)
    return {"data": data["data"], "layout": layout, "config": _CONFIG}


def plot(data: Mapping[str, Any], name: str, said: str) -> ui.plotly:
    """A figure as wide as its place; ``said`` is what those hear who do not see it."""
    found = ui.plotly(drawn(data))
    found.style(f"width:100%;height:{float(data['layout']['height'])}px")
    found.props["id"] = f"plot-{name}"
    found.props["role"] = "figure"
    found.props["aria-label"] = said
    return found


def figure_of(file: Path) -> Mapping[str, Any] | None:
    """A figure from its file; nothing where there is none that can be drawn."""
    try:
        data = json.loads(file.read_text(encoding="utf-8"))
        return data if float(data["layout"]["height"]) and data["data"] is not None else None
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return None


def sketched(graph: Any) -> None:
    """The sketch of a model, and the same in words; it scrolls where the window is narrow."""
    drawn = sketch.figure(graph)
    if not drawn:
        return
    with ui.element("div").classes("sketched") as place:
        ui.html(drawn, sanitize=False).style("width:100%")
    place.props('tabindex="0" role="group" aria-label="Sketch of the model"')
    with ui.expansion("The sketch in words").classes("w-full"):
        items = "".join(f"<li>{escape(one)}</li>" for one in sketch.told(graph))
        ui.html(f"<ul class='soft'>{items}</ul>", sanitize=False)


def code(text: str) -> None:
    """Text as it is, with a button that copies it. No Markdown: a backtick in it means nothing."""
    with ui.element("div").classes("command"):
        ui.html(f"<pre><code>{escape(text)}</code></pre>", sanitize=False)
        copy = ui.button("Copy").props("flat dense")
        copy.on("click", js_handler=_COPY)


@contextmanager
def told(error: Mapping[str, str]) -> Iterator[None]:
    """A message that stays; what a person cancelled is no fault. Inside stands more of it."""
    cancelled = error.get("at") == "cancelled"
    with ui.element("div").classes("note" if cancelled else "trouble") as box:
        box.props["role"] = "status" if cancelled else "alert"
        ui.html(panels.trouble(error), sanitize=False)
        yield


def refused(error: SpiralError) -> None:
    """A message that passes."""
    found = error.as_dict()
    said = found["given"]
    for name, key in (("Expected", "expected"), ("Try", "try")):
        said += f". {name}: {found[key]}" if found.get(key) else ""
    ui.notify(said, type="warning", multi_line=True, position="top", close_button="Close")


def nothing_here(error: SpiralError) -> None:
    """A page for an address that names no study."""
    with bar("Nothing here"):
        pass
    with ui.element("div").classes("wrap"):
        with ui.element("div").classes("trouble"):
            ui.html(panels.trouble(error.as_dict()), sanitize=False)
        ui.link("All studies", "/").classes("quiet")


def local_plugins(session: Session) -> None:
    """The files that are run as local plugins, by name, and those that cannot be used."""
    files = session.local_plugins()
    if not files:
        return
    said = f"Runs local plugins: {', '.join(files)}. Started with --no-plugins it does without."
    ui.label(said).classes("soft local-plugins")
    place = ui.element("div").props('role="alert"')
    shown: list[tuple[str, ...]] = [()]

    def look() -> None:
        if session.broken == shown[0]:
            return
        shown[0] = session.broken
        place.clear()
        with place:
            for one in session.broken:
                ui.label(f"Not used: {one}").classes("trouble broken-plugin")

    look()
    ui.timer(0.5, look)


def command(study: Study) -> str:
    """What does the same from a terminal."""
    given = option_lines(study.overrides)
    if not study.added:
        return f"spiral diagnose{given}"
    return f"spiral add {' '.join(study.added)}{given}"


def links(session: Session, scene: Scene) -> None:
    """The saved run, MLflow's page of it, and the report to take away."""
    turn = scene.study.turn
    if turn is None or not turn.run_id:
        if turn is not None and turn.serial in scene.writing:
            ui.label("saving the run …").classes("soft")
        elif turn is not None and turn.candidates is not None:
            ui.label("not saved as a run").classes("soft").tooltip("open the study again to retry")
        return
    ident = scene.study.ident
    with ui.button("Take away", icon="download").props("outline padding='4px 12px'"), ui.menu():

        def item(name: str, said: str) -> None:
            to = f"/take/{ident}/{turn.serial}/{name}"
            ui.menu_item(said, lambda: ui.navigate.to(to)).props('role="menuitem"')

        item("report.html", "Report, one HTML file")
        if browser() is not None:
            item("report.pdf", "Report, PDF")
        item("run.json", "All numbers (JSON)")
        ui.separator()
        ui.item_label("The model as").props('header role="presentation"')
        for kind in KINDS.values():
            item(f"model{kind.suffix}", kind.label)
    if turn.tracked:
        ui.link("MLflow", f"/mlflow/{ident}/{turn.serial}", new_tab=True).classes("quiet").tooltip(
            "the errors of this step and of the other branches, round by round"
        )
    elif turn.untracked:
        ui.label("not in MLflow").classes("soft").tooltip(turn.untracked)
