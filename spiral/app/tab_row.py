"""A row of tabs whose widgets stay as others come and go."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from nicegui import ui


class TabRow:
    """Tabs that control one panel; ``chosen`` is told the title of the tab that was clicked."""

    def __init__(self, panel: str, chosen: Callable[[str], None]) -> None:
        self._panel = panel
        self._shown = ""
        self._tabs: dict[str, ui.tab] = {}
        self._row = ui.tabs().props("align=left no-caps outside-arrows mobile-arrows inline-label")

        def on_change(event: Any) -> None:
            if event.value and event.value != self._shown:
                self._shown = event.value
                chosen(event.value)

        self._row.on_value_change(on_change)

    def show(self, titles: Sequence[str], shown: str) -> None:
        """Show tabs of these titles in this order, that of ``shown`` chosen."""
        for title in self._tabs.keys() - set(titles):
            self._tabs.pop(title).delete()
        for place, title in enumerate(titles):
            if title in self._tabs:
                continue
            with self._row:
                self._tabs[title] = ui.tab(title)
            self._tabs[title].props["aria-controls"] = self._panel
            self._tabs[title].move(target_index=place)
        self._shown = shown
        self._row.set_value(shown)
