"""Which branches an input took: marks put into the source of what is fuzzed as it is imported.

Every branch of a function (a body, either side of an `if`, a loop that ran and one that ended, a
handler, a `case`, a part of an `and`, `or` or `x if y else z`) sets one byte. A mark costs some 30
ns, so that every input is watched and not one in fifty, as a tracer would have it.
"""

from __future__ import annotations

import ast
import importlib.abc
import importlib.machinery
import sys
from collections.abc import Sequence
from pathlib import Path
from types import CodeType, ModuleType
from typing import Any

MARKS, MARK = "__marks__", "__mark__"
MOST = 1 << 16
PLAIN = {"property", "staticmethod", "classmethod", "contextmanager", "cached_property", "override"}
"""Decorators whose functions stay Python. Others may compile, and compiled code has no marks."""
LONGEST_WORD = 24


class Marks:
    """The marks of one process, and the words that the marked modules look for.

    Args:
        modules: names of modules and packages to mark; a package means all in it.

    Attributes:
        taken: one byte a branch, 1 where some input took it.
        count: how many branches there are.
        words: short texts and bytes that stand in the sources.
    """

    def __init__(self, modules: Sequence[str] = ()) -> None:
        self.taken = bytearray(MOST)
        self.count = 0
        self.words: set[bytes] = set()
        self._modules = tuple(modules)
        self._seen = bytes(self.taken)

    def wants(self, module: str) -> bool:
        """Whether it is to be marked."""
        return any(module == m or module.startswith(f"{m}.") for m in self._modules)

    def number(self) -> int:
        """Of the next branch."""
        self.count += 1
        assert self.count < MOST, "more branches than marks"
        return self.count - 1

    def news(self) -> bool:
        """Whether a branch has been taken since the last call that never was before."""
        if self.taken == self._seen:
            return False
        self._seen = bytes(self.taken)
        return True

    def reached(self) -> int:
        """How many branches have been taken."""
        return self.taken.count(1)

    def marked(self, source: bytes, name: str) -> CodeType:
        """The source's code with marks in it."""
        tree = _Marker(self).visit(ast.parse(source))
        return compile(ast.fix_missing_locations(tree), name, "exec", dont_inherit=True)

    def install(self) -> None:
        """Mark what is imported from now on; what has been imported stays as it is."""
        sys.meta_path.insert(0, _Finder(self))


class _Finder(importlib.abc.MetaPathFinder):
    def __init__(self, marks: Marks) -> None:
        self._marks = marks

    def find_spec(self, fullname: str, path: Any, target: Any = None) -> Any:
        if not self._marks.wants(fullname):
            return None
        spec = importlib.machinery.PathFinder.find_spec(fullname, path, target)
        if spec is not None and isinstance(spec.loader, importlib.machinery.SourceFileLoader):
            spec.loader = _Loader(spec.loader.name, spec.loader.path, self._marks)
        return spec


class _Loader(importlib.machinery.SourceFileLoader):
    def __init__(self, name: str, path: str, marks: Marks) -> None:
        super().__init__(name, path)
        self._marks = marks

    def get_code(self, fullname: str) -> CodeType:
        del fullname
        return self._marks.marked(Path(self.path).read_bytes(), self.path)

    def exec_module(self, module: ModuleType) -> None:
        vars(module)[MARKS] = self._marks.taken
        vars(module)[MARK] = self._marks.taken.__setitem__
        super().exec_module(module)


class _Marker(ast.NodeTransformer):
    """Puts marks into functions; what stands outside of them runs once, at import."""

    def __init__(self, marks: Marks) -> None:
        self._marks = marks
        self._inside = False

    def _statement(self) -> ast.stmt:
        target = ast.Subscript(
            ast.Name(MARKS, ast.Load()), ast.Constant(self._marks.number()), ast.Store()
        )
        return ast.Assign([target], ast.Constant(1))

    def _before(self, value: ast.expr) -> ast.expr:
        """The value, marked when it is asked for: `__mark__(7, 1) or value`."""
        call = ast.Call(
            ast.Name(MARK, ast.Load()),
            [ast.Constant(self._marks.number()), ast.Constant(1)],
            [],
        )
        return ast.BoolOp(ast.Or(), [call, value])

    def _function(self, node: ast.FunctionDef | ast.AsyncFunctionDef) -> ast.AST:
        names = [d.attr if isinstance(d, ast.Attribute) else getattr(d, "id", "") for d in
                 node.decorator_list]  # fmt: skip
        if any(name not in PLAIN for name in names):
            return node
        outside, self._inside = self._inside, True
        self.generic_visit(node)
        self._inside = outside
        at = 1 if ast.get_docstring(node) is not None else 0
        node.body.insert(at, self._statement())
        return node

    visit_FunctionDef = _function
    visit_AsyncFunctionDef = _function

    def _branches(self, node: Any) -> ast.AST:
        self.generic_visit(node)
        if self._inside:
            node.body.insert(0, self._statement())
            if hasattr(node, "orelse"):
                node.orelse.insert(0, self._statement())
        return node  # type: ignore[no-any-return]

    visit_If = _branches
    visit_For = _branches
    visit_While = _branches
    visit_ExceptHandler = _branches
    visit_match_case = _branches

    def visit_BoolOp(self, node: ast.BoolOp) -> ast.AST:
        self.generic_visit(node)
        if self._inside:
            node.values[1:] = [self._before(value) for value in node.values[1:]]
        return node

    def visit_IfExp(self, node: ast.IfExp) -> ast.AST:
        self.generic_visit(node)
        if self._inside:
            node.body, node.orelse = self._before(node.body), self._before(node.orelse)
        return node

    def visit_Lambda(self, node: ast.Lambda) -> ast.AST:
        return node  # some are handed to compilers

    def visit_Constant(self, node: ast.Constant) -> ast.AST:
        word = node.value.encode() if isinstance(node.value, str) else node.value
        if isinstance(word, bytes) and 0 < len(word) <= LONGEST_WORD and b" " not in word.strip():
            self._marks.words.add(word)
        return node
