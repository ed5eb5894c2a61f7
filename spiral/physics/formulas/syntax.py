"""Formulas as text: read by an allow-list, computed by walking the tree, never by ``eval``.

    formula := number | name | -f | f + f | f - f | f * f | f / f | f ** number | f ** name
             | function(f, ...)

One reading serves SymPy, pint and NumPy: names stand for symbols, quantities or numbers.
"""

from __future__ import annotations

import ast
import math
import operator
from collections.abc import Callable, Iterator, Mapping
from functools import lru_cache
from typing import Any

from spiral import math as physics
from spiral.types.errors import ConfigError, did_you_mean

LONGEST = 1000  # characters of a formula
DEEPEST = 40  # levels of nested terms
LARGEST_EXPONENT = 12
MOST_TERMS = 500  # of a formula multiplied out: its derivatives are then found within seconds

OPERATORS: dict[type[ast.operator], Callable[[Any, Any], Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.Pow: operator.pow,
}
COMPARISONS: dict[type[ast.cmpop], Callable[[Any, Any], Any]] = {
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
}
# Of and to numbers without a unit.
ELEMENTARY = ("sin", "cos", "sinh", "cosh", "tanh", "exp", "log")
COUNTS = {
    **dict.fromkeys(ELEMENTARY, 1), "sqrt": 1, "abs": 1,
    "maximum": 2, "minimum": 2, "hypot": 2, "where": 3,
}  # fmt: skip
"""Function -> how many values it takes."""
POSITIVE = ("abs", "hypot", "sqrt", "exp")  # whose values a root may be taken of
CONSTANTS = {"pi": math.pi}

_HINTS: dict[type[ast.AST], str] = {
    ast.Compare: "a comparison stands first in where(x > g, a, b)",
    ast.IfExp: "where(x > g, a, b) in place of if",
    ast.BoolOp: "where(x > g, where(x < h, a, b), b) in place of and",
    ast.Attribute: "a rate is written x_rate, and nothing has a dot",
    ast.Subscript: "axes have names of their own: x, y",
}


@lru_cache(maxsize=512)
def read(text: str) -> ast.expr:
    """The tree of a formula, every node of it allowed; ``x^3`` is x**3.

    Raises
    ------
    ConfigError : what is not a formula, or is not allowed in one.
    """
    if len(text) > LONGEST:
        raise ConfigError(
            f"an expression of {len(text)} characters", f"at most {LONGEST}", "an effect in a file"
        )
    try:
        tree = ast.parse(text.strip().replace("^", "**"), mode="eval").body
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        reason = error.msg if isinstance(error, SyntaxError) else type(error).__name__
        raise ConfigError(f"expression {text!r}: {reason}", "a formula", "-k3*x**3") from error
    tree = _NamedPowers(text).visit(tree)
    _check_tree(tree, text, DEEPEST)
    if terms(tree) > MOST_TERMS:
        raise ConfigError(
            f"expression {text!r}: {terms(tree)} terms when multiplied out",
            f"at most {MOST_TERMS}",
            "a lower power, or fewer terms inside it; an effect in a file for others",
        )
    return tree


def names(text: str) -> tuple[str, ...]:
    """The names a formula uses, functions and constants aside, in order of appearance."""
    called = {id(n.func) for n in ast.walk(read(text)) if isinstance(n, ast.Call)}
    nodes = [n for n in ast.walk(read(text)) if isinstance(n, ast.Name) and id(n) not in called]
    nodes.sort(key=lambda n: n.col_offset)
    return tuple(dict.fromkeys(n.id for n in nodes if n.id not in CONSTANTS))


def compute(text: str, values: Mapping[str, Any]) -> Any:
    """The value of a formula; a name's value is a symbol, a quantity with a unit, or a number.

    Raises
    ------
    ConfigError : a division by zero, or a number too large.
    """
    try:
        return _evaluate_node(read(text), values)
    except (ZeroDivisionError, OverflowError) as error:
        raise ConfigError(
            f"expression {text!r}: {error}", "a formula with finite values"
        ) from error


def exponent(node: ast.expr) -> float:
    """The number a power is raised to."""
    sign = -1.0 if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub) else 1.0
    inner = node.operand if isinstance(node, ast.UnaryOp) else node
    assert isinstance(inner, ast.Constant)
    return sign * inner.value  # type: ignore[operator]


def terms(node: ast.expr) -> int:
    """How many terms a formula has when it is multiplied out, at most.

    A sum of t terms to the power n has (n + t - 1)! / (n! (t - 1)!) of them; what stands inside a
    function is multiplied out for itself.
    """
    if isinstance(node, ast.UnaryOp):
        return terms(node.operand)
    if isinstance(node, ast.Call):
        return max(map(terms, node.args))
    if isinstance(node, ast.Compare):
        return max(map(terms, (node.left, *node.comparators)))
    if not isinstance(node, ast.BinOp):
        return 1
    left = terms(node.left)
    if _is_power(node):
        power = math.ceil(abs(exponent(node.right)))
        return math.comb(power + left - 1, left - 1)
    right = terms(node.right)
    return left + right if isinstance(node.op, ast.Add | ast.Sub) else left * right


