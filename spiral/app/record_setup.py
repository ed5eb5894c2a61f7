"""The setup of an uploaded file: what is in it, and which column is which series.

A setup lies in ``OUT/studies/uploads/ID`` beside its file, so that a reload finds it.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from spiral.app.study import FOLDER, UPLOADS, data_converter
from spiral.io.run_id import new_run_id
from spiral.io.storage import read_text_inside
from spiral.io.writing import to_json, write_whole
from spiral.types.errors import ConfigError
from spiral.types.formatting import join_words

FILE = "setup.json"
FIT, TEST = "fit", "test"
AT_REST = "0"  # in the place of an input's column: held at zero
ENDS = ("from", "to")  # of a range of speed
_ID = re.compile(r"[0-9a-f-]{8,40}")
_FIELDS = {"record.resample": "resample", "record.fill_gaps": "fill_gaps"}
_ADVISED = re.compile(  # a key of the command line with a value, and no word that stands for one
    r"\b((?:record|system)\.\w+|holdout_blocks)=((?![A-Z_]+\b)(?:'[^']*'|[^\s',;]*[^\s',;.]))"
)
_SENSORS = "<i>Sensors and inputs</i>"
_READING = "<i>Rate, gaps and offsets</i>"
_PLACES = {
    "units": "in the field beside each column", "rate": "beside <i>time</i>, as the sample rate",
    "rows": "in <i>Fitted rows</i> below the picture of the columns",
    "time": "in <i>What is what</i>", "channels": "in <i>What is what</i>",
    "inputs": "in <i>What is what</i>", "resample": f"under {_READING}",
    "fill_gaps": f"under {_READING}", "offset": f"under {_READING}", "hold": f"under {_SENSORS}",
    "pulse": f"under {_SENSORS}", "rotation": f"under {_SENSORS}",
    "probe_angles": f"under {_SENSORS}", "slow_roll": f"under {_SENSORS}",
    "path": "among <i>Records of this machine</i>",
}  # fmt: skip
_MORE = "under <i>More</i>, one <code>KEY=VALUE</code> a line"
_TIMES = ("time", "t", "seconds", "zeit", "clock")
_NAMED = {"rpm": "rpm", "hz": "Hz", "um": "um", "µm": "um", "mm": "mm", "ms": "ms", "mv": "mV",
          "rad": "rad", "deg": "deg"}  # fmt: skip
_ANGLES = {"angle", "winkel", "phi", "theta", "deg"}
_SPEEDS = ("speed", "rpm", "omega", "drehzahl", "n")


@dataclass(frozen=True)
class Choice:
    """Which column is what, and what the model begins with.

    ``columns`` and ``units`` are by the system's own names; ``without`` are effects of the seed
    that are left out; ``values`` and ``free`` (found by the fit or not) are by full parameter name.
    ``fit_rows`` and ``test_rows`` are first row and end of what is fitted and of the test, all rows
    where empty; ``hold`` says by input how it runs between samples; ``pulse`` is the column of a
    once-per-turn pulse, ``rotation`` a shaft's sense, ``angles`` degrees of probes by channel.
    ``effects`` are labels of effects beside the seed's; ``resample`` is a rate in Hz, ``fill_gaps``
    the longest gap that is bridged, in samples, ``offsets`` what instruments read at rest by name;
    ``slow_roll`` is the range of speed (from, to) in which a shaft turns slowly.
    """

    system: str = ""
    time: str = ""
    rate: str = ""
    columns: Mapping[str, str] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)
    more: str = ""
    without: tuple[str, ...] = ()
    values: Mapping[str, str] = field(default_factory=dict)
    free: Mapping[str, bool] = field(default_factory=dict)
    fit_rows: tuple[int, ...] = ()
    test_rows: tuple[int, ...] = ()
    hold: Mapping[str, str] = field(default_factory=dict)
    pulse: str = ""
    rotation: str = ""
    angles: Mapping[str, str] = field(default_factory=dict)
    effects: tuple[str, ...] = ()
    resample: str = ""
    fill_gaps: str = ""
    offsets: Mapping[str, str] = field(default_factory=dict)
    slow_roll: Mapping[str, str] = field(default_factory=dict)

    def measured(self, name: str) -> bool:
        """Whether a series comes from a column, and is not held at zero."""
        return self.columns.get(name, "") not in ("", AT_REST)


@dataclass(frozen=True)
class RecordSetup:
    """A file, its columns once it has been read, and what was chosen so far.

    ``systems`` describes the systems there are; ``seen`` what the last look at the mapped record
    came to; ``drawn`` whether a picture of the columns is there; ``model`` what the
    model holds (``file_preview.describe_model``); ``separator`` and ``decimal`` how
    a text file writes columns and fractions, where that had to be said; ``others`` are further
    files of the same machine (path, name, use: fit or test); ``equations`` the text of a system of
    one's own, which then stands last among the systems as ``own``; ``foresight`` is whether the
    record can tell effects apart (``identifiability.identifiability_forecast``), empty until that
    is known; ``reading`` is what reading changes in the first file's numbers (series, notes),
    empty where nothing changes; ``left_out`` are messages about columns with a text among numbers.
    """

    ident: str
    name: str
    path: str
    columns: tuple[Mapping[str, Any], ...] = ()
    rows: int = 0
    systems: tuple[Mapping[str, Any], ...] = ()
    choice: Choice = field(default_factory=Choice)
    seen: tuple[Mapping[str, Any], ...] = ()
    trouble: Mapping[str, str] | None = None
    drawn: bool = False
    model: Mapping[str, Any] = field(default_factory=dict)
    separator: str = ""
    decimal: str = ""
    others: tuple[Mapping[str, str], ...] = ()
    equations: str = ""
    foresight: Mapping[str, Any] = field(default_factory=dict)
    reading: Mapping[str, Any] = field(default_factory=dict)
    left_out: tuple[Mapping[str, str], ...] = ()

    def files(self, use: str) -> list[str]:
        """Paths of the files to fit, or of those to test."""
        own = [self.path] if use == FIT else []
        return own + [o["path"] for o in self.others if o["use"] == use]

    def system(self) -> Mapping[str, Any] | None:
        """The system chosen."""
        return next((s for s in self.systems if s["name"] == self.choice.system), None)


def setup_folder(out: Path, ident: str) -> Path:
    """The folder of a setup.

    Raises
    ------
    ConfigError : no name that a setup may have.
    """
    if not _ID.fullmatch(ident):
        raise ConfigError(f"file {ident[:60]!r}", "a file that was dropped", "drop it again")
    return out / FOLDER / UPLOADS / ident


def new_setup(out: Path, name: str) -> RecordSetup:
    """A setup with a folder for its file, which is not there yet."""
    ident = new_run_id()
    folder = setup_folder(out, ident)
    folder.mkdir(parents=True)
    return RecordSetup(ident, name, str(folder / safe_file_name(name)))


def safe_file_name(name: str) -> str:
    """A file's name without a path and without what a file system might refuse."""
    last = name.replace("\\", "/").rsplit("/", 1)[-1]
    cleaned = re.sub(r"[^\w.()+ -]", "_", last).strip(". ")[-120:]
    return cleaned or "record"


