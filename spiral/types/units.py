"""Units by pint: one registry, conversions, and the unit check of physics.

Speed is converted explicitly: pint would take 1 Hz as 1 rad/s.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable
from functools import lru_cache
from types import SimpleNamespace
from typing import Any

from spiral.types.cache import kept
from spiral.types.effect import (
    Effect,
    FlowEffect,
    ForceEffect,
    InputEffect,
    ParameterEffect,
    SensorEffect,
    StateFlow,
)
from spiral.types.errors import ConfigError, InputError, PluginError
from spiral.types.parameter import Parameter, State
from spiral.types.port import At, Port
from spiral.types.rates import per_second
from spiral.types.system import MechanicalSystem, System

_POWER = re.compile(r"(?<=[/* ])([A-Za-zµΩ]+)(-?\d)\b")  # beside another unit: T2 may be a name
_LENGTH_POWER = re.compile(r"^([kcdmuµ]?m)([23])\b")
_PREFIX = "(?:da|[kMGcdmuµn])?"
_TOGETHER = re.compile(
    rf"(?<!\w)(?:({_PREFIX}N|kg)([cmk]?m)(s?)|({_PREFIX}(?:[NVAWJCKT]|Pa))(s))"
    r"(?:(?:\*\*)?(-?\d+(?:\.\d+)?))?(?![\w.]|\*\*)"
)
_TURNS = re.compile(r"(?<!\w)[Ur](?=/(?:min|s)\b)")  # U/min is an enzyme's unit to pint
_SUPERSCRIPTS = str.maketrans({"²": "**2", "³": "**3", "·": "*", "⋅": "*", "\u03bc": "µ"})
_GRAVITY = {"g": 9.80665, "mg": 9.80665e-3}  # of an acceleration, where pint reads grams
_PER_TURN = {"hz": 2 * math.pi, "1/s": 2 * math.pi, "rpm": 2 * math.pi / 60, "rps": 2 * math.pi}
_PER_TURN |= {f"{turn}/min": 2 * math.pi / 60 for turn in ("1", "u", "r", "rev")}
_PER_TURN |= {f"{turn}/s": 2 * math.pi for turn in ("u", "r", "rev")}
_LAST = {"meter": 1, "kelvin": 2, "second": 3, "radian": 4}  # factors of a unit, in this order
_ALIASES = ("ohm = Ohm", "turn = rev", "torr = Torr")


@lru_cache(maxsize=1)
def registry() -> Any:
    """The unit registry, its parsed definitions cached on disk."""
    import pint

    try:
        units = pint.UnitRegistry(cache_folder=":auto:")
    except OSError:
        units = pint.UnitRegistry()
    for name in _ALIASES:
        units.define(f"@alias {name}")
    units.formatter.default_sort_func = _usual_order
    return units


def _usual_order(items: Iterable[tuple[str, Any, str]], _: Any) -> list[tuple[str, Any, str]]:
    """Factors of a unit as engineers order them: ``N*m*s``, which by the alphabet is ``m*N*s``."""
    return sorted(items, key=lambda item: (_LAST.get(item[2], 0), item[0]))


@lru_cache(maxsize=512)
def short_form(unit: str) -> str:
    """A compact way to write a unit: ``(m/s^2)/(m)`` -> ``1/s^2``; empty where dimensionless.

    A mass is ``kg``, whatever force and length it is the quotient of.
    """
    if not unit:
        return ""
    parsed = _parse(unit)
    if parsed.dimensionless:
        return "rad" if unit.strip() == "rad" else ""
    if base_form(unit) == (1.0, {"kg": 1}):
        return "kg"
    text = f"{parsed:~C}" if hasattr(parsed, "__format__") else str(parsed)
    return text.replace("**", "^")


def base_form(unit: str) -> tuple[float, dict[str, int]] | None:
    """A difference of one unit as a factor and the powers of kg, m, s, A, K, mol, cd and rad.

    Nothing where it has no such form: broken powers, a count, a level.
    """
    import pint

    try:
        one, two, three = (registry().Quantity(n, _parse(unit)).to_base_units() for n in (1, 2, 3))
    except (pint.PintError, ValueError, TypeError):
        return None
    names = {"kilogram": "kg", "meter": "m", "second": "s", "ampere": "A", "kelvin": "K",
             "mole": "mol", "candela": "cd", "radian": "rad"}  # fmt: skip
    powers = {names.get(str(k), ""): float(v) for k, v in two.unit_items()}
    step, other = (float(b.magnitude - a.magnitude) for a, b in ((one, two), (two, three)))
    straight = math.isclose(step, other, rel_tol=1e-9)
    if "" in powers or not straight or not all(v.is_integer() for v in powers.values()):
        return None
    return step, {k: int(v) for k, v in powers.items()}


def spelled(unit: str) -> str:
    """A unit as people write it (``m/s^2``, ``m/s2``, ``m s-2``, ``Nm``) in the notation of pint.

    To pint ``Nm`` is a yarn's length for a mass, and ``As`` an ampere in the plural.
    """
    text = _TURNS.sub("turn", unit.translate(_SUPERSCRIPTS).replace("^", "**"))
    text = _TOGETHER.sub(_apart, text)
    return _POWER.sub(r"\1**\2", _LENGTH_POWER.sub(r"\1**\2", text))


def _apart(match: re.Match[str]) -> str:
    """``Nm`` -> ``(N*m)``, ``Nms^2`` -> ``(N*m*s**2)``, ``kgm2`` -> ``(kg*m**2)``."""
    *parts, power = match.groups()
    product = "*".join(filter(None, parts))
    return f"({product}**{power})" if power else f"({product})"


def _parse(unit: str) -> Any:
    """A unit; where a port has none, its place in a relative unit is empty: ``()/()``."""
    import pint

    unit = unit.replace("()", "(dimensionless)")
    try:
        return registry().Unit(spelled(unit).replace("1*", "") or "")
    except (pint.UndefinedUnitError, pint.errors.DefinitionSyntaxError, ValueError, TypeError):
        return registry().parse_expression(spelled(unit)).units


def factor(given: str, wanted: str, what: str) -> float:
    """Multiply differences in ``given`` by this to have them in ``wanted``.

    Raises
    ------
    InputError : an unknown unit, or one of another dimension.
    """
    return conversion(given, wanted, what)[0]


def conversion(given: str, wanted: str, what: str) -> tuple[float, float]:
    """Factor and zero: a value x in ``given`` is factor x + zero in ``wanted``.

    The zero is that of the scale, 273.15 from degC to K; for most units it is 0.

    Raises
    ------
    InputError : an unknown unit, one of another dimension, or one that no straight line converts.
    """
    import pint

    if wanted in _NONE and given.strip().lower() in _PURE:
        return 1.0, 0.0
    if (per_second := _turning_rate(given.strip(), wanted)) is not None:
        return per_second, 0.0
    try:
        if given.strip() in _GRAVITY and _parse(wanted).is_compatible_with("m/s**2"):
            return _GRAVITY[given.strip()] * factor("m/s^2", wanted, what), 0.0
        return _linear_conversion(spelled(given), spelled(wanted))
    except pint.UndefinedUnitError as error:
        raise InputError(
            f"unit {given!r} of {what}",
            f"a unit of {_wanted_words(wanted)}",
            "write it as in 'um', 'mm/s', 'm/s^2', 'deg', 'rpm', 'Hz', 'degC', 'l/min', 'V'",
        ) from error
    except (pint.DimensionalityError, pint.OffsetUnitCalculusError) as error:
        raise InputError(
            f"unit {given!r} of {what}",
            f"a unit that converts to {_wanted_words(wanted)}",
            f"correct record.units{' (1, %, ppm)' * (wanted in _NONE)}, or give a column measured "
            f"in {_wanted_words(wanted)}",
        ) from error
    except Exception as error:  # pint's parser raises what Python's tokenizer does
        bare = wanted in _NONE
        raise InputError(
            f"unit {given!r} of {what}",
            f"{_wanted_words(wanted)}: 1, '%' or 'ppm'" if bare else f"a unit such as {wanted!r}",
            f"a column multiplied by the factor, where {given!r} is one" if bare else "",
        ) from error


def _turning_rate(given: str, wanted: str) -> float | None:
    """The factor of a speed of rotation, where one of both units counts turns; else nothing.

    To pint a turn is 6.28 and a hertz is 1/s, so that 60 rpm would be 6.28 Hz.
    """
    turns = _PER_TURN.get(given.lower())
    if wanted == "rad/s":
        return turns
    if wanted == "Hz" and given == "rad/s":
        return 1 / (2 * math.pi)
    return turns / (2 * math.pi) if turns is not None and wanted in ("Hz", "1/s") else None


_NONE = ("", "1")  # the unit of a number without a unit
_PURE = ("pu", "p.u.", "per unit", "-", "none")  # as files write it; pu is a mass to pint


def _wanted_words(unit: str) -> str:
    return "a number without a unit" if unit in _NONE else repr(unit)


def _linear_conversion(given: str, wanted: str) -> tuple[float, float]:
    """Factor and zero of units whose scales are straight lines of one another."""
    pairs = (registry().Quantity(x, given).to(wanted).magnitude for x in (0.0, 1.0, 2.0))
    zero, one, two = (float(value) for value in pairs)
    if not math.isclose(two - one, one - zero, rel_tol=1e-9):
        raise ValueError(f"{given} is no straight line of {wanted}")
    return one - zero, zero


def check_units(system: System, effect: Effect) -> None:
    """Evaluate an effect's equation on quantities with units.

    Raises
    ------
    PluginError : the units do not fit; the message names the effect and both units.
    """
    import pint

    port = system.place(effect)
    known = effect.units if isinstance(effect, StateFlow | ParameterEffect) else ()
    if known and not any(_is_one_kind(port.position_unit or "1", unit) for unit in known):
        raise ConfigError(
            f"effect {effect.label!r} at port {port.name!r} in {port.position_unit or '1'}",
            f"states in {', '.join(known)}",
        )
    try:
        for what, value, expected in _evaluate_effect(system, effect, port):
            _check_dimension(f"{what} {effect.label!r}", value, expected)
    except (pint.DimensionalityError, pint.errors.OffsetUnitCalculusError) as error:
        raise PluginError(
            f"effect {effect.label!r} at port {port.name!r}: {error}",
            "an equation whose units fit",
            "check the units of its parameters",
        ) from error


def _is_one_kind(unit: str, other: str) -> bool:
    """Whether two units are of one quantity; an angle is not a number."""
    one, two = base_form(unit), base_form(other)
    if one is None or two is None:
        return _parse(unit).dimensionality == _parse(other).dimensionality
    return one[1] == two[1]


def check_system_units(system: MechanicalSystem) -> None:
    """Evaluate M q'' and a system's own force on quantities with units.

    Raises
    ------
    PluginError : a unit differs from that of the injection of its coordinate.
    """
    import pint

    coordinates, name = system.coordinates, system.plugin_name()
    q, p = _quantities((*coordinates, *system.others)), _quantities(system.parameters)
    v, u = _quantities(coordinates, per_second), _input_quantities(system)
    try:
        force, mass = system.force(q, v, u, p), system.mass(q, p)
        flows = system.flows(q, v, u, p)
    except (pint.DimensionalityError, pint.errors.OffsetUnitCalculusError) as error:
        raise PluginError(f"system {name!r}: {error}", "an equation whose units fit") from error
    units = {state.name: per_second(state.unit) for state in system.others}
    units |= {entry.name: entry.unit for entry in system.injections}
    for other, value in flows.items():
        _check_dimension(f"rate of {other!r} of system {name!r}", value, units[other])
    for i, entry in enumerate(system.injections[: len(coordinates)]):
        own = [("force", force[i])]
        own += [
            (f"mass row {i}", m * quantity(per_second(c.unit, 2)))
            for m, c in zip(mass[i], coordinates, strict=True)
            if not _is_zero(m)
        ]
        for what, value in own:
            _check_dimension(f"{what} of system {name!r}", value, entry.unit)


def check_rate_units(system: System) -> None:
    """Evaluate the rates of a system of first order on quantities with units.

    Raises
    ------
    PluginError : a rate in another unit than its state's per second, what is injected included.
    """
    import pint

    name, x, p = system.plugin_name(), _quantities(system.states), _quantities(system.parameters)
    injected = vars(_quantities(system.injections))
    try:
        rates = system.rate(x, _input_quantities(system), p, injected)
    except pint.errors.OffsetUnitCalculusError as error:
        raise PluginError(
            f"system {name!r}: a product with a temperature in degrees",
            "temperatures in K, or differences of two",
            "T - T_room in place of T, or states in K",
        ) from error
    except pint.DimensionalityError as error:
        raise PluginError(f"system {name!r}: {error}", "rates whose units fit") from error
    except ValueError as error:  # what pint raises where a number is compared with a quantity
        raise PluginError(
            f"system {name!r}: {error}",
            "quantities compared with quantities of their unit, or with 0",
            "a parameter with a unit in place of the number",
        ) from error
    for state in system.states:
        what = f"rate of {state.name!r} of system {name!r}"
        _check_dimension(what, rates[state.name], per_second(state.unit))


def check_reading_units(system: System) -> None:
    """Evaluate what sensors report that is no state on quantities with units.

    Raises
    ------
    PluginError : a reading whose formula is of another unit.
    """
    import pint

    if not system.readings:
        return
    name = system.plugin_name()
    x, p = _quantities(system.states), _quantities(system.parameters)
    rates = _quantities(system.states, per_second)
    try:
        given = system.reading(x, rates, _input_quantities(system), p)
    except (pint.DimensionalityError, pint.errors.OffsetUnitCalculusError) as error:
        raise PluginError(f"system {name!r}: {error}", "a reading whose units fit") from error
    for entry in system.readings:
        _check_dimension(
            f"reading {entry.name!r} of system {name!r}", given[entry.name], entry.unit
        )


def _is_zero(value: Any) -> bool:
    return isinstance(value, int | float) and value == 0


def _input_quantities(system: System) -> SimpleNamespace:
    u = SimpleNamespace(time=quantity("s"))
    for item in system.inputs:
        setattr(u, item.name, quantity(item.unit))
        setattr(u, item.rate.name, quantity(item.rate.unit))
    return u


@kept(2048)
def units_fit(system: System, effect: Effect) -> bool:
    """Whether an effect's units fit a system (sin of a length does not)."""
    try:
        check_units(system, effect)
    except (PluginError, ConfigError):
        return False
    except Exception:  # broken in itself, whatever the units: tracing it says so
        return True
    return True


