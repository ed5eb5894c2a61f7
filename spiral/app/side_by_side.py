"""Steps of a study side by side: predictions overlaid, errors by horizon and channel, parameters.

All of it is read from what the steps left on disk; nothing is fitted.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from html import escape
from typing import Any

from nicegui import ui

from spiral.app import horizon_errors
from spiral.app.figures import Figures, Span
from spiral.app.session import LiveStudy
from spiral.app.study import Study, StudyState, turn_folder
from spiral.types.errors import SpiralError
from spiral.types.formatting import digits, error_percent, plus_minus
from spiral.types.run import estimate_rows
from spiral.view.report.style import add_hover_text, label_words, typeset_unit

NAME, MOST = "beside", 6
_SAID = (
    "The test record, measured and as each step predicts it freely, and below what each misses. "
    "Drag to see every sample of a stretch."
)


@dataclass
class SideBySide:
    """What one tab of the browser compares: ``chosen`` are serials of steps.

    ``again`` has the comparison drawn anew, ``changed`` is told that something else was chosen.
    """

    figures: Figures
    again: Callable[[], None]
    changed: Callable[[], None]
    chosen: tuple[int, ...] = ()
    opened: bool = field(init=False)

    def __post_init__(self) -> None:
        self.opened = len(self.chosen) > 1

    def build(self, scene: LiveStudy) -> None:
        """The choice of steps and, where it is opened, what they come to; nothing for one step."""
        study = scene.study
        if len(study.turns) < 2:
            return
        box = ui.expansion("Compare steps and branches side by side", value=self.opened)
        with box.classes("w-full").props('id="beside"'):
            if self.opened:
                self._draw_content(study)
        box.on_value_change(self._toggle_open)

    def address(self) -> tuple[int, ...]:
        """The steps that a link to this view names."""
        return self.chosen if self.opened else ()

    def _toggle_open(self, event: Any) -> None:
        if bool(event.value) != self.opened:
            self.opened = bool(event.value)
            self.changed()
            self.again()

    def _draw_content(self, study: Study) -> None:
        turns = self.chosen_turns(study)
        with ui.row().classes("gap-2").props('role="group" aria-label="steps to compare"'):
            for turn in study.turns:
                box = ui.checkbox(_step_path(study, turn), value=turn in turns)
                box.on_value_change(functools.partial(self._toggle_step, turn.serial))
                box.set_enabled(turn in turns or len(turns) < MOST)
        if len(turns) < 2:
            ui.html("<p class='soft'>Tick two steps or more.</p>", sanitize=False)
            return
        self._draw_overlay(study, turns)
        ui.html(comparison_errors(study, turns), sanitize=False).classes("w-full").style(
            "margin-bottom:14px"
        )
        ui.html(comparison_parameters(study, turns), sanitize=False).classes("w-full")

    def chosen_turns(self, study: Study) -> list[StudyState]:
        """The steps chosen; at first the ends of all branches, or the last step and the first."""
        known = [t for t in study.turns if t.serial in self.chosen]
        if not self.chosen:
            ends = [t for t in study.turns if not study.after(t.serial)]
            known = ends[-MOST:] if len(ends) > 1 else [study.turns[0], *ends]
            self.chosen = tuple(t.serial for t in known)
        return known[:MOST]

    def _toggle_step(self, serial: int, event: Any) -> None:
        left = [s for s in self.chosen if s != serial]
        self.chosen = tuple(sorted([*left, serial] if event.value else left)) or (-1,)
        self.changed()
        self.again()

    def _draw_overlay(self, study: Study, turns: Sequence[StudyState]) -> None:
        names = [step_name(study, t) for t in turns]
        folders = [turn_folder(self.figures.session.out, study.ident, t.serial) for t in turns]

        def overlay_figure(looked_at: Span | None) -> Any:
            from spiral.io.curves import read_curves
            from spiral.view.report.overlay import overlay_models

            labelled_curves = []
            for label, folder in zip(names, folders, strict=True):
                try:
                    curves = read_curves(folder / "free")
                except SpiralError:
                    continue
                labelled_curves += [] if curves is None else [(label, curves)]
            return overlay_models(labelled_curves, looked_at)

        def read_traces(looked_at: Span | None) -> list[Any]:
            figure = overlay_figure(looked_at)
            return [] if figure is None else [(t.x, t.y) for t in figure.data]

        figure = overlay_figure(None)
        if figure is None:
            ui.html("<p class='soft'>No free run of these steps is finite.</p>", sanitize=False)
            return
        data = add_hover_text(figure).to_plotly_json()
        self.figures.draw_figure(data, NAME, _SAID, read_traces)
        ui.html(f"<p class='caption'>{escape(_SAID)}</p>", sanitize=False)


def step_name(study: Study, turn: StudyState) -> str:
    """A step in a few words: what it added, with its number where another added the same."""
    if not turn.added:
        return "the model as it was"
    alike = [t for t in study.turns if t.added == turn.added]
    which = f" ({alike.index(turn) + 1})" if len(alike) > 1 else ""
    return f"+ {label_words(turn.added)}{which}"


def _step_path(study: Study, turn: StudyState) -> str:
    """A step with all that was added before it, and its error."""
    said = [step_name(study, turn)]
    before = turn
    while before.parent is not None and (above := study.turn_of(before.parent)) is not None:
        said.insert(0, step_name(study, above))
        before = above
    path = " ".join(said[1:]) or said[0]
    return f"{path}: {error_percent(turn.result.get('test_error'))}"


def comparison_errors(study: Study, turns: Sequence[StudyState]) -> str:
    """Errors of steps on the test record, by horizon and by channel; the least of a row is bold."""
    of = [
        {horizon_errors.horizon_label(h): h["error"] for h in t.result.get("unseen") or ()}
        for t in turns
    ]
    horizons = dict.fromkeys(h for entries in of for h in entries)
    rows = [(horizon, [entries.get(horizon) for entries in of]) for horizon in horizons]
    channels = [t.result.get("channels") or {} for t in turns]
    for channel in dict.fromkeys(c for entries in channels for c in entries):
        share = [entries.get(channel, {}).get("relative") for entries in channels]
        rows.append((f"free run, {channel}", share))
    rows.append(("fitted record, free run", [t.result.get("fit_error") for t in turns]))
    shown = [
        (label, [error_percent(v) for v in values], _index_of_least(values))
        for label, values in rows
    ]
    chi2 = [digits(t.result.get("chi2_per_dof")) for t in turns]
    return _comparison_table(
        study, turns, "error on", [*shown, ("χ² per degree of freedom", chi2, None)]
    )


def comparison_parameters(study: Study, turns: Sequence[StudyState]) -> str:
    """Every parameter with its standard error in each step; a dash where a model has none."""
    tables = [
        {(r["effect"], r["parameter"]): r for r in estimate_rows({"model": t.result.get("model")})}
        for t in turns
    ]
    rows = []
    for key in dict.fromkeys(k for table in tables for k in table):
        unit = next(table[key]["unit"] for table in tables if key in table)
        cells = [
            plus_minus(table[key]["estimate"], table[key].get("se")) if key in table else "-"
            for table in tables
        ]
        shown = typeset_unit(unit or "1")
        rows.append(
            (", ".join(map(label_words, key)) + (f" ({shown})" if shown else ""), cells, None)
        )
    return _comparison_table(study, turns, "parameter", rows)


Rows = Sequence[tuple[str, Sequence[str], int | None]]
"""A row's name, its cells, and which of them stands out."""


def _comparison_table(study: Study, turns: Sequence[StudyState], what: str, rows: Rows) -> str:
    head = "".join(f"<th class='n'>{escape(step_name(study, t))}</th>" for t in turns)
    body = ""
    for label, cells, best in rows:
        inside = [f"<b>{escape(c)}</b>" if i == best else escape(c) for i, c in enumerate(cells)]
        numbers = "".join(f"<td class='n'>{cell}</td>" for cell in inside)
        body += f"<tr><td>{escape(label)}</td>{numbers}</tr>"
    return (
        f"<div class='wide' tabindex='0'><table class='plain'><tr><th>{what}</th>{head}</tr>"
        f"{body}</table></div>"
    )


def _index_of_least(values: Sequence[float | None]) -> int | None:
    known = [v for v in values if v is not None]
    return values.index(min(known)) if len(set(known)) > 1 else None
