"""Effects written as a formula: a force, or a flow, from a text such as ``-k3*x**3``.

A formula becomes an effect like any other: a class made for it, whose equation walks the formula.
Tracing, units, Jacobians, LaTeX and compiled code follow from it as from an effect in a file.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import lru_cache
from types import SimpleNamespace
from typing import Any, ClassVar

from spiral.physics.formulas import syntax
from spiral.physics.formulas.dimensions import (
    check_unit_agrees,
    dimension,
    infer_dimensions,
    unit_for,
)
from spiral.physics.formulas.place import (
    Place,
    place_of,
    values_at_hand,
)
from spiral.types.effect import Effect, FlowEffect, ForceEffect
from spiral.types.errors import ConfigError, did_you_mean
from spiral.types.fields import construct
from spiral.types.parameter import Parameter
from spiral.types.system import System

_TIME = ("t", "time")


@dataclass(frozen=True)
class Definition:
    """What a user says of an effect by expression.

    Fields
    ------
    expression : a formula; a list with one for each axis; or axis, or channel of a flow -> formula.
    units : parameter -> unit, where the equation leaves it open.
    shape : parameter that does not enter linearly (a gap, a width) -> its value.
    grid : such a parameter -> values to try, as shares of the largest motion in the record.
    lower : parameter -> lower bound.
    per_axis : parameters with one value for each axis.
    port : where it acts; left out, the system's first port.
    meaning : what it is, in a few words.
    """

    expression: Any = None
    units: Mapping[str, str] | None = None
    shape: Mapping[str, float] | None = None
    grid: Mapping[str, tuple[float, ...]] | None = None
    lower: Mapping[str, float] | None = None
    per_axis: tuple[str, ...] = ()
    port: str = ""
    meaning: str = ""

    def as_dict(self) -> dict[str, Any]:
        """As a configuration holds it; what was left out is not there."""
        return {k: v for k, v in asdict(self).items() if v}


def effect_from_expression(
    name: str, expression: Any, system: System, port: str = "", **options: Any
) -> Effect:
    """An effect from a formula, its units found or checked.

        effect_from_expression("dent", "-k3*x**3", oscillator)

    Parameters
    ----------
    name : of the effect, a Python identifier.
    expression : text; list with one text for each axis of the port; or mapping axis (or, of a
        system of first order, channel) -> text. It may name the port's axes (``x``), their rates
        (``x_rate``), the axis at hand (``q``, ``v``, or ``axis_position``, ``axis_velocity`` where
        the system has other uses for these: one text then serves all axes), inputs (``speed``) and
        states of a system of first order; every other name is a parameter.
        A force acts on the machine: ``-k*x`` is a spring.
    system, port : where it acts.
    options : ``units``, ``shape``, ``grid``, ``lower``, ``per_axis``, ``meaning``, as in
        ``Definition``.

    Raises
    ------
    ConfigError : what is not allowed in a formula; units that do not fit; a parameter whose unit
        or role is open.
    """
    given = {"expression": expression, "port": port, **options}
    return class_of(name, given, system)()


def class_of(name: str, given: Mapping[str, Any], system: System) -> type[Effect]:
    """The class of an effect by expression; the same one for the same definition and place.

    Raises
    ------
    ConfigError : as ``effect_from_expression``, and for an unknown field.
    """
    where = f"effect.{name}"
    if not name.isidentifier():
        raise ConfigError(f"an effect named {name!r}", "letters, digits and _", "dry_rub")
    definition = construct(Definition, {k: v for k, v in given.items() if v is not None}, where)
    if not definition.expression:
        raise ConfigError(f"{where} without an expression", f"{where}.expression=FORMULA")
    text = json.dumps(definition.as_dict(), sort_keys=True)
    return _build_class(name, text, place_of(system, definition.port))


def definitions_of(effects: tuple[Effect, ...]) -> dict[str, dict[str, Any]]:
    """Name -> definition of those that are effects by expression."""
    return {e.plugin_name(): e.definition.as_dict() for e in effects if isinstance(e, _BY_FORMULA)}


# --- the classes ---------------------------------------------------------------------------------


class ForceByFormula(ForceEffect):
    """A force given by a formula for each axis."""

    definition: ClassVar[Definition]
    place: ClassVar[Place]
    formulas: ClassVar[tuple[tuple[str, str], ...]]

    def force(self, at, u, p):
        """The formulas' values, one for each axis."""
        values = _input_values(self.place, u)
        for (axis, _), q, v in zip(self.place.positions, at.position, at.velocity, strict=True):
            values |= {axis: q, f"{axis}_rate": v}
        forces = []
        for i, (_, text) in enumerate(self.formulas):
            own = _parameter_values(self.parameters, p, i)
            each = values_at_hand(at.position[i], at.velocity[i])
            forces.append(syntax.compute(text, {**each, **values, **own}))
        return forces


