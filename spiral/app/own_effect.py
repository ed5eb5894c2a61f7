"""An effect that a person writes on the page, as the command line takes it.

The fields take a formula as the command line does, with or without its quotes and key, so that what
a message advises can be typed as it stands.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from spiral.app.record_setup import quoted
from spiral.types.errors import ConfigError

if TYPE_CHECKING:
    from spiral.types.system import System

_NAME = re.compile(r"[a-z][a-z0-9_]*")
_WRAPPED = re.compile(
    r"""\s*(?:effect\.\w+\.)?(\w+)\s*=\s*(['"]?)(\{.*\}|\[.*\])\2\s*""", re.DOTALL
)
VALUES = "NAME=NUMBER for a gap or a width, NAME=UNIT where a unit is open"


def own_name(typed: str) -> str:
    """The name of an effect as typed: ``Fifth power`` is ``fifth_power``."""
    return re.sub(r"[\s-]+", "_", typed.strip().lower())


def overrides_of(name: str, formula: str, values: str = "") -> list[str]:
    """What the command line is told of an effect by expression.

    Parameters
    ----------
    name : as ``own_name`` gives it.
    formula : ``-k*q**3``; for each axis or channel ``x: -k*y; y: k*x``, or such a text in braces;
        or a list in brackets.
    values : ``w=0.003, b=N/m``: the value of a gap or a width, the unit of a coefficient.

    Raises
    ------
    ConfigError : no name, no formula, or values that are none.
    """
    text = _bare(formula, "expression")
    if not _NAME.fullmatch(name) or not text:
        raise ConfigError(
            f"an effect {name!r} = {formula.strip()!r}",
            "a name of small letters, digits and _, and a formula",
            "hardening and -k3*q**3",
        )
    key = f"effect.{name}"
    found = [f"{key}.expression={_expression(text)}"]
    for field, table in zip(("shape", "units"), _values(values), strict=True):
        if table:
            inside = ", ".join(f"{k}: {v}" for k, v in table.items())
            found.append(f"{key}.{field}={{{inside}}}")
    return found


def example(system: System) -> dict[str, Any]:
    """A formula that works on a system, and what a formula may name there, in words."""
    from spiral.physics.formulas.place import EACH_AXIS, place_of

    at = place_of(system)
    inputs = [name for name, _ in at.inputs]
    if not at.force:
        states = [name for name, _ in at.states]
        text = "; ".join(f"{name}: -c_{name}*{states[0]}" for name, _ in at.outputs)
        return {"formula": text, "names": [("states", states), ("inputs", inputs)]}
    axes = [name for name, _ in at.positions]
    named = [("displacements", axes), ("velocities", [f"{a}_rate" for a in axes]),
             ("of the axis at hand", list(EACH_AXIS)), ("inputs", inputs)]  # fmt: skip
    return {"formula": "-k3*q**3", "names": [(k, v) for k, v in named if v]}


def _bare(text: str, key: str) -> str:
    """A field's text without ``effect.NAME.KEY='...'`` around it."""
    found = _WRAPPED.fullmatch(text)
    return (found[3] if found and found[1] == key else text).strip()


def _expression(text: str) -> str:
    """A formula, or one for each axis, as a value of the overrides' grammar."""
    if text[0] == "[" and text[-1] == "]":
        return "[" + ", ".join(quoted(p) for p in _parts(text[1:-1])) + "]"
    inside = text[1:-1] if text[0] == "{" and text[-1] == "}" else text
    pairs = [p.partition(":") for p in _parts(inside)]
    if not all(colon and name.strip().isidentifier() for name, colon, _ in pairs):
        return quoted(text)
    each = (
        f"{name.strip()}: {quoted(formula.strip().strip(_QUOTES))}" for name, _, formula in pairs
    )
    return "{" + ", ".join(each) + "}"


_QUOTES = "'\""


def _parts(text: str) -> Iterator[str]:
    """Pieces between commas, semicolons and new lines that stand in no brackets."""
    depth, begun = 0, 0
    for at, letter in enumerate(text + ";"):
        depth += (letter in "([{") - (letter in ")]}")
        if letter in ",;\n" and depth <= 0:
            if piece := text[begun:at].strip().strip(_QUOTES):
                yield piece
            begun = at + 1


def _values(text: str) -> tuple[dict[str, str], dict[str, str]]:
    """Values of gaps and widths, and units of coefficients, by name."""
    from spiral.types.units import short_form

    for key in ("shape", "units"):
        text = _bare(text, key)
    inside = text[1:-1] if text.startswith("{") and text.endswith("}") else text
    shape: dict[str, str] = {}
    units: dict[str, str] = {}
    for part in _parts(inside):
        name, _, given = (p.strip() for p in re.sub(r"^(\w+)\s*:", r"\1=", part).partition("="))
        try:
            number = float(given)
        except ValueError:
            number = None
        try:
            if not name.isidentifier() or not given or not math.isfinite(number or 0.0):
                raise ValueError
            if number is None:
                short_form(given)
                units[name] = quoted(given)
            else:
                shape[name] = repr(number)
        except Exception as error:  # of pint's parser, whatever Python's tokenizer raises
            raise ConfigError(f"gaps, widths and units {part[:60]!r}", VALUES, "w=0.003") from error
    return shape, units
