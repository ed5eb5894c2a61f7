"""A study of the page, as saved in ``OUT/studies/ID/study.json``: a tree of its states.

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
from spiral.io.storage import read_text_inside, resolve_inside_folder, unwritable_folder_error
from spiral.io.writing import to_json, write_whole
from spiral.types.errors import ConfigError, InputError

if TYPE_CHECKING:
    from cattrs import Converter

FOLDER, FILE, UPLOADS = "studies", "study.json", "uploads"
LEARNED = "settings.learned"
_ID = re.compile(r"[0-9a-f-]{8,40}")


@dataclass(frozen=True)
class StudyState:
    """One state of a study (a *turn*; the page says step), in plain data.

    ``parent`` is the serial of the turn that it was made from; ``added`` the effect that made it;
    ``caveats`` are sentences that limit its verdict, ``alike`` effects of the model with those they
    cannot be told from; ``result`` its numbers as a round in the JSON output;
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
    """A study: its overrides, its turns (states), and which of them is shown.

    ``own`` are candidates that a formula of the user's defines, among the overrides; ``example``
    is such a formula that works here, and what one may name. ``trouble`` is the last message, and
    at which order it arose; ``note`` what a person wrote of the study;
    ``program`` the options that its overrides change (``python_text.non_default_options``);
    ``tour`` whether it is a guided one.
    """

    ident: str
    title: str
    overrides: tuple[str, ...]
    created: str
    turns: tuple[StudyState, ...] = ()
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
    def turn(self) -> StudyState | None:
        """The turn that the page shows; nothing before the first fit."""
        return self.turns[self.at] if self.turns else None

    @property
    def line(self) -> tuple[StudyState, ...]:
        """The turns from the first to the one that is shown."""
        turns: list[StudyState] = []
        turn = self.turn
        while turn is not None:
            turns.insert(0, turn)
            before = turn.parent
            turn = None if before is None else self.turn_of(before)
        return tuple(turns)

    def after(self, serial: int | None) -> tuple[StudyState, ...]:
        """The turns that follow a turn, one for each branch; with ``None`` the first turns."""
        return tuple(t for t in self.turns if t.parent == serial)

    @property
    def added(self) -> tuple[str, ...]:
        """The effects that were added and are still in the model, in their order."""
        return self._added_and_gone[0]

    @property
    def gone(self) -> tuple[str, ...]:
        """The effects that were added and later removed, as superfluous beside another one."""
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

    def turn_of(self, serial: int) -> StudyState | None:
        """A turn by its number, which no other ever gets."""
        return next((t for t in self.turns if t.serial == serial), None)


def add_turn(study: Study, turn: StudyState) -> Study:
    """The study with one more turn, made from the selected one and selected itself."""
    parent = None if study.turn is None else study.turn.serial
    turns = (*study.turns, replace(turn, parent=parent))
    return replace(study, turns=turns, at=len(turns) - 1, trouble=None)


def update_turn(study: Study, serial: int, **values: Any) -> Study:
    """The study with new values in one turn; unchanged where it has no such turn any more."""
    turns = tuple(replace(t, **values) if t.serial == serial else t for t in study.turns)
    return replace(study, turns=turns)


def remove_newest_turn(study: Study, serial: int) -> Study:
    """A study whose newest turn is taken back, where it has that number and is not the first."""
    turn = study.turn
    if turn is None or turn.serial != serial or turn.parent is None:
        return study
    back = select_turn(study, turn.parent)
    return replace(back, turns=tuple(t for t in back.turns if t.serial != serial))


def select_turn(study: Study, serial: int) -> Study:
    """The study with that turn selected; nothing is fitted, since every turn is kept."""
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
        study_folder(out, study.ident).mkdir(parents=True)
        save_study(out, study)
    except OSError as error:
        raise unwritable_folder_error(out, error) from error
    return study


def study_folder(out: Path, ident: str) -> Path:
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


def turn_folder(out: Path, ident: str, serial: int) -> Path:
    """The folder of one turn: its checkpoint, its curves, its figures."""
    return study_folder(out, ident) / f"turn-{serial}"


def trial_figure_file(figures: Path, effect: str, what: str = "why") -> Path:
    """The file of a figure of an effect's trial: ``why`` it helps, or its ``force``."""
    return figures / f"{what}-{re.sub(r'[^a-z0-9_]', '-', effect)}.json"


def save_study(out: Path, study: Study) -> None:
    """Write the study over what was there, or leave that as it was."""
    write_whole(study_folder(out, study.ident) / FILE, to_json(asdict(study)))


def load_study(out: Path, ident: str) -> Study:
    """A study from disk.

    Raises
    ------
    ConfigError : no such study. InputError : a file that is none.
    """
    file = resolve_inside_folder(study_folder(out, ident), FILE)
    if not file.is_file():
        raise ConfigError(
            f"study {ident}", f"a study in {out / FOLDER}", "choose one from the list"
        )
    try:
        data = json.loads(read_text_inside(file.parent, file.name))
        study = data_converter().structure({**data, "ident": ident}, Study)
        for turn in study.turns:
            float(turn.result.get("test_error") or 0.0)  # a number: the list of studies shows it
        turns = _repair_parents(study.turns)
        return replace(study, turns=turns, at=min(max(study.at, 0), max(len(turns) - 1, 0)))
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise InputError(f"{file}: {error}", "a study saved by this program") from error


def _repair_parents(turns: tuple[StudyState, ...]) -> tuple[StudyState, ...]:
    """Turns with their parents checked: an earlier turn, else the one before; none for the first.

    Files of version 0.2 name no parents: there, turns were a line.
    """
    repaired: list[StudyState] = []
    for turn in turns:
        earlier = [t.serial for t in repaired]
        parent = turn.parent if turn.parent in earlier else (earlier or [None])[-1]
        repaired.append(replace(turn, parent=parent))
    return tuple(repaired)


def delete_study(out: Path, ident: str) -> None:
    """Delete a study; the runs that its turns were saved as stay.

    Raises
    ------
    InputError : a folder that cannot be deleted.
    """
    try:
        shutil.rmtree(study_folder(out, ident))
    except OSError as error:
        raise unwritable_folder_error(out, error) from error


def list_studies(out: Path) -> list[Study]:
    """All studies, the latest first; files that are none are passed over."""
    loaded = []
    for file in sorted((out / FOLDER).glob(f"*/{FILE}"), reverse=True):
        try:
            loaded.append(load_study(out, file.parent.name))
        except (ConfigError, InputError):
            continue
    return loaded


@lru_cache(maxsize=1)
def data_converter() -> Converter:
    """Converter of plain data to the dataclasses of a study, which casts values to their types."""
    from cattrs import Converter

    return Converter(detailed_validation=False)
