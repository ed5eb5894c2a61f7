"""Setups of uploaded files: the fit process reads and checks each before a study is made of it."""

from __future__ import annotations

import hashlib
import shutil
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from spiral.app import record_setup as setups
from spiral.app.processes import Event
from spiral.app.record_setup import Choice, RecordSetup
from spiral.io.readers.limits import memory_limit, time_limit
from spiral.io.readers.table import find_file
from spiral.io.writing import write_whole
from spiral.types.errors import ConfigError

Give = Callable[[Mapping[str, Any]], None]
FORESEE = "foresee"
EQUATIONS = "read_equations"
FILE_ORDERS = ("describe_file", "check", EQUATIONS, FORESEE)


@dataclass(frozen=True)
class OpenFile:
    """A setup with what is under way for it; ``version`` grows with every change.

    ``foreseeing``: the identifiability forecast (``foresight``) is under way. ``asked`` numbers the
    mappings, so that answers to an earlier one are dropped.
    """

    setup: RecordSetup
    version: int = 0
    busy: str = ""
    asked: int = 0
    foreseeing: bool = False


class FileSetup:
    """All setups of one folder of runs; ``give`` sends an order, ``forgo`` cancels a forecast."""

    def __init__(
        self, out: Path, give: Give, forgo: Callable[[str], object], plugins: str | None,
        lock: threading.RLock,
    ) -> None:  # fmt: skip
        self._out, self._give, self._plugins, self._lock = out, give, plugins, lock
        self._forgo = forgo
        self._open: dict[str, OpenFile] = {}

    def create_setup(self, name: str) -> RecordSetup:
        """A new setup with a folder for a file of this name."""
        return setups.new_setup(self._out, name)

    def discard_setup(self, setup: RecordSetup) -> None:
        """Delete the folder of a file that did not arrive."""
        shutil.rmtree(setups.setup_folder(self._out, setup.ident), ignore_errors=True)

    def read_arrived_file(self, setup: RecordSetup) -> None:
        """Order that a file, now complete on disk, be read."""
        with self._lock:
            version = self._open[setup.ident].version if setup.ident in self._open else 0
            self._store_file(OpenFile(setup, version, busy="Reading the file"))
            folder = str(setups.setup_folder(self._out, setup.ident))
            layout = {"separator": setup.separator or None, "decimal": setup.decimal or None}
            order = self._file_order(setup, "describe_file")
            self._give({**order, **layout, "path": setup.path, "folder": folder})

    def reread_file(self, ident: str, separator: str, decimal: str) -> None:
        """Read a text file again with this column separator and this decimal mark."""
        setup = self.current_file(ident).setup
        told = {"separator": separator, "decimal": decimal.strip(), "trouble": None}
        self.read_arrived_file(replace(setup, **told))

    def open_local_file(self, path: str) -> str:
        """A file on this machine, read where it lies; returns the setup's name.

        Raises
        ------
        InputError : no such file.
        """
        file = find_file(path.strip()).resolve()
        setup = replace(setups.new_setup(self._out, file.name), path=str(file))
        self.read_arrived_file(setup)
        return setup.ident

    def current_file(self, ident: str) -> OpenFile:
        """A setup as it is now.

        Raises
        ------
        ConfigError : no such setup.
        """
        with self._lock:
            if ident not in self._open:
                self._open[ident] = OpenFile(setups.load_setup(self._out, ident))
            return self._open[ident]

    def change_choice(self, ident: str, choice: Choice) -> None:
        """Take another mapping of columns; where it is complete, order that the record be read."""
        with self._lock:
            opened = self.current_file(ident)
            if choice.system != opened.setup.choice.system:
                setup = _setup_for_system(opened.setup, choice.system)
                opened, choice = replace(opened, setup=setup), setup.choice
            self._check_mapping(replace(opened, setup=replace(opened.setup, choice=choice)))

    def join_file(self, ident: str, file: Path, name: str) -> None:
        """One more file of the same machine: the test, where there is none yet, else to fit."""
        with self._lock:
            setup = self.current_file(ident).setup
            use = setups.FIT if setup.files(setups.TEST) else setups.TEST
            self.set_file_use(ident, str(file), name, use)

    def set_file_use(self, ident: str, path: str, name: str, use: str) -> None:
        """Take a further file for the fit or the test, or leave it out where ``use`` is empty."""
        with self._lock:
            opened = self.current_file(ident)
            one = {"path": path, "name": name, "use": use}
            known = [one if o["path"] == path else o for o in opened.setup.others]
            others = known if one in known else [*known, one]
            setup = replace(opened.setup, others=tuple(o for o in others if o["use"]))
            if use == setups.TEST:  # a whole file is the test now, not rows of the first
                setup = replace(setup, choice=setups.without_test_rows(setup.choice, setup.rows))
            self._check_mapping(replace(opened, setup=setup))

    def free_file_path(self, ident: str, name: str) -> Path:
        """A place for a further file, which is not there yet."""
        folder, wanted = (
            setups.setup_folder(self._out, self.current_file(ident).setup.ident),
            setups.safe_file_name(name),
        )
        for number in range(1, 1000):
            file = folder / (wanted if number == 1 else f"{number}-{wanted}")
            if not file.exists():
                return file
        raise ConfigError(f"a thousandth file {wanted}", "fewer files of one name", "rename it")

    def join_local_file(self, ident: str, path: str) -> None:
        """A further file on this machine, read where it lies.

        Raises
        ------
        InputError : no such file.
        """
        file = find_file(path.strip()).resolve()
        self.join_file(ident, file, file.name)

    def _check_mapping(self, opened: OpenFile) -> None:
        """Store a changed setup without old results; where it is complete, order a new reading.

        The last message stays until the reading ends, so that nothing moves under the mouse.
        """
        if opened.foreseeing:
            self._forgo(opened.setup.ident)
        complete = not setups.missing_choices(opened.setup)
        still = opened.setup.trouble if complete else None
        setup = replace(opened.setup, seen=(), trouble=still, foresight={}, reading={})
        asked = opened.asked + 1
        self._store_file(replace(opened, setup=setup, asked=asked, foreseeing=False,
                          busy="Reading with this mapping" if complete else ""))  # fmt: skip
        if complete:
            self._give(self._mapping_order(setup, "check", asked))

    def _mapping_order(self, setup: RecordSetup, do: str, asked: int) -> dict[str, Any]:
        order = {
            **self._file_order(setup, do),
            "folder": str(setups.setup_folder(self._out, setup.ident)),
        }
        return {**order, "overrides": list(setups.setup_overrides(setup)), "asked": asked}

    def set_equations(self, ident: str, text: str) -> None:
        """Take equations as the system, once they are read; a file of its own for every text."""
        with self._lock:
            opened = self.current_file(ident)
            name = f"equations-{hashlib.sha256(text.encode()).hexdigest()[:12]}.yaml"
            file = setups.setup_folder(self._out, ident) / name
            write_whole(file, text)
            setup = replace(opened.setup, equations=text, trouble=None)
            asked = opened.asked + 1
            self._store_file(
                replace(opened, setup=setup, asked=asked, busy="Reading the equations")
            )
            self._give({**self._file_order(setup, EQUATIONS), "path": str(file), "asked": asked})

    def study_arguments(self, ident: str) -> tuple[str, tuple[str, ...]]:
        """Title and overrides of the study that a setup makes.

        Raises
        ------
        ConfigError : a mapping that is not complete.
        """
        opened = self.current_file(ident)
        setup, lacking = opened.setup, setups.missing_choices(opened.setup)
        if lacking:
            raise ConfigError(f"a mapping without {', '.join(lacking)}", "all of them chosen",
                              "choose what is marked")  # fmt: skip
        if opened.foreseeing:
            self._forgo(ident)  # the first fit needs the processor more
        more = f" and {len(setup.others)} more" if setup.others else ""
        return setup.name + more, setups.setup_overrides(setup)

    def on_event(self, order: Mapping[str, Any], kind: str, data: Event) -> None:
        """Apply a process event to its setup; events about an earlier mapping are dropped."""
        with self._lock:
            opened = self.current_file(str(order["study"]))
            if order.get("asked", opened.asked) != opened.asked:
                return  # the mapping has changed since
            if order["do"] == FORESEE:
                self._on_foresight_event(opened, kind, data)
                return
            setup = opened.setup
            if kind == "columns":
                setup = replace(setup, **{**data, "columns": tuple(data["columns"]),
                                          "systems": tuple(data["systems"]),
                                          "left_out": tuple(data["left_out"])})  # fmt: skip
            elif kind == "system":
                given = (*(s for s in setup.systems if not s.get("own")), data["system"])
                self._use_read_equations(
                    replace(opened, setup=replace(setup, systems=given)), data["system"]
                )
                return
            elif kind == "records":
                setup = replace(setup, seen=tuple(data["records"]), trouble=None)
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
                return  # reading with the new system is under way
            busy = "" if kind in ("done", "failed", "cancelled") else opened.busy
            then = kind == "done" and order["do"] == "check"
            self._store_file(replace(opened, setup=setup, busy=busy, foreseeing=then))
            if then:
                self._give(self._mapping_order(setup, FORESEE, opened.asked))

    def _use_read_equations(self, opened: OpenFile, system: Mapping[str, Any]) -> None:
        """Go on with a system of equations that was read: columns are guessed anew."""
        setup = _setup_for_system(opened.setup, system["name"])
        self._check_mapping(replace(opened, setup=setup))

    def _on_foresight_event(self, opened: OpenFile, kind: str, data: Event) -> None:
        """Keep the identifiability forecast when it comes; where it fails, there is none."""
        if kind == "foresight":
            opened = replace(opened, setup=replace(opened.setup, foresight=dict(data)))
        elif kind not in ("done", "failed", "cancelled"):
            return
        self._store_file(replace(opened, foreseeing=opened.foreseeing and kind == "foresight"))

    def _file_order(self, setup: RecordSetup, do: str) -> dict[str, Any]:
        """An order with its limits of time and memory, which grow with the size of the file."""
        file = Path(setup.path)
        size = file.stat().st_size if file.is_file() else 0
        most = {"seconds": time_limit(size), "memory": memory_limit(size)}
        about = {"study": setup.ident, "plugins": self._plugins, "overrides": []}
        return {"do": do, **about, **most}

    def _store_file(self, opened: OpenFile) -> None:
        self._open[opened.setup.ident] = replace(opened, version=opened.version + 1)
        setups.save_setup(self._out, opened.setup)


def _setup_for_system(setup: RecordSetup, name: str) -> RecordSetup:
    """The setup for another system: columns guessed anew; rows, rate, gaps and *More* kept."""
    system = next(s for s in setup.systems if s["name"] == name)
    was = setup.choice
    kept = {k: getattr(was, k) for k in ("fit_rows", "test_rows", "resample", "fill_gaps", "more")}
    choice = replace(setups.guess_columns(setup.columns, system), **kept)
    return replace(setup, choice=choice, model={})
