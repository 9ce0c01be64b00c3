"""Evaluates the source code of an arm's equations without executing it.

The source (see `sourcecode`) is for users to keep and use. Here it is parsed as data: each function
becomes a list of sums, products, powers, sines and cosines on numbered cells. Anything else is an
error. So code that a name or a damaged file puts into the source is never executed.
"""

from __future__ import annotations

import ast
import operator
from collections.abc import Callable
from typing import Any

import numpy as np

from plant.errors import LinkError

_TWO: dict[type[ast.operator], Callable[[Any, Any], Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.Pow: operator.pow,
}
_ONE: dict[str, Callable[[Any], Any]] = {"sin": np.sin, "cos": np.cos}

Shape = int | tuple["Shape", ...]
"""A cell, or a tuple of cells as in the source."""


class Equation:
    """One function of the source; its arguments are tuples, `p` is the arm's by default."""

    def __init__(self, node: ast.FunctionDef, p: tuple[float, ...]) -> None:
        self.name = node.name
        self._p = p
        self._arguments = [argument.arg for argument in node.args.args]
        if node.args.vararg or node.args.kwarg or self._arguments[-1:] != ["p"]:
            raise _unexpected(node)
        self._given: dict[str, list[int | None]] = {}
        self._cells: list[Any] = []
        self._names: dict[str, int] = {}
        self._steps: list[tuple[Callable[..., Any], int, int, int]] = []
        self._out: list[Shape] = []
        for line in node.body:
            self._line(line)
        if len(self._out) != 1 or set(self._given) - set(self._arguments):
            raise _unexpected(node)

    def __call__(self, *given: Any, p: Any = None) -> Any:
        """The results, a tuple or a tuple of tuples; numbers or arrays of any one shape."""
        if len(given) != len(self._arguments) - 1:
            raise TypeError(f"{self.name}({', '.join(self._arguments[:-1])})")
        cells = self._cells.copy()
        values = (*given, self._p if p is None else p)
        for name, value in zip(self._arguments, values, strict=True):
            targets = self._given.get(name)
            if targets is None:
                continue
            for cell, part in zip(targets, value, strict=True):
                if cell is not None:
                    cells[cell] = part
        for function, out, a, b in self._steps:
            cells[out] = function(cells[a]) if b < 0 else function(cells[a], cells[b])
        return _gathered(self._out[0], cells)

    def _line(self, line: ast.stmt) -> None:
        match line:
            case ast.Expr(value=ast.Constant(value=str())):
                return
            case ast.Assign(targets=[ast.Tuple(elts=names)], value=ast.Name(id=source)):
                if source in self._given:
                    raise _unexpected(line)
                self._given[source] = [self._target(name) for name in names]
            case ast.Assign(targets=[ast.Name(id=name)], value=value):
                self._names[name] = self._value(value)
            case ast.Return(value=ast.Tuple() as value):
                self._out.append(self._shape(value))
            case _:
                raise _unexpected(line)

    def _target(self, name: ast.expr) -> int | None:
        if not isinstance(name, ast.Name):
            raise _unexpected(name)
        if name.id == "_":
            return None
        self._names[name.id] = self._cell(None)
        return self._names[name.id]

    def _cell(self, value: Any) -> int:
        self._cells.append(value)
        return len(self._cells) - 1

    def _step(self, function: Callable[..., Any], a: int, b: int = -1) -> int:
        out = self._cell(None)
        self._steps.append((function, out, a, b))
        return out

    def _shape(self, node: ast.expr) -> Shape:
        if isinstance(node, ast.Tuple):
            return tuple(self._shape(part) for part in node.elts)
        return self._value(node)

    def _value(self, node: ast.expr) -> int:
        # A long sum nests on its left side: follow it in a loop, not by recursion.
        later: list[ast.BinOp] = []
        while isinstance(node, ast.BinOp):
            later.append(node)
            node = node.left
        match node:
            case ast.Constant(value=int() | float() as number):
                cell = self._cell(number)
            case ast.Name(id=name) if name in self._names:
                cell = self._names[name]
            case ast.UnaryOp(op=ast.USub(), operand=operand):
                cell = self._step(operator.neg, self._value(operand))
            case ast.Call(func=ast.Name(id=name), args=[argument], keywords=[]) if name in _ONE:
                cell = self._step(_ONE[name], self._value(argument))
            case _:
                raise _unexpected(node)
        for binary in reversed(later):
            function = _TWO.get(type(binary.op))
            if function is None:
                raise _unexpected(binary)
            cell = self._step(function, cell, self._value(binary.right))
        return cell


def equations_of(source: str) -> dict[str, Equation]:
    """The functions of a source by name, without `state_space`, which only calls another one.

    Raises `LinkError` for text that `sourcecode` cannot have written.
    """
    p: tuple[float, ...] | None = None
    out: dict[str, Equation] = {}
    try:
        for line in ast.parse(source).body:
            match line:
                case ast.Expr(value=ast.Constant(value=str())) | ast.ImportFrom(module="numpy"):
                    pass
                case ast.Assign(targets=[ast.Name(id="NAMES")]):
                    pass
                case ast.Assign(targets=[ast.Name(id="P")]) if p is None:
                    p = _numbers(line)
                case ast.FunctionDef(name=name) if p is not None:
                    if name != "state_space":
                        out[name] = Equation(line, p)
                case _:
                    raise _unexpected(line)
        if not out:
            raise ValueError
        return out
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        raise LinkError(f"these are no equations of an arm ({type(error).__name__})") from None


def _numbers(line: ast.Assign) -> tuple[float, ...]:
    value = ast.literal_eval(line.value)
    if not isinstance(value, tuple) or not all(isinstance(number, float) for number in value):
        raise _unexpected(line)
    return value


def _gathered(shape: Shape, cells: list[Any]) -> Any:
    if isinstance(shape, tuple):
        return tuple([_gathered(part, cells) for part in shape])
    return cells[shape]


def _unexpected(node: ast.stmt | ast.expr) -> LinkError:
    return LinkError(f"these are no equations of an arm: unexpected code in line {node.lineno}")
