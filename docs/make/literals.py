"""Keys that stand as literals in the source of readers, for the test that none is left out."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

from docs.make.asked import HOUSE, SECTION_METHODS, TABLE_METHODS, Recorder

READERS = {
    "rigs.rigfile.toml_reader": TABLE_METHODS,
    "gap.mapping.section": SECTION_METHODS,
}
"""Module of the class that a reader imports, and the methods that ask for a key."""
PACKAGES = ("rigs", "studies", "cli", "gap")
OWN_TABLE = ".table()"
"""What a driver calls that reads keys of its own of [pressure_source]."""
Literal = tuple[Path, int, int, str]
"""File, first and last line of the question, key."""


def literals() -> Iterator[Literal]:
    """Every question for a literal key in the source of all readers."""
    for package in PACKAGES:
        for path in sorted((HOUSE / package).rglob("*.py")):
            text = path.read_text("utf-8")
            methods = [methods for module, methods in READERS.items() if f"from {module} " in text]
            if not methods and OWN_TABLE in text:
                methods = [TABLE_METHODS]
            if methods:
                yield from _of(path, ast.parse(text), methods[0])


def never_reached(recorder: Recorder) -> list[str]:
    """Questions that no file led to, as "file:line key"."""
    made = []
    for path, first, last, key in literals():
        reached = any((str(path), line, key) in recorder.lines for line in range(first, last + 1))
        if not reached:
            made.append(f"{path.relative_to(HOUSE).as_posix()}:{first} {key}")
    return made


def _of(path: Path, tree: ast.Module, methods: tuple[str, ...]) -> Iterator[Literal]:
    helpers = _helpers(tree, methods)
    for node in ast.walk(tree):
        if not isinstance(node, ast.Call):
            continue
        at = None
        if isinstance(node.func, ast.Attribute) and node.func.attr in methods:
            at = 0
        elif isinstance(node.func, ast.Name):
            at = helpers.get(node.func.id)
        if at is None or len(node.args) <= at:
            continue
        key = node.args[at]
        if isinstance(key, ast.Constant) and isinstance(key.value, str):
            yield path, node.lineno, node.end_lineno or node.lineno, key.value


def _helpers(tree: ast.Module, methods: tuple[str, ...]) -> dict[str, int]:
    """Functions of the module that ask a table for a key, and the position of the key."""
    made = {}
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef):
            names = [argument.arg for argument in node.args.args]
            tables = [
                ast.unparse(argument.annotation) in ("Table", "Section")
                for argument in node.args.args
                if argument.annotation is not None
            ]
            if "key" in names and any(tables) and _asks(node, methods):
                made[node.name] = names.index("key")
    return made


def _asks(function: ast.FunctionDef, methods: tuple[str, ...]) -> bool:
    return any(
        isinstance(node, ast.Call)
        and (isinstance(node.func, ast.Attribute) and node.func.attr in methods)
        and node.args
        and isinstance(node.args[0], ast.Name)
        and node.args[0].id == "key"
        for node in ast.walk(function)
    )
