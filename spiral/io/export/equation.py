"""The model as text: an equation in plain Unicode, and in LaTeX."""

# ruff: noqa: N802, RUF001, RUF002  (SymPy's printers look methods up by class name; Greek is meant)
from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import sympy as sp
from sympy.printing.str import StrPrinter

from spiral.io.export.names import latex_text, sanitise_text
from spiral.physics.outside.program import ProgramValue
from spiral.physics.trace import TracedModel, trace
from spiral.types.effect import Effect, ParameterEffect, SensorEffect
from spiral.types.label import owner_of, parameter_of
from spiral.types.model import Model
from spiral.types.port import varied_key
from spiral.types.system import has_coordinates

_SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
_GREEK = {"alpha": "α", "beta": "β", "theta": "θ", "phase": "θ", "speed": "Ω"}
_DIGITS = 4
_ROUNDING = 1e-12  # share of a term that is left of it by rounding
_WIDE = 20  # letters of a left side beside which its terms begin


@dataclass(frozen=True)
class EquationTerm:
    """What one effect (or the system itself) contributes to one equation."""

    owner: str
    value: sp.Expr


@dataclass(frozen=True)
class Equation:
    """left = sum of terms; in place of a rate, ``inertia`` is a sum over several accelerations."""

    left: str
    terms: tuple[EquationTerm, ...]
    inertia: sp.Expr | None = None


def model_equations(model: Model) -> tuple[tuple[Equation, ...], TracedModel]:
    """One equation for each state that is not merely the rate of another, and each changed reading.

    Contributions are differences of the traced right-hand side with and without an effect, so the
    text shows what is integrated. Where accelerations are coupled (M is not diagonal), the balance
    of forces M q'' = F is shown in place of q'' = M^-1 F, which a reader would not know again.
    """
    whole = trace(model.system, model.effects)
    bare = trace(model.system, ())
    alone = {e.label: _traced_without_and_with(model, e) for e in model.effects}
    base = _substitute_values(bare, model)
    balanced = _coupled_rows(model, bare)
    listed = []
    for name in whole.states:
        if has_coordinates(model.system) and whole.rate_name(name) in whole.states:
            continue
        row, inertia = balanced.get(name), None
        terms = []
        if name in bare.states:
            own = _right_side(base, name, row)
            if row is not None:
                own, inertia = _split_inertia(own, base)
            terms.append(EquationTerm("", own))
        for label, (less, more) in alone.items():
            if name in more.states:
                own = _right_side(more, name, row)
                before = _right_side(less, name, row) if name in less.states else sp.Integer(0)
                own = _linearise_program_calls(own, before)
                terms.append(EquationTerm(label, _shorter_difference(own, before)))
        terms = [EquationTerm(t.owner, _name_program_calls(t.value)) for t in terms]
        listed.append(Equation(f"{name}'", tuple(t for t in terms if t.value != 0), inertia))
    read = tuple(
        e for e in model.effects
        if isinstance(e, SensorEffect) or alone[e.label][0].output != alone[e.label][1].output
    )  # fmt: skip
    return (*listed, *_reading_equations(model, read)), whole


def _coupled_rows(model: Model, traced: TracedModel) -> dict[str, int]:
    """Rate of a coordinate -> its row in the balance of forces, where accelerations are coupled."""
    slopes = sp.Matrix(traced.forces).jacobian(traced.acceleration) if traced.forces else None
    if slopes is None or slopes.is_diagonal() or any(f.atoms(ProgramValue) for f in traced.forces):
        return {}
    names = [c.name for c in model.system.coordinates]  # type: ignore[attr-defined]
    return {traced.rate_name(name): i for i, name in enumerate(names)}


def _right_side(traced: TracedModel, name: str, row: int | None) -> Any:
    """The rate of a state, or row ``row`` of F - M q''."""
    return traced.rate[traced.states.index(name)] if row is None else -traced.forces[row]


def _split_inertia(value: sp.Expr, traced: TracedModel) -> tuple[Any, Any]:
    """F and M q'' of F - M q''."""
    still = value.subs(dict.fromkeys(traced.acceleration, 0))
    return still, sp.expand(still - value)


