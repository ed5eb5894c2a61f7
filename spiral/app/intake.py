"""Files on their way to a study: read and looked at by the process of the fits, kept as drafts."""

from __future__ import annotations

import shutil
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from spiral.app import draft as kept
from spiral.app.crew import Event
from spiral.app.draft import Choice, Draft
from spiral.io.readers.files import find_file
from spiral.types.errors import ConfigError

Give = Callable[[Mapping[str, Any]], None]
DOES = ("peek", "check")


@dataclass(frozen=True)
class Desktop:
    """A draft with what is under way for it; ``version`` grows with every change."""

    draft: Draft
    version: int = 0
    busy: str = ""
    asked: int = 0


class Intake:
    """All drafts of one folder of runs."""

    def __init__(self, out: Path, give: Give, plugins: str | None, lock: threading.RLock) -> None:
        self._out, self._give, self._plugins, self._lock = out, give, plugins, lock
        self._open: dict[str, Desktop] = {}

    def begin(self, name: str) -> Draft:
        """Room for a file of this name."""
        return kept.begun(self._out, name)

    def forget(self, draft: Draft) -> None:
        """The room of a file that did not arrive."""
        shutil.rmtree(kept.place(self._out, draft.ident), ignore_errors=True)

    def arrived(self, draft: Draft) -> None:
        """The file is there: read it."""
        with self._lock:
            kept.save(self._out, draft)
            self._open[draft.ident] = Desktop(draft, busy="Reading the file")
            folder = str(kept.place(self._out, draft.ident))
            self._give({**self._order(draft, "peek"), "path": draft.path, "folder": folder})

    def there(self, path: str) -> str:
        """A file on this machine, read where it lies; returns the draft's name.

        Raises
        ------
        InputError : no such file.
        """
        file = find_file(path.strip()).resolve()
        draft = replace(kept.begun(self._out, file.name), path=str(file))
        self.arrived(draft)
        return draft.ident

    def look(self, ident: str) -> Desktop:
        """A draft as it is now.

        Raises
        ------
        ConfigError : no such draft.
        """
        with self._lock:
            if ident not in self._open:
                self._open[ident] = Desktop(kept.load(self._out, ident))
            return self._open[ident]

    def choose(self, ident: str, choice: Choice) -> None:
        """Another mapping; where it is complete, it is looked at with the record's own eyes."""
        with self._lock:
            desktop = self.look(ident)
            if choice.system != desktop.draft.choice.system:
                system = next(s for s in desktop.draft.systems if s["name"] == choice.system)
                choice = replace(kept.guessed(desktop.draft.columns, system), more=choice.more)
            draft = replace(desktop.draft, choice=choice, seen=(), trouble=None)
            complete = not kept.lacking(draft)
            asked = desktop.asked + 1
            self._put(replace(desktop, draft=draft, asked=asked,
                              busy="Reading with this mapping" if complete else ""))  # fmt: skip
            if complete:
                order = self._order(draft, "check")
                self._give({**order, "overrides": list(kept.overrides(draft)), "asked": asked})

    def question(self, ident: str) -> tuple[str, tuple[str, ...]]:
        """Title and overrides of the study that a draft makes.

        Raises
        ------
        ConfigError : a mapping that is not complete.
        """
        draft = self.look(ident).draft
        lacking = kept.lacking(draft)
        if lacking:
            raise ConfigError(f"a mapping without {', '.join(lacking)}", "all of them chosen",
                              "choose what is marked")  # fmt: skip
        return draft.name, kept.overrides(draft)

    def on_event(self, order: Mapping[str, Any], kind: str, data: Event) -> None:
        """What the process told of a draft."""
        with self._lock:
            desktop = self.look(str(order["study"]))
            if order.get("asked", desktop.asked) != desktop.asked:
                return  # the mapping has changed since
            draft = desktop.draft
            if kind == "columns":
                draft = replace(draft, **{**data, "columns": tuple(data["columns"]),
                                          "systems": tuple(data["systems"])})  # fmt: skip
            elif kind == "records":
                draft = replace(draft, seen=tuple(data["records"]))
            elif kind == "failed":
                draft = replace(draft, trouble=dict(data))
            elif kind not in ("done", "cancelled"):
                return
            busy = "" if kind in ("done", "failed", "cancelled") else desktop.busy
            self._put(replace(desktop, draft=draft, busy=busy))

    def _order(self, draft: Draft, do: str) -> dict[str, Any]:
        return {"do": do, "study": draft.ident, "plugins": self._plugins, "overrides": []}

    def _put(self, desktop: Desktop) -> None:
        self._open[desktop.draft.ident] = replace(desktop, version=desktop.version + 1)
        kept.save(self._out, desktop.draft)
