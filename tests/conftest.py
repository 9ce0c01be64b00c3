"""Which tests belong to `make campaign` because of their cost, beside those marked in place."""

from __future__ import annotations

import functools
import os
import tomllib
from pathlib import Path

import pytest
import typer.testing

HOUSE = Path(__file__).resolve().parent.parent
_PYPROJECT = tomllib.loads((HOUSE / "pyproject.toml").read_text(encoding="utf-8"))
PACKAGES: list[str] = _PYPROJECT["tool"]["importlinter"]["root_packages"]
os.environ["PAMRIG_DIAGNOSES"] = "off"  # each test computes what it claims
# As `cli.main.command_line` does: all commands are built once, not anew for each that is run.
typer.testing._get_command = functools.cache(typer.testing._get_command)  # type: ignore[attr-defined]
SLOW = Path(__file__).with_name("slow.txt")


def slow_tests() -> list[str]:
    """Node ids listed in slow.txt."""
    lines = SLOW.read_text(encoding="utf-8").splitlines()
    return [line for line in lines if line and not line.startswith("#")]


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark the listed tests."""
    listed = set(slow_tests())
    for item in items:
        if item.nodeid in listed:
            item.add_marker(pytest.mark.campaign)
            item.add_marker(pytest.mark.slow)
