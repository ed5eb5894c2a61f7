"""Options of ``spiral plan``: the configuration's section ``plan``, checked."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from spiral.inference.excitation import FORMS
from spiral.types.errors import ConfigError
from spiral.types.fields import construct


@dataclass(frozen=True)
class PlanOptions:
    """What a plan may vary; what is left out follows from the records at hand.

    Fields
    ------
    effects : those to tell apart (or named after the verb).
    parameter, standard_error : a parameter by full name, and the standard error it should have.
    speeds : [from, to] in Hz, or one number, of a turning machine.
    unbalances : factors on the unbalance: 1 as it is, 3 with a trial weight of twice its moment.
    forms : of an input that drives: noise, multisine, chirp.
    amplitudes : factors on the input's root mean square at hand.
    bands : [low, high] in Hz of such an input.
    durations : s.
    rates : samples per s.
    shown : tests in the table.
    """

    effects: tuple[str, ...] = ()
    parameter: str | None = None
    standard_error: float | None = None
    speeds: tuple[Any, ...] = ()
    unbalances: tuple[float, ...] = ()
    forms: tuple[str, ...] = ()
    amplitudes: tuple[float, ...] = ()
    bands: tuple[tuple[float, ...], ...] = ()
    durations: tuple[float, ...] = ()
    rates: tuple[float, ...] = ()
    shown: int = 10


def plan_options(section: Mapping[str, Any] | None) -> PlanOptions:
    """The wishes of a configuration's section ``plan``.

    Raises
    ------
    ConfigError : an unknown field, or a value that cannot be.
    """
    options = construct(
        PlanOptions, {k: v for k, v in (section or {}).items() if v is not None}, "plan"
    )
    for name in ("durations", "rates", "amplitudes", "unbalances"):
        for value in getattr(options, name):
            if not value > 0:
                raise ConfigError(f"plan.{name}: {value:g}", "numbers above zero")
    for form in options.forms:
        if form not in FORMS[2:]:
            raise ConfigError(f"plan.forms: {form!r}", f"some of {', '.join(FORMS[2:])}")
    if options.standard_error is not None and not options.standard_error > 0:
        raise ConfigError(f"plan.standard_error={options.standard_error:g}", "a number above zero")
    return options
