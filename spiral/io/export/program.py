"""The intermediate form that every exported program is printed from: names, units, expressions.

    x' = f(t, x, u, p),    y = h(t, x, u, p),    and f_x, f_p, f_u, h_x, h_p, h_u

Names from a run of unknown origin enter a file only by ``identifiers`` and ``header_lines``.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import sympy as sp
from sympy.logic.boolalg import Boolean
from sympy.printing.codeprinter import PrintMethodNotImplementedError

from spiral.io.export.names import ascii_identifier, sanitise_text
from spiral.physics.effect_states import own_states
from spiral.physics.outside.program import ProgramValue
from spiral.physics.trace import TracedModel, trace
from spiral.types.errors import ConfigError
from spiral.types.model import Model
from spiral.types.parameter import BETWEEN
from spiral.types.placement import TIME
from spiral.types.units import short_form


@dataclass(frozen=True)
class ProgramVariable:
    """A state, input, reading or parameter; ``symbol`` stands for it in the expressions."""

    name: str
    unit: str
    symbol: sp.Symbol
    about: str = ""


@dataclass(frozen=True)
class Constant(ProgramVariable):
    """A parameter with its value and standard error (nothing where it was not fitted)."""

    value: float = math.nan
    error: float | None = None


@dataclass(frozen=True)
class Program:
    """What a printer needs of a model; ``inputs`` include the rates that are used, not time.

    ``rates`` names the input that each such rate belongs to, ``between`` how each input runs
    between samples (a key of ``BETWEEN``).
    """

    title: str
    origin: str
    name: str
    states: tuple[ProgramVariable, ...]
    inputs: tuple[ProgramVariable, ...]
    outputs: tuple[ProgramVariable, ...]
    parameters: tuple[Constant, ...]
    time: sp.Symbol
    rates: Mapping[str, str]
    between: Mapping[str, str]
    rate: tuple[sp.Expr, ...]
    output: tuple[sp.Expr, ...]

    @cached_property
    def rate_x(self) -> list[list[sp.Expr]]:
        """f_x, n rows of n."""
        return symbolic_jacobian(self.rate, [s.symbol for s in self.states])

    @cached_property
    def rate_p(self) -> list[list[sp.Expr]]:
        """f_p, n rows of as many as parameters."""
        return symbolic_jacobian(self.rate, [p.symbol for p in self.parameters])

    @cached_property
    def rate_u(self) -> list[list[sp.Expr]]:
        """f_u, n rows of as many as inputs."""
        return symbolic_jacobian(self.rate, [i.symbol for i in self.inputs])

    @cached_property
    def output_u(self) -> list[list[sp.Expr]]:
        """h_u, a row for each reading."""
        return symbolic_jacobian(self.output, [i.symbol for i in self.inputs])

    @cached_property
    def output_x(self) -> list[list[sp.Expr]]:
        """h_x, a row for each reading."""
        return symbolic_jacobian(self.output, [s.symbol for s in self.states])

    @cached_property
    def output_p(self) -> list[list[sp.Expr]]:
        """h_p, a row for each reading."""
        return symbolic_jacobian(self.output, [p.symbol for p in self.parameters])


def build_program(model: Model, origin: str = "") -> Program:
    """A model ready for a printer; ``origin`` says in words where it comes from.

    Raises
    ------
    ConfigError : a parameter without a finite value. PluginError : an equation that is not traced.
    """
    system, traced = model.system, trace(model.system, model.effects)
    if any(sp.sympify(e).has(ProgramValue) for e in (*traced.rate, *traced.output)):
        raise ConfigError(
            f"a model around the program of the system {system.plugin_name()!r}",
            "a system whose equations are known",
            "text or latex, with the effects that were found as equations",
        )
    values = model.row("model", "fit it first, or give values={{'{}': 1.0}}")
    rates = {i.rate.name: i.name for i in system.inputs if i.derivative}
    return Program(
        title=model.name,
        origin=origin,
        name=ascii_identifier(system.plugin_name()) or "model",
        states=_state_items(model, traced),
        inputs=_input_items(model, traced, rates),
        outputs=tuple(
            ProgramVariable(
                name,
                _read_unit(lambda n=name: short_form(system.unit_of(n)), name),
                sp.Symbol(f"y{i}", real=True),
                "reading",
            )
            for i, name in enumerate(traced.channels)
        ),
        parameters=tuple(
            _parameter_constant(model, key, symbol, float(value))
            for key, symbol, value in zip(traced.keys, traced.p, values, strict=True)
        ),
        time=traced.u[traced.inputs.index(TIME)],
        rates=rates,
        between={i.name: i.interpolation for i in system.inputs},
        rate=tuple(map(_extrema_as_piecewise, traced.rate)),
        output=tuple(map(_extrema_as_piecewise, traced.output)),
    )


def _state_items(model: Model, traced: TracedModel) -> tuple[ProgramVariable, ...]:
    system = model.system
    units = {s.name: s.unit for s in system.states} | own_states(system, model.effects)
    items = []
    for name, symbol in zip(traced.states, traced.x, strict=True):
        own = "of an effect" if "." in name else "hidden"
        about = "measured" if name in system.observed else own
        items.append(
            ProgramVariable(
                name, _read_unit(lambda n=name: short_form(units[n]), name), symbol, about
            )
        )
    return tuple(items)


def _input_items(
    model: Model, traced: TracedModel, rates: Mapping[str, str]
) -> tuple[ProgramVariable, ...]:
    known = {i.name: i for i in model.system.inputs}
    items = []
    for name, symbol in zip(traced.inputs, traced.u, strict=True):
        if name in rates:
            unit = _read_unit(lambda n=name: short_form(f"({known[rates[n]].unit})/s"), name)
            items.append(ProgramVariable(name, unit, symbol, f"time derivative of {rates[name]}"))
        elif name != TIME:
            how = BETWEEN[known[name].interpolation]
            items.append(
                ProgramVariable(
                    name,
                    _read_unit(lambda n=name: short_form(known[n].unit), name),
                    symbol,
                    f"between samples: {how}",
                )
            )
    return tuple(items)


def _parameter_constant(model: Model, key: str, symbol: sp.Symbol, value: float) -> Constant:
    if not math.isfinite(value):
        raise ConfigError(
            f"{sanitise_text(key)} = {value}",
            "a number for every parameter",
            "export a run that converged",
        )
    error = model.errors.get(key)
    known = error is not None and math.isfinite(error)
    about = f"standard error {error:.4g}" if known else "no standard error"
    unit = _read_unit(lambda: model.unit(key), key)
    return Constant(key, unit, symbol, about, value, error if known else None)


def _read_unit(read: Callable[[], str], whose: str) -> str:
    """A unit in its short form; text that does not parse as a unit is refused."""
    try:
        return read()
    except Exception as error:  # pint's parser raises what Python's tokenizer does
        raise ConfigError(
            f"unit of {sanitise_text(whose)}: {sanitise_text(str(error))}",
            "a unit, such as 'kg*m^2' or 'rad/s'",
        ) from error


# --- expressions ---------------------------------------------------------------------------------


class _Magnitude(sp.Function):
    """|a| of a real value, whose slope is its sign; SymPy's own asks whether it is real."""

    def fdiff(self, argindex: int = 1) -> Any:
        return _Direction(self.args[0])


