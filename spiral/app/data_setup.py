"""The records of a setup: further files, stretches marked on the picture, how inputs were given.

What is chosen here becomes ``record.path=[...]``, ``test.path=``, ``record.rows=``, ``test.rows=``,
``record.hold=``, ``record.pulse=``, ``record.rotation=``, ``record.probe_angles=`` and
``record.slow_roll=``.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from html import escape
from typing import Any

from nicegui import ui

from spiral.app import frame, horizon_errors, panels
from spiral.app import record_setup as setups
from spiral.app.drop_zone import drop_zone
from spiral.app.record_setup import FIT, TEST, Choice, RecordSetup
from spiral.app.session import Session
from spiral.types.errors import SpiralError
from spiral.types.formatting import first_words
from spiral.types.parameter import BETWEEN
from spiral.view.report.style import BLUE, ORANGE
from spiral.view.terminal.shell import option_lines

_USES = {FIT: "fitted", TEST: "test, never fitted", "": "leave it out"}
_DRAGS = {"zoom": "Zoom", FIT: "Mark what is fitted", TEST: "Mark the test"}
_COLOURS = {FIT: BLUE, TEST: ORANGE}
_SAID = "Rows, counted from zero; choose above what a drag over the picture marks."
_HAS_TEST = "Another file is the test record; leave it out to mark a stretch of this one."
_PLANNED = 2  # effects of a group that a command names
_PLAN = (
    "The first two of each group, on the command line; after the first fit the page plans it too."
)
_MOST = 6  # effects of a group that are named


@dataclass
class DataSetup:
    """The records in one tab; ``change`` takes over other fields of the choice."""

    session: Session
    ident: str
    change: Callable[..., None]
    drag: str = "zoom"
    plot: ui.plotly | None = None
    rows: dict[tuple[str, int], ui.input] = field(default_factory=dict)
    shown: dict[tuple[str, int], str] = field(default_factory=dict)  # what the program wrote there

    def current_setup(self) -> RecordSetup:
        """The setup as it is now."""
        return self.session.file_setup.current_file(self.ident).setup

    # --- the picture, and stretches of it --------------------------------------------------------

    def draw_picture(self, data: Mapping[str, Any]) -> None:
        """Draw the first columns over row number; a drag marks the rows to fit or to test."""
        setup = self.current_setup()
        toggle = ui.toggle(_DRAGS, value=self.drag, on_change=lambda e: self._set_drag(e.value))
        toggle.props('unelevated no-caps dense padding="2px 10px" aria-label="A drag"')
        toggle.classes("drags")
        layout = {**data["layout"], "shapes": stretch_shapes(setup), **self._drag_layout(),
                  "selectdirection": "h"}  # fmt: skip
        said = f"The first columns of {setup.name}, row by row"
        self.plot = frame.draw_plot({**data, "layout": layout}, "columns", said)
        self.plot.on("plotly_selected", self._on_selected, args=["range"])
        with ui.element("div").classes("stretches"):
            for use, name in ((FIT, "Fitted rows"), (TEST, "Test rows")):
                ui.html(f"<i style='background:{_COLOURS[use]}'></i>{name}", sanitize=False)
                for end, word in enumerate(("from", "to")):
                    self.rows[use, end] = self._rows_input(use, end, f"{name} {word}")
            ui.button("All rows", on_click=self._take_all_rows).props("flat dense")
        ui.html(f"<p class='soft'>{_SAID}</p>", sanitize=False)
        lacking = missing_values_note(setup.columns)
        ui.html(f"<p class='soft'>{escape(lacking)}</p>", sanitize=False)

    def show_stretches(self) -> None:
        """Show the stretches as they are chosen; a field that somebody types in is left alone."""
        if self.plot is None or self.plot.is_deleted:
            return
        setup = self.current_setup()
        self.plot.run_plot_method("relayout", {"shapes": stretch_shapes(setup), "selections": []})
        for (use, end), box in self.rows.items():
            rows = _stretch_rows(setup.choice, use)
            wanted = str(rows[end]) if rows else ""
            if box.value != wanted and box.value == self.shown[use, end]:
                box.set_value(wanted)
            self.shown[use, end] = wanted

    def _drag_layout(self) -> dict[str, Any]:
        """What a drag over the picture does; ``meta`` says for whom a stretch is marked."""
        return {"dragmode": "zoom" if self.drag == "zoom" else "select", "meta": self.drag}

    def _set_drag(self, what: str) -> None:
        self.drag = what
        if self.plot is not None:
            self.plot.run_plot_method("relayout", {**self._drag_layout(), "selections": []})

    def _on_selected(self, event: Any) -> None:
        ends = next((v for k, v in ((event.args or {}).get("range") or {}).items()
                     if k.startswith("x")), None)  # fmt: skip
        if ends and self.drag in _COLOURS:
            self._drop_typed()
            self._mark_rows(self.drag, round(min(ends)), round(max(ends)))

    def _take_all_rows(self) -> None:
        self._drop_typed()
        self.change(fit_rows=(), test_rows=())
        self.show_stretches()

    def _drop_typed(self) -> None:
        """What was typed and never made a stretch gives way to what is chosen next."""
        self.shown = {key: box.value or "" for key, box in self.rows.items()}

    def _mark_rows(self, use: str, first: int, stop: int) -> None:
        setup = self.current_setup()
        if use == TEST and setup.files(TEST):
            ui.notify(_HAS_TEST, type="warning", position="top", close_button="Close")
            self.show_stretches()
            return
        choice = setups.mark_stretch(setup.choice, use, first, stop, setup.rows)
        self.change(fit_rows=choice.fit_rows, test_rows=choice.test_rows)

    def _rows_input(self, use: str, end: int, label: str) -> ui.input:
        rows = _stretch_rows(self.current_setup().choice, use)
        hint = "all" if (use, end) == (FIT, 0) else ""
        self.shown[use, end] = str(rows[end]) if rows else ""
        box = ui.input(value=self.shown[use, end], placeholder=hint)
        box.on("change", lambda: self._on_rows_typed(use))  # Enter, or the next field
        box.props["aria-label"] = label
        return box.props("outlined dense inputmode=numeric")

    def _on_rows_typed(self, use: str) -> None:
        """Two whole numbers make a stretch, two empty fields all rows; other text is ignored."""
        texts = [(self.rows[use, end].value or "").strip() for end in (0, 1)]
        now = _stretch_rows(self.current_setup().choice, use)
        if not any(texts) and now:
            self.change(**{f"{use}_rows": ()})
        elif all(t.isdecimal() for t in texts):
            first, stop = (int(t[:12]) for t in texts)
            if first < stop and (first, stop) != now:
                self._mark_rows(use, first, stop)

    # --- further files ---------------------------------------------------------------------------

    def draw_files(self) -> None:
        """All files of this machine with what each is for, and room for another."""
        setup = self.current_setup()
        ui.html("<h2 class='head'>Records of this machine</h2>", sanitize=False)
        with ui.element("div").classes("files").props('id="files"'):
            ui.html(f"<b>{escape(setup.name)}</b>", sanitize=False)
            ui.html("<span class='soft'>fitted</span>", sanitize=False)
            for other in setup.others:
                ui.html(f"<b>{escape(other['name'])}</b>", sanitize=False)
                box = ui.select(_USES, value=other["use"])
                box.on_value_change(functools.partial(self._set_file_use, other))
                box.props["aria-label"] = f"{other['name']} is"
                box.props("outlined dense options-dense")
        drop_zone(self.ident)
        with ui.row().classes("items-center no-wrap gap-2").style("margin-top:8px"):
            where = ui.input(placeholder="or its path on this machine").props("outlined dense")
            where.props["aria-label"] = "path of another file"
            where.style("flex:1 1 auto").on("keydown.enter", lambda: self._add_typed_file(where))
            ui.button("Add", on_click=lambda: self._add_typed_file(where)).props("outline")

    def _set_file_use(self, other: Mapping[str, str], event: Any) -> None:
        self.session.file_setup.set_file_use(self.ident, other["path"], other["name"], event.value)

    def _add_typed_file(self, where: ui.input) -> None:
        try:
            self.session.file_setup.join_local_file(self.ident, where.value or "")
        except SpiralError as error:
            frame.notify_error(error)

    # --- how inputs and a rotor's sensors are given ----------------------------------------------

    def draw_instruments(self) -> None:
        """How inputs run between samples; of a rotor the pulse, its sense, probes and slow roll."""
        setup = self.current_setup()
        system, choice = setup.system(), setup.choice
        if system is None:
            return
        rotor = any(i["name"] == "speed" for i in system["inputs"])
        chosen = [i["name"] for i in system["inputs"] if i["required"]]
        known = bool(
            choice.hold or choice.pulse or choice.rotation or choice.angles or choice.slow_roll
        )
        with ui.expansion("Sensors and inputs", value=known).classes("w-full"), \
                ui.element("div").classes("instruments"):  # fmt: skip
            ways = {"": "not known: found from the record", **BETWEEN}
            for name in chosen:
                self._draw_select(f"{panels.label_words(name)} between samples", ways,
                             choice.hold.get(name, ""), "hold", name)  # fmt: skip
            if rotor:
                columns = {"": "none", **{c["name"]: c["name"] for c in setup.columns}}
                self._draw_select("once-per-turn pulse", columns, choice.pulse, "pulse")
                turns = {"": "counterclockwise", "clockwise": "clockwise"}
                self._draw_select("sense of rotation", turns, choice.rotation, "rotation")
                for channel in system["channels"]:
                    name = channel["name"]
                    label = f"probe {name}, degrees from the first axis"
                    self._draw_text_input(label, "angles", name)
                for end in setups.ENDS:
                    label = f"slow roll {end} speed, in the file's unit"
                    self._draw_text_input(label, "slow_roll", end)

    def _draw_select(
        self, label: str, options: Mapping[str, str], value: str, what: str, key: str = ""
    ) -> None:
        def choose_option(event: Any) -> None:
            chosen = event.value or ""
            now = getattr(self.current_setup().choice, what)
            self.change(**{what: {**now, key: chosen} if key else chosen})

        ui.label(label)
        box = ui.select(
            dict(options), value=value if value in options else "", on_change=choose_option
        )
        box.props["aria-label"] = label
        box.props("outlined dense options-dense")

    def _draw_text_input(self, label: str, what: str, key: str) -> None:
        """A field for one entry of a mapping of the choice."""

        def take_text(event: Any) -> None:
            now = getattr(self.current_setup().choice, what)
            self.change(**{what: {**now, key: event.value or ""}})

        ui.label(label)
        value = getattr(self.current_setup().choice, what).get(key, "")
        box = ui.input(value=value, on_change=take_text)
        box.props["aria-label"] = label
        box.props("outlined dense debounce=700")


def missing_values_note(columns: Sequence[Mapping[str, Any]]) -> str:
    """What the marks below the curves are; empty where every row has its value."""
    counts = [f"{c['missing']} in {c['name']}" for c in columns if c.get("missing")]
    return (
        f"Triangles below a curve: rows without a value, {first_words(counts)}." if counts else ""
    )


def stretch_shapes(setup: RecordSetup) -> list[dict[str, Any]]:
    """Shaded stretches of the picture: what is fitted, what is the test."""
    return [
        {"type": "rect", "xref": "x", "yref": "paper", "x0": rows[0], "x1": rows[1], "y0": 0,
         "y1": 1, "fillcolor": colour, "opacity": 0.16, "line": {"width": 0}, "layer": "below"}
        for use, colour in _COLOURS.items() if (rows := _stretch_rows(setup.choice, use))
    ]  # fmt: skip


def _stretch_rows(choice: Choice, use: str) -> tuple[int, ...]:
    return choice.fit_rows if use == FIT else choice.test_rows


def foresight_message(forecast: Mapping[str, Any], waiting: bool) -> str:
    """HTML text of ``identifiability.identifiability_forecast``; empty until it is asked for."""
    if waiting and not forecast:
        said = "Looking what this record can tell apart, before any fit …"
        return f"<p class='soft' id='foresight'>{said}</p>"
    if not forecast:
        return ""
    if "unknown" in forecast:
        return f"<p class='soft' id='foresight'>{escape(forecast['unknown'])}</p>"
    if not forecast["alike"]:
        said = f"This record can tell all {forecast['terms']} terms apart: those of the model, and "
        said += "those that may be missing."
        short = forecast["needed"] and forecast["needed"] > forecast["samples"]
        said += (
            f" To be sure of a small one takes {forecast['needed']:.0f} samples" if short else ""
        )
        said += f"; it has {forecast['samples']}." if short else ""
        return f"<p class='good' id='foresight'>{escape(said)}</p>"
    items = "".join(
        f"<li>{escape(_effect_names(g, forecast['own']))}</li>" for g in forecast["alike"]
    )
    return (
        "<div class='note caveats' id='foresight'><b>Before any fit: this record cannot tell "
        f"apart</b><ul>{items}</ul>{escape(_excitation_advice(forecast['advice']))}</div>"
    )


def draw_plan_commands(forecast: Mapping[str, Any], overrides: Sequence[str]) -> None:
    """The command that plans a test for each group of effects that look alike."""
    own = set(forecast.get("own") or ()) - set(forecast.get("seed") or ())
    groups = [[e for e in group if e not in own] for group in forecast.get("alike") or ()]
    groups = [group[:_PLANNED] for group in groups if len(group) > 1]
    if not groups:
        return
    with ui.expansion("Plan the test that tells them apart").classes("w-full"):
        ui.html(f"<p class='soft'>{_PLAN}</p>", sanitize=False)
        for group in groups:
            frame.draw_code(f"spiral plan {' '.join(group)}{option_lines(overrides)}")


def _effect_names(labels: Sequence[str], own: Sequence[str]) -> str:
    """The effects of a group, those of the model first and marked."""
    names = [f"{panels.label_words(e)} (in the model)" for e in labels if e in own]
    names += [panels.label_words(e) for e in labels if e not in own]
    left = len(names) - _MOST
    return horizon_errors.join_words([*names[:_MOST], *([f"{left} more"] if left > 0 else [])])


def _excitation_advice(advice: str) -> str:
    """What to do, without the groups that the advice begins with and the command it ends with."""
    told = advice.partition(": ")[2].partition(". ")[2] or advice
    return told.partition("; plan it with")[0].rstrip(".") + "."
