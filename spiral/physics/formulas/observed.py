"""What sensors report, as text: states, their rates, and formulas of these.

x        a state            x'       its rate, a state where the equations have x''
x''      an acceleration    a = x'' + g        a formula, with a name
"""

from __future__ import annotations

import re
from collections.abc import Sequence

from spiral.types.errors import ConfigError

_RATE = re.compile(r"([A-Za-z_]\w*)('{1,2})")


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
        elif rate and len(rate[2]) == 1 and rate[1] in twice:
            name = f"{rate[1]}_rate"
        elif rate:
            formula, name = name, f"{rate[1]}_{'rate' if len(rate[2]) == 1 else 'acceleration'}"
            formulas.append((name, formula))
        if not name.isidentifier():
            raise ConfigError(
                f"observed: {text}",
                "a state, a rate x' or x'', or NAME = FORMULA",
                f"load = {text}" if not equals else "letters, digits and _ in its name",
            )
        names.append(name)
    return tuple(names), tuple(formulas)