class FlowByFormula(FlowEffect):
    """Flows given by a formula for each channel."""

    definition: ClassVar[Definition]
    place: ClassVar[Place]
    formulas: ClassVar[tuple[tuple[str, str], ...]]

    def flow(self, x, u, p):
        """The formulas' values by channel."""
        values = _input_values(self.place, u) | {n: getattr(x, n) for n, _ in self.place.states}
        own = _parameter_values(self.parameters, p, 0)
        return {c: syntax.compute(text, {**values, **own}) for c, text in self.formulas}


_BY_FORMULA = (ForceByFormula, FlowByFormula)


def _input_values(place: Place, u: SimpleNamespace) -> dict[str, Any]:
    return {n: getattr(u, n) for n, _ in place.inputs}


def _parameter_values(
    known: tuple[Parameter, ...], p: SimpleNamespace, axis: int
) -> dict[str, Any]:
    return {q.name: getattr(p, q.name)[axis] if q.per_axis else getattr(p, q.name) for q in known}


@lru_cache(maxsize=256)
def _build_class(name: str, text: str, place: Place) -> type[Effect]:
    definition = construct(Definition, json.loads(text), f"effect.{name}")
    formulas = _formulas_by_output(definition.expression, place)
    used = dict.fromkeys(n for t in formulas.values() for n in syntax.names(t))
    free = tuple(n for n in used if n not in place.known)
    _check_names(definition, free, place)
    parameters = _define_parameters(definition, formulas, free, place)
    one = definition.expression
    each_axis = isinstance(one, str) and place.is_for_all_axes(syntax.names(one))
    equation = "; ".join(f"{'F' if place.force else 'flow'}_{k} = {t}" for k, t in formulas.items())
    words = definition.meaning.rstrip(".") or "An effect by expression"
    body = {
        "__doc__": f"{words}: {equation}.",
        "__module__": __name__,
        "plugin_name": classmethod(lambda cls: name),
        "__reduce__": lambda self: (_rebuild_effect, (name, text, place, self.port, self.variant)),
        "__annotations__": {"port": str},
        "port": definition.port,
        "parameters": parameters,
        "definition": definition,
        "place": place,
        "formulas": tuple(formulas.items()),
        "inputs": tuple(n for n in used if n in dict(place.inputs)),
        "channels": () if place.force else tuple(n for n in used if n in dict(place.states)),
        "axes": len(place.positions) if place.force and not each_axis else None,
    }
    base = ForceByFormula if place.force else FlowByFormula
    made: type[Effect] = type(base)(name, (base,), body)  # type: ignore[assignment]
    return made


def _rebuild_effect(name: str, text: str, place: Place, port: str, variant: str) -> Effect:
    """An effect by expression as unpickling makes it, in another process."""
    return _build_class(name, text, place)(port=port, variant=variant)


def _formulas_by_output(given: Any, place: Place) -> dict[str, str]:
    """Axis or channel -> formula, from any of the ways to give it."""
    outputs = [name for name, _ in place.outputs]
    what = "axis" if place.force else "channel"
    if isinstance(given, Mapping):
        for name in given:
            if name not in outputs:
                expected = f"an {what}" if place.force else f"a {what}"
                raise ConfigError(
                    f"an expression for {name!r}",
                    f"{expected}: {', '.join(outputs)}",
                    did_you_mean(str(name), outputs),
                )
        return {n: str(given.get(n, 0)) for n in outputs if place.force or n in given}
    texts = [str(t) for t in given] if isinstance(given, list | tuple) else [str(given)]
    if len(texts) == 1 and place.is_for_all_axes(syntax.names(texts[0])):
        texts = texts * len(outputs)
    if len(texts) != len(outputs):
        each = ", ".join(f"{n}: ..." for n in outputs)
        raise ConfigError(
            f"{len(texts)} expression{'s' * (len(texts) > 1)} ({', '.join(texts)})",
            f"{len(outputs)}, one for each {what}: {', '.join(outputs)}",
            f"expression='{{{each}}}'"
            + (f", or {' and '.join(place.at_hand)} for every axis" if place.force else ""),
        )
    return dict(zip(outputs, texts, strict=True))