class _Direction(sp.Function):
    """The sign of a real value, whose slope is zero."""

    def fdiff(self, argindex: int = 1) -> Any:
        return sp.Integer(0)


class _RoundedValue(sp.Function):
    """A rounded value (``floor``, ``ceiling``), whose slope is zero."""

    def fdiff(self, argindex: int = 1) -> Any:
        return sp.Integer(0)


def symbolic_jacobian(
    values: Sequence[sp.Expr], symbols: Sequence[sp.Symbol]
) -> list[list[sp.Expr]]:
    """Exact d values / d symbols, a row for each value; at corners as ``physics.emit`` has them."""
    rows = []
    given: Sequence[Any] = values
    for value in given:
        smooth: Any = value.replace(sp.Abs, _Magnitude).replace(sp.sign, _Direction)
        for kind in (sp.floor, sp.ceiling):
            smooth = smooth.replace(
                kind, lambda a, kind=kind: _RoundedValue(a, sp.Dummy(kind.__name__))
            )
        free = smooth.free_symbols
        row = [smooth.diff(s) if s in free else sp.Integer(0) for s in symbols]
        rows.append([_restore_sympy_functions(entry) for entry in row])
    return rows


def _restore_sympy_functions(value: Any) -> sp.Expr:
    """Replace the stand-ins for abs, sign, floor and ceiling by SymPy's own functions."""
    rounded = {"floor": sp.floor, "ceiling": sp.ceiling}
    value = value.replace(_RoundedValue, lambda a, kind: rounded[kind.name](a))
    return value.replace(_Magnitude, sp.Abs).replace(_Direction, sp.sign)


