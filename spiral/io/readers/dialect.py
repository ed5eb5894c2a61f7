"""Detects how a text file is written: separator, decimal mark, names, a row of units.

Every separator and decimal mark is tried on the first lines, and judged by the share of numbers.
The best one is taken; where two are as good, the file is refused rather than guessed.
"""

from __future__ import annotations

import csv
import io
import re
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

from spiral.io.readers.table import MISSING
from spiral.types.errors import ConfigError, InputError

SPACES = r"\s+"
SEPARATORS = {",": "commas", ";": "semicolons", "\t": "tabs", "|": "bars", SPACES: "spaces"}
DECIMALS = {".": "decimal point", ",": "decimal comma"}

_COMMENT = re.compile(r"\s*(#|%|//|;;)\s*")
_NUMBER = {
    mark: re.compile(rf"[+-]?(\d+({re.escape(mark)}\d*)?|{re.escape(mark)}\d+)([eE][+-]?\d+)?")
    for mark in DECIMALS
}
_NUMBER[","] = re.compile(r"[+-]?(\d+(,\d+)?|,\d+)([eE][+-]?\d+)?")
_THOUSANDS = re.compile(r"[+-]?[1-9]\d{0,2}(,\d{3})+")
_NO_UNIT = ("", "-", "--", "1")
_AT_END = re.compile(r".*?(?:\[([^][]+)\]|\(([^()]+)\))")
_LETTERS = "smNVgAK°"  # one letter in round brackets is a unit only where it is usual
_LINES = 300


@dataclass(frozen=True)
class Dialect:
    """One way to read a text file.

    Parameters
    ----------
    separator, decimal : what stands between cells and before fractions.
    names : of the columns, the empty ones of trailing separators left out.
    units : column -> unit, from a row under the names.
    width : cells in each row.
    first : number of lines above row 0.
    above : number of lines above the names.
    share : of the cells that are not empty, those that are numbers.
    marked : cells that hold the decimal mark.
    """

    separator: str
    decimal: str
    names: tuple[str, ...]
    width: int
    first: int
    share: float
    above: int = 0
    units: Mapping[str, str] = field(default_factory=dict)
    marked: tuple[str, ...] = ()

    def in_words(self) -> str:
        """The dialect in words."""
        word = SEPARATORS.get(self.separator, repr(self.separator))
        words = [f"columns separated by {word}" if len(self.names) > 1 else "one column"]
        words.append(DECIMALS[self.decimal])
        if self.above:
            words.append(f"{self.above} line{'s' * (self.above > 1)} above the names left out")
        if self.units:
            listed = ", ".join(f"{k} in {v}" for k, v in self.units.items())
            words.append(f"a row of units under the names ({listed})")
        return ", ".join(words)


def split_cells(line: str, separator: str) -> list[str]:
    """The cells of one line, without quotes and outer spaces."""
    if separator == SPACES:
        return line.split()
    try:
        cells = next(csv.reader([line], delimiter=separator, skipinitialspace=True), [])
    except csv.Error:
        return [line]
    return [c.strip() for c in cells]


def find_dialect(given: str, text: str, separator: str | None, decimal: str | None) -> Dialect:
    """The one way to read ``text``, the beginning of the file ``given``.

    Parameters
    ----------
    separator, decimal : as configured; ``None`` to find them.

    Raises
    ------
    InputError : no reading gives names over numbers, or several do.
    """
    lines = list(io.StringIO(text, newline=None))[:_LINES]
    lines = [line.rstrip("\n") for line in lines]
    separators = [_check_separator(separator)] if separator else list(SEPARATORS)
    decimals = [decimal] if decimal else list(DECIMALS)
    if decimal and decimal not in DECIMALS:
        raise ConfigError(f"record.decimal={decimal!r}", "'.' or ','", "leave it out: it is found")
    dialects = [
        d for s in separators for m in decimals if (d := _fit_dialect(lines, s, m)) is not None
    ]
    fits = _best_dialects([d for d in dialects if d.names])
    if not fits:
        raise _no_dialect_error(given, dialects, lines, separator)
    if len(fits) > 1:
        both = " or ".join(f"{d.in_words()} ({len(d.names)} columns)" for d in fits[:2])
        raise InputError(
            f"{given}: can be read in two ways, as {both}", "one way", "give record.separator"
        )
    best = fits[0]
    if decimal is None and best.marked and all(_THOUSANDS.fullmatch(c) for c in best.marked):
        raise InputError(
            f"{given}: {best.marked[0]!r} can be a decimal comma or a mark of thousands",
            "numbers that are one or the other",
            "record.decimal=',' if it is the decimal comma; else export without thousands marks",
        )
    return best


