"""The first page: begin with an embedded record or a file, or go on with an earlier study."""

from __future__ import annotations

import re
from dataclasses import dataclass
from html import escape

from nicegui import ui

from spiral.app import frame, panels, studies, tour
from spiral.app.drop_zone import drop_script, drop_zone
from spiral.app.session import Session
from spiral.io.readers.table import find_file
from spiral.types.errors import InputError, SpiralError
from spiral.view.report.style import label_title


def start_page(session: Session) -> None:
    """Build the first page."""
    with frame.header_bar(""):
        pass
    with ui.element("div").classes("wrap"):
        ui.html(
            "<h1 class='big'>What is your model missing?</h1><p class='soft' style='font-size:17px;"
            "max-width:72ch'>Compare a model with measurements, see where it fails, learn which "
            "physical effect is missing, add it, and watch the error fall.</p>",
            sanitize=False,
        )
        _draw_tour_button(session)
        with ui.element("section").classes("card"):
            ui.html("<h2 class='head'>Begin with an embedded record</h2>", sanitize=False)
            known_presets = presets()
            here = [p for p in known_presets if p.lacks is None]
            with ui.element("div").classes("choices"):
                for preset in here:
                    _draw_preset_button(session, preset.name, preset.said)
            _draw_absent_presets([p for p in known_presets if p.lacks is not None])
        with ui.element("section").classes("card"):
            ui.html("<h2 class='head'>Or bring your own measurements</h2>", sanitize=False)
            drop_zone()
            drop_script()
            _draw_path_input(session)
        frame.draw_local_plugins(session)
        studies.draw_study_list(session)


def _draw_tour_button(session: Session) -> None:
    def start_tour() -> None:
        ui.navigate.to(f"/study/{tour.begin_tour(session)}")

    with ui.row().style("align-items:center;gap:12px"):
        button = ui.button("Take the tour", icon="play_arrow", on_click=start_tour)
        button.props("unelevated color=primary")
        said = "A rotor in two to three minutes: one button to click, and what you see in words."
        ui.html(f"<span class='soft'>{said}</span>", sanitize=False)


def _draw_path_input(session: Session) -> None:
    """A file that is on this machine already is read where it lies, whatever its size."""

    def read_path() -> None:
        try:
            ident = session.file_setup.open_local_file(where.value or "")
        except SpiralError as error:
            frame.notify_error(error)
            return
        ui.navigate.to(f"/file/{ident}")

    with ui.row().classes("items-center no-wrap gap-2").style("margin-top:12px"):
        where = ui.input(placeholder="or the path of a file on this machine").props(
            "outlined dense clearable"
        )
        where.style("flex:1 1 420px;max-width:560px").on("keydown.enter", read_path)
        ui.button("Read", on_click=read_path).props("outline")


@dataclass(frozen=True)
class Preset:
    """An embedded study: its name, what its file says, and the measured file that it lacks here."""

    name: str
    said: str
    lacks: str | None = None


def presets() -> list[Preset]:
    """The presets with the first sentence of what their files say of them; the demo's first.

    Other rotors follow it, since their sentences say what differs from it.

    Those with a strategy of their own are left to the command line: the page adds by hand, and not
    every strategy can admit what a person chooses.
    """
    from importlib.resources import files

    import yaml

    from spiral.io.config import PACKAGE, experiments

    embedded = []
    for name in sorted(experiments(), key=lambda n: (not n.startswith("rotor_"), n)):
        text = (files(PACKAGE) / "experiment" / f"{name}.yaml").read_text("utf-8")
        lines = text.splitlines()
        if any(re.match(r"\s*- override /strategy: ", x) for x in lines):
            continue
        told = [x[1:].strip() for x in lines[1:] if x.startswith("#")]
        said = " ".join(told).split(". ")[0].rstrip(".") + "."
        needed = (yaml.safe_load(text).get("record") or {}).get("path")
        embedded.append(
            Preset(name, said, needed if needed and not _is_available(needed) else None)
        )
    return embedded


def _is_available(path: str) -> bool:
    try:
        find_file(path)
    except InputError:
        return False
    return True


def _draw_absent_presets(absent: list[Preset]) -> None:
    """Presets on measured data that is not on this machine, and how they come to run."""
    if not absent:
        return
    names = ", ".join(f"{panels.label_words(p.name)} ({p.lacks})" for p in absent)
    ui.label(
        f"With measured data that is not on this machine: {names}. Set SPIRAL_DATA to the folder "
        "that holds these files; experiments/NAME/README.md says where each comes from."
    ).classes("soft").props["id"] = "absent"


def _draw_preset_button(session: Session, name: str, said: str) -> None:
    def create_study() -> None:
        try:
            ident = session.create(label_title(name), (f"experiment={name}",))
        except SpiralError as error:
            frame.notify_error(error)
            return
        ui.navigate.to(f"/study/{ident}")

    with ui.element("button").classes("choice").props('type="button"').on("click", create_study):
        title = label_title(name)
        ui.html(f"<b>{escape(title)}</b><span>{escape(said)}</span>", sanitize=False)
