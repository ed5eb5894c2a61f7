"""Expressions and their exact derivatives as LLVM instructions, by forward differentiation.

Every node of an expression becomes one value, however often it occurs, and beside it the slopes by
those symbols that it depends on: d(ab) = a db + b da, d g(a) = g'(a) da, and so on. A slope that is
zero by the structure of the expression is not there at all.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import sympy as sp
from llvmlite import ir

from spiral.physics.outside.program import CalledProgram, ProgramValue
from spiral.types.errors import PluginError

DOUBLE = ir.DoubleType()
INDEX = ir.IntType(64)
_INTRINSIC = {sp.sin: "sin", sp.cos: "cos", sp.exp: "exp", sp.log: "log"}
_LIBRARY = {
    sp.tan: "tan", sp.tanh: "tanh", sp.sinh: "sinh", sp.cosh: "cosh", sp.asin: "asin",
    sp.acos: "acos", sp.atan: "atan", sp.asinh: "asinh", sp.acosh: "acosh", sp.atanh: "atanh",
    sp.erf: "erf", sp.floor: "floor", sp.ceiling: "ceil",
}  # fmt: skip
MOST_FACTORS = 4  # of an integer power that is a product
_ORDERED = {sp.Gt: ">", sp.Ge: ">=", sp.Lt: "<", sp.Le: "<=", sp.Eq: "==", sp.Ne: "!="}


@dataclass(frozen=True)
class Node:
    """A value, and its slopes by the number of the variable; none that is zero everywhere."""

    value: Any
    slopes: Mapping[int, Any]


class Emitter:
    """Writes expressions into a block, with their slopes by some symbols.

    Parameters
    ----------
    builder : where instructions go.
    symbols : the value of every symbol.
    active : the number of each symbol that slopes are wanted for.
    """

    def __init__(
        self,
        builder: ir.IRBuilder,
        symbols: Mapping[sp.Symbol, Any],
        active: Mapping[sp.Symbol, int],
    ) -> None:
        self._builder = builder
        self._nodes: dict[sp.Basic, Node] = {}
        self._conditions: dict[sp.Basic, Any] = {}
        self._programs: dict[tuple[CalledProgram, tuple[sp.Basic, ...]], list[Node]] = {}
        one = number(1.0)
        for symbol, value in symbols.items():
            own = {active[symbol]: one} if symbol in active else {}
            self._nodes[symbol] = Node(value, own)

    def node(self, expression: sp.Basic) -> Node:
        """The value of an expression and its slopes.

        Raises
        ------
        PluginError : a function or symbol that has no machine code here.
        """
        known = self._nodes.get(expression)
        if known is None:
            known = self._nodes[expression] = self._emit_node(expression)
        return known

    def _emit_node(self, e: Any) -> Node:
        if e.is_Number or e.is_NumberSymbol:
            return Node(number(float(e)), {})
        if e.is_Add:
            return self._sum([self.node(a) for a in e.args])
        if e.is_Mul:
            return self._product(e.args)
        if e.is_Pow:
            return self._power(*e.args)
        if isinstance(e, sp.Piecewise):
            return self._piecewise(e.args)
        if isinstance(e, sp.Max | sp.Min):
            return self._extreme(e)
        if isinstance(e, ProgramValue) and e.column is None:
            return self._program(e.program, e.args)[e.row]
        if len(e.args) == 1:
            return self._elementary(e.func, self.node(e.args[0]))
        if isinstance(e, sp.atan2):
            return self._angle(*(self.node(a) for a in e.args))
        raise _no_code_error(e if isinstance(e, sp.Symbol) else e.func)

    # --- values --------------------------------------------------------------------------------

    def _call_math(self, name: str, *values: Any) -> Any:
        """A function of the mathematics library."""
        if name in (*_INTRINSIC.values(), "pow", "fabs", "sqrt"):
            function = self._builder.module.declare_intrinsic(f"llvm.{name}", [DOUBLE])
        else:
            kind = ir.FunctionType(DOUBLE, [DOUBLE] * len(values))
            module = self._builder.module
            function = module.globals.get(name) or ir.Function(module, kind, name)
        return self._builder.call(function, values)

    def _multiply(self, a: Any, b: Any) -> Any:
        if _equals_constant(a, 1.0):
            return b
        if _equals_constant(b, 1.0):
            return a
        return self._builder.fneg(b) if _equals_constant(a, -1.0) else self._builder.fmul(a, b)

    def _weighted_slopes(self, *parts: tuple[Any, Node]) -> dict[int, Any]:
        """Slopes of sum_i w_i n_i, the weights held."""
        slopes: dict[int, Any] = {}
        for weight, node in parts:
            for key, slope in node.slopes.items():
                term = self._multiply(weight, slope)
                slopes[key] = self._builder.fadd(slopes[key], term) if key in slopes else term
        return slopes

    # --- rules ---------------------------------------------------------------------------------

    def _sum(self, nodes: Sequence[Node]) -> Node:
        value = nodes[0].value
        for node in nodes[1:]:
            value = self._builder.fadd(value, node.value)
        return Node(value, self._weighted_slopes(*((number(1.0), n) for n in nodes)))

    def _product(self, factors: Sequence[sp.Basic]) -> Node:
        node = self.node(factors[0])
        for factor in factors[1:]:
            other = self.node(factor)
            slopes = self._weighted_slopes((other.value, node), (node.value, other))
            node = Node(self._multiply(node.value, other.value), slopes)
        return node

    def _power(self, base: sp.Basic, exponent: Any) -> Node:
        """Powers of small integers are products, negative powers quotients."""
        node = self.node(base)
        if exponent.is_Integer and int(exponent) < 0:
            return self._inverse(self.node(base ** (-exponent)))
        if exponent.is_Integer and int(exponent) <= MOST_FACTORS:
            return self._product([base] * int(exponent))
        if exponent == sp.S.Half:
            value = self._call_math("sqrt", node.value)
            return Node(
                value, self._weighted_slopes((self._builder.fdiv(number(0.5), value), node))
            )
        if base == sp.E:
            return self._elementary(sp.exp, self.node(exponent))
        power = self.node(exponent)
        value = self._call_math("pow", node.value, power.value)
        parts = []
        if node.slopes:
            less = self.node(exponent - 1)
            below = self._call_math("pow", node.value, less.value)
            parts.append((self._multiply(power.value, below), node))
        if power.slopes:
            parts.append((self._multiply(value, self._call_math("log", node.value)), power))
        return Node(value, self._weighted_slopes(*parts))

    def _inverse(self, node: Node) -> Node:
        value = self._builder.fdiv(number(1.0), node.value)
        weight = self._builder.fneg(self._multiply(value, value)) if node.slopes else value
        return Node(value, self._weighted_slopes((weight, node)))

    def _piecewise(self, pieces: Sequence[Any]) -> Node:
        """The first piece whose condition holds, of all that are there; NaN where none does."""
        selected = Node(number(float("nan")), {})
        for expression, condition in reversed(pieces):
            node = self.node(expression)
            if condition == sp.true:
                selected = node
                continue
            selected = self._select(self._condition(condition), node, selected)
        return selected

    def _select(self, holds: Any, yes: Node, no: Node) -> Node:
        zero = number(0.0)
        slopes = {
            k: self._builder.select(holds, yes.slopes.get(k, zero), no.slopes.get(k, zero))
            for k in dict.fromkeys((*yes.slopes, *no.slopes))
        }
        return Node(self._builder.select(holds, yes.value, no.value), slopes)

    def _extreme(self, e: Any) -> Node:
        sign = ">=" if isinstance(e, sp.Max) else "<="
        node = self.node(e.args[0])
        for other in map(self.node, e.args[1:]):
            holds = self._builder.fcmp_ordered(sign, node.value, other.value)
            node = self._select(holds, node, other)
        return node

    def _program(self, program: CalledProgram, given: tuple[sp.Basic, ...]) -> list[Node]:
        """All values of a program by one call; slopes only by arguments that vary."""
        known = self._programs.get((program, given))
        if known is not None:
            return known
        b, count, nodes = self._builder, len(program.rows), [self.node(a) for a in given]
        varied = [i for i, node in enumerate(nodes) if node.slopes]
        columns = ir.Constant(ir.ArrayType(INDEX, len(varied)), varied)
        with b.goto_entry_block():  # once, not in every turn of a loop
            arguments, values, slopes, wanted = (
                b.alloca(ir.ArrayType(kind, max(size, 1)))
                for kind, size in (
                    (DOUBLE, len(nodes)), (DOUBLE, count), (DOUBLE, count * len(varied)),
                    (INDEX, len(varied)),
                )
            )  # fmt: skip
            if varied:
                b.store(columns, wanted)
        for i, node in enumerate(nodes):
            b.store(node.value, b.gep(arguments, [_integer_constant(0), _integer_constant(i)]))
        own = [_integer_constant(a.ctypes.data) for a in (program.whole, program.numbers)]
        places = [b.ptrtoint(p, INDEX) for p in (arguments, wanted, values, slopes)]
        kind = ir.FunctionType(ir.VoidType(), [INDEX] * 7)
        kernel = b.inttoptr(_integer_constant(program.address or 0), kind.as_pointer())
        b.call(kernel, [*own, *places[:2], _integer_constant(len(varied)), *places[2:]])

        def entry(array: Any, index: int) -> Any:
            return b.load(b.gep(array, [_integer_constant(0), _integer_constant(index)]))

        row_nodes = []
        for row in range(count):
            parts = [(entry(slopes, c * count + row), nodes[i]) for c, i in enumerate(varied)]
            row_nodes.append(Node(entry(values, row), self._weighted_slopes(*parts)))
        self._programs[program, given] = row_nodes
        return row_nodes

    def _angle(self, y: Node, x: Node) -> Node:
        squares = self._builder.fadd(
            self._multiply(y.value, y.value), self._multiply(x.value, x.value)
        )
        by_y = self._builder.fdiv(x.value, squares)
        by_x = self._builder.fdiv(self._builder.fneg(y.value), squares)
        return Node(
            self._call_math("atan2", y.value, x.value), self._weighted_slopes((by_y, y), (by_x, x))
        )

    def _condition(self, c: Any) -> Any:
        known = self._conditions.get(c)
        if known is None:
            known = self._conditions[c] = self._emit_condition(c)
        return known

    def _emit_condition(self, c: Any) -> Any:
        if c in (sp.true, sp.false):
            return ir.Constant(ir.IntType(1), int(c == sp.true))
        if type(c) in _ORDERED:
            left, right = (self.node(a).value for a in c.args)
            if isinstance(c, sp.Ne):
                return self._builder.fcmp_unordered("!=", left, right)
            return self._builder.fcmp_ordered(_ORDERED[type(c)], left, right)
        if isinstance(c, sp.Not):
            return self._builder.not_(self._condition(c.args[0]))
        if isinstance(c, sp.ITE):  # of a corner inside another corner's condition
            return self._builder.select(*(self._condition(a) for a in c.args))
        join = {sp.And: self._builder.and_, sp.Or: self._builder.or_}.get(type(c))
        if join is None:
            raise _no_code_error(type(c))
        value = self._condition(c.args[0])
        for other in c.args[1:]:
            value = join(value, self._condition(other))
        return value

    def _elementary(self, function: Any, inner: Node) -> Node:
        """g(a), and g'(a) da where a varies."""
        x = inner.value
        if function is sp.Abs:
            value = self._call_math("fabs", x)
        elif function is sp.sign:
            return Node(self._sign(x), {})
        elif function in _INTRINSIC:
            value = self._call_math(_INTRINSIC[function], x)
        elif function in _LIBRARY:
            value = self._call_math(_LIBRARY[function], x)
        else:
            raise _no_code_error(function)
        if not inner.slopes or function in (sp.floor, sp.ceiling):
            return Node(value, {})
        return Node(value, self._weighted_slopes((self._slope(function, x, value), inner)))

    def _sign(self, x: Any) -> Any:
        zero = number(0.0)
        above = self._builder.select(self._builder.fcmp_ordered(">", x, zero), number(1.0), zero)
        return self._builder.select(self._builder.fcmp_ordered("<", x, zero), number(-1.0), above)

    def _slope(self, function: Any, x: Any, value: Any) -> Any:
        """g'(x), where ``value`` is g(x)."""
        b, one = self._builder, number(1.0)

        def square() -> Any:
            return self._multiply(x, x)

        def over_root(value: Any) -> Any:
            return b.fdiv(one, self._call_math("sqrt", value))

        rules: dict[Any, Callable[[], Any]] = {
            sp.Abs: lambda: self._sign(x),
            sp.sin: lambda: self._call_math("cos", x),
            sp.cos: lambda: b.fneg(self._call_math("sin", x)),
            sp.exp: lambda: value,
            sp.log: lambda: b.fdiv(one, x),
            sp.tan: lambda: b.fadd(one, self._multiply(value, value)),
            sp.tanh: lambda: b.fsub(one, self._multiply(value, value)),
            sp.sinh: lambda: self._call_math("cosh", x),
            sp.cosh: lambda: self._call_math("sinh", x),
            sp.asin: lambda: over_root(b.fsub(one, square())),
            sp.acos: lambda: b.fneg(over_root(b.fsub(one, square()))),
            sp.atan: lambda: b.fdiv(one, b.fadd(one, square())),
            sp.asinh: lambda: over_root(b.fadd(one, square())),
            sp.acosh: lambda: over_root(b.fsub(square(), one)),
            sp.atanh: lambda: b.fdiv(one, b.fsub(one, square())),
            sp.erf: lambda: self._multiply(
                number(1.1283791670955126),  # 2 / sqrt(pi)
                self._call_math("exp", b.fneg(square())),
            ),
        }
        return rules[function]()


def number(value: float) -> ir.Constant:
    """A constant."""
    return ir.Constant(DOUBLE, value)


def _integer_constant(value: int) -> ir.Constant:
    return ir.Constant(INDEX, value)


def _equals_constant(value: Any, number: float) -> bool:
    return isinstance(value, ir.Constant) and value.constant == number


def _no_code_error(met: Any) -> PluginError:
    """The error for a function or a symbol that an equation may not hold."""
    name = str(met) if isinstance(met, sp.Symbol) else getattr(met, "__name__", str(met))
    known = sorted(f.__name__ for f in (*_INTRINSIC, *_LIBRARY))
    return PluginError(
        f"{name} in an equation, which has no machine code",
        f"numbers, the symbols given, + - * / **, {', '.join(known)}, Abs, sign, Piecewise",
        "write it with the functions of spiral.math",
    )