def _check_separator(separator: str) -> str:
    separator = {r"\t": "\t", " ": SPACES}.get(separator, separator)
    if separator != SPACES and (len(separator) != 1 or separator in '"\n\r'):
        raise ConfigError(
            f"record.separator={separator!r}", "one character", "leave it out: it is found"
        )
    return separator


def _best_dialects(dialects: list[Dialect]) -> list[Dialect]:
    """The dialects with the largest share of numbers; those with several columns go first."""
    dialects = [d for d in dialects if d.share > 0.3]
    dialects = [d for d in dialects if len(d.names) > 1] or dialects
    top = max((d.share for d in dialects), default=0.0)
    dialects = [d for d in dialects if d.share > top - 1e-9]
    marked = {d.separator for d in dialects if d.decimal == "." and not d.marked}
    dialects = [d for d in dialects if d.decimal == "." or d.marked or d.separator not in marked]
    one_column = all(len(d.names) == 1 for d in dialects)
    plain = [d for d in dialects if d.separator != SPACES] or dialects
    return plain[:1] if one_column else plain


@dataclass(frozen=True)
class _Line:
    cells: tuple[str, ...]
    numbers: int
    texts: int
    comment: bool

    def is_data(self, width: int) -> bool:
        return len(self.cells) == width and not self.comment and 0 < self.numbers >= self.texts


def _parse_line(text: str, separator: str, decimal: str) -> _Line:
    comment = _COMMENT.match(text)
    cells = tuple(split_cells(text[comment.end() :] if comment else text, separator))
    numbers = sum(_NUMBER[decimal].fullmatch(c) is not None for c in cells)
    missing = sum(c.lower() in MISSING for c in cells)
    return _Line(cells, numbers, len(cells) - numbers - missing, comment is not None)


