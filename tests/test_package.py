"""What is installed, and what a package index and a reader are told about it."""

from __future__ import annotations

import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

HOUSE = Path(__file__).resolve().parent.parent
PROJECT = tomllib.loads((HOUSE / "pyproject.toml").read_text("utf-8"))
PACKAGES = sorted(
    pattern.rstrip("*") for pattern in PROJECT["tool"]["setuptools"]["packages"]["find"]["include"]
)


def test_every_package_says_that_it_is_typed() -> None:
    assert [name for name in PACKAGES if not (HOUSE / name / "py.typed").is_file()] == []
    assert PROJECT["tool"]["setuptools"]["package-data"]["*"] == ["py.typed"]


def test_the_page_about_installing_names_every_top_level_package() -> None:
    page = (HOUSE / "docs" / "start" / "install.md").read_text("utf-8")
    told = page.partition("top-level packages: ")[2].partition(". Some")[0]
    assert sorted(re.findall(r"`(\w+)`", told)) == PACKAGES


def test_citation_and_changelog_are_of_this_version() -> None:
    version = PROJECT["project"]["version"]
    citation = (HOUSE / "CITATION.cff").read_text("utf-8")
    assert re.search(rf"^version: {re.escape(version)}$", citation, re.MULTILINE)
    newest = re.search(r"^## (\S+)", (HOUSE / "CHANGELOG.md").read_text("utf-8"), re.MULTILINE)
    assert newest is not None
    assert newest[1] == version


def pins(lock: str) -> dict[str, str]:
    text = (HOUSE / lock).read_text("utf-8")
    return dict(re.findall(r"^([A-Za-z0-9._-]+)==(\S+)", text, re.MULTILINE))


def test_the_demo_installs_what_runs_need_and_nothing_that_only_tests_need() -> None:
    runs, tests = pins("locks/run.lock"), pins("requirements.lock")
    assert runs.items() <= tests.items(), "the same versions in both"
    assert not {"pytest", "mujoco", "pin", "ruff", "mypy", "hypothesis"} & set(runs)
    said = subprocess.run(
        ["make", "--dry-run", "--always-make", "demo"],
        cwd=HOUSE, capture_output=True, text=True, check=True,
    ).stdout  # fmt: skip
    assert "locks/run.lock" in said
    assert "requirements.lock" not in said


def test_the_installer_shows_the_reason_where_pip_fails(tmp_path: Path) -> None:
    lock = tmp_path / "broken.lock"
    lock.write_text("pamrig == = 1.0\n", "utf-8")
    done = subprocess.run(
        [sys.executable, str(HOUSE / "tests" / "install.py"), str(lock)],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode != 0
    assert "Invalid requirement" in done.stderr
    assert "broken.lock: " not in done.stdout


def test_a_part_of_a_lock_file_has_these_packages_with_their_sums() -> None:
    from tests.install import part

    lock = HOUSE / "locks" / "run.lock"
    some = part(lock, ["numba", "llvmlite"])
    assert re.findall(r"^([a-z]+)==", some, re.MULTILINE) == ["llvmlite", "numba"]
    assert all(entry.count("--hash=sha256:") > 3 for entry in some.split("numba==")[:2])
    assert all(line in lock.read_text("utf-8") for line in some.splitlines())


@pytest.mark.parametrize("name", ["CHANGELOG.md", "CITATION.cff", "CONTRIBUTING.md"])
def test_what_a_visitor_looks_for_is_there(name: str) -> None:
    assert (HOUSE / name).stat().st_size > 200