def _traced_without_and_with(model: Model, effect: Effect) -> tuple[TracedModel, TracedModel]:
    """The system without an effect and with it, values in place; with what the effect changes."""
    changed = ""
    if isinstance(effect, ParameterEffect):
        changed = owner_of(varied_key(model.system.place(effect)))
    beside = tuple(e for e in model.effects if e.label == changed)
    less, more = trace(model.system, beside), trace(model.system, (*beside, effect))
    return _substitute_values(less, model), _substitute_values(more, model)


def equation_text(model: Model) -> str:
    """The model in plain text, one effect on each line with its name.

    x'' = - 8085 x            linear_stiffness
          - 4.5 x'            linear_damping
    """
    blocks = []
    for item in model_equations(model)[0]:
        left = _left_side(item.left)
        if item.inertia is not None:
            left = _signed_terms(item.inertia).removeprefix("+ ")
        lines = [
            (_signed_terms(t.value), sanitise_text(t.owner or "system")) for t in item.terms
        ] or [("0", "")]
        wide = min(max(len(text) for text, _ in lines), 60)
        pad = " " * (len(left) + 3 if len(left) <= _WIDE else 6)
        lines[0] = (lines[0][0].removeprefix("+ "), lines[0][1])
        rows = [f"{pad}{text:<{wide}}   {owner}".rstrip() for text, owner in lines]
        first = rows[0][len(pad) :]
        rows[0] = f"{left} = {first}" if len(left) <= _WIDE else f"{left}\n    = {first}"
        blocks.append("\n".join(rows))
    return "\n".join(blocks)


def equation_latex(model: Model) -> str:
    """The model as an ``align`` environment, one effect on each line with its name."""
    listed, _ = model_equations(model)
    rows = []
    for item in listed:
        for index, term in enumerate(item.terms):
            value = flatten_cases(_rename_and_round(term.value, _latex_name))
            text = sp.latex(value, mul_symbol=r"\,")
            text = text if text.startswith("-") or index == 0 else f"+ {text}"
            owner = latex_text(term.owner or "system")
            left = _latex_left(item) + " &= " if index == 0 else "&\\quad "
            rows.append(rf"{left}{text} && \text{{{owner}}} \\")
    return "\n".join([r"\begin{align*}", *rows, r"\end{align*}"])


def _reading_equations(model: Model, effects: tuple[Effect, ...]) -> list[Equation]:
    """What the sensors report, where ``effects`` change it: each one's change, in their order.

    Effects on sensors do, and changes of a parameter by which a reading is computed.
    """
    if not effects:
        return []
    others = tuple(e for e in model.effects if e not in effects)
    steps = [
        _substitute_values(trace(model.system, (*others, *effects[:count])), model).output
        for count in range(len(effects) + 1)
    ]
    listed = []
    for row, name in enumerate(model.system.observed):
        terms = [EquationTerm("", steps[0][row])]
        for effect, before, after in zip(effects, steps, steps[1:], strict=False):
            terms.append(
                EquationTerm(
                    effect.label, _name_program_calls(_shorter_difference(after[row], before[row]))
                )
            )
        listed.append(Equation(f"reading of {name}", tuple(t for t in terms if t.value != 0)))
    return listed


def _substitute_values(traced: TracedModel, model: Model) -> TracedModel:
    """Symbols renamed after states and inputs, parameters replaced by their values."""
    swap: dict[Any, Any] = {}
    for names, symbols in ((traced.states, traced.x), (traced.inputs, traced.u)):
        swap.update({s: _real_symbol(n) for n, s in zip(names, symbols, strict=True)})
    starts = {k: p.start for k, p in model.pairs}
    for key, symbol in zip(traced.keys, traced.p, strict=True):
        value = model.values.get(key, starts.get(key))
        known = value is not None and value == value
        swap[symbol] = sp.Float(value) if known else _real_symbol(parameter_of(key))
    names = [traced.rate_name(c.name) for c in getattr(model.system, "coordinates", ())]
    rates = tuple(_real_symbol(f"{n}_rate") for n in names) if traced.acceleration else ()
    swap.update(zip(traced.acceleration, rates, strict=True))
    tiny = {f: 0 for e in traced.rate for f in e.atoms(sp.Float) if 0 < abs(f) < 1e-150}

    def substitute(rows: tuple[sp.Expr, ...]) -> tuple[Any, ...]:
        return tuple(sp.sympify(e).xreplace(tiny).xreplace(swap).doit() for e in rows)

    return replace(
        traced, rate=substitute(traced.rate), output=substitute(traced.output),
        forces=substitute(traced.forces), acceleration=rates,
    )  # fmt: skip


