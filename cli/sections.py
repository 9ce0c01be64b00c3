"""The list of commands by what a person wants to do, and what ``pamrig`` alone says."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from typer.core import TyperGroup

from rigs.protocols.names import PROTOCOLS

if TYPE_CHECKING:
    from collections.abc import Iterable

    from daq.store.info import RunInfo

SECTIONS: dict[str, tuple[str, ...]] = {
    "Test": (*PROTOCOLS, "test", "run", "continue", "record"),
    "Bench": ("init", "virtual", "doctor", "read", "vent", "console", "calibrate", "firmware"),
    "Data": ("runs", "report", "view", "length", "strain", "pose", "import"),
    "Model": ("models", "fit", "links"),
    "Gap": ("gap",),
    "Simulate": ("simulate", "study", "demo"),
}
"""Heading to commands, in the order of ``pamrig --help``. A test finds a command in none."""
LONGEST_SUMMARY = 150


class SectionedGroup(TyperGroup):
    """Lists its commands under the headings of `SECTIONS`."""

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write one list for each heading; commands of no heading come last."""
        wide = max(map(len, self.commands))
        named = {name for names in SECTIONS.values() for name in names}
        rest = tuple(name for name in self.commands if name not in named)
        for heading, names in {**SECTIONS, "Other": rest}.items():
            there = [(name, self.commands[name]) for name in names if name in self.commands]
            rows = [
                (name.ljust(wide), command.get_short_help_str(LONGEST_SUMMARY))
                for name, command in there
                if not command.hidden
            ]
            if rows:
                with formatter.section(heading):
                    formatter.write_dl(rows)


def start_text(folder: Path) -> str:
    """What to do next, from the newest run in a folder of runs.

    Args:
        folder: where runs are kept unless an option names another place.
    """
    from daq.store.store import list_runs

    lines = ["pamrig: test bench for pneumatic artificial muscles.", ""]
    lines += _next_steps(list_runs(folder), folder)
    lines += ["", "All commands: pamrig --help. Options of one: pamrig COMMAND --help."]
    return "\n".join(lines)


NO_RUNS = (
    ("pamrig demo", "a first test on a simulated bench, with its report"),
    ("pamrig isometric --live", "the same test, watched as it runs"),
    ("pamrig doctor --rig FILE", "check a bench of your own before its first test"),
)
INTERRUPTED = (
    ("pamrig continue last", "go on after its last complete point"),
    ("pamrig report last", "a report of what was measured"),
)
FINISHED = (
    ("pamrig report last", "table and report"),
    ("pamrig view last", "its record in the browser"),
    ("pamrig fit last --model NAME", "fit a muscle model (pamrig models list)"),
    ("pamrig gap where last", "where the simulation differs from it"),
)


def _next_steps(runs: Iterable[RunInfo], folder: Path) -> list[str]:
    from daq.store.info import TESTS

    tests = [info for info in runs if info.origin in TESTS]
    if not tests:
        return [f"There are no tests in {folder} yet. Begin with", "", *_commands(NO_RUNS)]
    last = tests[-1]
    which = f"last of {len(tests)} tests" if len(tests) > 1 else "only test"
    text = f"The {which} in {folder} is {last.run_id}: {last.outcome}. Next:"
    steps = FINISHED if last.outcome == "clean" else INTERRUPTED
    return [text, "", *_commands(steps)]


def _commands(steps: Iterable[tuple[str, str]]) -> list[str]:
    steps = list(steps)
    wide = max(len(command) for command, _ in steps)
    return [f"  {command.ljust(wide)}   {what}" for command, what in steps]
