"""Files on their way to a study: read and looked at by the process of the fits, kept as setups."""

from __future__ import annotations

import hashlib
import shutil
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from spiral.app import record_setup as kept
from spiral.app.processes import Event
from spiral.app.record_setup import Choice, RecordSetup
from spiral.io.readers.files import find_file
from spiral.io.readers.limits import memory_for, seconds_for
from spiral.io.writing import write_whole
from spiral.types.errors import ConfigError

Give = Callable[[Mapping[str, Any]], None]
FORESEE = "foresee"
EQUATIONS = "read_equations"
DOES = ("describe_file", "check", EQUATIONS, FORESEE)


@dataclass(frozen=True)
class OpenFile:
    """A setup with what is under way for it; ``version`` grows with every change.

    ``foreseeing``: whether it is being looked at what the record can tell apart.
    """

    setup: RecordSetup
    version: int = 0
    busy: str = ""
    asked: int = 0
    foreseeing: bool = False


class FileSetup:
    """All setups of one folder of runs; ``give`` hands an order on, ``forgo`` ends a foresight."""

    def __init__(
        self, out: Path, give: Give, forgo: Callable[[str], object], plugins: str | None,
        lock: threading.RLock,
    ) -> None:  # fmt: skip
        self._out, self._give, self._plugins, self._lock = out, give, plugins, lock
        self._forgo = forgo
        self._open: dict[str, OpenFile] = {}

    def begin(self, name: str) -> RecordSetup:
        """Room for a file of this name."""
        return kept.begun(self._out, name)

    def forget(self, setup: RecordSetup) -> None:
        """The room of a file that did not arrive."""
        shutil.rmtree(kept.place(self._out, setup.ident), ignore_errors=True)

    def arrived(self, setup: RecordSetup) -> None:
        """The file is there: read it."""
        with self._lock:
            version = self._open[setup.ident].version if setup.ident in self._open else 0
            self._put(OpenFile(setup, version, busy="Reading the file"))
            folder = str(kept.place(self._out, setup.ident))
            layout = {"separator": setup.separator or None, "decimal": setup.decimal or None}
            order = self._order(setup, "describe_file")
            self._give({**order, **layout, "path": setup.path, "folder": folder})

    def read_as(self, ident: str, separator: str, decimal: str) -> None:
        """Read a text file again, told what stands between its columns and before fractions."""
        setup = self.look(ident).setup
        told = {"separator": separator, "decimal": decimal.strip(), "trouble": None}
        self.arrived(replace(setup, **told))

    def there(self, path: str) -> str:
        """A file on this machine, read where it lies; returns the setup's name.

        Raises
        ------
        InputError : no such file.
        """
        file = find_file(path.strip()).resolve()
        setup = replace(kept.begun(self._out, file.name), path=str(file))
        self.arrived(setup)
        return setup.ident

    def look(self, ident: str) -> OpenFile:
        """A setup as it is now.

        Raises
        ------
        ConfigError : no such setup.
        """
        with self._lock:
            if ident not in self._open:
                self._open[ident] = OpenFile(kept.load(self._out, ident))
            return self._open[ident]

    def choose(self, ident: str, choice: Choice) -> None:
        """Another mapping; where it is complete, it is looked at with the record's own eyes."""
        with self._lock:
            opened = self.look(ident)
            if choice.system != opened.setup.choice.system:
                setup = _with_system(opened.setup, choice.system)
                opened, choice = replace(opened, setup=setup), setup.choice
            self._check(replace(opened, setup=replace(opened.setup, choice=choice)))

    def join(self, ident: str, file: Path, name: str) -> None:
        """One more file of the same machine: the test, where there is none yet, else to fit."""
        with self._lock:
            setup = self.look(ident).setup
            use = kept.FIT if setup.files(kept.TEST) else kept.TEST
            self.use(ident, str(file), name, use)

    def use(self, ident: str, path: str, name: str, use: str) -> None:
        """Take a further file for the fit or the test, or leave it out where ``use`` is empty."""
        with self._lock:
            opened = self.look(ident)
            one = {"path": path, "name": name, "use": use}
            known = [one if o["path"] == path else o for o in opened.setup.others]
            others = known if one in known else [*known, one]
            setup = replace(opened.setup, others=tuple(o for o in others if o["use"]))
            if use == kept.TEST:  # which a stretch of the first file is no longer
                setup = replace(setup, choice=replace(setup.choice, test_rows=()))
            self._check(replace(opened, setup=setup))

    def room(self, ident: str, name: str) -> Path:
        """A place for a further file, which is not there yet."""
        folder, wanted = kept.place(self._out, self.look(ident).setup.ident), kept.safe(name)
        for number in range(1, 1000):
            file = folder / (wanted if number == 1 else f"{number}-{wanted}")
            if not file.exists():
                return file
        raise ConfigError(f"a thousandth file {wanted}", "fewer files of one name", "rename it")

    def beside(self, ident: str, path: str) -> None:
        """A further file on this machine, read where it lies.

        Raises
        ------
        InputError : no such file.
        """
        file = find_file(path.strip()).resolve()
        self.join(ident, file, file.name)

    def _check(self, opened: OpenFile) -> None:
        """Have a changed setup looked at with the record's own eyes, where it is complete."""
        if opened.foreseeing:
            self._forgo(opened.setup.ident)
        setup = replace(opened.setup, seen=(), trouble=None, foresight={}, reading={})
        complete = not kept.lacking(setup)
        asked = opened.asked + 1
        self._put(replace(opened, setup=setup, asked=asked, foreseeing=False,
                          busy="Reading with this mapping" if complete else ""))  # fmt: skip
        if complete:
            self._give(self._asked(setup, "check", asked))

    def _asked(self, setup: RecordSetup, do: str, asked: int) -> dict[str, Any]:
        order = {**self._order(setup, do), "folder": str(kept.place(self._out, setup.ident))}
        return {**order, "overrides": list(kept.overrides(setup)), "asked": asked}

    def write(self, ident: str, text: str) -> None:
        """Take equations as the system, once they are read; a file of its own for every text."""
        with self._lock:
            opened = self.look(ident)
            name = f"equations-{hashlib.sha256(text.encode()).hexdigest()[:12]}.yaml"
            file = kept.place(self._out, ident) / name
            write_whole(file, text)
            setup = replace(opened.setup, equations=text, trouble=None)
            asked = opened.asked + 1
            self._put(replace(opened, setup=setup, asked=asked, busy="Reading the equations"))
            self._give({**self._order(setup, EQUATIONS), "path": str(file), "asked": asked})

    def question(self, ident: str) -> tuple[str, tuple[str, ...]]:
        """Title and overrides of the study that a setup makes.

        Raises
        ------
        ConfigError : a mapping that is not complete.
        """
        opened = self.look(ident)
        setup, lacking = opened.setup, kept.lacking(opened.setup)
        if lacking:
            raise ConfigError(f"a mapping without {', '.join(lacking)}", "all of them chosen",
                              "choose what is marked")  # fmt: skip
        if opened.foreseeing:
            self._forgo(ident)  # the first fit needs the processor more
        more = f" and {len(setup.others)} more" if setup.others else ""
        return setup.name + more, kept.overrides(setup)

    def on_event(self, order: Mapping[str, Any], kind: str, data: Event) -> None:
        """What the process told of a setup."""
        with self._lock:
            opened = self.look(str(order["study"]))
            if order.get("asked", opened.asked) != opened.asked:
                return  # the mapping has changed since
            if order["do"] == FORESEE:
                self._foreseen(opened, kind, data)
                return
            setup = opened.setup
            if kind == "columns":
                setup = replace(setup, **{**data, "columns": tuple(data["columns"]),
                                          "systems": tuple(data["systems"])})  # fmt: skip
            elif kind == "system":
                given = (*(s for s in setup.systems if not s.get("own")), data["system"])
                self._written(replace(opened, setup=replace(setup, systems=given)), data["system"])
                return
            elif kind == "records":
                setup = replace(setup, seen=tuple(data["records"]))
            elif kind == "reading":
                setup = replace(setup, reading={**data["reading"], "asked": opened.asked})
            elif kind == "model":
                setup = replace(setup, model=dict(data))
            elif kind == "failed":
                setup = replace(setup, trouble={**data, "at": order["do"]})
            elif kind == "cancelled":
                said = f"Cancelled: {opened.busy.lower() or 'reading'}"
                setup = replace(setup, trouble={"given": said, "at": kind})
            elif kind != "done":
                return
            if kind == "done" and order["do"] == EQUATIONS:
                return  # what follows from them is under way
            busy = "" if kind in ("done", "failed", "cancelled") else opened.busy
            then = kind == "done" and order["do"] == "check"
            self._put(replace(opened, setup=setup, busy=busy, foreseeing=then))
            if then:
                self._give(self._asked(setup, FORESEE, opened.asked))

    def _written(self, opened: OpenFile, system: Mapping[str, Any]) -> None:
        """Go on with a system of equations that was read: columns are guessed anew."""
        setup = _with_system(opened.setup, system["name"])
        self._check(replace(opened, setup=setup))

    def _foreseen(self, opened: OpenFile, kind: str, data: Event) -> None:
        """What the record can tell apart, once that is known; a failure is told as not known."""
        if kind == "foresight":
            opened = replace(opened, setup=replace(opened.setup, foresight=dict(data)))
        elif kind not in ("done", "failed", "cancelled"):
            return
        self._put(replace(opened, foreseeing=opened.foreseeing and kind == "foresight"))

    def _order(self, setup: RecordSetup, do: str) -> dict[str, Any]:
        """An order with what it may take, the more the larger the file is."""
        file = Path(setup.path)
        size = file.stat().st_size if file.is_file() else 0
        most = {"seconds": seconds_for(size), "memory": memory_for(size)}
        about = {"study": setup.ident, "plugins": self._plugins, "overrides": []}
        return {"do": do, **about, **most}

    def _put(self, opened: OpenFile) -> None:
        self._open[opened.setup.ident] = replace(opened, version=opened.version + 1)
        kept.save(self._out, opened.setup)


def _with_system(setup: RecordSetup, name: str) -> RecordSetup:
    """A setup for another system: its columns guessed, what is said of rows and *More* kept."""
    system = next(s for s in setup.systems if s["name"] == name)
    was = setup.choice
    rows = {"fit_rows": was.fit_rows, "test_rows": was.test_rows}
    choice = replace(kept.guessed(setup.columns, system), more=was.more, **rows)
    return replace(setup, choice=choice, model={})
