"""A study driven by hand, as it lies on disk: ``OUT/studies/ID/study.json``, written whole.

Its turns form a tree: the model as it was, then one more effect at each turn. ``at`` is the turn
that is looked at; undoing moves it to the parent, and another effect added there begins another
branch. No turn is ever forgotten, save one that was cancelled before it was ranked.

A folder of studies may come from anywhere. A study is called by its folder; what its file holds is
checked by type, and names nothing that is run.
"""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from datetime import UTC, datetime
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from spiral.io.run_id import new_run_id
from spiral.io.storage import own_file, own_text, unwritable
from spiral.io.writing import to_json, write_whole
from spiral.types.errors import ConfigError, InputError

if TYPE_CHECKING:
    from cattrs import Converter

FOLDER, FILE, UPLOADS = "studies", "study.json", "uploads"
LEARNED = "settings.learned"
_ID = re.compile(r"[0-9a-f-]{8,40}")


@dataclass(frozen=True)
class Turn:
    """One state of a study, in plain data.

    ``parent`` is the serial of the turn that it was made from; ``added`` the effect that made it;
    ``caveats`` are sentences to hold against its verdict, ``alike`` effects of the model with what
    they cannot be told from; ``result`` its figures as a
    round of the JSON contract;
    ``candidates`` what may be missing next, best first; ``proposed`` what the gates would admit;
    ``shape`` what the force is like that none of them explains, in words, ``memory`` what it
    depends on besides the present state;
    ``preview`` is what adding the proposed effect would come to, tried on the test record (effect,
    changes at each horizon, test error); empty until it was tried; ``trials`` the same for every
    effect that was tried, by its name, and whether there is a figure of where it helps;
    ``figures`` what is drawn (name, heading, caption), one JSON file each; ``tracked`` its place in
    MLflow's page, or ``untracked`` why it has none.
    """

    serial: int
    added: str = ""
    result: Mapping[str, Any] = field(default_factory=dict)
    candidates: tuple[Mapping[str, Any], ...] | None = None
    proposed: tuple[str, ...] = ()
    rejected: Mapping[str, str] = field(default_factory=dict)
    verdict: str = ""
    advice: str = ""
    shape: str = ""
    preview: Mapping[str, Any] = field(default_factory=dict)
    sentence: str = ""
    equation: tuple[Mapping[str, Any], ...] = ()
    figures: tuple[tuple[str, str, str], ...] = ()
    complete: bool = False
    run_id: str = ""
    tracked: str = ""
    untracked: str = ""
    parent: int | None = None
    caveats: tuple[str, ...] = ()
    alike: tuple[tuple[str, ...], ...] = ()
    memory: str = ""
    trials: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)


@dataclass(frozen=True)
class Study:
    """A question (its overrides), its turns, and where it stands.

    ``own`` are candidates that a formula of the user's defines, among the overrides; ``example``
    is such a formula that works here, and what one may name. ``trouble`` is the last message, and
    at which order it arose; ``note`` what a person wrote of the study;
    ``program`` what its overrides ask for, as ``python_text.asked`` has it; ``tour`` whether it
    tells what to do next.
    """

    ident: str
    title: str
    overrides: tuple[str, ...]
    created: str
    turns: tuple[Turn, ...] = ()
    at: int = 0
    serials: int = 0
    trouble: Mapping[str, str] | None = None
    records: tuple[Mapping[str, Any], ...] = ()
    noise_floor: float | None = None
    own: tuple[str, ...] = ()
    example: Mapping[str, Any] = field(default_factory=dict)
    note: str = ""
    program: Mapping[str, Any] = field(default_factory=dict)
    tour: bool = False

    @property
    def turn(self) -> Turn | None:
        """The turn that is looked at; nothing before the first fit."""
        return self.turns[self.at] if self.turns else None

    @property
    def line(self) -> tuple[Turn, ...]:
        """The turns from the first to the one that is looked at."""
        found: list[Turn] = []
        turn = self.turn
        while turn is not None:
            found.insert(0, turn)
            before = turn.parent
            turn = None if before is None else self.turn_of(before)
        return tuple(found)

    def after(self, serial: int | None) -> tuple[Turn, ...]:
        """The turns made from a turn, one for each branch; those made from none with ``None``."""
        return tuple(t for t in self.turns if t.parent == serial)

    @property
    def added(self) -> tuple[str, ...]:
        """The effects that were added and are still in the model, in their order."""
        return self._added_and_gone[0]

    @property
    def gone(self) -> tuple[str, ...]:
        """The effects that were added and let go again, superfluous beside a later one."""
        return self._added_and_gone[1]

    @property
    def _added_and_gone(self) -> tuple[tuple[str, ...], tuple[str, ...]]:
        present: list[str] = []
        gone: list[str] = []
        for turn in self.line:
            if turn.added:
                present = [*(e for e in present if e != turn.added), turn.added]
            left = [e for e in turn.result.get("retired") or () if e in present]
            present = [e for e in present if e not in left]
            gone = [*(e for e in gone if e not in present), *left]
        return tuple(present), tuple(gone)

    def turn_of(self, serial: int) -> Turn | None:
        """A turn by its number, which no other ever gets."""
        return next((t for t in self.turns if t.serial == serial), None)


