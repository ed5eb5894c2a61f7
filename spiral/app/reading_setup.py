"""How a file's numbers are read: another rate, gaps, and what instruments read at rest, as fields.

What is chosen here becomes ``record.resample=``, ``record.fill_gaps=`` and ``record.offset=``.
"""

from __future__ import annotations

from collections.abc import Callable
from html import escape

from nicegui import ui

from spiral.app.record_setup import Choice, RecordSetup

_SAID = (
    "A lower rate goes through an anti-alias filter. What each of these does to the numbers is "
    "drawn under <i>What reading changes</i>."
)


def draw_reading_setup(
    setup: RecordSetup, now: Callable[[], Choice], change: Callable[..., None]
) -> None:
    """Fields for the rate, the longest gap that is bridged, and the offset of each series."""
    choice, system = setup.choice, setup.system()
    if system is None:
        return
    known = bool(choice.resample or choice.fill_gaps or any(choice.offsets.values()))
    with ui.expansion("Rate, gaps and offsets", value=known).classes("w-full"):
        with ui.element("div").classes("instruments"):
            _draw_number_input("resample to, Hz", choice.resample, "as it is",
                               lambda text: change(resample=text))  # fmt: skip
            _draw_number_input("bridge gaps of up to, samples", choice.fill_gaps, "refuse gaps",
                               lambda text: change(fill_gaps=text))  # fmt: skip
            for series in (*system["channels"], *system["inputs"]):
                name = series["name"]
                _draw_number_input(
                    f"{name} at rest, in the file's unit", choice.offsets.get(name, ""), "0",
                    lambda text, name=name: change(offsets={**now().offsets, name: text}),
                )  # fmt: skip
        ui.html(f"<p class='soft'>{_SAID}</p>", sanitize=False)


def _draw_number_input(
    label: str, value: str, placeholder: str, take: Callable[[str], None]
) -> None:
    ui.html(escape(label), sanitize=False)
    box = ui.input(value=value, placeholder=placeholder)
    box.on_value_change(lambda event: take(event.value or ""))
    box.props["aria-label"] = label
    box.props("outlined dense debounce=900 inputmode=decimal")
