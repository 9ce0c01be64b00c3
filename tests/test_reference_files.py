"""The reference of TOML files is complete, and is what its generator makes."""

from __future__ import annotations

from pathlib import Path

import pytest

from docs.make import files, literals
from docs.make.asked import HOUSE, Recorder
from docs.make.kinds import KINDS
from docs.make.readers import Reading
from rigs.rigfile.toml_reader import Table


def test_every_key_has_a_line_and_every_line_a_key() -> None:
    lines = files.Lines()
    files.page(lines)
    missing, unused = "\n".join(lines.missing), "\n".join(lines.unused())
    assert not missing, f"add these lines to docs/make/keys.toml:\n{missing}"
    assert not unused, f"no reader asks for these lines of docs/make/keys.toml:\n{unused}"


def test_the_page_is_what_the_generator_makes() -> None:
    assert files.PAGE.read_text("utf-8") == files.page(), "run: python -m docs.make"


def test_every_key_in_the_source_of_a_reader_was_asked_for() -> None:
    unreached = literals.never_reached(files.recording())
    assert unreached == [], "add an example to docs/make/examples that has these keys"


def test_every_key_that_a_reader_looks_for_was_read() -> None:
    only_looked_for = [
        place
        for place, asked in files.recording().keys.items()
        if not asked.defaults and place[1] != "channels"
    ]
    assert only_looked_for == [], "add an example to docs/make/examples that has these keys"


def test_every_kind_of_file_is_on_the_page() -> None:
    assert {row.kind for row in files.rows()} == {kind.id for kind in KINDS}


def test_shipped_files_have_no_key_that_is_not_on_the_page() -> None:
    """The other way round: by the words of the page, not by the readers."""
    page = files.PAGE.read_text("utf-8")
    for path in [
        *(HOUSE / "configs").rglob("*.toml"),
        *(HOUSE / "docs" / "examples").rglob("*.toml"),
    ]:
        for line in path.read_text("utf-8").splitlines():
            key, equals, _ = line.partition(" = ")
            if equals and key.isidentifier() and "protocols" not in path.parts:
                assert f"| `{key}` |" in page or key in ("pressure", "force"), (path, key)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder whose files count as rig files."""
    (tmp_path / "rigs").mkdir()
    return tmp_path / "rigs"


def test_a_new_key_and_a_changed_bound_are_seen(folder: Path) -> None:
    def made(high: float, default: float) -> Recorder:
        reading = Reading()
        with reading.recorder.recording():
            t = Table({"a": 1.0}, str(folder / "x.toml"))
            t.number("a", 0, high, default, unit="N")
            assert "b" not in t
        return reading.recorder

    one = made(5.0, 2.0).keys
    assert one["rig", "", "a"].limits == {(0, 5.0)}
    assert one["rig", "", "a"].defaults == {2.0}
    assert one["rig", "", "b"].tested
    assert made(6.0, 2.0).keys["rig", "", "a"].limits == {(0, 6.0)}
    assert Table.number.__name__ == "number"
    assert not hasattr(Table.number, "__wrapped__"), "the class is as it was"
