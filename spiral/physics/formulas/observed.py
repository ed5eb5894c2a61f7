"""What sensors report, as text: states, their rates, and formulas of these.

x        a state            x'       its rate, a state where the equations have x''
x''      an acceleration    a = x'' + g        a formula, with a name
"""

from __future__ import annotations

import re
from collections.abc import Sequence

from spiral.types.errors import ConfigError

_RATE = re.compile(r"([A-Za-z_]\w*)('{1,2})")
_ENDINGS = {"'": "_rate", "''": "_acceleration"}


def with_primes(name: str) -> str:
    """A channel's name as equations write it, ``x'`` for ``x_rate``; empty for other names."""
    spelled = (name.removesuffix(e) + p for p, e in _ENDINGS.items() if name.endswith(e))
    return next(spelled, "")


def split_observed(
    given: Sequence[str], twice: Sequence[str]
) -> tuple[tuple[str, ...], tuple[tuple[str, str], ...]]:
    """Names of the channels, and the (name, formula) of those that are no state.

    ``twice`` are the states whose second derivative is in the equations.

    Raises
    ------
    ConfigError : a formula without a name.
    """
    names: list[str] = []
    formulas: list[tuple[str, str]] = []
    for text in given:
        name, equals, formula = (part.strip() for part in text.partition("="))
        rate = _RATE.fullmatch(name)
        if equals:
            formulas.append((name, formula))
        elif rate:
            is_state = rate[2] == "'" and rate[1] in twice
            formula, name = name, rate[1] + _ENDINGS[rate[2]]
            if not is_state:
                formulas.append((name, formula))
        if not name.isidentifier():
            raise ConfigError(
                f"observed: {text}",
                "a state, a rate x' or x'', or NAME = FORMULA",
                f"load = {text}" if not equals else "letters, digits and _ in its name",
            )
        names.append(name)
    return tuple(names), tuple(formulas)