def is_zero(node: ast.expr) -> bool:
    """Whether a node is the number zero, which has any unit."""
    return isinstance(node, ast.Constant) and node.value == 0


def _evaluate_node(node: ast.expr, values: Mapping[str, Any]) -> Any:
    if isinstance(node, ast.Constant):
        return node.value
    if isinstance(node, ast.Name):
        return values[node.id] if node.id in values else CONSTANTS[node.id]
    if isinstance(node, ast.UnaryOp):
        inner = _evaluate_node(node.operand, values)
        return -inner if isinstance(node.op, ast.USub) else inner
    if isinstance(node, ast.BinOp):
        return _evaluate_binary(node, values)
    if isinstance(node, ast.Compare):
        left, right = _evaluate_pair(node.left, node.comparators[0], values)
        return COMPARISONS[type(node.ops[0])](left, right)
    assert isinstance(node, ast.Call)
    return _evaluate_call(node, values)


def _evaluate_binary(node: ast.BinOp, values: Mapping[str, Any]) -> Any:
    if isinstance(node.op, ast.Add | ast.Sub):
        left, right = _evaluate_pair(node.left, node.right, values)
    else:
        left = _evaluate_node(node.left, values)
        right = exponent(node.right) if _is_power(node) else _evaluate_node(node.right, values)
        if _is_power(node) and right.is_integer():
            right = int(right)
        if _is_power(node) and isinstance(left, int):
            left = float(left)  # overflows where whole numbers would grow without end
    return OPERATORS[type(node.op)](left, right)


def _evaluate_pair(first: ast.expr, second: ast.expr, values: Mapping[str, Any]) -> tuple[Any, Any]:
    """Two values of one unit; a literal zero takes the other's."""
    left, right = _evaluate_node(first, values), _evaluate_node(second, values)
    if is_zero(first) and not is_zero(second):
        left = 0 * right
    elif is_zero(second) and not is_zero(first):
        right = 0 * left
    return left, right


def _evaluate_call(node: ast.Call, values: Mapping[str, Any]) -> Any:
    assert isinstance(node.func, ast.Name)
    name, given = node.func.id, node.args
    if name in ELEMENTARY or name == "sqrt":
        return getattr(physics, name)(_evaluate_node(given[0], values))
    if name == "abs":
        return physics.length([_evaluate_node(given[0], values)])
    if name == "where":
        return physics.where(
            _evaluate_node(given[0], values), *_evaluate_pair(given[1], given[2], values)
        )
    first, second = _evaluate_pair(given[0], given[1], values)
    if name == "hypot":
        return physics.length([first, second])
    if name == "maximum":
        return physics.maximum(first, second)
    return -physics.maximum(-first, -second)


# --- what is allowed -----------------------------------------------------------------------------


class _NamedPowers(ast.NodeTransformer):
    """Powers with a name for an exponent written out: a**n is exp(n*log(a)), a > 0."""

    def __init__(self, text: str) -> None:
        self.text = text

    def visit_BinOp(self, node: ast.BinOp) -> ast.AST:
        """A power, or what is made of some."""
        self.generic_visit(node)
        bare = node.right.operand if isinstance(node.right, ast.UnaryOp) else node.right
        if not (_is_power(node) and isinstance(bare, ast.Name)):
            return node
        if not _is_never_negative(node.left):
            raise _signed_power_error(self.text, bare.id, f"abs(x)**{bare.id}")
        log = ast.Call(ast.Name("log", ast.Load()), [node.left], [])
        product = ast.BinOp(node.right, ast.Mult(), log)
        power = ast.Call(ast.Name("exp", ast.Load()), [product], [])
        return ast.fix_missing_locations(ast.copy_location(power, node))


def _check_tree(node: ast.AST, text: str, depth: int) -> None:
    if depth == 0:
        raise ConfigError(f"expression {text!r}", f"at most {DEEPEST} levels of nested terms")
    for part in _allowed_children(node, text):
        _check_tree(part, text, depth - 1)


def _allowed_children(node: ast.AST, text: str) -> Iterator[ast.AST]:
    """What an allowed node is made of; an error where it is not allowed."""
    if isinstance(node, ast.Constant):
        _check_number(node, text)
    elif isinstance(node, ast.Name):
        if node.id in COUNTS:
            raise ConfigError(f"expression {text!r}: {node.id} without ()", f"{node.id}(...)")
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub | ast.UAdd):
        yield node.operand
    elif isinstance(node, ast.BinOp) and type(node.op) in OPERATORS:
        if _is_power(node):
            _check_power(node, text)
        yield node.left
        yield node.right
    elif isinstance(node, ast.Call):
        yield from _check_call(node, text)
    else:
        operation = getattr(node, "op", node)
        raise _not_allowed_error(
            text, node, _HINTS.get(type(operation), _HINTS.get(type(node), ""))
        )


