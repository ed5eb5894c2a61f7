"""A page that stays as it is under a mouse button that is down, so that no click is lost.

A click goes to what lies under the mouse when its button is pressed and when it is released.
Pressing it also takes the focus from a field, whose text then changes what the page shows.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from nicegui import ui

_KEY = "pressed"
_LONGEST = 10.0  # s: a release that was never told, as of a window that lost it, holds no longer
_WATCH = """let pressed = false;
const tell = down => { if (pressed !== down) emitEvent('pressed', pressed = down); };
const after = e => setTimeout(() => tell(false), e.pointerType === 'touch' ? 300 : 0);
addEventListener('pointerdown', () => tell(true), true);
for (const name of ['pointerup', 'pointercancel', 'dragend']) addEventListener(name, after, true);
addEventListener('blur', after);
addEventListener('pointermove', e => { if (!e.buttons) after(e); }, true);"""
"""Messages keep their order: a press is told before what a field lost by it changes, and a release
after its click; of a finger, the click comes some time after it has been lifted."""


@dataclass
class Press:
    """Whether the mouse button of one tab is down; ``since`` is when that was told."""

    since: float | None = None

    def is_held(self) -> bool:
        """Whether nothing may be drawn anew now."""
        return self.since is not None and time.monotonic() - self.since < _LONGEST

    def watch(self, released: Callable[[], None]) -> None:
        """Have the browser tell presses; ``released`` draws what had to wait."""

        def on_change(event: Any) -> None:
            self.since = time.monotonic() if event.args else None
            if not event.args:
                released()

        ui.on(_KEY, on_change)
        ui.run_javascript(_WATCH)