def save_setup(out: Path, setup: RecordSetup) -> None:
    """Write the setup over what was there."""
    write_whole(setup_folder(out, setup.ident) / FILE, to_json(asdict(setup)))


def load_setup(out: Path, ident: str) -> RecordSetup:
    """A setup from disk.

    Raises
    ------
    ConfigError : no such setup.
    """
    try:
        data = json.loads(read_text_inside(setup_folder(out, ident), FILE))
        return data_converter().structure({**data, "ident": ident}, RecordSetup)
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise ConfigError(f"file {ident}", "one that was dropped here", "drop it again") from error


def guess_columns(columns: Sequence[Mapping[str, Any]], system: Mapping[str, Any]) -> Choice:
    """Guess the column of time and of each series, by name, then by unit; each column once."""
    names = [c["name"] for c in columns]
    left = dict.fromkeys(names)
    matches: dict[str, str] = {}

    def take_column(wanted: Sequence[str]) -> str:
        for fits in (_equals_word, _starts_with_word, _contains_word):
            for want in wanted:
                for name in left:
                    if fits(name, want):
                        del left[name]
                        return name
        return ""

    unit_of = {c["name"]: c["unit"] for c in columns}
    time = take_column(_TIMES)
    for series in (*system["channels"], *system["inputs"]):
        name = series["name"]
        chosen = take_column(_SPEEDS if name == "speed" else (name.lower(),))
        if chosen:
            matches[name] = chosen
    for series in (*system["channels"], *system["inputs"]):
        alike = [c for c in left if _unit_match(c, unit_of[c], series) == 2]
        if series["name"] not in matches and len(alike) == 1:  # the only one in its unit
            matches[series["name"]] = alike[0]
            del left[alike[0]]
    for channel in system["channels"]:
        may = [c for c in left if _unit_match(c, unit_of[c], channel)]
        if channel["name"] not in matches and may:
            matches[channel["name"]] = may[0]
            del left[may[0]]
    units = {
        k: u for k, c in {**matches, "time": time}.items()
        if c and not unit_of[c] and (u := unit_from_name(c))
    }  # fmt: skip
    return Choice(system["name"], time, "", matches, units)