def _quantities(
    items: Iterable[State | Parameter], of: Callable[[str], str] = str
) -> SimpleNamespace:
    """One of each by its name, in its unit or a unit made ``of`` it, no two of one size.

    Where all were of one size, differences of products (L M - N^2) would be zero.
    """
    return SimpleNamespace(
        **{i.name: quantity(of(i.unit), 1.25 + k / 97) for k, i in enumerate(items)}
    )


def _quantities_at(port: Port, items: Iterable[State | Parameter]) -> SimpleNamespace:
    """One of each by its name, in its unit at a port; a tuple where there is one for each axis."""
    each = {i.name: (quantity(port.unit(i.unit)), i.per_axis) for i in items}
    return SimpleNamespace(
        **{k: (one,) * len(port.axes) if per_axis else one for k, (one, per_axis) in each.items()}
    )


def quantity(unit: str, size: float = 1.25) -> Any:
    """A number with its unit, as pint has it; ``size`` is one at which hardly a formula is zero."""
    return registry().Quantity(size, _parse(unit) if unit else "")


def _evaluate_effect(system: System, effect: Effect, port: Port) -> list[tuple[str, Any, str]]:
    """(what it is, its value with units, the unit it must have) of all that an effect gives."""
    count, unit = len(port.axes), port.position_unit
    position = tuple(quantity(unit, 1.0 + 0.25 * i) for i in range(count))
    velocity = tuple(quantity(per_second(unit), 0.5 + 0.25 * i) for i in range(count))
    acceleration = tuple(quantity(per_second(unit, 2)) for _ in range(count))
    own, p = (_quantities_at(port, items) for items in (effect.states, effect.parameters))
    u = _input_quantities(system)
    into = quantity(port.force_unit)
    at = At(position, velocity, own, acceleration, quantity(unit, 1.75), lambda value: into)
    values = [(f"rate {k} of effect", v, unit) for k, v, unit in _own_rates(effect, port, at, u, p)]
    if isinstance(effect, ForceEffect):
        values += [("effect", value, port.force_unit) for value in effect.force(at, u, p)]
    elif isinstance(effect, SensorEffect):
        unit = port.force_unit if effect.driver else port.position_unit
        readings = effect.reading([quantity(unit, 0.75) for _ in position], at, u, p)
        values += [("effect", value, unit) for value in readings]
    elif isinstance(effect, InputEffect):
        values.append(("effect", effect.drive(at, u, p), port.position_unit))
    elif isinstance(effect, ParameterEffect):
        values.append(("factor of effect", effect.factor(at, u, p), ""))
    elif isinstance(effect, StateFlow):
        values += [("effect", value, port.force_unit) for value in effect.flow(at, u, p)]
    elif isinstance(effect, FlowEffect):
        x = SimpleNamespace(**{s.name: quantity(s.unit) for s in system.states}, own=own)
        units = {i.name: i.unit for i in system.injections}
        values += [("effect", value, units[name]) for name, value in effect.flow(x, u, p).items()]
    return values


def _own_rates(
    effect: Effect, port: Port, at: At, u: SimpleNamespace, p: SimpleNamespace
) -> list[tuple[str, Any, str]]:
    rates = effect.rate(at, u, p) if effect.states else {}
    return [
        (state.name, value, per_second(port.unit(state.unit)))
        for state in effect.states
        if state.name in rates
        for value in (rates[state.name] if state.per_axis else [rates[state.name]])
    ]


def _check_dimension(what: str, value: Any, expected: str) -> None:
    if _is_zero(value):
        return
    given = registry().Quantity(value) if not hasattr(value, "dimensionality") else value
    if given.dimensionality != _parse(expected).dimensionality:
        raise PluginError(
            f"{what} gives {given.units:~C}",
            f"{expected}",
            "check the units of its parameters",
        )
