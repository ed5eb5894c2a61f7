"""Elements of all pages: the bar at the top, figures, messages, the equivalent command line."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from html import escape
from pathlib import Path
from typing import Any

from nicegui import ui

from spiral.app import panels
from spiral.app.narrow import fit_narrow, is_narrow
from spiral.app.session import LiveStudy, Session
from spiral.app.study import Study
from spiral.app.stylesheet import STYLE
from spiral.io.export.kinds import KINDS
from spiral.types.errors import SpiralError
from spiral.view.report import sketch
from spiral.view.report.mathfont import math_style
from spiral.view.report.pictures import find_browser
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
def header_bar(crumb: str) -> Iterator[None]:
    """The bar at the top of a page; elements built in the context stand at its right."""
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


def responsive_figure(data: Mapping[str, Any]) -> dict[str, Any]:
    """Data, layout and options of a figure for Plotly in the browser, as wide as its container.

    In a narrow window pictures that stand side by side come to stand one below the other.
    """
    data = fit_narrow(data) if is_narrow() else data
    layout = {**data["layout"], "autosize": True, "uirevision": "kept",
              "paper_bgcolor": CLEAR, "plot_bgcolor": CLEAR,
              "modebar": {"bgcolor": CLEAR, "color": "#767f8a", "activecolor": BLUE}}  # fmt: skip
    layout.pop("width", None)
    return {"data": data["data"], "layout": layout, "config": _CONFIG}


def draw_plot(data: Mapping[str, Any], name: str, said: str) -> ui.plotly:
    """Draw a figure as wide as its container; ``said`` describes it to screen readers."""
    figure = responsive_figure(data)
    element = ui.plotly(figure)
    element.style(f"width:100%;height:{float(figure['layout']['height'])}px")
    element.props["id"] = f"plot-{name}"
    element.props["role"] = "figure"
    element.props["aria-label"] = said
    return element


def load_figure(file: Path) -> Mapping[str, Any] | None:
    """A figure from its file; nothing where there is none that can be drawn."""
    try:
        data = json.loads(file.read_text(encoding="utf-8"))
        return data if float(data["layout"]["height"]) and data["data"] is not None else None
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return None


def draw_sketch(graph: Any) -> None:
    """The sketch of a model, and the same in words; it scrolls where the window is narrow."""
    drawn = sketch.sketch_figure(graph)
    if not drawn:
        return
    with ui.element("div").classes("sketched") as place:
        ui.html(drawn, sanitize=False).style("width:100%")
    place.props('tabindex="0" role="group" aria-label="Sketch of the model"')
    with ui.expansion("The sketch in words").classes("w-full"):
        items = "".join(f"<li>{escape(one)}</li>" for one in sketch.describe_sketch(graph))
        ui.html(f"<ul class='soft'>{items}</ul>", sanitize=False)


def draw_code(text: str) -> None:
    """Text as it is, with a button that copies it. No Markdown: a backtick in it means nothing."""
    with ui.element("div").classes("command"):
        ui.html(f"<pre><code>{escape(text)}</code></pre>", sanitize=False)
        copy = ui.button("Copy").props("flat dense")
        copy.on("click", js_handler=_COPY)


@contextmanager
def error_box(error: Mapping[str, str]) -> Iterator[None]:
    """An error that stays on the page, a cancellation as a note; the context may add elements."""
    cancelled = error.get("at") == "cancelled"
    with ui.element("div").classes("note" if cancelled else "trouble") as box:
        box.props["role"] = "status" if cancelled else "alert"
        ui.html(panels.error_message(error), sanitize=False)
        yield


def notify_error(error: SpiralError) -> None:
    """Show an error as a notification that goes away by itself."""
    message = error.as_dict()
    said = message["given"]
    for name, key in (("Expected", "expected"), ("Try", "try")):
        said += f". {name}: {message[key]}" if message.get(key) else ""
    ui.notify(said, type="warning", multi_line=True, position="top", close_button="Close")


def not_found_page(error: SpiralError) -> None:
    """A page for an address that names no study."""
    with header_bar("Nothing here"):
        pass
    with ui.element("div").classes("wrap"):
        with ui.element("div").classes("trouble"):
            ui.html(panels.error_message(error.as_dict()), sanitize=False)
        ui.link("All studies", "/").classes("quiet")


def draw_local_plugins(session: Session) -> None:
    """The files that are run as local plugins, by name, and those that cannot be used."""
    files = session.local_plugins()
    if not files:
        return
    said = f"Runs local plugins: {', '.join(files)}. Started with --no-plugins it does without."
    ui.label(said).classes("soft local-plugins")
    place = ui.element("div").props('role="alert"')
    shown: list[tuple[str, ...]] = [()]

    def show_broken() -> None:
        if session.broken == shown[0]:
            return
        shown[0] = session.broken
        place.clear()
        with place:
            for one in session.broken:
                ui.label(f"Not used: {one}").classes("trouble broken-plugin")

    show_broken()
    ui.timer(0.5, show_broken)


def shell_command(study: Study) -> str:
    """The shell command that does the same as the study's selected step."""
    given = option_lines(study.overrides)
    if not study.added:
        return f"spiral diagnose{given}"
    return f"spiral add {' '.join(study.added)}{given}"


def draw_run_links(session: Session, scene: LiveStudy) -> None:
    """Draw the menu of downloads (report, numbers, model) and the link to MLflow."""
    turn = scene.study.turn
    if turn is None or not turn.run_id:
        if turn is not None and turn.serial in scene.writing:
            ui.label("saving the run …").classes("soft")
        elif turn is not None and turn.candidates is not None:
            ui.label("not saved as a run").classes("soft").tooltip("open the study again to retry")
        return
    ident = scene.study.ident
    with ui.button("Take away", icon="download").props("outline padding='4px 12px'"), ui.menu():

        def add_menu_item(name: str, said: str) -> None:
            to = f"/take/{ident}/{turn.serial}/{name}"
            ui.menu_item(said, lambda: ui.navigate.to(to)).props('role="menuitem"')

        add_menu_item("report.html", "Report, one HTML file")
        if find_browser() is not None:
            add_menu_item("report.pdf", "Report, PDF")
        add_menu_item("run.json", "All numbers (JSON)")
        ui.separator()
        ui.item_label("The model as").props('header role="presentation"')
        for kind in KINDS.values():
            add_menu_item(f"model{kind.suffix}", kind.label)
    if turn.tracked:
        ui.link("MLflow", f"/mlflow/{ident}/{turn.serial}", new_tab=True).classes("quiet").tooltip(
            "the errors of this step and of the other branches, round by round"
        )
    elif turn.untracked:
        ui.label("not in MLflow").classes("soft").tooltip(turn.untracked)