def _unit_match(column: str, unit: str, series: Mapping[str, Any]) -> int:
    """How well a column's unit goes with a series: 2 alike, 1 not known, 0 another dimension.

    An input that need not be measured is taken by its name alone.
    """
    said = unit or unit_from_name(column) or ("rad" if _ANGLES & set(_name_words(column)) else "")
    if not said:
        return 1
    alike = _unit_dimension(said) == _unit_dimension(series["unit"])
    return 2 * (alike and bool(series["unit"]) and series.get("required", True))


def _unit_dimension(unit: str) -> Any:
    from spiral.types.units import base_form

    form = base_form(unit)
    return unit if form is None else form[1]


def _name_words(name: str) -> list[str]:
    """The words of a column's name: ``probeX_um`` has probe, x and um."""
    return [w.lower() for w in re.findall(r"[A-Z]*[a-zµ]+|[A-Z]+", name)]


def _equals_word(name: str, want: str) -> bool:
    return name.lower() == want


def _starts_with_word(name: str, want: str) -> bool:
    return _name_words(name)[:1] == [want]


def _contains_word(name: str, want: str) -> bool:
    return want in _name_words(name)


def unit_from_name(name: str) -> str:
    """The unit that a column's name says, as ``rpm`` or ``disp_um``; nothing where it says none."""
    last = re.split(r"[^a-zµ]+", name.lower().strip())[-1]
    return _NAMED.get(last, "")


def missing_choices(setup: RecordSetup) -> list[str]:
    """What still has to be chosen, in words."""
    system, choice = setup.system(), setup.choice
    if system is None:
        return ["a system"]
    needed = [s["name"] for s in system["channels"]]
    turned = {"speed"} if choice.pulse else set()  # a pulse tells the speed
    needed += [s["name"] for s in system["inputs"] if s["required"] and s["name"] not in turned]
    missing = [f"a column for {n}" for n in needed if not choice.columns.get(n)]
    if not choice.time and not choice.rate.strip():
        missing.append("a column of time, or the sample rate")
    return missing


def setup_overrides(setup: RecordSetup) -> tuple[str, ...]:
    """The overrides of the command line that say the same as a setup."""
    choice, system = setup.choice, setup.system()
    assert system is not None
    channels = {s["name"] for s in system["channels"]}
    named = quote_value(choice.system) if system.get("own") else choice.system
    given = [f"system={named}", "record=file"]
    given += [
        _path_override(part, setup.files(use))
        for part, use in (("record", FIT), ("test", TEST))
        if setup.files(use)
    ]
    if choice.time:
        given.append(f"record.time={quote_value(choice.time)}")
    else:
        given.append(f"record.rate={choice.rate.strip()}")
    for key, said in (("separator", setup.separator), ("decimal", setup.decimal)):
        if said:
            given.append(f"record.{key}={quote_value(said)}")
    chosen = {k: v for k, v in choice.columns.items() if v}
    for key, part in (
        ("channels", {k: v for k, v in chosen.items() if k in channels}),
        ("inputs", {k: v for k, v in chosen.items() if k not in channels}),
        ("units", {k: v.strip() for k, v in choice.units.items() if v.strip() and
                   (k in chosen or (k == "time" and choice.time))}),
    ):  # fmt: skip
        if part:
            inside = ", ".join(f"{k}: {quote_value(v)}" for k, v in part.items())
            given.append(f"record.{key}={{{inside}}}")
    given += _series_overrides(setup) + _model_overrides(choice)
    return (*given, *(line.strip() for line in choice.more.splitlines() if line.strip()))


def advised_lines(trouble: Mapping[str, str] | None) -> list[str]:
    """Lines for *More* that a message tells to try, as ``record.resample=299.9``; each key once."""
    lines = {
        key: f"{key}={value}" for key, value in _ADVISED.findall((trouble or {}).get("try", ""))
    }
    return list(lines.values())


def places_of_settings(trouble: Mapping[str, str] | None) -> str:
    """Where the page has the settings that a message names, as HTML; empty if it names none."""
    said = " ".join(str(v) for v in (trouble or {}).values())
    keys = dict.fromkeys(re.findall(r"\brecord\.(\w+)", said))
    places: dict[str, list[str]] = {}
    for key in keys:
        places.setdefault(_PLACES.get(key, _MORE), []).append(f"<code>record.{key}</code>")
    named = [f"{join_words(names)} {place}" for place, names in places.items()]
    return f"On this page: {'; '.join(named)}." if named else ""


def units_taken(setup: RecordSetup) -> list[str]:
    """Series whose unit neither the file nor a person gave, with the unit that is taken."""
    system, choice = setup.system(), setup.choice
    if system is None:
        return []
    named = {c["name"]: c["unit"] for c in setup.columns}
    usual = {s["name"]: s["unit"] for s in (*system["channels"], *system["inputs"])}
    usual = {name: unit for name, unit in usual.items() if choice.measured(name) and unit}
    columns = {**choice.columns, "time": choice.time}
    usual |= {"time": "s"} if choice.time else {}
    return [
        f"{name} in {unit}"
        for name, unit in usual.items()
        if not choice.units.get(name, "").strip() and not named.get(columns[name])
    ]


