"""The page of an uploaded file: map its columns to the system, and check before any fit."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from html import escape
from pathlib import Path
from typing import Any

from nicegui import ui

from spiral.app import equations, frame, model_setup, panels
from spiral.app import record_setup as setups
from spiral.app.data_setup import DataSetup, draw_plan_commands, foresight_message
from spiral.app.drop_zone import drop_script
from spiral.app.file_preview import PICTURE, READING
from spiral.app.file_setup import OpenFile
from spiral.app.narrow import watch_width
from spiral.app.press import Press
from spiral.app.reading_setup import draw_reading_setup
from spiral.app.record_setup import Choice, RecordSetup
from spiral.app.session import Session
from spiral.io.readers.formats import is_text
from spiral.types.errors import SpiralError
from spiral.types.formatting import number
from spiral.view.report import text

_TICK = 0.2
_NONE = "none"
_CLOCK = "sample rate"
_BLOCKS = "holdout_blocks=5"
_NOTHING = "Nothing yet: what keeps this record from being read stands at the top of the page."


@dataclass
class MappingPage:
    """One tab on one setup."""

    session: Session
    ident: str
    version: int = -1
    drawn: dict[str, Any] = field(default_factory=dict)
    regions: dict[str, ui.element] = field(default_factory=dict)
    press: Press = field(default_factory=Press)

    def __post_init__(self) -> None:
        self.desk = DataSetup(self.session, self.ident, self._change_choice)

    def refresh(self) -> None:
        """Draw what has changed, once no mouse button is down."""
        opened = self.session.file_setup.current_file(self.ident)
        if opened.version == self.version or self.press.is_held():
            return
        self.version = opened.version
        for name, build, depends in self._region_builders(opened):
            if name in self.drawn and self.drawn[name] == depends:
                continue
            self.drawn[name] = depends
            self.regions[name].clear()
            with self.regions[name]:
                build(opened)
        choice = opened.setup.choice
        stretches = (choice.fit_rows, choice.test_rows)
        if self.drawn.get("stretches", ((), ())) != stretches:
            self.desk.show_stretches()
        self.drawn["stretches"] = stretches

    def redraw(self, *names: str) -> None:
        """Draw regions anew."""
        for name in names:
            self.drawn.pop(name, None)
        self.version = -1
        self.refresh()

    def _region_builders(
        self, opened: OpenFile
    ) -> list[tuple[str, Callable[[OpenFile], None], Any]]:
        setup, columns = opened.setup, len(opened.setup.columns)
        named = tuple((r["key"], r["unit"]) for r in setup.model.get("parameters", ()))
        told = (named, setup.model.get("sketch"))  # a value that is being typed redraws nothing
        return [
            ("state", self._draw_state, (opened.busy, setup.trouble)),
            ("columns", self._draw_columns, columns),
            ("form", self._draw_mapping, (columns, setup.choice.system, setup.choice.time,
                                  setup.trouble if equations.equations_error(setup) else None)),
            ("model", self._draw_model, (told, setup.choice.without, setup.choice.effects)),
            ("reading", self._draw_reading, setup.reading),
            ("records", self._draw_records, (bool(columns), setup.others)),
            ("seen", self._draw_summary, (setup.seen, setup.choice, setup.trouble,
                                  bool(setup.systems))),
            *([("forecast", self._draw_forecast, (setup.foresight, opened.foreseeing))]
              if setup.systems else []),
        ]  # fmt: skip

    def _draw_state(self, opened: OpenFile) -> None:
        if opened.busy:
            with ui.element("div").classes("card working afloat").props('role="status"'):
                ui.spinner(size="20px")
                ui.label(opened.busy + " …").classes("words")
                ui.button("Cancel", on_click=self._cancel_reading).props(
                    "outline dense color=negative padding='2px 12px'")  # fmt: skip
        if opened.setup.trouble and not equations.equations_error(opened.setup):
            with frame.error_box(opened.setup.trouble):
                if not opened.setup.columns:
                    ui.link("Choose another file", "/").classes("quiet")
                self._draw_advice(opened.setup)
                if opened.setup.columns:
                    said = setups.places_of_settings(opened.setup.trouble)
                    ui.html(said, sanitize=False).classes("places")
            if not opened.setup.columns and is_text(Path(opened.setup.path)):
                self._draw_text_layout(opened.setup)

    def _draw_advice(self, setup: RecordSetup) -> None:
        """A button for each setting that the message tells to try."""
        lines = setups.advised_lines(setup.trouble) if setup.columns else []
        if not lines:
            return
        with ui.row().classes("gap-2").style("margin-top:8px").props('id="advice"'):
            for line in lines:
                button = ui.button(f"Use {line}")
                button.on_click(functools.partial(self._use_setting, line)).props("outline")

    def _use_setting(self, line: str) -> None:
        """Take a setting that a message names, and show it in its field."""
        self.drawn.pop("form", None)
        now = self._current_choice()
        self._change_choice(**vars(setups.with_setting(now, line)))

    def _draw_text_layout(self, setup: RecordSetup) -> None:
        """Fields for ``record.separator`` and ``record.decimal``, where no columns were found."""
        with ui.row().classes("items-center gap-2").style("margin-top:10px"):
            between = ui.input("Between columns", value=setup.separator)
            mark = ui.input("Before decimals", value=setup.decimal)
            for box in (between, mark):
                box.props("outlined dense").style("width:180px")
            button = ui.button("Read it so", on_click=lambda: self.session.file_setup.reread_file(
                self.ident, between.value or "", mark.value or ""))  # fmt: skip
            button.props("outline")

    def _cancel_reading(self) -> None:
        """Stop reading; what was read and chosen before stays."""
        self.session.cancel(self.ident)

    def _draw_columns(self, opened: OpenFile) -> None:
        setup = opened.setup
        if not setup.columns:
            return
        rows = [
            (c["name"], c["unit"], ", ".join(number(v) for v in c["first"]),
             f"{number(c['lowest'])} … {number(c['highest'])}")
            for c in setup.columns
        ]  # fmt: skip
        ui.html(f"<h2 class='head'>{escape(setup.name)}: {setup.rows} rows</h2>", sanitize=False)
        table = text.html_table(("column", "unit", "first rows", "range"), rows)
        ui.html(panels.restyle_table(table), sanitize=False)
        if setup.left_out:
            ui.html(panels.left_out_note(setup.left_out), sanitize=False)
            said = setups.places_of_settings({"try": setup.left_out[0].get("try", "")})
            ui.html(f"<p class='soft'>{said}</p>", sanitize=False)
        if setup.drawn:
            data = frame.load_figure(setups.setup_folder(self.session.out, self.ident) / PICTURE)
            if data is not None:
                self.desk.draw_picture(data)

    def _draw_reading(self, opened: OpenFile) -> None:
        """What reading makes of the file's numbers, before and after."""
        changes = opened.setup.reading
        if not changes:
            return
        ui.html("<h2 class='head'>What reading changes</h2>", sanitize=False)
        said = "".join(f"<li>{escape(note)}</li>" for note in changes["notes"])
        ui.html(f"<ul class='soft'>{said}</ul>", sanitize=False)
        data = frame.load_figure(setups.setup_folder(self.session.out, self.ident) / READING)
        if data is None or not changes["series"]:
            ui.html("<p class='soft'>No number changes.</p>", sanitize=False)
            return
        frame.draw_plot(
            data, "reading", f"Before and after reading: {', '.join(changes['series'])}"
        )
        said = "Orange as the file has it, blue as it is read; at the right where it changes most."
        ui.html(f"<p class='caption'>{said}</p>", sanitize=False)

    def _draw_records(self, opened: OpenFile) -> None:
        if opened.setup.columns:
            self.desk.draw_files()

    def _draw_mapping(self, opened: OpenFile) -> None:
        setup = opened.setup
        if not setup.systems:
            return
        ui.html("<h2 class='head'>What is what</h2>", sanitize=False)
        chosen = setup.choice.system or None
        ui.select(_system_titles(setup), value=chosen, label="System: the physics that is known",
                  on_change=lambda e: self._change_choice(system=e.value)).props(
            "outlined dense").classes("w-full")  # fmt: skip
        equations.draw_equations_form(
            setup, functools.partial(self.session.file_setup.set_equations, self.ident)
        )
        system = setup.system()
        if system is None:
            meanings = (
                f"<b>{escape(panels.label_words(s['name']))}</b>: "
                + panels.effect_meaning(s["meaning"])
                for s in setup.systems
                if not s.get("own")
            )
            text = f"<p class='soft' style='margin-top:8px'>{'<br>'.join(meanings)}</p>"
            ui.html(text, sanitize=False)
            return
        said = (
            f"<p class='soft' style='margin-top:6px'>{panels.effect_meaning(system['meaning'])}</p>"
        )
        ui.html(said, sanitize=False)
        with ui.element("div").classes("mapping"):
            self._draw_time_row(setup)
            for series in system["channels"]:
                self._draw_series_row(setup, series, "measured")
            for series in system["inputs"]:
                self._draw_series_row(
                    setup, series, "input" if series["required"] else "input, if measured"
                )
        self.desk.draw_instruments()
        draw_reading_setup(setup, self._current_choice, self._change_choice)
        self._draw_more(setup)

    def _draw_more(self, setup: RecordSetup) -> None:
        """What has no field of its own, as lines of the command line."""
        with ui.expansion("More: candidates, noise, the system's fields",
                          value=bool(setup.choice.more)).classes("w-full"):  # fmt: skip
            ui.textarea(
                "One KEY=VALUE a line, as in a terminal", value=setup.choice.more,
                placeholder="record.noise={x: 1e-6}\nholdout=0.3",
                on_change=lambda e: self._change_choice(more=e.value or ""),
            ).props("outlined dense debounce=900").classes("w-full")  # fmt: skip

    def _draw_model(self, opened: OpenFile) -> None:
        model_setup.draw_model_setup(opened.setup, self._current_choice, self._change_choice)

    def _current_choice(self) -> Choice:
        return self.session.file_setup.current_file(self.ident).setup.choice

    def _draw_time_row(self, setup: RecordSetup) -> None:
        ui.html("<b>time</b>", sanitize=False)
        names = {"": _CLOCK, **{c["name"]: c["name"] for c in setup.columns}}
        with ui.element("div").props('data-for="time"'):
            ui.select(
                names,
                value=setup.choice.time if setup.choice.time in names else "",
                on_change=lambda e: self._choose_time_column(e.value),
            ).props("outlined dense")
        if setup.choice.time:
            self._draw_unit_input(setup, "time", "s")
        else:
            ui.input(value=setup.choice.rate, placeholder="in Hz",
                     on_change=lambda e: self._change_choice(rate=e.value or "")).props(
                'outlined dense debounce=500 aria-label="sample rate"')  # fmt: skip

    def _choose_time_column(self, column: str) -> None:
        units = self._current_choice().units
        self._change_choice(time=column, units={**units, "time": self._unit_from_column(column)})

    def _draw_series_row(self, setup: RecordSetup, series: Mapping[str, Any], kind: str) -> None:
        name = series["name"]
        ui.html(f"<b>{escape(name)}</b> <span class='soft'>{kind}</span>", sanitize=False)
        names = {"": _NONE, **{c["name"]: c["name"] for c in setup.columns}}
        if kind == "input" and setups.AT_REST not in names:
            names[setups.AT_REST] = "held at zero"
        value = setup.choice.columns.get(name, "")

        def choose_column(event: Any) -> None:
            now = self._current_choice()
            said = self._unit_from_column(event.value)
            self._change_choice(columns={**now.columns, name: event.value},
                         units={**now.units, name: said})  # fmt: skip
            unit.set_value(said)
            unit.props["placeholder"] = self._unit_placeholder(event.value, series["unit"])

        with ui.element("div") as place:
            place.props["data-for"] = name
            box = ui.select(names, value=value if value in names else "", on_change=choose_column)
            box.props("outlined dense")
        unit = self._draw_unit_input(setup, name, series["unit"])

    def _draw_unit_input(self, setup: RecordSetup, name: str, usual: str) -> ui.input:
        column = setup.choice.time if name == "time" else setup.choice.columns.get(name, "")

        def choose_unit(event: Any) -> None:
            now = self._current_choice()
            self._change_choice(units={**now.units, name: event.value or ""})

        box = ui.input(value=setup.choice.units.get(name, ""), on_change=choose_unit,
                       placeholder=self._unit_placeholder(column, usual))  # fmt: skip
        box.props["aria-label"] = f"unit of {name}"
        return box.props("outlined dense debounce=500")

    def _unit_placeholder(self, column: str, usual: str) -> str:
        """The unit that a file names for a column, else the system's own."""
        setup = self.session.file_setup.current_file(self.ident).setup
        named = {c["name"]: c["unit"] for c in setup.columns}
        return named.get(column) or usual or "no unit"

    def _unit_from_column(self, column: str) -> str:
        """The unit in a column's name where the file names none, as in ``disp_um``."""
        setup = self.session.file_setup.current_file(self.ident).setup
        named = any(c["name"] == column and c["unit"] for c in setup.columns)
        return "" if named else setups.unit_from_name(column)

    def _draw_summary(self, opened: OpenFile) -> None:
        setup = opened.setup
        if not setup.systems:
            return
        ui.html("<h2 class='head'>What was understood</h2>", sanitize=False)
        lacking = setups.missing_choices(setup)
        if lacking:
            ui.html(f"<p class='soft'>Still to choose: {escape(', '.join(lacking))}.</p>",
                    sanitize=False)  # fmt: skip
        elif setup.seen:
            ui.html(panels.records_table(setup.seen), sanitize=False).classes("wide w-full").props(
                "tabindex=0"
            )
            ui.html(panels.units_note(setups.units_taken(setup)), sanitize=False)
            said = f"{panels.test_split_note(setup.seen)} Are the ranges those of your machine?"
            ui.html(f"<p class='soft' style='margin-top:8px' id='apart'>{escape(said)}</p>",
                    sanitize=False)  # fmt: skip
            self._draw_quiet_warning(setup)
        elif setup.trouble:
            ui.html(f"<p class='soft'>{_NOTHING}</p>", sanitize=False)
        self.regions["forecast"] = ui.element("div").style("width:100%")
        self.drawn.pop("forecast", None)
        begin = ui.button("Compare with the model", icon="play_arrow", on_click=self._create_study)
        begin.props("unelevated color=primary").style("margin-top:12px")
        begin.set_enabled(bool(setup.seen) and not setup.trouble)

    def _draw_forecast(self, opened: OpenFile) -> None:
        """What the record can tell apart: it comes later, and must not replace the button below."""
        setup = opened.setup
        if setup.seen and not setups.missing_choices(setup):
            ui.html(foresight_message(setup.foresight, opened.foreseeing), sanitize=False)
            draw_plan_commands(setup.foresight, setups.setup_overrides(setup))

    def _draw_quiet_warning(self, setup: RecordSetup) -> None:
        """A warning where the test record hardly moves, and another split with one click."""
        said = panels.quiet_test_warning(setup.seen)
        if not said:
            return
        ui.html(said, sanitize=False)
        if panels.is_test_held_out(setup.seen):
            button = ui.button("Keep parts of five blocks apart instead")
            button.on_click(functools.partial(self._use_setting, _BLOCKS)).props("outline")

    def _change_choice(self, **values: Any) -> None:
        now: Choice = self._current_choice()
        changed = replace(now, **values)
        if changed != now:
            self.session.file_setup.change_choice(self.ident, changed)
            self.refresh()

    def _create_study(self) -> None:
        try:
            title, overrides = self.session.file_setup.study_arguments(self.ident)
            ident = self.session.create(title, overrides)
        except SpiralError as error:
            frame.notify_error(error)
            return
        ui.navigate.to(f"/study/{ident}")


