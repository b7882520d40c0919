"""Scalar expressions as a graph: equal subexpressions are one node, derivatives are expressions again.

An :class:`Expression` is made by arithmetic on symbols and constants. Two equal expressions are the same object, so common
subexpressions are found while they are written, and code printed from the graph computes each of them once. Derivatives are
taken backwards through the graph (the adjoint of every node), which costs a small multiple of the expression itself
(Griewank and Walther, Evaluating Derivatives, doi:10.1137/1.9780898717761).

The same graph is printed as C (:func:`c_lines`) and evaluated on NumPy arrays (:func:`evaluate`).
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from types import MappingProxyType
from typing import Any

import numpy as np

_NODES: dict[tuple[Any, ...], Expression] = {}


def of_scalars(made: Callable[[Any, Any], Any]) -> Callable[[Any, Any], Any]:
    """An operator of two scalars; with an array NumPy takes it entry by entry."""

    def asked(x: Any, y: Any) -> Any:
        return NotImplemented if isinstance(y, np.ndarray) and y.ndim else made(x, y)

    return asked


class Expression:
    """A node of the graph: an operation and its arguments. Made by arithmetic, never directly."""

    __slots__ = ("arguments", "number", "operation")

    def __init__(self, operation: str, arguments: tuple[Any, ...], number: int) -> None:
        self.operation, self.arguments, self.number = operation, arguments, number

    @of_scalars
    def __add__(self, other: Any) -> Expression:
        return _sum(self, as_expression(other))

    @of_scalars
    def __mul__(self, other: Any) -> Expression:
        return _product(self, as_expression(other))

    @of_scalars
    def __truediv__(self, other: Any) -> Expression:
        return _quotient(self, as_expression(other))

    def __neg__(self) -> Expression:
        return _negative(self)

    @of_scalars
    def __sub__(self, other: Any) -> Expression:
        return _sum(self, _negative(as_expression(other)))

    @of_scalars
    def __rsub__(self, other: Any) -> Expression:
        return _sum(as_expression(other), _negative(self))

    @of_scalars
    def __rtruediv__(self, other: Any) -> Expression:
        return _quotient(as_expression(other), self)

    def __pow__(self, exponent: float) -> Expression:
        """Whole powers by multiplication, square roots, and other powers of positive numbers."""
        if exponent == 0.5:
            return sqrt(self)
        if exponent != int(exponent):
            return exp(log(self) * exponent)
        # whole powers as products: no logarithm of negative numbers
        exponent = int(exponent)
        out = ONE
        for _ in range(abs(exponent)):
            out = out * self
        return out if exponent >= 0 else ONE / out

    __radd__ = __add__
    __rmul__ = __mul__

    # what has no derivative everywhere cannot be part of a formula
    def __bool__(self) -> bool:
        raise TypeError("an expression has no truth value: it must be one formula, the same at all times")

    def __lt__(self, other: Any) -> bool:
        raise TypeError("expressions cannot be compared: they must be one smooth formula (np.tanh is a smooth sign)")

    __le__ = __gt__ = __ge__ = __lt__

    def __abs__(self) -> Expression:
        raise TypeError("abs has no derivative at 0; np.sqrt(x * x + c * c) is smooth")

    # NumPy's functions of objects call the method of their name, np.sin(x) is x.sin(): those of x alone are set below
    def arctan2(self, x: Any) -> Expression:
        """Angle of the point (x, self), rad, in (-pi, pi]."""
        return atan2(self, x)

    def hypot(self, x: Any) -> Expression:
        """Distance of the point (x, self) from the origin."""
        return sqrt(self * self + x * x)

    def __repr__(self) -> str:
        if self.operation in ("symbol", "constant"):
            return str(self.arguments[0])
        return f"{self.operation}({', '.join(map(repr, self.arguments))})"


def _node(operation: str, *arguments: Any) -> Expression:
    """The one node with this operation and these arguments."""
    key = (operation, *arguments)
    if key not in _NODES:
        _NODES[key] = Expression(operation, arguments, len(_NODES))
    return _NODES[key]


@contextmanager
def passing() -> Iterator[None]:
    """Expressions made within are forgotten with those who hold them; none of them may be combined with later ones."""
    before = len(_NODES)
    try:
        yield
    finally:
        while len(_NODES) > before:
            _NODES.popitem()


def symbol(name: str) -> Expression:
    """An unknown; ``name`` is how C code refers to it."""
    return _node("symbol", name)


def constant(value: float) -> Expression:
    """A number."""
    return _node("constant", float(value))


def as_expression(value: Any) -> Expression:
    """A number as a node; expressions as they are, also those in an array without dimensions."""
    if isinstance(value, np.ndarray) and value.ndim == 0:
        value = value.item()
    return value if isinstance(value, Expression) else constant(value)


ZERO, ONE = constant(0.0), constant(1.0)


def _sum(a: Expression, b: Expression) -> Expression:
    if a is ZERO or b is ZERO:
        return b if a is ZERO else a
    if a.operation == b.operation == "constant":
        return constant(a.arguments[0] + b.arguments[0])
    if (b.operation == "minus" and b.arguments[0] is a) or (a.operation == "minus" and a.arguments[0] is b):
        return ZERO
    if a is b:
        return _product(constant(2.0), a)
    # a + b and b + a are one node
    return _node("+", *sorted((a, b), key=lambda x: x.number))


def _negative(a: Expression) -> Expression:
    if a.operation == "constant":
        return constant(-a.arguments[0])
    return a.arguments[0] if a.operation == "minus" else _node("minus", a)


def _product(a: Expression, b: Expression) -> Expression:
    if a is ZERO or b is ZERO:
        return ZERO
    if a is ONE or b is ONE:
        return b if a is ONE else a
    if a.operation == b.operation == "constant":
        return constant(a.arguments[0] * b.arguments[0])
    # constants stand first, and are gathered
    if b.operation == "constant":
        a, b = b, a
    if a.operation == "constant" and a.arguments[0] < 0:
        return _negative(_product(constant(-a.arguments[0]), b))
    if a.operation == "constant" and b.operation == "*" and b.arguments[0].operation == "constant":
        return _product(constant(a.arguments[0] * b.arguments[0].arguments[0]), b.arguments[1])
    if a.operation == "constant" and b.operation == "*" and b.arguments[1].operation == "constant":
        return _product(constant(a.arguments[0] * b.arguments[1].arguments[0]), b.arguments[0])
    # signs move outwards, so that equal products meet
    if a.operation == "minus" or b.operation == "minus":
        inner = [x.arguments[0] if x.operation == "minus" else x for x in (a, b)]
        product = _product(*inner)
        return product if a.operation == b.operation else _negative(product)
    return _node("*", *sorted((a, b), key=lambda x: x.number))


def _quotient(a: Expression, b: Expression) -> Expression:
    if a is ZERO or b is ONE:
        return a
    if a.operation == b.operation == "constant":
        return constant(a.arguments[0] / b.arguments[0])
    if a.operation == "minus":
        return _negative(_quotient(a.arguments[0], b))
    # 1 / b is a node of its own: several quotients share it
    return a * _node("/", ONE, b) if a is not ONE else _node("/", ONE, b)


# ---- functions --------------------------------------------------------------------------------------------------------------


def sqrt(x: Any) -> Expression:
    """Square root."""
    return _node("sqrt", as_expression(x))


def sin(x: Any) -> Expression:
    """Sine."""
    return _node("sin", as_expression(x))


def cos(x: Any) -> Expression:
    """Cosine."""
    return _node("cos", as_expression(x))


def exp(x: Any) -> Expression:
    """Exponential."""
    return _node("exp", as_expression(x))


def log(x: Any) -> Expression:
    """Natural logarithm."""
    return _node("log", as_expression(x))


def tanh(x: Any) -> Expression:
    """Hyperbolic tangent, a smooth sign."""
    return _node("tanh", as_expression(x))


def atan2(y: Any, x: Any) -> Expression:
    """Angle of the point (x, y), rad, in (-pi, pi]."""
    return _node("atan2", as_expression(y), as_expression(x))


def nearest_turn(angle: Any, near: Any) -> Expression:
    """``angle`` (rad) plus the whole turns that bring it next to ``near``; its derivative is that of ``angle``."""
    return _node("nearest_turn", as_expression(angle), as_expression(near))


# NumPy's functions of one number, each as accurate as there, at the ends of its range, too
for _name, _function in {
    "sqrt": sqrt,
    "sin": sin,
    "cos": cos,
    "exp": exp,
    "log": log,
    "tanh": tanh,
    "arctan": lambda x: atan2(x, ONE),
    "tan": lambda x: sin(x) / cos(x),
    "arcsin": lambda x: atan2(x, sqrt((1.0 - x) * (1.0 + x))),
    "arccos": lambda x: atan2(sqrt((1.0 - x) * (1.0 + x)), x),
    "sinh": lambda x: 0.5 * tanh(x) * (exp(x) + exp(-x)),  # exp(x) - exp(-x) cancels
    "cosh": lambda x: 0.5 * (exp(x) + exp(-x)),
    "expm1": lambda x: tanh(0.5 * x) * (exp(x) + 1.0),
    "log10": lambda x: log(x) / math.log(10.0),
    "deg2rad": lambda x: x * (math.pi / 180.0),
    "radians": lambda x: x * (math.pi / 180.0),
}.items():
    setattr(Expression, _name, _function)

# Derivatives of each operation by its arguments: (arguments, the node itself) -> one factor an argument.
_DERIVATIVES: dict[str, Callable[..., tuple[Expression, ...]]] = {
    "+": lambda a, b, y: (ONE, ONE),
    "minus": lambda a, y: (-ONE,),
    "*": lambda a, b, y: (b, a),
    "/": lambda a, b, y: (y, -(y * y)),  # only 1 / b exists
    "sqrt": lambda a, y: (0.5 / y,),
    "sin": lambda a, y: (cos(a),),
    "cos": lambda a, y: (-sin(a),),
    "exp": lambda a, y: (y,),
    "log": lambda a, y: (1.0 / a,),
    "tanh": lambda a, y: (1.0 - y * y,),
    "atan2": lambda a, b, y: (b / (a * a + b * b), -a / (a * a + b * b)),
    "nearest_turn": lambda a, b, y: (ONE, ZERO),
}


def _ordered(results: Iterable[Expression]) -> list[Expression]:
    """All nodes below some results, arguments before what uses them."""
    done: dict[Expression, None] = {}
    stack: list[tuple[Expression, bool]] = [(y, False) for y in reversed(list(results))]

    # depth first without recursion: formulas may be thousands of nodes deep
    while stack:
        node, ready = stack.pop()
        if node in done:
            continue
        inner = [] if node.operation in ("symbol", "constant") else node.arguments
        if ready or not inner:
            done[node] = None
        else:
            stack.append((node, True))
            stack += [(x, False) for x in reversed(inner) if x not in done]
    return list(done)


def gradient(y: Expression, by: Sequence[Expression]) -> list[Expression]:
    """Derivatives of y by some symbols, by adjoints."""
    adjoint: dict[Expression, Expression] = {y: ONE}

    # backwards from the result: one pass, however many variables there are
    for node in reversed(_ordered([y])):
        factor = adjoint.get(node, ZERO)
        if factor is ZERO or node.operation in ("symbol", "constant"):
            continue
        parts = _DERIVATIVES[node.operation](*node.arguments, node)
        for argument, part in zip(node.arguments, parts, strict=True):
            adjoint[argument] = adjoint.get(argument, ZERO) + factor * part
    return [adjoint.get(x, ZERO) for x in by]


_MADE: dict[str, Callable[..., Expression]] = {"+": _sum, "minus": _negative, "*": _product, "/": _quotient}


def rebuilt(
    results: Sequence[Expression],
    constants: Callable[[float], Expression] | None = None,
    symbols: Mapping[Expression, Expression] = MappingProxyType({}),
) -> list[Expression]:
    """The same expressions with each number x replaced by ``constants(x)``, and symbols by others."""
    constants = constant if constants is None else constants
    new: dict[Expression, Expression] = {}
    for node in _ordered(results):
        if node.operation == "symbol":
            new[node] = symbols.get(node, node)
        elif node.operation == "constant":
            new[node] = constants(node.arguments[0])
        else:
            arguments = [new[x] for x in node.arguments]
            made = _MADE.get(node.operation)
            new[node] = made(*arguments) if made else _node(node.operation, *arguments)
    return [new[y] for y in results]


def symbols_of(results: Iterable[Expression]) -> set[Expression]:
    """All symbols that some expressions depend on."""
    return {x for x in _ordered(results) if x.operation == "symbol"}


# ---- evaluation ---------------------------------------------------------------------------------------------------------------


def _nearest_turn(angle: Any, near: Any) -> Any:
    return angle + 2 * math.pi * np.rint((near - angle) / (2 * math.pi))


_NUMPY: dict[str, Callable[..., Any]] = {
    "+": np.add,
    "minus": np.negative,
    "*": np.multiply,
    "/": np.divide,
    "sqrt": np.sqrt,
    "sin": np.sin,
    "cos": np.cos,
    "exp": np.exp,
    "log": np.log,
    "tanh": np.tanh,
    "atan2": np.arctan2,
    "nearest_turn": _nearest_turn,
}


# the same of plain numbers, some ten times sooner; what is not finite may be an error
_PLAIN: dict[str, Callable[..., Any]] = {
    "+": operator.add,
    "minus": operator.neg,
    "*": operator.mul,
    "/": operator.truediv,
    "nearest_turn": _nearest_turn,
    **{name: getattr(math, name) for name in ("sqrt", "sin", "cos", "exp", "log", "tanh", "atan2")},
}


class Program:
    """Expressions ready for NumPy, or for plain ``numbers`` alone: the steps of their graph in order."""

    def __init__(self, results: Sequence[Expression], *, numbers: bool = False) -> None:
        nodes = _ordered(results)
        place = {node: i for i, node in enumerate(nodes)}
        known = _PLAIN if numbers else _NUMPY
        self.given: list[Any] = [None] * len(nodes)
        self.symbols: list[tuple[int, str]] = []
        self.steps: list[tuple[int, Callable[..., Any], tuple[int, ...]]] = []
        for i, node in enumerate(nodes):
            if node.operation == "constant":
                self.given[i] = node.arguments[0]
            elif node.operation == "symbol":
                self.symbols.append((i, node.arguments[0]))
            elif node.operation in known:
                self.steps.append((i, known[node.operation], tuple(place[x] for x in node.arguments)))
        self.results = [place[result] for result in results]

    def __call__(self, values: Mapping[str, Any]) -> list[Any]:
        """Numbers or arrays of all results; ``values``: symbol -> number or array."""
        found: list[Any] = self.given.copy()
        for i, name in self.symbols:
            found[i] = values[name]
        for i, function, (first, *more) in self.steps:
            found[i] = function(found[first], found[more[0]]) if more else function(found[first])
        return [found[i] for i in self.results]


_C = {"+": "{} + {}", "minus": "-{}", "*": "{}*{}", "/": "{}/{}", "nearest_turn": "nearest_turn({}, {})"}


def c_lines(results: Sequence[Expression], targets: Sequence[str]) -> list[str]:
    """C statements that assign expressions to ``targets``; nodes used once are written where they are used."""
    nodes = _ordered(results)
    uses: dict[Expression, int] = {}
    for node in nodes:
        for x in node.arguments if node.operation not in ("symbol", "constant") else ():
            uses[x] = uses.get(x, 0) + 1
    for y in results:
        uses[y] = uses.get(y, 0) + 1

    # what is used more than once gets a variable
    text: dict[Expression, str] = {}
    lines: list[str] = []
    for node in nodes:
        if node.operation == "symbol":
            text[node] = node.arguments[0]
            continue

        if node.operation == "constant":
            text[node] = f"({node.arguments[0]!r})"
            continue
        pattern = _C.get(node.operation, node.operation + "(" + ", ".join("{}" for _ in node.arguments) + ")")
        written = pattern.format(*(text[x] for x in node.arguments))
        if uses[node] > 1:
            name = f"t{len(lines)}"
            lines.append(f"const double {name} = {written};")
            text[node] = name
        else:
            text[node] = f"({written})"
    return lines + [f"{target} = {text[y]};" for target, y in zip(targets, results, strict=True)]