def with_setting(choice: Choice, line: str) -> Choice:
    """A choice with a setting as ``advised_lines`` gives it: in its field, else in *More*."""
    key, _, value = line.partition("=")
    if key in _FIELDS:
        return replace(choice, **{_FIELDS[key]: value})
    return replace(choice, more=replace_line(choice.more, line))


def replace_line(more: str, line: str) -> str:
    """The text of *More* with a line, in the place of one that says something else of its key."""
    key = line.partition("=")[0]
    kept = [
        old for old in more.splitlines() if old.strip() and old.partition("=")[0].strip() != key
    ]
    return "\n".join([*kept, line])


def _path_override(part: str, files: Sequence[str]) -> str:
    listed = ", ".join(map(quote_value, files))
    return f"{part}.path={listed if len(files) == 1 else f'[{listed}]'}"


def _series_overrides(setup: RecordSetup) -> list[str]:
    """Overrides for rows, for inputs between samples and for a rotor's sensors."""
    choice = setup.choice
    lines = []
    if choice.fit_rows:
        lines.append(f"record.rows=[{','.join(map(str, choice.fit_rows))}]")
    if choice.test_rows and not setup.files(TEST):
        lines.append(f"test.rows=[{','.join(map(str, choice.test_rows))}]")
    hold = {k: v for k, v in choice.hold.items() if v and choice.columns.get(k)}
    angles = {k: v.strip() for k, v in choice.angles.items() if v.strip()}
    offsets = {k: v.strip() for k, v in choice.offsets.items() if v.strip() and choice.measured(k)}
    for key, values in (("hold", hold), ("probe_angles", angles), ("offset", offsets)):
        if values:
            inside = ", ".join(f"{k}: {v}" for k, v in values.items())
            lines.append(f"record.{key}={{{inside}}}")
    lines += [
        f"{key}={value}"
        for key, name in _FIELDS.items()
        if (value := getattr(choice, name).strip())
    ]
    ends = [choice.slow_roll.get(end, "").strip() for end in ENDS]
    if all(ends):
        lines.append(f"record.slow_roll={{speed: [{', '.join(ends)}]}}")
    if choice.pulse:
        lines.append(f"record.pulse={quote_value(choice.pulse)}")
    if choice.rotation:
        lines.append(f"record.rotation={choice.rotation}")
    return lines


def mark_stretch(choice: Choice, use: str, first: int, stop: int, rows: int) -> Choice:
    """A choice with a stretch of rows marked for the fit or the test; the two never overlap.

    Where they would, the other keeps the longer side of what it had. Marking the test alone leaves
    to the fit the longer side of the record.
    """
    first, stop = max(0, min(first, stop)), min(rows, max(first, stop))
    mine, other = ("fit_rows", "test_rows") if use == FIT else ("test_rows", "fit_rows")
    had = getattr(choice, other) or ((0, rows) if use == TEST else ())
    if had:
        sides = ((had[0], min(had[1], first)), (max(had[0], stop), had[1]))
        best = max(sides, key=lambda s: s[1] - s[0])
        had = best if best[1] > best[0] else ()
    return replace(choice, **{mine: (first, stop), other: had})


def without_test_rows(choice: Choice, rows: int) -> Choice:
    """A choice without a test stretch; a fit that only its mark made shorter has all rows again."""
    if not choice.test_rows:
        return choice
    first, stop = choice.test_rows
    marked = mark_stretch(replace(choice, fit_rows=()), TEST, first, stop, rows)
    left = () if marked.fit_rows == choice.fit_rows else choice.fit_rows
    return replace(choice, fit_rows=left, test_rows=())


def _model_overrides(choice: Choice) -> list[str]:
    """Overrides for the model that a study begins with."""
    lines = []
    if choice.effects:
        lines.append(f"effect=[{','.join(choice.effects)}]")
    if choice.without:
        lines.append(f"without=[{','.join(choice.without)}]")
    values = {k: v.strip() for k, v in choice.values.items() if v.strip()}
    if values:
        lines.append("values={" + ", ".join(f"{k}: {v}" for k, v in values.items()) + "}")
    for key, wanted in (("fixed", False), ("free", True)):
        names = [k for k, free in choice.free.items() if free is wanted]
        if names:
            lines.append(f"{key}=[{','.join(names)}]")
    return lines


def quote_value(text: str) -> str:
    """Text as one value of the overrides' grammar, whatever is in it."""
    ended = text + "\\" * (len(text) - len(text.rstrip("\\")))  # doubled before the quote
    return "'" + re.sub(r"(\\*)'", lambda m: 2 * m.group(1) + "\\'", ended) + "'"
