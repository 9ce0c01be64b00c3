"""The reference of the Python interface is complete, and is what its generator makes."""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Iterator
from typing import Any

import pytest

import pamrig
from docs.make import python_page

OTHERS = {"DataFrame", "Any", "Axes", "None", "Run"}
"""Types of other packages, and the record behind `RecordedRun` (record-format.md)."""


def public() -> Iterator[tuple[str, Any]]:
    """Every object on the page, and the methods and properties of its classes."""
    for group in python_page.groups():
        for name, one in group.names.items():
            if inspect.isclass(one) or inspect.isfunction(one):
                yield name, one
            if inspect.isclass(one):
                for member, what in python_page.members(one):
                    yield f"{name}.{member}", what


def without_line(one: Any) -> list[str]:
    """Parameters that the docstring does not name; a single one is what the summary is about."""
    called = one.__func__ if isinstance(one, (classmethod, staticmethod)) else one
    constructed = not inspect.isclass(one) or python_page._has_constructor(one)
    if isinstance(one, property) or not constructed:
        return []
    names = [name for name in inspect.signature(called).parameters if name not in ("self", "cls")]
    text = python_page.docstring(one)
    missing = [name for name in names if not re.search(rf"\b{name}\b", text)]
    return missing if len(names) > 1 else []


PUBLIC = dict(public())


@pytest.mark.parametrize("name", PUBLIC)
def test_everything_public_has_a_docstring_that_names_its_parameters(name: str) -> None:
    assert python_page.docstring(PUBLIC[name]), f"{name} has no docstring"
    assert without_line(PUBLIC[name]) == [], f"{name}: the docstring does not name them"


def test_the_page_is_what_the_generator_makes() -> None:
    text = python_page.PAGE.read_text("utf-8")
    assert text == python_page.page(), "run: python -m docs.make"
    for name in PUBLIC:
        assert f" `{name}`\n" in text


def test_every_public_name_of_the_package_is_on_the_page() -> None:
    own = [name for name, one in vars(pamrig).items() if getattr(one, "__module__", "") == "pamrig"]
    assert {name for name in own if not name.startswith("_")} == set(pamrig.__all__)


def test_what_the_public_functions_return_is_on_the_page() -> None:
    for name in pamrig.__all__:
        one = getattr(pamrig, name)
        if inspect.isfunction(one):
            words = re.findall(r"[A-Z]\w+", str(inspect.signature(one).return_annotation))
            assert [word for word in words if word not in PUBLIC and word not in OTHERS] == []


def test_a_function_without_docstring_or_parameter_would_be_found() -> None:
    def bare(a: int, b: int) -> int:
        """About a alone."""
        return a + b

    found: Callable[..., int] = bare
    assert without_line(found) == ["b"]
    bare.__doc__ = None
    assert python_page.docstring(bare) == ""