def _is_power(node: ast.BinOp) -> bool:
    return isinstance(node.op, ast.Pow)


def _not_allowed_error(text: str, node: ast.AST, hint: str) -> ConfigError:
    segment = ast.get_source_segment(text.strip(), node) or type(node).__name__
    where = "" if segment.strip() == text.strip() else f": {segment}"
    return ConfigError(
        f"expression {text!r}{where}",
        f"numbers, names, + - * / **, and {', '.join(COUNTS)}",
        hint or "an effect in a file takes any Python: spiral new effect NAME",
    )


def _check_number(node: ast.Constant, text: str) -> None:
    value = node.value
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise _not_allowed_error(text, node, "")
    if abs(value) > 1e100:
        raise ConfigError(f"expression {text!r}: {value!s:.20}", "numbers below 1e100")


def _check_power(node: ast.BinOp, text: str) -> None:
    inner = node.right.operand if isinstance(node.right, ast.UnaryOp) else node.right
    if not isinstance(inner, ast.Constant) or not isinstance(inner.value, int | float):
        raise _not_allowed_error(
            text, node.right, "a power has a number or a name: x**3, abs(x)**n"
        )
    if abs(inner.value) > LARGEST_EXPONENT:
        raise ConfigError(
            f"expression {text!r}: the power {inner.value}", f"at most {LARGEST_EXPONENT}"
        )
    power = -inner.value if isinstance(node.right, ast.UnaryOp) else inner.value
    if not float(inner.value).is_integer() and not _is_never_negative(node.left):
        keeping = f"; x*abs(x)**{power - 1:g} keeps the sign" if power > 1 else ""
        raise _signed_power_error(text, power, f"abs(x)**{power:g}{keeping}")


def _signed_power_error(text: str, power: object, try_: str) -> ConfigError:
    return ConfigError(
        f"expression {text!r}: the power {power} of what may be negative",
        "a whole power, or one of abs(...), hypot(...), sqrt(...), maximum(x, least) or a sum of "
        "squares",
        try_,
    )


def _is_never_negative(node: ast.expr) -> bool:
    """Whether a term is at least zero whatever its names stand for, as a sum of squares is.

    A name that something is kept above (``maximum(x, least)``), or that such a term is multiplied
    with or divided by, is taken for positive.
    """
    if isinstance(node, ast.Constant):
        return isinstance(node.value, int | float) and node.value >= 0
    if isinstance(node, ast.Call):
        name = node.func.id if isinstance(node.func, ast.Name) else ""
        bounds = (b for b in node.args if isinstance(b, ast.Name) or _is_never_negative(b))
        return name in POSITIVE or (name == "maximum" and any(bounds))
    if not isinstance(node, ast.BinOp) or isinstance(node.op, ast.Sub):
        return False
    if _is_power(node):
        power = node.right
        even = isinstance(power, ast.Constant) and power.value in range(0, LARGEST_EXPONENT + 1, 2)
        return even or _is_never_negative(node.left)
    if isinstance(node.op, ast.Mult) and ast.dump(node.left) == ast.dump(node.right):
        return True
    sides = (node.left, node.right)
    sure = [_is_never_negative(side) for side in sides]
    scaled = isinstance(node.op, ast.Mult | ast.Div)
    return all(sure) or (scaled and any(sure) and any(isinstance(s, ast.Name) for s in sides))


def _check_call(node: ast.Call, text: str) -> Iterator[ast.AST]:
    name = node.func.id if isinstance(node.func, ast.Name) else ""
    if name == "sign":
        hint = "tanh(v/w) with a width w: a step has no slope to fit by"
        raise _not_allowed_error(text, node, hint)
    if name not in COUNTS:
        raise _not_allowed_error(text, node, did_you_mean(name, COUNTS) if name else "")
    if node.keywords or len(node.args) != COUNTS[name]:
        raise ConfigError(
            f"expression {text!r}: {name} of {len(node.args)} values", f"{COUNTS[name]} values"
        )
    first = node.args[0]
    if name != "where":
        yield from node.args
        return
    single = isinstance(first, ast.Compare) and len(first.ops) == 1
    if not (single and isinstance(first, ast.Compare) and type(first.ops[0]) in COMPARISONS):
        raise _not_allowed_error(text, first, "where(x > g, a, b)")
    yield first.left
    yield first.comparators[0]
    yield from node.args[1:]