def file_page(session: Session, ident: str) -> None:
    """Build the page of one file."""
    try:
        opened = session.file_setup.current_file(ident)
    except SpiralError as error:
        frame.not_found_page(error)
        return
    form = MappingPage(session, ident)
    drop_script()
    with frame.header_bar(opened.setup.name):
        pass
    with ui.element("div").classes("wrap"):
        form.regions["state"] = ui.element("div")
        with ui.element("div").classes("split"):
            with ui.element("div").style("display:flex;flex-direction:column;gap:18px;min-width:0"):
                form.regions["form"] = ui.element("section").classes("card")
                form.regions["records"] = ui.element("section").classes("card")
                form.regions["seen"] = ui.element("section").classes("card")
            with ui.element("div").style("display:flex;flex-direction:column;gap:18px;min-width:0"):
                form.regions["columns"] = ui.element("section").classes("card")
                form.regions["reading"] = ui.element("section").classes("card")
                form.regions["model"] = ui.element("section").classes("card")
    watch_width(lambda: form.redraw("columns", "reading"))
    form.press.watch(form.refresh)
    form.refresh()
    ui.timer(_TICK, form.refresh)


def _system_titles(setup: RecordSetup) -> dict[str, str]:
    """Names of the systems that a record may be of, each with its words on the page."""
    return {
        s["name"]: "equations of your own" if s.get("own") else panels.label_words(s["name"])
        for s in setup.systems
    }