def _linearise_program_calls(value: sp.Expr, before: sp.Expr) -> Any:
    """Program calls linearised about the arguments before: f(a + da) = f(a) + sum f_a da."""
    swap = {}
    for old in before.atoms(ProgramValue):
        for new in value.atoms(ProgramValue) - {old}:
            if (new.program, new.row, new.column) == (old.program, old.row, None):
                pairs: Any = enumerate(zip(new.args, old.args, strict=True))
                changes = [(i, a - b) for i, (a, b) in pairs if a != b]
                slopes = (old.fdiff(i + 1) * change for i, change in changes)
                swap[new] = old + sum(slopes)
    return value.xreplace(swap)


def _name_program_calls(value: sp.Expr) -> Any:
    """Program calls replaced by symbols: f[v] for a value, df[v]/dF for a slope."""
    swap = {}
    for call in value.atoms(ProgramValue):
        name = f"f[{call.program.rows[call.row]}]"
        if call.column is not None:
            name = f"d{name}/d{call.program.arguments[call.column]}"
        swap[call] = _real_symbol(name)
    return value.xreplace(swap)


def _real_symbol(name: str) -> sp.Symbol:
    return sp.Symbol(name, real=True)


def _shorter_difference(value: sp.Expr, before: sp.Expr) -> Any:
    """value - before; multiplied out only where that is shorter.

    Of nested conditions (choked flow through an orifice) SymPy may make one that compares nothing;
    such a difference stays as it is.
    """
    left = value - before
    try:
        expanded = sp.expand(left) if before != 0 else left
    except TypeError:
        return left
    return min((left, _without_rounding(expanded, value)), key=sp.count_ops)


def _without_rounding(difference: Any, value: sp.Expr) -> Any:
    """A sum without terms that are no more than what rounding leaves of the same term of a value.

    5.1e-4 T - 5.1e-4 T of two models is zero, or 2e-19 T.
    """
    size = {m: abs(c) for c, m in (t.as_coeff_Mul() for t in sp.Add.make_args(sp.expand(value)))}
    terms = (t.as_coeff_Mul() for t in sp.Add.make_args(difference))
    kept = (c * m for c, m in terms if not abs(c) <= _ROUNDING * size.get(m, 0))
    return sp.Add(*kept)


def _left_side(text: str) -> str:
    return f"{_unicode_name(text[:-1])}'" if text.endswith("'") else text


def _latex_left(item: Equation) -> str:
    if item.inertia is None:
        return _latex_left_side(item.left)
    return sp.latex(_rename_and_round(item.inertia, _latex_name), mul_symbol=r"\,")


def _latex_left_side(text: str) -> str:
    if not text.endswith("'"):
        return rf"\text{{{latex_text(text)}}}"
    return _latex_name(f"{text[:-1]}_rate")


def _unicode_name(name: str) -> str:
    """``x_rate`` -> ``x'``, ``alpha`` -> ``α``."""
    if name.endswith("_rate"):
        return f"{_unicode_name(name.removesuffix('_rate'))}'"
    return _GREEK.get(name, name)


def _latex_name(name: str) -> str:
    for ending, accent in (("_rate_rate", "ddot"), ("_rate", "dot")):
        if name.endswith(ending):
            return rf"\{accent}{{{_latex_name(name.removesuffix(ending))}}}"
    words = {"speed": r"\Omega", "phase": r"\theta", "alpha": r"\alpha", "beta": r"\beta"}
    return words.get(name, name if len(name) == 1 else rf"\mathrm{{{latex_text(name)}}}")


def _rename_and_round(value: Any, name: Any) -> Any:
    """Symbols renamed and numbers rounded, for a printer."""
    swap: dict[Any, Any] = {s: sp.Symbol(name(s.name)) for s in value.free_symbols}
    swap.update({f: sp.Float(f"{float(f):.{_DIGITS}g}", _DIGITS) for f in value.atoms(sp.Float)})
    return value.xreplace(swap)