def _check_names(definition: Definition, free: tuple[str, ...], place: Place) -> None:
    """Refuse time as a name, and options of parameters that are not in the expression."""
    for name in free:
        if name in _TIME:
            raise ConfigError(
                f"{name!r} in an expression",
                f"states, inputs and parameters; known here: {', '.join(place.known)}",
                "an input for what changes with time",
            )
    for what in ("units", "shape", "grid", "lower", "per_axis"):
        for name in getattr(definition, what) or ():
            if name not in free:
                raise ConfigError(
                    f"{what} of {name!r}",
                    f"a parameter of the expression: {', '.join(free) or 'it has none'}",
                    did_you_mean(name, free) if free else "",
                )


# --- their parameters ----------------------------------------------------------------------------


def _define_parameters(
    definition: Definition, formulas: Mapping[str, str], free: tuple[str, ...], place: Place
) -> tuple[Parameter, ...]:
    units = _parameter_units(definition, formulas, free, place)
    shapes = {**(definition.shape or {}), **(definition.grid or {})}
    amplitudes = tuple(n for n in free if n not in shapes)
    _check_linear(formulas, free, amplitudes, place)
    return tuple(
        Parameter(
            name,
            units[name],
            lower=(definition.lower or {}).get(name),
            start=(definition.shape or {}).get(name),
            role="shape" if name in shapes else "amplitude",
            per_axis=name in definition.per_axis,
            grid=(definition.grid or {}).get(name, ()),
        )
        for name in free
    )


def _parameter_units(
    definition: Definition, formulas: Mapping[str, str], free: tuple[str, ...], place: Place
) -> dict[str, str]:
    """Parameter -> unit relative to the port, found from the equation or checked against it."""
    said = {n: place.absolute(u) for n, u in (definition.units or {}).items()}
    due = dict(place.outputs)
    what = "force on" if place.force else "flow into"
    wanted = {f"{what} {k}": (t, due[k]) for k, t in formulas.items()}
    unsaid = tuple(n for n in free if n not in said)
    dimensions = infer_dimensions(wanted, {**place.known, **said}, unsaid)
    units = {}
    for name in free:
        unit = unit_for(dimensions[name], place.words) if name in dimensions else None
        if name in said:
            given = (definition.units or {})[name]
            units[name] = (
                given if place.is_relative(given) else _coherent_unit(name, said[name], place)
            )
        elif unit is None:
            raise ConfigError(
                f"parameter {name!r}, whose unit has no short form here",
                "a unit for it",
                f"units='{{{name}: UNIT}}'",
            )
        else:
            units[name] = unit
    return units


def _coherent_unit(name: str, unit: str, place: Place) -> str:
    """A given unit in the place's words, after a check that its size is that of the place's."""
    coherent = unit_for(dimension(unit), place.words)
    if coherent is None:
        return unit
    check_unit_agrees(name, unit, place.absolute(coherent) or "dimensionless")
    return coherent


def _check_linear(
    formulas: Mapping[str, str], free: tuple[str, ...], amplitudes: tuple[str, ...], place: Place
) -> None:
    """The effect must be zero without its amplitudes, and linear in them together."""
    import sympy as sp

    symbols = {n: sp.Symbol(n, real=True) for n in (*place.known, *free)}
    own = [symbols[n] for n in amplitudes]
    for text in formulas.values():
        value = sp.sympify(syntax.compute(text, symbols))
        if value.has(sp.zoo, sp.nan, sp.oo):
            raise ConfigError(f"expression {text!r}, which is infinite", "a finite formula")
        if sp.expand(value.subs(dict.fromkeys(own, 0))) != 0:
            raise ConfigError(
                f"expression {text!r}, not zero without its coefficients"
                f"{' ' + ', '.join(amplitudes) if amplitudes else ''}",
                "a coefficient as a factor of every term, to be found by the fit",
                f"k*({text})",
            )
        for name, symbol in zip(amplitudes, own, strict=True):
            others = value.diff(symbol).free_symbols & set(own)
            if others:
                raise _not_linear_error(text, sorted({name, *map(str, others)}), place)


def _not_linear_error(text: str, pair: list[str], place: Place) -> ConfigError:
    return ConfigError(
        f"expression {text!r}, not linear in {' and '.join(pair)}",
        f"parameters that are plain factors, others with a value; known here: "
        f"{', '.join(place.known)}",
        f"shape='{{{pair[-1]}: VALUE}}' for a gap, a width, a rate of change",
    )
