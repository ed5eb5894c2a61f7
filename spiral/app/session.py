"""The session of the page: all studies and their worker processes, shared by all browser tabs.

The session alone writes ``study.json``. Orders go to two ``processes``; their events change the
study here, and every change has a number by which a tab sees that it is behind.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from spiral.app import horizon_errors
from spiral.app import study as study_files
from spiral.app.file_setup import FILE_ORDERS, FORESEE, FileSetup
from spiral.app.own_effect import effect_overrides, normalize_effect_name
from spiral.app.panels import label_words
from spiral.app.processes import Event, Process
from spiral.app.study import LEARNED, Study, StudyState
from spiral.io.registry import local_sources
from spiral.io.tracking.store import URI_VARIABLE
from spiral.types.errors import ConfigError
from spiral.types.label import name_of

_RANKS = ("start", "add", "rank", "invent")  # orders that end with a ranking
_OF_A_TURN = ("invent", "rank", "preview", "plan")  # orders that make no new one
_FIRST, _AGAIN = 32, 24  # messages of progress that a first fit and a later turn usually send
_LONG = 2000  # letters of a name or a note
_PLANNED = 40  # messages that planning usually sends, one for each test it judges
_EXPECTED = {"start": _FIRST, "add": _AGAIN, "contrast": _AGAIN, "invent": _FIRST,
             "rank": _FIRST, "preview": _AGAIN, "plan": _PLANNED}  # fmt: skip


@dataclass(frozen=True)
class Activity:
    """Work in progress: what, since when, and how many of the expected messages have come.

    ``lasted`` : seconds that the last order of the same kind took in this study; 0 for the first.
    """

    what: str
    serial: int
    words: str = ""
    lasted: float = 0.0
    began: float = field(default_factory=time.monotonic)
    said: int = 0
    expected: int = _FIRST

    @property
    def share(self) -> float:
        """Estimated share that is done: messages so far over the usual number."""
        return min(self.said / self.expected, 0.97)


@dataclass(frozen=True)
class LiveStudy:
    """A study with what is under way; ``version`` grows with every change.

    ``contrast`` are candidates side by side, their chi2 on windows of ``windows`` samples; ``plan``
    the tests that would tell effects apart; ``scored`` candidates of a turn whose ranking is under
    way, as scored before any is refitted.
    """

    study: Study
    version: int = 0
    busy: Activity | None = None
    writing: tuple[int, ...] = ()
    contrast: tuple[Mapping[str, Any], ...] = ()
    windows: int = 0
    plan: Mapping[str, Any] = field(default_factory=dict)
    scored: tuple[Mapping[str, Any], ...] = ()


class Session:
    """All studies of one folder of runs, and the processes that work on them."""

    def __init__(self, out: Path, plugins: str | None = None) -> None:
        self.out, self.plugins = out, plugins
        self._lock = threading.RLock()
        self._scenes: dict[str, LiveStudy] = {}
        self._expected = dict(_EXPECTED)
        self._lasted: dict[tuple[str, str], float] = {}  # s, by study and kind of order
        self._fits = Process("fits", out, self._on_fit_event)
        self._writer = Process("writer", out, self._on_writer_event)
        self.file_setup = FileSetup(
            out, self._route_file_order, self._writer.cancel, plugins, self._lock
        )
        self.broken: tuple[str, ...] = ()

    def close(self) -> None:
        """End the processes."""
        self._fits.close()
        self._writer.close()

    # --- what is there ---------------------------------------------------------------------------

    def local_plugins(self) -> tuple[str, ...]:
        """Files that are run as local plugins."""
        return tuple(map(str, local_sources(self.plugins)))

    def studies(self) -> list[Study]:
        """All studies on disk, the latest first."""
        return study_files.list_studies(self.out)

    def is_loaded(self, ident: str) -> bool:
        """Whether a study is open; one that was deleted is not."""
        return ident in self._scenes

    def scene(self, ident: str) -> LiveStudy:
        """A study as it is now.

        Raises
        ------
        ConfigError, InputError : no such study, or one that cannot be read.
        """
        with self._lock:
            if ident not in self._scenes:
                self._scenes[ident] = LiveStudy(study_files.load_study(self.out, ident))
                self._queue_unsaved_turns(ident)
            return self._scenes[ident]

    # --- what may be asked -----------------------------------------------------------------------

    def create(self, title: str, overrides: tuple[str, ...], tour: bool = False) -> str:
        """A new study, its first fit under way; returns its name.

        Raises
        ------
        ConfigError : an address of MLflow, which is the page's own affair.
        """
        for given in overrides:
            if given.partition("=")[0].lstrip("+") == "tracking.uri":
                raise ConfigError(
                    "tracking.uri on the page", "the address that the page was started with",
                    f"{URI_VARIABLE}=ADDRESS spiral app",
                )  # fmt: skip
        study = study_files.new_study(self.out, title, overrides, tour)
        with self._lock:
            self._scenes[study.ident] = LiveStudy(study)
        self.start(study.ident)
        return study.ident

    def start(self, ident: str) -> None:
        """Fit the seed, where that has not been done."""
        with self._lock:
            scene = self.scene(ident)
            if scene.busy or scene.study.turns:
                return
            self._start_order(scene, "start", "Fitting the model as it is")

    def add(self, ident: str, effect: str, serial: int) -> None:
        """Add an effect to the turn that the asking tab shows; or show it again.

        Raises
        ------
        ConfigError : the study has moved on, or is busy.
        """
        with self._lock:
            scene = self._idle_scene(ident, serial)
            again = [
                t
                for t in scene.study.after(serial)
                if t.added == effect and t.candidates is not None
            ]
            if again and name_of(effect) not in scene.study.own:  # a formula may differ
                self.move(ident, again[-1].serial, serial)
                return
            self._start_order(
                scene,
                "add",
                f"Adding {label_words(effect)}",
                effect=effect,
                base=serial,
                first=scene.study.turns[0].serial,
            )

    def rank(self, ident: str, serial: int) -> None:
        """Rank what a turn lacks, where that was cancelled or failed."""
        with self._lock:
            scene = self._idle_scene(ident, serial)
            self._start_order(scene, "rank", "Looking for what is missing", base=serial)

    def invent(self, ident: str, name: str, formula: str, serial: int, shape: str = "") -> None:
        """Rank anew with a candidate that a formula defines (``own_effect.effect_overrides``).

        ``shape`` is text such as ``w=0.003, b=N/m``: values of gaps and widths, units.

        Raises
        ------
        ConfigError : no name, no formula, no numbers, or a study that has moved on.
        """
        name = normalize_effect_name(name)
        wanted = effect_overrides(name, formula, shape)
        with self._lock:
            scene = self._idle_scene(ident, serial)
            given = [o for o in scene.study.overrides if not o.startswith(f"effect.{name}.")]
            self._start_order(scene, "invent", f"Testing {label_words(name)}", base=serial,
                      overrides=[*given, *wanted], name=name)  # fmt: skip

    def learn(self, ident: str, serial: int) -> None:
        """Rank anew with curves that are learned from the record, where nothing with a name passes.

        Raises
        ------
        ConfigError : the study has moved on, or is busy.
        """
        with self._lock:
            scene = self._idle_scene(ident, serial)
            wanted = [o for o in scene.study.overrides if o.partition("=")[0] != LEARNED]
            self._start_order(scene, "invent", "Learning its curve", base=serial,
                      overrides=[*wanted, f"{LEARNED}=true"], name="")  # fmt: skip

    def preview(self, ident: str, effect: str, serial: int) -> None:
        """Try an effect on the test record; adding it afterwards refits nothing."""
        with self._lock:
            self._start_preview(self._idle_scene(ident, serial), effect, serial)

    def contrast(self, ident: str, effects: tuple[str, ...], serial: int) -> None:
        """Refit with each of these, to see the difference; the study stays as it is."""
        with self._lock:
            scene = self._idle_scene(ident, serial)
            self._start_order(
                scene,
                "contrast",
                f"Comparing {' and '.join(map(label_words, effects))}",
                effects=list(effects),
                base=serial,
            )

    def plan(self, ident: str, effects: tuple[str, ...], serial: int, lengths: str = "") -> None:
        """Look for the test that would tell these apart; the study stays as it is.

        ``lengths`` is text such as ``20, 60``: how long the tests are, in s.

        Raises
        ------
        ConfigError : no numbers above zero, or a study that has moved on.
        """
        durations = _seconds_from_text(lengths)
        with self._lock:
            scene = self._idle_scene(ident, serial)
            what = f"Planning a test for {' and '.join(map(label_words, effects))}"
            self._start_order(
                scene, "plan", what, effects=list(effects), base=serial, durations=durations
            )

    def move(self, ident: str, to: int, serial: int) -> None:
        """Look at another turn: undo, do again, another branch; every turn is kept."""
        with self._lock:
            scene = self._idle_scene(ident, serial)
            self._store_scene(
                replace(scene, study=study_files.select_turn(scene.study, to), contrast=(), plan={})
            )

    def revise(self, ident: str, title: str, note: str) -> None:
        """Another name of a study, where one is given, and another note."""
        with self._lock:
            scene = self.scene(ident)
            title = title.strip()[:_LONG] or scene.study.title
            self._store_scene(
                replace(scene, study=replace(scene.study, title=title, note=note[:_LONG]))
            )

    def delete(self, ident: str) -> None:
        """Delete a study at rest; the runs of its turns stay."""
        with self._lock:
            scene = self.scene(ident)
            if scene.busy or scene.writing:
                raise ConfigError("a study at work", "a study at rest", "wait, or cancel it first")
            study_files.delete_study(self.out, ident)
            del self._scenes[ident]

    def cancel(self, ident: str) -> None:
        """End what is under way; the study stays as it was before."""
        with self._lock:  # an order that is just being given is seen
            self._fits.cancel(ident)

    # --- how it is done --------------------------------------------------------------------------

    def _idle_scene(self, ident: str, serial: int) -> LiveStudy:
        scene = self.scene(ident)
        if scene.busy:
            raise ConfigError(f"a click while {scene.busy.what.lower()}", "a study at rest",
                              "wait, or cancel it first")  # fmt: skip
        if scene.study.turn is None or scene.study.turn.serial != serial:
            raise ConfigError("a click on what another tab has changed meanwhile",
                              "the study as it is now, shown here", "look again")  # fmt: skip
        return scene

    def _start_order(self, scene: LiveStudy, do: str, what: str, **more: Any) -> None:
        serial = scene.study.serials
        study = replace(scene.study, serials=serial + 1, trouble=None)
        lasted = self._lasted.get((study.ident, do), 0.0)
        busy = Activity(what, serial, self._waiting_message(), lasted, expected=self._expected[do])
        self._store_scene(replace(scene, study=study, contrast=(), plan={}, busy=busy))
        self._fits.give({**self._study_order(study, do, serial), **more})

    def _waiting_message(self) -> str:
        """The studies that an order given now waits for, as a process does one order at a time."""
        ahead = [f"“{s.study.title}”" for s in self._scenes.values() if s.busy]
        return f"waits for {horizon_errors.join_words(ahead)}" if ahead else ""

    def _start_preview(self, scene: LiveStudy, effect: str, serial: int) -> None:
        self._start_order(scene, "preview", f"Trying {label_words(effect)} on the test record",
                  effect=effect, base=serial)  # fmt: skip

    def _study_order(self, study: Study, do: str, serial: int) -> dict[str, Any]:
        return {"do": do, "study": study.ident, "serial": serial, "plugins": self.plugins,
                "overrides": list(study.overrides)}  # fmt: skip

    def _store_scene(self, scene: LiveStudy, save: bool = True) -> LiveStudy:
        scene = replace(scene, version=scene.version + 1)
        self._scenes[scene.study.ident] = scene
        if save:
            study_files.save_study(self.out, scene.study)
        return scene

    def _on_fit_event(self, order: Mapping[str, Any], kind: str, data: Event) -> None:
        if kind == "broken":
            self.broken = tuple(data["broken"])
            return
        if order["do"] in FILE_ORDERS:
            self.file_setup.on_event(order, kind, data)
            return
        with self._lock:
            scene = self.scene(order["study"])
            if kind == "progress":
                if scene.busy:
                    busy = replace(scene.busy, words=data["words"], said=scene.busy.said + 1)
                    self._store_scene(replace(scene, busy=busy), save=False)
                return
            if kind in ("done", "failed", "cancelled"):
                self._finish_order(order, kind, data, scene)
                return
            scene = self._apply_event(order, kind, data, scene)
            if kind == "ranked" and order["do"] == "invent":
                own = tuple(dict.fromkeys((*scene.study.own, order["name"])))
                own = tuple(name for name in own if name)
                given = tuple(order["overrides"])
                scene = replace(scene, study=replace(scene.study, overrides=given, own=own))
            self._store_scene(scene)
            if kind == "ranked" and order["do"] != "invent":
                self._queue_run_writing(order["study"], _target_serial(order))

    def _apply_event(
        self, order: Mapping[str, Any], kind: str, data: Event, scene: LiveStudy
    ) -> LiveStudy:
        """The scene after an event that brought a result."""
        study = scene.study
        serial = _target_serial(order)
        if kind == "records":
            values = {k: data.get(k, {}) for k in ("example", "program")}
            values["records"] = tuple(data["records"])
            return replace(scene, study=replace(study, **values))
        if kind == "turn":
            turn = StudyState(serial, data["added"], data["result"])
            study = replace(study_files.add_turn(study, turn), noise_floor=data["noise_floor"])
            return replace(scene, study=study)
        if kind == "contrast":
            return replace(scene, contrast=tuple(data["rows"]), windows=data["horizon"])
        if kind == "plan":
            return replace(scene, plan=data["plan"])
        if kind == "scored":
            turn = study.turn_of(serial)
            waits = turn is not None and turn.candidates is None
            return replace(scene, scored=tuple(data["candidates"])) if waits else scene
        values = {k: v for k, v in data.items() if k in StudyState.__dataclass_fields__}
        if kind == "ranked":
            values |= {"preview": {}, "trials": {}}  # another ranking proposes anew
        if kind == "preview":
            values = _trial_update(study.turn_of(serial), data["preview"])
        for name in ("candidates", "proposed", "equation", "caveats", "alike"):
            if name in values:
                values[name] = tuple(values[name])
        if "figures" in values:
            values["figures"] = tuple((n, h, c) for n, h, c in values["figures"])
        return replace(scene, study=study_files.update_turn(study, serial, **values))

    def _finish_order(
        self, order: Mapping[str, Any], kind: str, data: Event, scene: LiveStudy
    ) -> None:
        busy, study = scene.busy, scene.study
        if kind == "done" and busy:
            self._expected[order["do"]] = max(busy.said, 1)
            self._lasted[study.ident, order["do"]] = time.monotonic() - busy.began
        if kind == "failed":
            study = replace(study, trouble={**data, "at": order["do"]})
        if kind == "cancelled":
            study = study_files.remove_newest_turn(
                study, order["serial"]
            )  # it may have landed, not yet ranked
            said = f"Cancelled: {busy.what.lower()}" if busy else "Cancelled"
            study = replace(study, trouble={"given": said, "at": kind})
        scene = self._store_scene(replace(scene, study=study, busy=None, scored=()))
        turn = study.turn
        if kind == "done" and turn and turn.proposed and not turn.preview and order["do"] in _RANKS:
            self._start_preview(scene, turn.proposed[0], turn.serial)

    def _route_file_order(self, order: Mapping[str, Any]) -> None:
        """Send an order about a file: a forecast to the writer, all else to the fit process."""
        (self._writer if order["do"] == FORESEE else self._fits).give(order)

    def _queue_run_writing(self, ident: str, serial: int) -> None:
        scene = self.scene(ident)
        self._store_scene(replace(scene, writing=(*scene.writing, serial)), save=False)
        self._writer.give(self._study_order(scene.study, "write", serial))

    def _queue_unsaved_turns(self, ident: str) -> None:
        """Queue the ranked turns that an earlier program did not save as runs before it ended."""
        for turn in self._scenes[ident].study.turns:
            if turn.candidates is not None and not turn.run_id:
                self._queue_run_writing(ident, turn.serial)

    def _on_writer_event(self, order: Mapping[str, Any], kind: str, data: Event) -> None:
        if order["do"] == FORESEE:
            self.file_setup.on_event(order, kind, data)
            return
        with self._lock:
            scene = self.scene(order["study"])
            serial = order["serial"]
            if kind in ("done", "failed", "cancelled"):
                left = tuple(s for s in scene.writing if s != serial)
                study = study_files.update_turn(scene.study, serial, complete=kind == "done")
                self._store_scene(replace(scene, study=study, writing=left))
            elif kind != "progress":
                self._store_scene(self._apply_event(order, kind, data, scene))


def _seconds_from_text(text: str) -> list[float]:
    """Lengths of tests in s, from text such as ``20, 60``; none from empty text."""
    try:
        lengths = [float(word) for word in text.replace(",", " ").split()]
        if not all(0 < length < math.inf for length in lengths):
            raise ValueError
    except ValueError as error:
        raise ConfigError(f"lengths of tests: {text[:60]!r}", "numbers above zero, in s",
                          "20, 60") from error  # fmt: skip
    return lengths


def _trial_update(turn: StudyState | None, trial: Mapping[str, Any]) -> dict[str, Any]:
    """Fields of a turn after an effect was tried: its trials, and the preview of a proposed one."""
    if turn is None:
        return {}
    effect = trial["effect"]
    known = {"trials": {**turn.trials, effect: trial}}
    return {**known, "preview": trial} if effect in turn.proposed else known


def _target_serial(order: Mapping[str, Any]) -> int:
    """Serial of the turn that an order's results belong to: its base, or the new turn."""
    return order["base" if order["do"] in _OF_A_TURN else "serial"]
