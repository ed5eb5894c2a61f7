"""Equations typed into a box as the system of a study, in the form of docs/how-to/own-model.md."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping

from nicegui import ui

from spiral.app import frame
from spiral.app.file_setup import EQUATIONS
from spiral.app.record_setup import RecordSetup

_FILE = re.compile(r"^\S*equations-[0-9a-f]{12}\.yaml: ")  # a name nobody typed
BEGINNING = """\
title: Two masses, the second one hidden
equations:
  - m1*x'' + c*x' + k*x = kc*(z - x) + F
  - m2*z'' = kc*(x - z)
states: {x: m, z: m}
inputs: {F: N}
parameters:
  m1: 1.0 kg
  m2: 0.2 kg
  c: N*s/m
  k: N/m
  kc: N/m
observed: [x]
"""
_SAID = (
    "Equations as in a book, x' and x'' for rates, units for all. A parameter with a value is "
    "known, one with a unit alone is found by the fit. States that are not observed are hidden."
)


def equations_error(setup: RecordSetup) -> Mapping[str, str] | None:
    """The error in the typed equations, or nothing; it is shown beside their text box."""
    trouble = setup.trouble or {}
    if trouble.get("at") != EQUATIONS:
        return None
    return {**trouble, "given": _FILE.sub("", trouble["given"])}


def draw_equations_form(setup: RecordSetup, take: Callable[[str], None]) -> None:
    """A box for equations, the beginning of an example in it, and what is wrong with them."""
    error = equations_error(setup)
    with ui.expansion("Write equations of your own", value=bool(setup.equations)).classes(
        "w-full equations"
    ):
        ui.html(f"<p class='soft'>{_SAID}</p>", sanitize=False)
        box = ui.textarea(value=setup.equations or BEGINNING)
        box.props["aria-label"] = "Equations of the system"
        box.props("outlined dense autogrow spellcheck=false").classes("w-full")
        if error:
            with frame.error_box(error):
                pass
        button = ui.button("Use these equations", on_click=lambda: take(box.value or ""))
        button.props("outline").style("margin-top:6px")
