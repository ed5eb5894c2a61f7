"""An effect that a person writes on the page, as the command line takes it.

The fields take a formula as the command line does, with or without its quotes and key, so that what
a message advises can be typed as it stands.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from spiral.app.record_setup import quote_value
from spiral.types.errors import ConfigError

if TYPE_CHECKING:
    from spiral.types.system import System

_NAME = re.compile(r"[a-z][a-z0-9_]*")
_WRAPPED = re.compile(
    r"""\s*(?:effect\.\w+\.)?(\w+)\s*=\s*(['"]?)(\{.*\}|\[.*\])\2\s*""", re.DOTALL
)
VALUES = "NAME=NUMBER for a gap or a width, NAME=UNIT where a unit is open"


def normalize_effect_name(typed: str) -> str:
    """The name of an effect as typed: ``Fifth power`` is ``fifth_power``."""
    return re.sub(r"[\s-]+", "_", typed.strip().lower())


def effect_overrides(name: str, formula: str, values: str = "") -> list[str]:
    """Overrides, as on the command line, that define an effect by its formula.

    Parameters
    ----------
    name : as ``normalize_effect_name`` returns it.
    formula : ``-k*q**3``; for each axis or channel ``x: -k*y; y: k*x``, or such a text in braces;
        or a list in brackets.
    values : ``w=0.003, b=N/m``: the value of a gap or a width, the unit of a coefficient.

    Raises
    ------
    ConfigError : no name, no formula, or values that are none.
    """
    text = _strip_assignment(formula, "expression")
    if not _NAME.fullmatch(name) or not text:
        raise ConfigError(
            f"an effect {name!r} = {formula.strip()!r}",
            "a name of small letters, digits and _, and a formula",
            "hardening and -k3*q**3",
        )
    key = f"effect.{name}"
    lines = [f"{key}.expression={_expression_value(text)}"]
    for field, table in zip(("shape", "units"), _parse_values(values), strict=True):
        if table:
            inside = ", ".join(f"{k}: {v}" for k, v in table.items())
            lines.append(f"{key}.{field}={{{inside}}}")
    return lines


def example_formula(system: System) -> dict[str, Any]:
    """A formula that works on a system, and what a formula may name there, in words."""
    from spiral.physics.formulas.place import place_of

    at = place_of(system)
    inputs = [name for name, _ in at.inputs]
    if not at.force:
        states = [name for name, _ in at.states]
        text = "; ".join(f"{name}: -c_{name}*{states[0]}" for name, _ in at.outputs)
        return {"formula": text, "names": [("states", states), ("inputs", inputs)]}
    axes = [name for name, _ in at.positions]
    named = [("displacements", axes), ("velocities", [f"{a}_rate" for a in axes]),
             ("of the axis at hand", list(at.at_hand)), ("inputs", inputs)]  # fmt: skip
    return {"formula": f"-k3*{at.at_hand[0]}**3", "names": [(k, v) for k, v in named if v]}


def _strip_assignment(text: str, key: str) -> str:
    """A field's text without ``effect.NAME.KEY='...'`` around it."""
    match = _WRAPPED.fullmatch(text)
    return (match[3] if match and match[1] == key else text).strip()


def _expression_value(text: str) -> str:
    """A formula, or one for each axis, as a value of the overrides' grammar."""
    if text[0] == "[" and text[-1] == "]":
        return "[" + ", ".join(quote_value(p) for p in _split_pieces(text[1:-1])) + "]"
    inside = text[1:-1] if text[0] == "{" and text[-1] == "}" else text
    pairs = [p.partition(":") for p in _split_pieces(inside)]
    if not all(colon and name.strip().isidentifier() for name, colon, _ in pairs):
        return quote_value(text)
    each = (
        f"{name.strip()}: {quote_value(formula.strip().strip(_QUOTES))}"
        for name, _, formula in pairs
    )
    return "{" + ", ".join(each) + "}"


_QUOTES = "'\""


def _split_pieces(text: str) -> Iterator[str]:
    """Pieces between commas, semicolons and new lines that stand in no brackets."""
    depth, begun = 0, 0
    for at, letter in enumerate(text + ";"):
        depth += (letter in "([{") - (letter in ")]}")
        if letter in ",;\n" and depth <= 0:
            if piece := text[begun:at].strip().strip(_QUOTES):
                yield piece
            begun = at + 1


def _parse_values(text: str) -> tuple[dict[str, str], dict[str, str]]:
    """Values of gaps and widths, and units of coefficients, by name."""
    from spiral.types.units import short_form

    for key in ("shape", "units"):
        text = _strip_assignment(text, key)
    inside = text[1:-1] if text.startswith("{") and text.endswith("}") else text
    shape: dict[str, str] = {}
    units: dict[str, str] = {}
    for part in _split_pieces(inside):
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
                units[name] = quote_value(given)
            else:
                shape[name] = repr(number)
        except Exception as error:  # of pint's parser, whatever Python's tokenizer raises
            raise ConfigError(f"gaps, widths and units {part[:60]!r}", VALUES, "w=0.003") from error
    return shape, units
