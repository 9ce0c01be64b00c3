"""The page of all commands, from the program's own command line."""

from __future__ import annotations

import inspect
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from cli.main import command_line
from cli.sections import SECTIONS
from rigs.protocols.names import PROTOCOLS

PATH = "docs/reference/commands.md"
FIELDS = Path(__file__).with_name("json_fields.toml")
HEAD = Path(__file__).with_name("commands_head.md")


def page() -> str:
    """The whole page as Markdown."""
    parts = [HEAD.read_text(encoding="utf-8")]
    root = command_line()
    for section, names in SECTIONS.items():
        parts.append(f"## {section}\n")
        tests = [name for name in names if name in PROTOCOLS]
        if tests:
            parts.append(_protocols(root, tests))
        for name in (n for n in names if n not in tests):
            parts += [_command(words, found) for words, found in _leaves(name, root.commands[name])]
    parts.append(_fields())
    return "\n".join(parts)


def every_command() -> Iterator[tuple[str, Any]]:
    """(words after ``pamrig``, command) of each command that does something."""
    for name, found in command_line().commands.items():
        yield from _leaves(name, found)


def _leaves(words: str, command: Any) -> Iterator[tuple[str, Any]]:
    if not hasattr(command, "commands"):
        yield words, command
        return
    for name, inner in command.commands.items():
        yield from _leaves(f"{words} {name}", inner)


def _protocols(root: Any, names: list[str]) -> str:
    """The tests of the program take the same options; they are listed once."""
    rows = ["| command | |", "|--|--|"]
    rows += [f"| `pamrig {name}` | {_summary(root.commands[name])} |" for name in names]
    first = root.commands[names[0]]
    same = [o.opts[0] for o in first.params]
    for name in names[1:]:
        assert [o.opts[0] for o in root.commands[name].params] == same, name
    own = ("--rig", "--protocol", "--specimen")
    return "\n".join([*rows, "", "Options of each of them:", "", _options(first, own), ""])


def _command(words: str, command: Any) -> str:
    arguments = [p for p in command.params if p.param_type_name == "argument"]
    usage = " ".join(_argument(p) for p in arguments)
    lines = [f"### pamrig {words}", "", _summary(command), ""]
    lines += [f"    pamrig {words} {usage}".rstrip() + " [OPTIONS]", ""]
    for p in arguments:
        lines.append(f"- **{p.name.upper()}** {p.help}{_default(p)}")
    if arguments:
        lines.append("")
    lines.append(_options(command))
    return "\n".join([*lines, ""])


def _argument(parameter: Any) -> str:
    name = parameter.name.upper() + ("..." if parameter.nargs == -1 else "")
    return name if parameter.required else f"[{name}]"


def _summary(command: Any) -> str:
    return " ".join(inspect.cleandoc(command.help or "").split())


def _options(command: Any, varied: tuple[str, ...] = ()) -> str:
    rows = ["| option | value | meaning |", "|--|--|--|"]
    for p in command.params:
        if p.param_type_name != "option" or p.hidden or p.name == "help":
            continue
        names = ", ".join(f"`{name}`" for name in [*p.opts, *p.secondary_opts])
        kind = "" if p.is_flag else _kind(p)
        default = " Default: that of the test." if p.opts[0] in varied else _default(p)
        rows.append(f"| {names} | {kind} | {_cell(p.help or '')}{default} |")
    return "\n".join(rows) if len(rows) > 2 else "No options."


def _kind(parameter: Any) -> str:
    annotation = parameter.type_descriptor.annotation
    kinds: dict[Any, str] = {
        str: "text",
        float: "number",
        int: "whole number",
        Path: "path",
        list[str]: "text, repeated",
    }
    return kinds[annotation] + (", required" if parameter.required else "")


def _default(parameter: Any) -> str:
    value = parameter.default
    if (
        parameter.required
        or value is None
        or callable(value)
        or value is False
        or value in ("", ())
    ):
        return ""
    if getattr(parameter, "is_flag", False):
        return " Default: yes."
    return f" Default: `{value}`."


def _cell(text: str) -> str:
    return " ".join(text.replace("|", "\\|").split())


def json_fields() -> dict[str, dict[str, Any]]:
    """Name of a JSON value to its fields; ``commands`` lists what prints it."""
    return tomllib.loads(FIELDS.read_text(encoding="utf-8"))


def _fields() -> str:
    lines = ["## Fields of --json", ""]
    there = {words for words, _ in every_command()}
    for name, fields in json_fields().items():
        commands = ", ".join(f"`pamrig {c}`" if c in there else c for c in fields["commands"])
        lines += [
            f"### {name}",
            "",
            f"Printed by {commands}.",
            "",
            "| field | meaning |",
            "|--|--|",
        ]
        lines += [f"| `{k}` | {_cell(v)} |" for k, v in fields.items() if k != "commands"]
        lines.append("")
    return "\n".join(lines)


def main() -> None:
    """Write the page."""
    (Path(__file__).resolve().parents[2] / PATH).write_text(page(), "utf-8")
