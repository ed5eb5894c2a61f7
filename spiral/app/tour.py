"""A guided study: each step explained in words, and one button for the next."""

from __future__ import annotations

from collections.abc import Callable
from html import escape

from nicegui import ui

from spiral.app import panels
from spiral.app.session import LiveStudy, Session
from spiral.app.study import Study, StudyState
from spiral.types.formatting import error_percent, percent

PRESET = "rotor_coastdown"
_BEGIN = (
    "A rotor slows down from 40 Hz to rest. Two sensors see it move in x and y; its tilts are "
    "hidden. The model begins as two springs, two dampers and an unbalance. It is being fitted "
    "now, which takes some seconds; then it predicts another run-down of the same machine."
)
_LOOK = (
    "The large number is the error of that prediction, on data that no fit has seen. Below, "
    "black is measured and blue is the model. Candidates for what is missing are being ranked."
)
_END = (
    "What is left is noise. <i>Take away</i> (top right) holds the report and the model as a "
    "program. Now bring a record of your own: the first page takes a file as it is."
)


def begin_tour(session: Session) -> str:
    """A study on the embedded rotor that tells what to do; returns its name."""
    return session.create("A tour: the rotor", (f"experiment={PRESET}",), tour=True)


def draw_tour_step(scene: LiveStudy, where: Callable[[], None], add: Callable[[str], None]) -> None:
    """What this step shows, and the next click; nothing where the study is no tour.

    ``where`` shows where the model fails; ``add`` admits an effect.
    """
    study, turn = scene.study, scene.study.turn
    if not study.tour:
        return
    with ui.element("section").classes("card tour").props('id="tour" role="status"'):
        ui.html(f"<h2 class='head'>Tour, step {len(study.line) + 1}</h2>", sanitize=False)
        ui.html(f"<p>{_step_text(study, turn, scene.busy is not None)}</p>", sanitize=False)
        if turn is None or turn.candidates is None or scene.busy is not None:
            return
        with ui.row().classes("gap-2"):
            if turn.proposed:
                effect = turn.proposed[0]
                button = ui.button(
                    f"Add {panels.label_words(effect)}", on_click=lambda: add(effect)
                )
                button.props("unelevated padding='4px 14px'")
                ui.button("Where does it fail?", on_click=where).props("outline")
            else:
                ui.link("To the first page", "/").classes("quiet")


def _step_text(study: Study, turn: StudyState | None, busy: bool) -> str:
    """What is seen now, as HTML text."""
    if turn is None:
        return _BEGIN
    error = _error_percent(turn)
    if turn.candidates is None:
        return (
            f"{_error_change_text(study)} {_LOOK}"
            if len(study.line) == 1
            else _error_change_text(study)
        )
    if not turn.proposed:
        noise = f" Noise alone makes {percent(study.noise_floor)}." if study.noise_floor else ""
        return f"{_error_change_text(study)}{noise} {_END}"
    name = f"<b>{escape(panels.label_words(turn.proposed[0]))}</b>"
    first = (
        "The list <i>What is missing</i> has what it may be, by the share of the error it explains."
    )
    said = first if len(study.line) == 1 else f"{_error_change_text(study)} The list was made anew."
    if busy:
        return f"{said} Being tried: {name}, on data that took no part in its choice."
    return f"{said} {name} is confirmed: add it, and watch the error take a step down from {error}."


def _error_change_text(study: Study) -> str:
    line = study.line
    if len(line) < 2:
        return "".join(f"The error is {_error_percent(one)}." for one in line)
    before, now = line[-2], line[-1]
    name = escape(panels.label_words(now.added))
    return (
        f"With <b>{name}</b> the error went from {_error_percent(before)} to {_error_percent(now)}."
    )


def _error_percent(turn: StudyState) -> str:
    return error_percent(turn.result.get("test_error"))