def _extrema_as_piecewise(value: Any) -> sp.Expr:
    """Rewrite Max and Min as Piecewise, whose derivatives every language can express."""
    return sp.sympify(value).replace(
        lambda e: isinstance(e, sp.Max | sp.Min), lambda e: e.rewrite(sp.Piecewise)
    )


class Subexpression(NamedTuple):
    """A common subexpression, computed once: its name, its text, and whether it is Boolean."""

    name: str
    text: str
    logical: bool


def assignments(
    values: Sequence[sp.Expr], write: Callable[[Any], Any], names: Mapping[sp.Symbol, str]
) -> tuple[list[Subexpression], list[str]]:
    """Common subexpressions in order of evaluation, and the texts of the values.

    Raises
    ------
    ConfigError : a function that the language has not.
    """
    named = [v.xreplace({s: sp.Symbol(n, real=True) for s, n in names.items()}) for v in values]
    parts, left = sp.cse(named, symbols=sp.numbered_symbols("part_"), list=True, order="none")
    try:
        return (
            [Subexpression(s.name, write(e), isinstance(e, Boolean)) for s, e in parts],
            [write(e) for e in left],
        )
    except PrintMethodNotImplementedError as error:
        raise ConfigError(
            f"an equation with a function that this language has not ({error})",
            "functions of spiral.math",
            "another kind, or spiral.export(run, 'text')",
        ) from error


def jacobian_entries(
    matrices: Mapping[str, list[list[sp.Expr]]],
    place: Callable[[str, int, int, int], str],
    zeros: bool = False,
) -> dict[str, sp.Expr]:
    """Target -> expression for each entry of some Jacobians; zero entries only with ``zeros``.

    ``place`` writes the target from a matrix's name, row, column and number of columns.
    """
    return {
        place(name, i, j, len(row)): entry
        for name, rows in matrices.items()
        for i, row in enumerate(rows)
        for j, entry in enumerate(row)
        if zeros or entry != 0
    }


def items_in_expressions(
    values: Iterable[sp.Expr], items: Iterable[ProgramVariable]
) -> list[ProgramVariable]:
    """Those items that occur in expressions."""
    free: set[Any] = set().union(*(v.free_symbols for v in values))
    return [item for item in items if item.symbol in free]


# --- names and texts -----------------------------------------------------------------------------


def identifiers(
    items: Iterable[ProgramVariable], reserved: Iterable[str] = ()
) -> dict[sp.Symbol, str]:
    """A name of ASCII letters, digits and underscores for each item, different from all others.

    ``linear_stiffness@bearing_1.stiffness_x`` becomes ``linear_stiffness_bearing_1_stiffness_x``;
    a word that is taken or reserved gets underscores behind it.
    """
    taken = {*reserved}
    names: dict[sp.Symbol, str] = {}
    for item in items:
        own = ascii_identifier(item.name) or "value"
        if own.startswith("part_"):  # names of common parts
            own = f"the_{own}"
        while own in taken:
            own += "_"
        taken.add(own)
        names[item.symbol] = own
    return names


def header_lines(exported: Program) -> list[str]:
    """Lines of a file's header: the model, its quantities, and what is not exported."""
    from spiral.version import __version__

    source = f", {exported.origin}" if exported.origin else ""
    lines = [f"{exported.title}{source} (SPIRAL {__version__})", "",
             "x' = f(t, x, u, p),   y = h(t, x, u, p),   t in s", ""]  # fmt: skip
    for head, items in (("states x", exported.states), ("inputs u", exported.inputs),
                        ("readings y", exported.outputs)):  # fmt: skip
        lines += [f"{head}:", *(_header_row(i.name, i.unit, i.about) for i in items), ""]
    lines.append("parameters p:")
    lines += [_header_row(p.name, p.unit, f"{p.value:.6g}, {p.about}") for p in exported.parameters]
    lines += ["", "Not in it: noise of the sensors and of the process, states at the start of a",
              "record, and a correction of the phase where a fit made one."]  # fmt: skip
    return [
        sanitise_text(line) if not line.startswith("  ") else f"  {sanitise_text(line)}"
        for line in lines
    ]


def _header_row(name: str, unit: str, about: str) -> str:
    return f"  {name} [{unit or '1'}]  {about}"