class _Unicode(StrPrinter):
    """Products by spaces, powers by superscripts, a few significant digits."""

    def _print_Float(self, expr: sp.Float) -> str:
        return _format_number(float(expr))

    def _print_Symbol(self, expr: sp.Symbol) -> str:
        return _unicode_name(expr.name)

    def _print_Pow(self, expr: sp.Pow, rational: bool = False) -> str:
        base, exponent = expr.args
        if exponent == sp.Rational(1, 2):
            return f"√({self._print(base)})"
        text = self.parenthesize(base, 1000, strict=True)
        if exponent.is_Integer and exponent > 0:
            return text + str(int(exponent)).translate(_SUPERSCRIPT)
        return f"{text}^({self._print(exponent)})"

    def _print_Mul(self, expr: sp.Mul) -> str:
        sign = "-" if expr.could_extract_minus_sign() else ""
        value: Any = -expr if sign else expr
        top, bottom = value.as_numer_denom()
        text = self._product(top)
        if bottom == 1:
            return sign + text
        below = self._product(bottom)
        alone = " " not in below or isinstance(bottom, sp.Add)  # which is in brackets
        return f"{sign}{text}/{below if alone else f'({below})'}"

    def _product(self, value: sp.Expr) -> str:
        factors = sp.Mul.make_args(value)
        numbers = [f for f in factors if f.is_Number]
        rest = [f for f in factors if not f.is_Number]
        rest.sort(key=lambda f: (isinstance(f, sp.Function), str(f)))
        words = [self._print(sp.Mul(*numbers))] if numbers and sp.Mul(*numbers) != 1 else []
        words += [self.parenthesize(f, 50) for f in rest]
        return " ".join(words) or "1"

    def _print_Abs(self, expr: sp.Abs) -> str:
        return f"|{self._print(expr.args[0])}|"

    def _print_Piecewise(self, expr: sp.Piecewise) -> str:
        pairs: Any = expr.args
        (first, condition), *others = pairs
        last = others[-1][0] if others else sp.Integer(0)
        if last == 0 and _is_positive_part(first, condition):
            return f"max({self._print(first)}, 0)"
        if isinstance(last, sp.Piecewise) and last.args[0].args[0] == 0:  # spiral.math.ramp
            return f"max({self._print(first)}, 0)"
        cases = case_list(expr)
        told = [f"{self._print(v)} where {self._print(c)}" for v, c in cases if c != sp.true]
        told += [f"else {self._print(v)}" for v, c in cases if c == sp.true]
        return f"[{', '.join(told)}]"


def case_list(value: sp.Piecewise) -> list[tuple[Any, Any]]:
    """Values with their conditions, the first that holds counts: cases of cases as one list.

    A case without a value (0 / 0, where a rounded corner is given no width) is never reached: those
    before it leave it no point.
    """
    pairs: Any = value.args
    listed: list[tuple[Any, Any]] = []
    for one, condition in pairs:
        inner = case_list(one) if isinstance(one, sp.Piecewise) else [(one, sp.true)]
        if inner[-1][1] != sp.true:  # what holds nowhere in it would fall to later cases
            inner = [(one, sp.true)]
        listed += [(v, condition if c == sp.true else sp.And(condition, c)) for v, c in inner]
    kept = [(v, c) for v, c in listed if not v.has(sp.zoo, sp.nan)]
    if len(kept) < len(listed) and kept:
        kept[-1] = (kept[-1][0], sp.true)
    return kept


def flatten_cases(value: Any) -> Any:
    """An expression in which no cases stand within cases."""
    swap = {one: sp.Piecewise(*case_list(one), evaluate=False) for one in value.atoms(sp.Piecewise)}
    return value.xreplace(swap)


def _is_positive_part(value: Any, condition: Any) -> bool:
    """Whether a condition reads value >= 0."""
    if not isinstance(condition, sp.Ge | sp.Gt | sp.Le | sp.Lt):
        return False
    relation: Any = condition
    return sp.expand(value - (relation.gts - relation.lts)) == 0


def _format_number(value: float) -> str:
    text = f"{value:.{_DIGITS}g}"
    if "e" not in text:
        return text
    digits, _, power = text.partition("e")
    return f"{digits}e{int(power)}"


def _signed_terms(value: sp.Expr) -> str:
    """The text with its sign first, as a term of a sum."""
    parts = sp.Add.make_args(value)
    printer = _Unicode()
    words = []
    for part in parts:
        text = printer.doprint(part)
        negative = text.startswith("-")
        words.append(f"{'-' if negative else '+'} {text.removeprefix('-')}")
    return " ".join(words)