def added(study: Study, turn: Turn) -> Study:
    """One turn more, made from the one that is looked at, and looked at from now on."""
    parent = None if study.turn is None else study.turn.serial
    turns = (*study.turns, replace(turn, parent=parent))
    return replace(study, turns=turns, at=len(turns) - 1, trouble=None)


def changed(study: Study, serial: int, **values: Any) -> Study:
    """A turn with other values; one that is no longer part of the study stays away."""
    turns = tuple(replace(t, **values) if t.serial == serial else t for t in study.turns)
    return replace(study, turns=turns)


def without(study: Study, serial: int) -> Study:
    """A study whose newest turn is taken back, where it has that number and is not the first."""
    turn = study.turn
    if turn is None or turn.serial != serial or turn.parent is None:
        return study
    back = moved(study, turn.parent)
    return replace(back, turns=tuple(t for t in back.turns if t.serial != serial))


def moved(study: Study, serial: int) -> Study:
    """The study looked at where that turn stands; nothing is fitted, since every turn is kept."""
    at = next((i for i, t in enumerate(study.turns) if t.serial == serial), study.at)
    return replace(study, at=at, trouble=None)


def new_study(out: Path, title: str, overrides: tuple[str, ...], tour: bool = False) -> Study:
    """A study on disk that has done nothing yet.

    Raises
    ------
    InputError : the folder of runs cannot be written.
    """
    now = datetime.now(UTC)
    there = (p.name for p in (out / FOLDER).glob("*"))
    ident, begun = new_run_id(now, there), now.isoformat(timespec="seconds")
    study = Study(ident, title, overrides, begun, tour=tour)
    try:
        place(out, study.ident).mkdir(parents=True)
        save(out, study)
    except OSError as error:
        raise unwritable(out, error) from error
    return study


def place(out: Path, ident: str) -> Path:
    """The folder of a study.

    Raises
    ------
    ConfigError : no name that a study may have.
    """
    if not _ID.fullmatch(ident):
        raise ConfigError(
            f"study {ident[:60]!r}", "the name of a study", "choose one from the list"
        )
    return out / FOLDER / ident


def turn_place(out: Path, ident: str, serial: int) -> Path:
    """The folder of one turn: its checkpoint, its curves, its figures."""
    return place(out, ident) / f"turn-{serial}"


def why_file(figures: Path, effect: str, what: str = "why") -> Path:
    """Where a figure of an effect's trial lies: ``why`` it helps, or its own ``force``."""
    return figures / f"{what}-{re.sub(r'[^a-z0-9_]', '-', effect)}.json"


def save(out: Path, study: Study) -> None:
    """Write the study over what was there, or leave that as it was."""
    write_whole(place(out, study.ident) / FILE, to_json(asdict(study)))


def load(out: Path, ident: str) -> Study:
    """A study from disk.

    Raises
    ------
    ConfigError : no such study. InputError : a file that is none.
    """
    file = own_file(place(out, ident), FILE)
    if not file.is_file():
        raise ConfigError(
            f"study {ident}", f"a study in {out / FOLDER}", "choose one from the list"
        )
    try:
        data = json.loads(own_text(file.parent, file.name))
        study = typed().structure({**data, "ident": ident}, Study)
        for turn in study.turns:
            float(turn.result.get("test_error") or 0.0)  # which the list of all studies shows
        turns = _grown(study.turns)
        return replace(study, turns=turns, at=min(max(study.at, 0), max(len(turns) - 1, 0)))
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise InputError(f"{file}: {error}", "a study saved by this program") from error


def _grown(turns: tuple[Turn, ...]) -> tuple[Turn, ...]:
    """Turns of which each but the first comes from an earlier one; from that before, if not said.

    Files of version 0.2 name no parents: there, turns were a line.
    """
    found: list[Turn] = []
    for turn in turns:
        earlier = [t.serial for t in found]
        parent = turn.parent if turn.parent in earlier else (earlier or [None])[-1]
        found.append(replace(turn, parent=parent))
    return tuple(found)


def forget(out: Path, ident: str) -> None:
    """Delete a study; the runs that its turns were saved as stay.

    Raises
    ------
    InputError : a folder that cannot be deleted.
    """
    try:
        shutil.rmtree(place(out, ident))
    except OSError as error:
        raise unwritable(out, error) from error


def studies(out: Path) -> list[Study]:
    """All studies, the latest first; files that are none are passed over."""
    found = []
    for file in sorted((out / FOLDER).glob(f"*/{FILE}"), reverse=True):
        try:
            found.append(load(out, file.parent.name))
        except (ConfigError, InputError):
            continue
    return found


@lru_cache(maxsize=1)
def typed() -> Converter:
    """Plain data to the types of a study; text where text belongs, numbers where numbers do."""
    from cattrs import Converter

    return Converter(detailed_validation=False)
