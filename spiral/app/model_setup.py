"""The model before any fit: every parameter with unit, bounds and value, known or to be found.

What is chosen here becomes ``effect=``, ``without=``, ``values=``, ``fixed=`` and ``free=`` of the
command line.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from html import escape
from typing import Any

from nicegui import ui

from spiral.app import frame, panels
from spiral.app.record_setup import Choice, RecordSetup
from spiral.types.formatting import number
from spiral.view.report.style import typeset_unit

Change = Callable[..., None]
"""Take over other fields of a ``Choice``."""


def draw_model_setup(setup: RecordSetup, now: Callable[[], Choice], change: Change) -> None:
    """Switches of the seed's effects, and a table of the parameters; nothing before it is known.

    ``now`` gives what is chosen at the moment of a click.
    """
    if not setup.model:
        return

    def switch_effect(label: str, event: Any) -> None:
        left = {*now().without} - {label} | (set() if event.value else {label})
        change(without=tuple(e["label"] for e in setup.model["seed"] if e["label"] in left))

    ui.html("<h2 class='head'>The model as it begins</h2>", sanitize=False)
    frame.draw_sketch(setup.model["sketch"])
    with ui.element("div").classes("seed"):
        for effect in setup.model["seed"]:
            label = effect["label"]
            box = ui.switch(panels.label_words(label), value=label not in setup.choice.without)
            box.on_value_change(functools.partial(switch_effect, label))
            ui.html(panels.effect_meaning(effect["meaning"]), sanitize=False).classes("soft")
    _draw_added_effects(setup, now, change)
    with (
        ui.element("div").classes("wide").props("tabindex=0"),
        ui.element("div").classes("parameters"),
    ):
        for head in ("parameter", "value (SI)", "unit", "bounds", "found by the fit"):
            ui.html(f"<b>{head}</b>", sanitize=False)
        for row in setup.model["parameters"]:
            _draw_parameter_row(row, now, change)


def _draw_added_effects(setup: RecordSetup, now: Callable[[], Choice], change: Change) -> None:
    """Effects that the model begins with besides its seed, and fields for another at a port."""
    for label in setup.choice.effects:
        with ui.row().classes("items-center no-wrap gap-2 begun-with"):
            ui.html(f"+ {escape(panels.label_words(label))}", sanitize=False)
            left = tuple(e for e in setup.choice.effects if e != label)
            button = ui.button("Remove", on_click=functools.partial(change, effects=left))
            button.props("flat dense")
            button.props["aria-label"] = f"Remove {panels.label_words(label)}"
    addable = {e["name"]: e for e in setup.model.get("addable") or ()}
    if not addable:
        return

    def show_ports(event: Any) -> None:
        about = addable[event.value]
        port.set_options(about["ports"], value=next(iter(about["ports"])))
        said.set_content(panels.effect_meaning(about["meaning"]))
        add.set_enabled(True)

    def add_effect() -> None:
        change(effects=tuple(dict.fromkeys((*now().effects, port.value))))

    with ui.element("div").classes("add-effect"):
        names = {name: panels.label_words(name) for name in addable}
        box = ui.select(names, label="Also in the model: effect", on_change=show_ports)
        port = ui.select({}, label="at port")
        for one in (box, port):
            one.props("outlined dense options-dense")
        add = ui.button("Put it in", on_click=add_effect).props("outline")
        add.set_enabled(False)
    said = ui.html("", sanitize=False).classes("soft")


def _draw_parameter_row(row: Mapping[str, Any], now: Callable[[], Choice], change: Change) -> None:
    key, low, high, value = row["key"], row["lower"], row["upper"], row["value"]
    owner = "" if row["owner"] == "system" else f"{panels.label_words(row['owner'])}, "
    name = f"{owner}{panels.label_words(row['name'])}"
    ui.html(escape(name), sanitize=False)
    box = ui.input(
        value=now().values.get(key, ""),
        placeholder="not known" if value is None else number(value, 5),
        on_change=lambda e: change(values={**now().values, key: e.value or ""}),
    )
    box.props["aria-label"] = f"value of {name}"
    box.props("outlined dense debounce=700")
    ui.html(escape(typeset_unit(row["unit"] or "1") or "1"), sanitize=False)
    ends = (
        "none" if low is None and high is None else f"{_format_bound(low)} … {_format_bound(high)}"
    )
    ui.html(ends, sanitize=False)
    free = ui.checkbox(value=now().free.get(key, row["free"]))
    free.props["aria-label"] = f"{name} is found by the fit"
    free.on_value_change(lambda e: change(free={**now().free, key: e.value}))


def _format_bound(bound: float | None) -> str:
    return "" if bound is None else number(bound)
