"""Integer constants of the firmware as numbers, before it is compiled for a board.

MicroPython's compiler inserts a constant only where it is defined. Anywhere else each use is looked
up by name at run time, 0.5 us or more on the chip, and a module with many public names makes each
of its look-ups slower. So each use becomes a number here, and what nobody looks up any more goes.
"""

from __future__ import annotations

import ast
import io
import tokenize
from collections.abc import Mapping


def constants(source: str) -> dict[str, int]:
    """Public integers of a module's top level: ``NAME = 3`` or ``NAME = const(3)``."""
    found: dict[str, int] = {}
    for node in ast.parse(source).body:
        if isinstance(node, ast.Assign) and len(node.targets) == 1:
            target, value = node.targets[0], node.value
            if isinstance(value, ast.Call) and getattr(value.func, "id", "") == "const":
                value = value.args[0]
            if not isinstance(target, ast.Name) or not isinstance(value, ast.Constant):
                continue
            if target.id.isupper() and target.id[0] != "_" and type(value.value) is int:
                found[target.id] = value.value
    return found


def inline(source: str, modules: Mapping[str, Mapping[str, int]]) -> str:
    """Source of one module with the constants of others, and each `const` of its own, as numbers.

    Args:
        source: of the module; its docstrings and comments may change their place.
        modules: by name of a module, its :func:`constants`.
    """
    own = constants(source)
    values = dict(own)
    skip: set[int] = set()
    imports: dict[int, str] = {}
    for node in ast.parse(source).body:
        if (
            isinstance(node, ast.ImportFrom)
            and (there := modules.get(node.module or "")) is not None
        ):
            taken = [n.name for n in node.names if n.name in there and n.asname is None]
            values.update({name: there[name] for name in taken})
            left = [
                n.name if n.asname is None else f"{n.name} as {n.asname}"
                for n in node.names
                if n.name not in taken
            ]
            skip.update(range(node.lineno, (node.end_lineno or node.lineno) + 1))
            imports[node.lineno] = (
                f"from {node.module} import {', '.join(left)}\n" if left else "\n"
            )
        elif isinstance(node, ast.Assign) and getattr(node.targets[0], "id", "") in own:
            if isinstance(node.value, ast.Call):  # const: nobody looks it up at run time
                skip.add(node.lineno)
            else:
                values.pop(node.targets[0].id)  # type: ignore[attr-defined]
    lines = source.splitlines(keepends=True)
    changes: list[tuple[int, int, int, str]] = []
    before = ""
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        row, column = token.start
        known = token.type == tokenize.NAME and token.string in values and before != "."
        if known and row not in skip:
            changes.append((row, column, len(token.string), str(values[token.string])))
        before = token.string
    for row, column, length, text in reversed(changes):
        line = lines[row - 1]
        lines[row - 1] = line[:column] + text + line[column + length :]
    for row in skip:
        lines[row - 1] = imports.get(row, "\n")
    return "".join(lines)
