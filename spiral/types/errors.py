"""Errors a person can act on: what was given, what was expected, what to try."""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from pathlib import Path


class SpiralError(Exception):
    """Base of all errors this package raises on purpose.

    Parameters
    ----------
    given : what the user gave.
    expected : what would have been accepted.
    try_ : the next thing to do.
    """

    def __init__(self, given: str, expected: str, try_: str = "") -> None:
        self.given = given
        self.expected = expected
        self.try_ = try_
        super().__init__(self.__str__())

    def __str__(self) -> str:
        lines = [f"given:    {self.given}", f"expected: {self.expected}"]
        if self.try_:
            lines.append(f"try:      {self.try_}")
        return "\n".join(lines)

    def __reduce__(self) -> tuple[type, tuple[str, str, str]]:
        return type(self), (self.given, self.expected, self.try_)

    def as_dict(self) -> dict[str, str]:
        """The error as ``--json`` writes it."""
        return {"given": self.given, "expected": self.expected, "try": self.try_}


class InputError(SpiralError):
    """Bad data: a file, a column, a unit, a number."""


class ConfigError(SpiralError):
    """Bad configuration: an unknown name, field or value."""


class PluginError(SpiralError):
    """A plugin that breaks its contract: its definition, units or behaviour."""


def near_misses(word: str, known: Iterable[str], count: int = 3) -> list[str]:
    """Names close to ``word``: ``OWNER.word``, then the same prefix, then by edit distance."""
    names = sorted(set(known))
    low = word.lower()
    owned = [n for n in names if n.lower().endswith("." + low)]
    prefixed = [n for n in names if n.lower().startswith(low) or low.startswith(n.lower())]
    inside = [n for n in names if len(low) > 3 and low in n.lower()]
    close = difflib.get_close_matches(word, names, n=count, cutoff=0.55)
    if not close and "." not in word:
        last = {n.rpartition(".")[2]: n for n in reversed(names)}
        close = [last[x] for x in difflib.get_close_matches(word, last, n=count, cutoff=0.75)]
    return list(dict.fromkeys([*owned, *prefixed, *close, *inside]))[:count]


def similar_files(place: Path) -> str:
    """A hint that names files of nearly this name in its folder; empty where there are none."""
    if not place.parent.is_dir():
        return ""
    near = near_misses(place.name, [p.name for p in place.parent.iterdir() if p.is_file()])
    return f"did you mean {' or '.join(str(place.parent / n) for n in near)}?" if near else ""


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """A hint naming near misses, or every known name where none is near."""
    names = sorted(set(known))
    near = near_misses(word, names)
    if near:
        return "did you mean " + " or ".join(repr(n) for n in near) + "?"
    return "one of: " + ", ".join(names) if names else "none are known here"
