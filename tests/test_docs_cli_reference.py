"""The page of commands and the fields of ``--json`` cannot go stale."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from cli.completion import model_names, run_names, shipped
from cli.data.reports import THESIS_TABLES
from cli.sections import SECTIONS, start_text
from daq.store.info import RunInfo
from docs.make import commands as reference

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / reference.PATH
FIELDS = reference.json_fields()


def test_the_page_is_what_the_program_says() -> None:
    assert PAGE.read_text(encoding="utf-8") == reference.page(), "run python -m docs.make"


def test_every_command_stands_under_a_heading_and_says_what_it_does() -> None:
    listed = {name for names in SECTIONS.values() for name in names}
    for words, command in reference.every_command():
        assert words.split()[0] in listed
        assert command.help, words
        for parameter in command.params:
            if parameter.name != "help":
                assert parameter.help, f"pamrig {words}: {parameter.name} has no help"


QUANTITIES = ("mm", "kpa", "kg", "n", "deg", "min", "seconds", "days")
UNITLESS = {
    *("--seed", "--seeds", "--count", "--jobs", "--threshold", "--budget", "--markers"),
    *("--repeats", "--base"),
    *("--u-each", "--u-gain", "--u-zero"),
}
"""Counts, and options whose help states the unit because it depends on the command."""


def test_an_option_that_takes_a_number_ends_in_its_unit() -> None:
    for words, command in reference.every_command():
        for parameter in command.params:
            number = parameter.type_descriptor.annotation in (int, float)
            if parameter.param_type_name != "option" or not number or parameter.is_flag:
                continue
            name = parameter.opts[0]
            assert name in UNITLESS or name.split("-")[-1] in QUANTITIES, f"pamrig {words} {name}"


QUICK = {
    "report": ["report", "last"],
    "runs list": ["runs", "list"],
    "runs show": ["runs", "show"],
    "runs verify": ["runs", "verify"],
    "runs export": ["runs", "export", "last", "--to", "csv"],
    "runs archive": ["runs", "archive", "last", "--title", "x", "--author", "Me", "--out", "x.zip"],
    "runs index": ["runs", "index"],
    "init protocol": ["init", "protocol", "isometric", "x.toml"],
    "length": ["length", "last"],
    "models list": ["models", "list"],
    "models compare": ["models", "compare", "c01", "--models", "fluidic"],
    "models rotary": ["models", "rotary"],
    "fit": ["fit", "c01", "--model", "fluidic"],
    "gap effects": ["gap", "effects"],
    "gap export": ["gap", "export", "last", "--out", "set"],
}
SLOW = {
    "doctor": ["doctor"],
    "init rig": ["init", "rig", "bench.toml", "--answer", "bench=virtual"],
    "read": ["read", "--rig", "virtual-instruments", "--seconds", "1"],
    "models audit-thesis": ["models", "audit-thesis"],
    "gap where": ["gap", "where", "last"],
    "gap diagnose": ["gap", "diagnose", "last"],
    "gap next": ["gap", "next", "last"],
    "gap shrink": ["gap", "shrink", "last"],
}


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder in which one short test has been made."""
    from bench_runs import quick, run_isometric
    from rigs.rigfile.config import load_rig

    folder = tmp_path_factory.mktemp("commands")
    config = load_rig("virtual")
    plan = quick(config, lengths_mm=(57.0, 60.0), pressures_kpa=(100.0, 250.0, 400.0), repeats=1)
    run_isometric(config, plan, folder / "runs")
    return folder


def printed(words: list[str], folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any) -> Any:
    """The JSON value of a command, without a process of its own."""
    from cli.main import command_line

    monkeypatch.chdir(folder)
    capsys.readouterr()
    command_line()([*words, "--json"], standalone_mode=False)
    return json.loads(capsys.readouterr().out)


def fields_of(value: Any) -> set[str]:
    """Names of the fields of an object, or of all objects of a list."""
    values = value if isinstance(value, list) else [value]
    assert values, "nothing was printed"
    return set().union(*values)


@pytest.mark.parametrize("name", QUICK)
def test_json_has_the_fields_of_the_page(
    name: str, bench: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    compare(name, printed(QUICK[name], bench, monkeypatch, capsys))


@pytest.mark.campaign
@pytest.mark.parametrize("name", SLOW)
def test_json_of_long_commands_has_the_fields_of_the_page(
    name: str, bench: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    compare(name, printed(SLOW[name], bench, monkeypatch, capsys))


def compare(name: str, value: Any) -> None:
    stated = set(FIELDS[name]) - {"commands"}
    if name == "report":
        stated |= set(FIELDS["isometric"]) - {"commands"}
    assert fields_of(value) == stated


def test_every_list_of_fields_is_compared() -> None:
    by_others = {"isometric", "report of several runs"}  # test_report_several compares the latter
    assert set(FIELDS) == {*QUICK, *SLOW, *by_others}


def test_without_a_test_the_program_says_how_to_begin(tmp_path: Path) -> None:
    text = start_text(tmp_path / "runs")
    assert "no tests" in text
    assert "pamrig demo" in text


@pytest.mark.parametrize(
    ("outcome", "next_command"),
    [("clean", "pamrig report last"), ("faulted", "pamrig continue last")],
)
def test_after_a_test_the_program_says_what_to_do_with_it(
    outcome: str, next_command: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    info = RunInfo("20260101T000000Z_isometric_x", "", "isometric", "x", outcome, 1.0, "f")
    monkeypatch.setattr("daq.store.store.list_runs", lambda _: [info])
    lines = start_text(tmp_path).splitlines()
    assert info.run_id in lines[2]
    assert lines[4].strip().startswith(next_command)


def test_tab_completes_runs_rigs_and_models(bench: Path) -> None:
    context: Any = SimpleNamespace(params={"runs": bench / "runs"})
    (run,) = (path.name for path in (bench / "runs").iterdir() if path.is_dir())
    assert run_names(context, "") == ["last", run]
    assert run_names(context, "isometric") == [run]
    assert run_names(context, run[:8]) == [run]
    assert "virtual" in shipped("rigs")("vir")
    assert "fluidic" in model_names("fl")


def test_the_shell_gets_completions_from_the_program(bench: Path) -> None:
    words = "pamrig report l"
    asked = {"_PAMRIG_COMPLETE": "complete_bash", "COMP_WORDS": words, "COMP_CWORD": "2"}
    done = subprocess.run(
        [Path(sys.executable).with_name("pamrig")], cwd=bench, capture_output=True, text=True,
        env={**os.environ, **asked}, check=False,
    )  # fmt: skip
    assert done.stdout.split() == ["last"], done.stderr


def test_the_help_of_an_import_names_every_thesis_table() -> None:
    from analysis.formats.thesis_sources import ALIASES, SOURCES

    said = re.findall(r"\b[cd]0\d\b", THESIS_TABLES)
    assert set(said) == {*SOURCES, *ALIASES}
