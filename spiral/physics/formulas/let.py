"""Names for parts of equations (``let: {e: Re*(i - im)}``), written out wherever they stand."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from spiral.types.errors import ConfigError

_NAME = re.compile(r"[A-Za-z_]\w*'?")
_NAMED = ("states", "inputs", "parameters", "constants")
_FORMULAS = ("equations", "ports", "mass")


def is_reserved(name: str) -> bool:
    """Whether a name means the same in every formula: the time, pi, a rate."""
    return name in ("t", "time", "pi") or name.endswith("_prime")


def write_out(given: Mapping[str, Any]) -> dict[str, Any]:
    """The sections of a system without ``let``: its formulas stand in place of their names.

    A name of ``let`` among ``observed`` becomes a reading of that name.

    Raises
    ------
    ConfigError : no mapping of names to formulas, a name that is taken, formulas that go in a
        circle, the rate of a name.
    """
    sections, formulas = {k: v for k, v in given.items() if k != "let"}, let_formulas(given)
    if not formulas:
        return sections
    for name in sections.keys() & set(_FORMULAS):
        sections[name] = _within(sections[name], formulas)
    observed = sections.get("observed") or ()
    observed = [observed] if isinstance(observed, str) else observed
    sections["observed"] = [_observed(str(o), formulas) for o in observed]
    return sections


def let_formulas(given: Mapping[str, Any]) -> dict[str, str]:
    """The formulas of ``let`` by name, those of other names written out; as in ``write_out``."""
    let = _declared(given)
    return {name: _written_out(name, let, ()) for name in let}


def _declared(given: Mapping[str, Any]) -> dict[str, str]:
    let = given.get("let") or {}
    if not isinstance(let, Mapping):
        raise ConfigError(f"let: {let!r}", "names and their formulas", "let: {e: Re*(i - im)}")
    taken = {str(n) for s in _NAMED if isinstance(given.get(s), Mapping) for n in given[s]}
    for name in map(str, let):
        if not name.isidentifier() or name in taken or is_reserved(name):
            why = "another meaning" if name.isidentifier() else "no name"
            raise ConfigError(f"let: {name}, which has {why}", "a name of its own", f"{name}_1")
    return {str(name): str(formula) for name, formula in let.items()}


def _written_out(text: str, let: Mapping[str, str], above: tuple[str, ...]) -> str:
    """A formula with every name of ``let`` replaced; ``above`` are those that it is a part of."""

    def formula(match: re.Match[str]) -> str:
        name = match[0].removesuffix("'")
        if name not in let:
            return match[0]
        if match[0] != name:
            raise ConfigError(
                f"{match[0]}, the rate of what let names", "rates of states and inputs",
                f"the rate of {let[name]}, written out",
            )  # fmt: skip
        if name in above:
            raise ConfigError(
                f"let: {' -> '.join((*above, name))}", "formulas that do not go in a circle"
            )
        return f"({_written_out(let[name], let, (*above, name))})"

    return _NAME.sub(formula, text)


def _within(given: Any, formulas: Mapping[str, str]) -> Any:
    """What a section holds, its texts written out; keys and numbers stay."""
    if isinstance(given, Mapping):
        return {k: _within(v, formulas) for k, v in given.items()}
    if isinstance(given, list | tuple):
        return [_within(v, formulas) for v in given]
    return _written_out(given, formulas, ()) if isinstance(given, str) else given


def _observed(text: str, formulas: Mapping[str, str]) -> str:
    name, equals, formula = (part.strip() for part in text.partition("="))
    if equals:
        return f"{name} = {_written_out(formula, formulas, ())}"
    return f"{name} = {formulas[name]}" if name in formulas else text
