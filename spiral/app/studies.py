"""The list of studies: search, rename, annotate, export and delete."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from html import escape

from nicegui import ui

from spiral.app import frame, panels
from spiral.app.session import Session
from spiral.app.study import Study
from spiral.types.errors import SpiralError
from spiral.types.formatting import percent

_LISTED = 12  # studies before "show all"
_STAYS = "Its figures and branches are gone then. The runs that its steps were saved as stay."
_HEADS = ("study", "added", "test error", "begun", "")


def draw_study_list(session: Session) -> None:
    """All studies, the latest first; those without a fit apart. Nothing where there are none."""
    known = session.studies()
    if not known:
        return
    with ui.element("section").classes("card"):
        ui.html("<h2 class='head'>Go on with a study</h2>", sanitize=False)
        box = ui.input(placeholder="Search names, notes and effects").props(
            "outlined dense clearable debounce=200 aria-label='Search studies'"
        )
        box.style("max-width:420px")
        place = ui.element("div").props('id="studies"')
        shown = {"all": False}

        def redraw_list() -> None:
            place.clear()
            matches = [s for s in session.studies() if _matches_words(s, box.value or "")]
            with place:
                _draw_study_tables(session, matches, shown, redraw_list)

        box.on_value_change(redraw_list)
        redraw_list()


def _draw_study_tables(
    session: Session, matches: Sequence[Study], shown: dict[str, bool], draw: Callable[[], None]
) -> None:
    fitted, failed = [s for s in matches if s.line], [s for s in matches if not s.line]
    if not matches:
        ui.html("<p class='soft'>No study has these words.</p>", sanitize=False)
    few = fitted if shown["all"] else fitted[:_LISTED]
    if few:
        _draw_study_table(session, few, draw)
    if len(few) < len(fitted):

        def show_all() -> None:
            shown["all"] = True
            draw()

        ui.button(f"Show all {len(fitted)}", on_click=show_all).props("flat dense")
    if failed:
        name = f"{len(failed)} without a fit" if fitted else "Studies without a fit"
        with ui.expansion(name, value=not fitted).classes("w-full"):
            _draw_study_table(session, failed, draw)


def _draw_study_table(session: Session, entries: Sequence[Study], draw: Callable[[], None]) -> None:
    with (
        ui.element("div").classes("wide").props("tabindex=0"),
        ui.element("table").classes("plain studies"),
    ):
        with ui.element("tr"):
            for head in _HEADS:
                said = escape(head) or "<span class='unseen'>more</span>"
                ui.html(said, sanitize=False, tag="th")
        for study in entries:
            with ui.element("tr"):
                for cell in _study_cells(study):
                    ui.html(cell, sanitize=False, tag="td")
                with ui.element("td"):
                    draw_study_menu(session, study, draw, draw)


def _study_cells(study: Study) -> tuple[str, ...]:
    title = f"<a class='quiet' href='/study/{study.ident}'>{escape(study.title)}</a>"
    note = f"<div class='soft'>{escape(study.note)}</div>" if study.note else ""
    added = ", ".join(map(panels.label_words, study.added)) or "none yet"
    error = percent(study.line[-1].result.get("test_error")) if study.line else "-"
    if not study.line:
        added = (study.trouble or {}).get("given", "not fitted yet")
    when = study.created[:16].replace("T", " ")
    return title + note, escape(added[:120]), escape(error), f"{escape(when)} UTC"


def _matches_words(study: Study, words: str) -> bool:
    """Whether a study has all of these words in its name, its note or its effects."""
    text = " ".join((study.title, study.note, *map(panels.label_words, study.added))).casefold()
    return all(word in text for word in words.casefold().split())


def draw_study_menu(
    session: Session, study: Study, changed: Callable[[], None], gone: Callable[[], None]
) -> None:
    """A button with what can be done to a study; ``changed`` and ``gone`` are told afterwards."""
    with ui.button(icon="more_vert").props("flat round dense") as button, ui.menu():
        button.props["aria-label"] = f"Study {study.title}: name, export, delete"
        for said, do in (("Name and note …", _open_name_dialog), ("Delete …", _open_delete_dialog)):
            then = changed if do is _open_name_dialog else gone
            ui.menu_item(said, functools.partial(do, session, study.ident, then)).props(
                'role="menuitem"'
            )
        whole = f"/whole/{study.ident}"
        ui.menu_item("Export the whole study (ZIP)", lambda: ui.navigate.to(whole)).props(
            'role="menuitem"'
        )


def _open_name_dialog(session: Session, ident: str, changed: Callable[[], None]) -> None:
    """A dialog for name and note."""
    study = session.scene(ident).study
    with _new_dialog("Name and note") as dialog, ui.card().classes("card dialog"):
        ui.html("<h2 class='head'>Name and note</h2>", sanitize=False)
        title = ui.input("Name", value=study.title).props("outlined dense").classes("w-full")
        note = ui.textarea("Note", value=study.note).props("outlined autogrow").classes("w-full")

        def save_changes() -> None:
            session.revise(ident, title.value or "", note.value or "")
            dialog.close()
            changed()

        _draw_dialog_buttons(dialog, "Save", save_changes)
    dialog.open()


def _open_delete_dialog(session: Session, ident: str, gone: Callable[[], None]) -> None:
    """A dialog that asks whether a study is to be deleted."""
    study = session.scene(ident).study
    with _new_dialog("Delete this study?") as dialog, ui.card().classes("card dialog"):
        ui.html(f"<h2 class='head'>Delete “{escape(study.title)}”?</h2>", sanitize=False)
        ui.html(f"<p class='soft'>{_STAYS}</p>", sanitize=False)

        def delete_study() -> None:
            dialog.close()
            try:
                session.delete(ident)
            except SpiralError as error:
                frame.notify_error(error)
                return
            gone()

        _draw_dialog_buttons(dialog, "Delete it", delete_study)
    dialog.open()


def _new_dialog(label: str) -> ui.dialog:
    dialog = ui.dialog()
    dialog.props["aria-label"] = label
    dialog.on("hide", dialog.delete)  # nothing of it is left in the page
    return dialog


def _draw_dialog_buttons(dialog: ui.dialog, said: str, do: Callable[[], None]) -> None:
    with ui.row().classes("gap-2").style("margin-top:8px"):
        ui.button(said, on_click=do).props("unelevated")
        ui.button("Cancel", on_click=dialog.close).props("flat")
