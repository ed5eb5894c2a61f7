"""Undo, redo and branches: the turns of a study as a tree, each reached with one click."""

from __future__ import annotations

import functools
from collections.abc import Callable

from nicegui import ui

from spiral.app import panels
from spiral.app.session import LiveStudy
from spiral.app.study import Study, StudyState
from spiral.types.formatting import error_percent

Move = Callable[[int | None], None]
"""Look at the turn with this serial."""


def draw_undo_redo(scene: LiveStudy, move: Move) -> None:
    """One step back, and one forward for each branch that begins here."""
    study, idle = scene.study, scene.busy is None
    turn = study.turn
    with ui.row().classes("gap-2").style("margin-top:14px"):
        before = None if turn is None else turn.parent
        undo = ui.button("Undo", icon="undo", on_click=lambda: move(before))
        undo.props("outline").set_enabled(idle and before is not None)
        for later in () if turn is None else study.after(turn.serial):
            again = ui.button(f"Redo {panels.label_words(later.added)}", icon="redo")
            again.on_click(functools.partial(move, later.serial))
            again.props("flat").set_enabled(idle)


def draw_branch_tree(scene: LiveStudy, move: Move) -> None:
    """All branches with their errors, where there are several; the line looked at is marked."""
    study = scene.study
    if all(len(study.after(t.serial)) < 2 for t in study.turns):
        return
    ui.html("<h3 class='label' style='margin-top:14px'>Branches, with their free-run error on the "
            "test record</h3>", sanitize=False)  # fmt: skip
    with ui.element("ul").classes("branches").props('id="branches"'):
        for first in study.after(None):
            _draw_branch(scene, first, move)


def _draw_branch(scene: LiveStudy, turn: StudyState, move: Move) -> None:
    """A turn and, below it, the turns made from it; only a fork indents its branches."""
    _draw_branch_entry(scene, turn, move)
    later = scene.study.after(turn.serial)
    for one in later:
        if len(later) == 1:
            _draw_branch(scene, one, move)
            continue
        with ui.element("li"), ui.element("ul"):
            _draw_branch(scene, one, move)


def _draw_branch_entry(scene: LiveStudy, turn: StudyState, move: Move) -> None:
    study: Study = scene.study
    here = study.turn is not None and study.turn.serial == turn.serial
    error = turn.result.get("test_error")
    said = f"+ {panels.label_words(turn.added)}" if turn.added else "the model as it was"
    shown = f"{said}: {error_percent(error)}"
    with ui.element("li"):
        entry = ui.button(shown).props("flat dense align=left")
        entry.set_enabled(scene.busy is None or here)  # the one looked at is not greyed
        if here:
            entry.props('aria-current="step"').classes("here")
            return
        entry.on_click(lambda: move(turn.serial))
        if any(t.serial == turn.serial for t in study.line):
            entry.classes("on-line")