def _fit_dialect(texts: list[str], separator: str, decimal: str) -> Dialect | None:
    """The dialect with these two marks; without names where no line fits above the rows."""
    lines = [_parse_line(t, separator, decimal) for t in texts]
    tail = [x for x in lines[len(lines) // 2 :] if x.numbers and not x.comment]
    if not tail:
        return None
    width = Counter(len(x.cells) for x in tail).most_common(1)[0][0]
    first = _first_row(lines, width)
    if first is None:
        return None
    position, units = _names_line(lines, first, width)
    if position is None and lines[first].texts:
        position, first = first, first + 1
    rows = lines[first:]
    filled = sum(x.numbers + x.texts for x in rows) or 1
    marked = tuple(
        c for x in rows for c in x.cells if decimal in c and _NUMBER[decimal].fullmatch(c)
    )
    share = sum(x.numbers for x in rows) / filled
    names = () if position is None else _drop_trailing_empty(lines[position].cells)
    if len(names) < width and any(any(x.cells[len(names) : width]) for x in rows):
        names = ()
    return Dialect(
        separator,
        decimal,
        _unique_names(names),
        width,
        first,
        share,
        position or 0,
        dict(_units_below_names(names, lines[units].cells)) if names and units is not None else {},
        marked,
    )


def _first_row(lines: list[_Line], width: int) -> int | None:
    """The first row of numbers: one without any text, and rows with some directly above it."""
    pure = (i for i, x in enumerate(lines) if x.is_data(width) and not x.texts)
    first = next(pure, None)
    if first is None:
        return next((i for i, x in enumerate(lines) if x.is_data(width)), None)
    while first > 0 and lines[first - 1].is_data(width):
        first -= 1
    return first


def _names_line(lines: list[_Line], first: int, width: int) -> tuple[int | None, int | None]:
    """Where the names and the units stand above row 0."""

    def holds_names(i: int) -> bool:
        count = len(_drop_trailing_empty(lines[i].cells))
        return lines[i].texts > 0 and count <= width and (count > 1 or width <= 2)

    above = [i for i in range(first - 1, -1, -1) if any(lines[i].cells)]
    while above and lines[above[0]].comment and not holds_names(above[0]):
        above.pop(0)
    if not above or not holds_names(above[0]):
        return None, None
    last = above[0]
    if len(above) > 1 and holds_names(above[1]) and _are_units(lines[last].cells):
        names = _drop_trailing_empty(lines[above[1]].cells)
        if len(names) >= len(_drop_trailing_empty(lines[last].cells)):
            return above[1], last
    return last, None


def _drop_trailing_empty(cells: tuple[str, ...]) -> tuple[str, ...]:
    while cells and not cells[-1]:
        cells = cells[:-1]
    return cells


def _unique_names(names: tuple[str, ...]) -> tuple[str, ...]:
    """Names that differ: a repeated one gets a number, one left out its position."""
    unique: list[str] = []
    for position, name in enumerate(names):
        usual = name or f"column {position}"
        again = usual
        count = 0
        while again in unique:
            count += 1
            again = f"{usual}.{count}"
        unique.append(again)
    return tuple(unique)


def _units_below_names(names: tuple[str, ...], cells: tuple[str, ...]) -> list[tuple[str, str]]:
    pairs = zip(_unique_names(names), (c.strip("[]() ") for c in cells), strict=False)
    return [(name, unit) for name, unit in pairs if unit not in _NO_UNIT]


def _are_units(cells: tuple[str, ...]) -> bool:
    """Whether every cell is a unit or says that there is none."""
    bare = [c.strip("[]() ") for c in cells]
    return any(c not in _NO_UNIT for c in bare) and all(c in _NO_UNIT or is_unit(c) for c in bare)


def units_in_names(names: Iterable[str]) -> dict[str, str]:
    """Units that names end with, in brackets: ``force [N]``, ``t (ms)``."""
    units = {}
    for name in names:
        match = _AT_END.fullmatch(name.rstrip())
        square, round_ = ((g or "").strip() for g in match.groups()) if match else ("", "")
        unit = square or (round_ if len(round_) > 1 or round_ in _LETTERS else "")
        if unit not in _NO_UNIT and is_unit(unit):
            units[name] = unit
    return units


def is_unit(text: str) -> bool:
    """Whether ``text`` names a unit, ``rpm`` and ``1/min`` among them."""
    from spiral.types.units import registry, spelled

    try:
        registry().Unit(spelled(text))
    except Exception:  # pint's parser raises what Python's tokenizer does
        return text.lower() in ("rpm", "hz", "rps", "1/s")
    return True


def _no_dialect_error(
    given: str, dialects: list[Dialect], lines: list[str], separator: str | None
) -> InputError:
    hint = "leave record.separator and record.decimal out: they are found" if separator else ""
    rows = max(dialects, key=lambda d: (d.share, d.width), default=None)
    if rows is None or rows.share <= 0.3:
        return InputError(
            f"{given}: no rows of numbers under {(lines or [''])[0][:60]!r}",
            "a line of names, then rows of numbers",
            hint or "separate the columns by commas, semicolons or tabs",
        )
    if rows.first == 0:
        return InputError(
            f"{given}: no names of columns over {(lines or [''])[0][:60]!r}",
            "a line of names, then rows of numbers",
            "the first line holds numbers: add a line with the columns' names",
        )
    names = split_cells(lines[rows.first - 1], rows.separator)
    if rows.separator == "," and len(names) < rows.width <= 2 * len(names):
        hint = "if fractions are written with commas, separate the columns by semicolons or tabs"
    return InputError(
        f"{given}: {len(names)} names ({', '.join(names)[:60]}) over rows of {rows.width} cells",
        "as many names as cells in each row",
        hint or "give record.separator and record.decimal",
    )
