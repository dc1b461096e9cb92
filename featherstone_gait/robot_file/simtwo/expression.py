"""Evaluate numbers of a SimTwo file, which may be expressions of named constants."""

from __future__ import annotations

import ast
import math
import operator
from collections.abc import Callable, Mapping
from typing import Any
from xml.etree.ElementTree import Element

from ..markup import MAX_NUMBER, children

MAX_LENGTH = 200  # of an expression

_FUNCTIONS: dict[str, Callable[..., float]] = {
    **{name: getattr(math, name) for name in ("sqrt", "sin", "cos", "tan", "atan", "exp")},
    "abs": abs,
    "min": min,
    "max": max,
    "rad": math.radians,
    "deg": math.degrees,
}
_OPERATORS: dict[type, Callable[..., float]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.BitXor: math.pow,  # as Pascal writes a power
    ast.USub: operator.neg,
    ast.UAdd: operator.pos,
}


def value_of(text: str, constants: Mapping[str, float], what: str) -> float:
    """Evaluate an expression; raise ValueError if it has no value."""
    try:
        if len(text) > MAX_LENGTH:
            raise ValueError(f"longer than {MAX_LENGTH} characters")
        value = float(_value(ast.parse(text.strip(), mode="eval").body, constants))
    except (ValueError, ArithmeticError, TypeError, SyntaxError, RecursionError, MemoryError) as error:
        reason = error.args[0] if error.args else type(error).__name__
        raise ValueError(f"{what} is {text[:40]!r}: {reason}; write a number such as 0.12, or an expression") from error
    if not abs(value) <= MAX_NUMBER:
        raise ValueError(f"{what} is {text[:40]!r} = {value!r}; expected a number up to {MAX_NUMBER:g}: correct it")
    return value


def _value(node: ast.AST, constants: Mapping[str, float]) -> float:
    if isinstance(node, ast.Constant) and isinstance(node.value, int | float) and not isinstance(node.value, bool):
        return float(node.value)
    if isinstance(node, ast.Name):
        known = {"pi": math.pi} if node.id == "pi" else constants
        if node.id not in known:
            raise ValueError(f"there is no constant {node.id!r}")
        return known[node.id]
    if isinstance(node, ast.BinOp) and type(node.op) in _OPERATORS:
        return _OPERATORS[type(node.op)](_value(node.left, constants), _value(node.right, constants))
    if isinstance(node, ast.UnaryOp) and type(node.op) in _OPERATORS:
        return _OPERATORS[type(node.op)](_value(node.operand, constants))
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in _FUNCTIONS:
        return _FUNCTIONS[node.func.id](*(_value(argument, constants) for argument in node.args))
    raise ValueError("not an expression of numbers, constants, + - * / ^ and functions")


def constants_of(root: Element, given: Mapping[str, float]) -> dict[str, float]:
    """Return the constants that <defines> states; those given override its <arg>, which are defaults."""
    constants = dict(given)
    for defines in root.iterfind("defines"):
        for element in children(defines, ("const", "arg")):
            name, value = element.get("name", ""), element.get("value", "")
            if element.tag == "const" or name not in given:
                constants[name] = value_of(value, constants, f"constant {name!r}")
    return constants


def stated(element: Element | None, names: str) -> str | None:
    """Return which of some attributes an element has, the first of several."""
    return next((name for name in names.split() if element is not None and element.get(name) is not None), None)


class Numbers:
    """Read numbers of elements with the constants of a file."""

    def __init__(self, constants: Mapping[str, float]) -> None:
        self.constants = constants

    def one(self, element: Element | None, names: str, default: float, what: str) -> float:
        """Return the first of some attributes that an element has; the default if either is missing."""
        name = stated(element, names)
        if element is None or name is None:
            return default
        return value_of(element.get(name, ""), self.constants, f"{what}: {name}")

    def xyz(self, element: Element | None, what: str, default: tuple[float, ...] = (0.0, 0.0, 0.0)) -> Any:
        """Return the attributes x, y and z."""
        return tuple(self.one(element, name, value, what) for name, value in zip("xyz", default))
