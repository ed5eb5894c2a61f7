"""The records of a setup: further files, stretches marked on the picture, how inputs were given.

What is chosen here becomes ``record.path=[...]``, ``test.path=``, ``record.rows=``, ``test.rows=``,
``record.hold=``, ``record.pulse=``, ``record.rotation=`` and ``record.probe_angles=``.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from html import escape
from typing import Any

from nicegui import ui

from spiral.app import frame, panels, unseen
from spiral.app import record_setup as kept
from spiral.app.drop_zone import drop_zone
from spiral.app.record_setup import FIT, TEST, Choice, RecordSetup
from spiral.app.session import Session
from spiral.types.errors import SpiralError
from spiral.types.parameter import BETWEEN
from spiral.view.report.style import BLUE, ORANGE

_USES = {FIT: "fitted", TEST: "test, never fitted", "": "leave it out"}
_DRAGS = {"zoom": "Zoom", FIT: "Mark what is fitted", TEST: "Mark the test"}
_COLOURS = {FIT: BLUE, TEST: ORANGE}
_SAID = "Rows, counted from zero; choose above what a drag over the picture marks."
_HAS_TEST = "Another file is the test record; leave it out to mark a stretch of this one."
_MOST = 6  # effects of a group that are named


@dataclass
class Desk:
    """The records in one tab; ``change`` takes over other fields of the choice."""

    session: Session
    ident: str
    change: Callable[..., None]
    drag: str = "zoom"
    plot: ui.plotly | None = None
    rows: dict[tuple[str, int], ui.input] = field(default_factory=dict)

    def setup(self) -> RecordSetup:
        """The setup as it is now."""
        return self.session.file_setup.look(self.ident).setup

    # --- the picture, and stretches of it --------------------------------------------------------

    def picture(self, data: Mapping[str, Any]) -> None:
        """The first columns over rows, on which stretches can be marked."""
        setup = self.setup()
        toggle = ui.toggle(_DRAGS, value=self.drag, on_change=lambda e: self._drag(e.value))
        toggle.props('unelevated no-caps dense padding="2px 10px" aria-label="A drag"')
        toggle.classes("drags")
        layout = {**data["layout"], "shapes": shapes(setup), "dragmode": self._mode(),
                  "selectdirection": "h"}  # fmt: skip
        said = f"The first columns of {setup.name}, row by row"
        self.plot = frame.plot({**data, "layout": layout}, "columns", said)
        self.plot.on("plotly_selected", self._marked, args=["range"])
        with ui.element("div").classes("stretches"):
            for use, name in ((FIT, "Fitted rows"), (TEST, "Test rows")):
                ui.html(f"<i style='background:{_COLOURS[use]}'></i>{name}", sanitize=False)
                for end, word in enumerate(("from", "to")):
                    self.rows[use, end] = self._row(use, end, f"{name} {word}")
            ui.button("All rows", on_click=lambda: self.change(fit_rows=(), test_rows=())).props(
                "flat dense")  # fmt: skip
        ui.html(f"<p class='soft'>{_SAID}</p>", sanitize=False)

    def mark(self) -> None:
        """Show the stretches as they are chosen now."""
        if self.plot is None or self.plot.is_deleted:
            return
        setup = self.setup()
        self.plot.run_plot_method("relayout", {"shapes": shapes(setup), "selections": []})
        for (use, end), box in self.rows.items():
            rows = _rows(setup.choice, use)
            wanted = str(rows[end]) if rows else ""
            if box.value != wanted:
                box.set_value(wanted)

    def _mode(self) -> str:
        return "zoom" if self.drag == "zoom" else "select"

    def _drag(self, what: str) -> None:
        self.drag = what
        if self.plot is not None:
            self.plot.run_plot_method("relayout", {"dragmode": self._mode(), "selections": []})

    def _marked(self, event: Any) -> None:
        ends = next((v for k, v in ((event.args or {}).get("range") or {}).items()
                     if k.startswith("x")), None)  # fmt: skip
        if ends and self.drag in _COLOURS:
            self._take(self.drag, round(min(ends)), round(max(ends)))

    def _take(self, use: str, first: int, stop: int) -> None:
        setup = self.setup()
        if use == TEST and setup.files(TEST):
            ui.notify(_HAS_TEST, type="warning", position="top", close_button="Close")
            self.mark()
            return
        choice = kept.stretches(setup.choice, use, first, stop, setup.rows)
        self.change(fit_rows=choice.fit_rows, test_rows=choice.test_rows)

    def _row(self, use: str, end: int, label: str) -> ui.input:
        rows = _rows(self.setup().choice, use)
        hint = "all" if (use, end) == (FIT, 0) else ""
        box = ui.input(value=str(rows[end]) if rows else "", placeholder=hint,
                       on_change=lambda: self._typed(use))  # fmt: skip
        box.props["aria-label"] = label
        return box.props("outlined dense debounce=900 inputmode=numeric")

    def _typed(self, use: str) -> None:
        """Two whole numbers make a stretch, two empty fields all rows; anything else waits."""
        texts = [(self.rows[use, end].value or "").strip() for end in (0, 1)]
        now = _rows(self.setup().choice, use)
        if not any(texts) and now:
            self.change(**{f"{use}_rows": ()})
        elif all(t.isdecimal() for t in texts):
            first, stop = (int(t[:12]) for t in texts)
            if first < stop and (first, stop) != now:
                self._take(use, first, stop)

    # --- further files ---------------------------------------------------------------------------

    def files(self) -> None:
        """All files of this machine with what each is for, and room for another."""
        setup = self.setup()
        ui.html("<h2 class='head'>Records of this machine</h2>", sanitize=False)
        with ui.element("div").classes("files").props('id="files"'):
            ui.html(f"<b>{escape(setup.name)}</b>", sanitize=False)
            ui.html("<span class='soft'>fitted</span>", sanitize=False)
            for other in setup.others:
                ui.html(f"<b>{escape(other['name'])}</b>", sanitize=False)
                box = ui.select(_USES, value=other["use"])
                box.on_value_change(functools.partial(self._use, other))
                box.props["aria-label"] = f"{other['name']} is"
                box.props("outlined dense options-dense")
        drop_zone(self.ident)
        with ui.row().classes("items-center no-wrap gap-2").style("margin-top:8px"):
            where = ui.input(placeholder="or its path on this machine").props("outlined dense")
            where.props["aria-label"] = "path of another file"
            where.style("flex:1 1 auto").on("keydown.enter", lambda: self._read(where))
            ui.button("Add", on_click=lambda: self._read(where)).props("outline")

    def _use(self, other: Mapping[str, str], event: Any) -> None:
        self.session.file_setup.use(self.ident, other["path"], other["name"], event.value)

    def _read(self, where: ui.input) -> None:
        try:
            self.session.file_setup.beside(self.ident, where.value or "")
        except SpiralError as error:
            frame.refused(error)

    # --- how inputs and a rotor's sensors are given ----------------------------------------------

    def instruments(self) -> None:
        """How inputs run between samples; of a rotor the pulse, its sense, and where probes sit."""
        setup = self.setup()
        system, choice = setup.system(), setup.choice
        if system is None:
            return
        rotor = any(i["name"] == "speed" for i in system["inputs"])
        chosen = [i["name"] for i in system["inputs"] if i["required"]]
        known = bool(choice.hold or choice.pulse or choice.rotation or choice.angles)
        with ui.expansion("Sensors and inputs", value=known).classes("w-full"), \
                ui.element("div").classes("instruments"):  # fmt: skip
            ways = {"": "not known: found from the record", **BETWEEN}
            for name in chosen:
                self._select(f"{panels.words(name)} between samples", ways,
                             choice.hold.get(name, ""), "hold", name)  # fmt: skip
            if rotor:
                columns = {"": "none", **{c["name"]: c["name"] for c in setup.columns}}
                self._select("once-per-turn pulse", columns, choice.pulse, "pulse")
                turns = {"": "counterclockwise", "clockwise": "clockwise"}
                self._select("sense of rotation", turns, choice.rotation, "rotation")
                for channel in system["channels"]:
                    self._angle(channel["name"])

    def _select(
        self, label: str, options: Mapping[str, str], value: str, what: str, key: str = ""
    ) -> None:
        def choose(event: Any) -> None:
            chosen = event.value or ""
            now = getattr(self.setup().choice, what)
            self.change(**{what: {**now, key: chosen} if key else chosen})

        ui.label(label)
        box = ui.select(dict(options), value=value if value in options else "", on_change=choose)
        box.props["aria-label"] = label
        box.props("outlined dense options-dense")

    def _angle(self, channel: str) -> None:
        label = f"probe {channel}, degrees from the first axis"

        def choose(event: Any) -> None:
            now = self.setup().choice.angles
            self.change(angles={**now, channel: event.value or ""})

        ui.label(label)
        box = ui.input(value=self.setup().choice.angles.get(channel, ""), on_change=choose)
        box.props["aria-label"] = label
        box.props("outlined dense debounce=700")


def shapes(setup: RecordSetup) -> list[dict[str, Any]]:
    """Shaded stretches of the picture: what is fitted, what is the test."""
    return [
        {"type": "rect", "xref": "x", "yref": "paper", "x0": rows[0], "x1": rows[1], "y0": 0,
         "y1": 1, "fillcolor": colour, "opacity": 0.16, "line": {"width": 0}, "layer": "below"}
        for use, colour in _COLOURS.items() if (rows := _rows(setup.choice, use))
    ]  # fmt: skip


def _rows(choice: Choice, use: str) -> tuple[int, ...]:
    return choice.fit_rows if use == FIT else choice.test_rows


def foresight(found: Mapping[str, Any], waiting: bool) -> str:
    """What the record can tell apart, in words; nothing where that was not asked yet."""
    if waiting and not found:
        said = "Looking what this record can tell apart, before any fit …"
        return f"<p class='soft' id='foresight'>{said}</p>"
    if not found:
        return ""
    if "unknown" in found:
        return f"<p class='soft' id='foresight'>{escape(found['unknown'])}</p>"
    if not found["alike"]:
        said = f"This record can tell all {found['terms']} terms apart: those of the model, and "
        said += "those that may be missing."
        short = found["needed"] and found["needed"] > found["samples"]
        said += f" To be sure of a small one takes {found['needed']:.0f} samples" if short else ""
        said += f"; it has {found['samples']}." if short else ""
        return f"<p class='good' id='foresight'>{escape(said)}</p>"
    items = "".join(f"<li>{escape(_group(g, found['own']))}</li>" for g in found["alike"])
    return (
        "<div class='note caveats' id='foresight'><b>Before any fit: this record cannot tell "
        f"apart</b><ul>{items}</ul>{escape(_excite(found['advice']))}</div>"
    )


def _group(labels: Sequence[str], own: Sequence[str]) -> str:
    """The effects of a group, those of the model first and marked."""
    names = [f"{panels.words(e)} (in the model)" for e in labels if e in own]
    names += [panels.words(e) for e in labels if e not in own]
    left = len(names) - _MOST
    return unseen.listed([*names[:_MOST], *([f"{left} more"] if left > 0 else [])])


def _excite(advice: str) -> str:
    """What to do, without the groups that the advice begins with and the command it ends with."""
    told = advice.partition(": ")[2].partition(". ")[2] or advice
    return told.partition("; plan it with")[0].rstrip(".") + "."
