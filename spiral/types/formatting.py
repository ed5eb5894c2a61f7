"""Numbers as people read them: shares, p-values, estimates with their errors."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from typing import Any

_LEAST = 1e-3  # percent; smaller shares are written as ``< 0.001 %``


def percent(value: float | None) -> str:
    """A share as people read it: ``1.99 %``; ``< 0.001 %`` where it is smaller than that."""
    if not _is_finite_number(value):
        return "-"
    share = 100 * float(value)  # type: ignore[arg-type]
    if 0 < abs(share) < _LEAST:
        return f"< {_LEAST:g} %"
    return f"{share:.0f} %" if abs(share) >= 1000 else f"{share:#.3g} %".replace(". ", " ")


def error_percent(value: float | None) -> str:
    """A prediction error as a share; ``not finite`` where the free run diverges."""
    return "not finite" if value is None else percent(value)


def join_words(names: Sequence[str]) -> str:
    """``a``, ``a and b``, ``a, b and c``."""
    return " and ".join(filter(None, (", ".join(names[:-1]), *names[-1:])))


def first_words(names: Sequence[str], most: int = 4) -> str:
    """``a, b``, and where there are more than ``most``, ``a, b and 3 more``."""
    left = len(names) - most
    return ", ".join(names[:most]) + (f" and {left} more" if left > 0 else "")


def sentences(text: str) -> list[tuple[str, tuple[str, ...]]]:
    """A verdict point by point: sentences, and what is listed under one, as in ``More is missing``.

    Clauses of a sentence that list different findings are points of their own; one that goes on
    about the one before it (``they are left out``) stays with it.
    """
    points: list[tuple[str, tuple[str, ...]]] = []
    for one in re.split(r"(?<=[.!?])\s+(?=[A-Z]|[a-z]\w*[._@]\w)", text.strip()):
        first, *more = re.split(r"; (?!(?:it|they|this|test error) |[^(]*\))", one)
        lead, colon, rest = first.partition(": ")
        if more and colon and "missing" in lead:
            points.append((f"{lead}:", (rest, *more[:-1], more[-1].removesuffix("."))))
        elif more:
            points += [(_as_sentence(clause), ()) for clause in (first, *more)]
        elif one:
            points.append((one, ()))
    return points


def _as_sentence(clause: str) -> str:
    """A clause that begins with a capital letter, but for a name, and ends with a full stop."""
    first = capitalised(clause)
    return first if first.endswith(".") else f"{first}."


def capitalised(words: str) -> str:
    """Words with a capital letter first; a name (``system.k``) is written as it is."""
    named = any(c in words.partition(" ")[0] for c in "._@")
    return words if named else words[:1].upper() + words[1:]


def number(value: float | None, digits: int = 4) -> str:
    """A few significant digits, ``-`` where there is no number."""
    return "-" if not _is_finite_number(value) else f"{float(value):.{digits}g}"  # type: ignore[arg-type]


def digits(value: float | None, count: int = 3) -> str:
    """``count`` significant digits, trailing zeros included: ``1.00``."""
    if not _is_finite_number(value) or not 1e-3 <= abs(float(value)) < 1e4:  # type: ignore[arg-type]
        return number(value, count)
    return f"{float(value):#.{count}g}".removesuffix(".")  # type: ignore[arg-type]


def duration(seconds: float, digits: int = 2) -> str:
    """A time in a unit in which it is no large number: ``450 s``, ``95 min``, ``6.4 h``, ``3.9 d``.

    A unit begins at ten minutes, two hours, two days.
    """
    for least, unit, size in (
        (172800.0, "d", 86400.0),
        (7200.0, "h", 3600.0),
        (600.0, "min", 60.0),
    ):
        if abs(seconds) >= least:
            return f"{_no_power(seconds / size, digits)} {unit}"
    return f"{_no_power(seconds, digits)} s"


def _no_power(value: float, digits: int) -> str:
    """A number with so many digits, or all before its point: ``110``, not ``1.1e+02``."""
    return f"{value:.0f}" if abs(value) >= 10**digits else number(value, digits)


def extent(samples: int, rate: float) -> str:
    """Length and rate of a record: ``6000 samples, 3 s, 2000 Hz``; ``... one every 60 min``."""
    often = f"{rate:.6g} Hz" if rate >= 1 else f"one every {duration(1 / rate, 4)}"
    return f"{samples} samples, {duration(samples / rate, 4)}, {often}"


def probability(value: float | None) -> str:
    """A p-value: ``0.32``, ``2e-09``, ``< 1e-99``."""
    if not _is_finite_number(value):
        return "-"
    p = float(value)  # type: ignore[arg-type]
    if p < 1e-99:
        return "< 1e-99"
    return f"{p:.2f}" if p >= 0.01 else f"{p:.0e}"


def plus_minus(value: float | None, se: float | None) -> str:
    """An estimate with its standard error to the digits that it supports."""
    if not _is_finite_number(value):
        return "-"
    size = float(value)  # type: ignore[arg-type]
    if not _is_finite_number(se) or not se:
        return f"{size:.5g}"
    error = float(se)
    power = _decimal_exponent(max(abs(size), error))
    scale = 10.0**power if abs(power) >= 5 or power <= -3 else 1.0
    places = max(0, 1 - _decimal_exponent(error / scale))
    text = f"{size / scale:.{places}f} ± {error / scale:.{places}f}"
    return text if scale == 1.0 else f"({text})e{power}"


def _decimal_exponent(value: float) -> int:
    return math.floor(math.log10(abs(value))) if value else 0


def _is_finite_number(value: Any) -> bool:
    return value is not None and math.isfinite(float(value))
