"""What is installed: versions and sums in lock files, actions by commit, the bill of materials."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from audit import HOUSE, LOCK, LOCKS, bill_of_materials, loose, pins

PYPROJECT = tomllib.loads((HOUSE / "pyproject.toml").read_text(encoding="utf-8"))
SUM = "0a30ef8f5322a4173720ae6712dc9a5e58f5a19868f3f167b4b5778db066c2b5"


@pytest.mark.parametrize("path", LOCKS, ids=lambda path: path.name)
def test_every_line_of_a_lock_file_is_one_version_with_the_sums_of_its_files(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    assert loose(text) == []
    assert len(pins(text)) > 1
    assert "://" not in text  # where files come from is a setting of the machine
    assert "index" not in re.sub(r"^[a-z0-9.-]+==.*$", "", text, flags=re.M)


@pytest.mark.parametrize(
    "line",
    [
        f"numpy>=2 --hash=sha256:{SUM}",
        "scipy==1.13.0 ; python_version < '3.12'",
        f"scipy==1.13.0 --hash=sha256:{SUM[:-1]}",
        f"scipy==1.13.0 --hash=md5:{SUM[:32]}",
        f"evil @ git+https://example.org/evil --hash=sha256:{SUM}",
        "-i elsewhere",
    ],
)
def test_a_line_without_version_or_sum_is_found(line: str) -> None:
    good = f"numpy==2.4.6 ; python_full_version < '3.12' \\\n    --hash=sha256:{SUM}\n# a remark\n"
    assert loose(good) == []
    assert loose(good + line + "\n") == [line[:100]]


def test_a_package_with_compiled_parts_has_sums_for_all_platforms() -> None:
    sums = {pin.name: len(pin.sums) for pin in pins(LOCK.read_text(encoding="utf-8"))}
    # The fewest files that cover Linux, Windows and macOS.
    assert all(sums[name] >= 4 for name in ("numpy", "scipy", "pandas", "pyarrow", "rerun-sdk"))


def test_the_lock_holds_every_dependency_within_its_limits() -> None:
    locked = {pin.name: pin.version for pin in pins(LOCK.read_text(encoding="utf-8"))}
    run = {pin.name for pin in pins((HOUSE / "locks/run.lock").read_text(encoding="utf-8"))}
    project = PYPROJECT["project"]
    for text in [*project["dependencies"], *project["optional-dependencies"]["test"]]:
        wanted = Requirement(text)
        if wanted.name != project["name"]:
            assert wanted.specifier.contains(locked[canonicalize_name(wanted.name)]), text
    assert {Requirement(text).name for text in project["dependencies"]} <= run
    assert not run & {"pytest", "ruff", "hypothesis"}


def test_the_lock_files_agree_on_versions() -> None:
    known = {(p.name, p.marker): p.version for p in pins(LOCK.read_text(encoding="utf-8"))}
    for name in ("run", "peers"):
        for pin in pins((HOUSE / f"locks/{name}.lock").read_text(encoding="utf-8")):
            assert known.get((pin.name, pin.marker), pin.version) == pin.version


def test_pip_and_the_build_backend_are_pinned() -> None:
    locked = {p.name: p.version for p in pins((HOUSE / "locks/build.lock").read_text())}
    assert set(locked) == {"pip", "setuptools"}
    backend = f"setuptools=={locked['setuptools']}"
    assert PYPROJECT["build-system"]["requires"] == [backend]
    assert backend in PYPROJECT["dependency-groups"]["build"]


@pytest.mark.parametrize("name", ["Makefile", ".ci/run", ".github/workflows/audit.yml"])
def test_everything_is_installed_by_its_sum(name: str) -> None:
    lines = (HOUSE / name).read_text(encoding="utf-8").splitlines()
    installs = [line for line in lines if "pip install" in line]
    assert installs
    for line in installs:
        by_sum = "$(HASHED)" in line or "--require-hashes" in line
        own = "--no-deps" in line and ("--no-build-isolation" in line or "dist/*.whl" in line)
        assert by_sum or own, line


def test_actions_are_pinned_by_commit() -> None:
    used = [
        line.split("uses:")[1].strip()
        for path in sorted((HOUSE / ".github").rglob("*.yml"))
        for line in path.read_text(encoding="utf-8").splitlines()
        if "uses:" in line
    ]
    assert used
    assert all(re.fullmatch(r"[\w-]+/[\w-]+@[0-9a-f]{40}  # v[0-9.]+", name) for name in used)


def test_the_bill_of_materials_names_every_package_with_its_sums() -> None:
    text = LOCK.read_text(encoding="utf-8")
    bill = bill_of_materials(text)
    assert (bill["bomFormat"], bill["specVersion"]) == ("CycloneDX", "1.6")
    listed = {c["purl"]: {h["content"] for h in c["hashes"]} for c in bill["components"]}
    assert listed == {f"pkg:pypi/{p.name}@{p.version}": set(p.sums) for p in pins(text)}
    refs = [c["bom-ref"] for c in bill["components"]]
    assert len(set(refs)) == len(refs)
    assert bill["dependencies"][0]["dependsOn"] == refs
    assert bill_of_materials(text) == bill
