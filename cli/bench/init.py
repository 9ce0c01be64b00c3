"""`pamrig init`: a rig file or a protocol file from questions, or a copy of a shipped file."""

from __future__ import annotations

import contextlib
import difflib
import importlib.resources
import os
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer.core import TyperGroup

from cli.options import RUNS, JsonOption, OutOption, RigOption
from cli.output import print_json, writing
from daq.errors import ConfigError

if TYPE_CHECKING:
    from importlib.resources.abc import Traversable

    from rigs.setup.questions import Interview

YesOption = Annotated[
    bool, typer.Option("--yes", help="Ask nothing: take the default of every question left.")
]
AnswersOption = Annotated[
    Path | None, typer.Option("--answers", help="TOML file of answers; these are not asked.")
]
AnswerOption = Annotated[
    list[str] | None, typer.Option("--answer", help="One answer, as KEY=VALUE; may be repeated.")
]
ReplaceOption = Annotated[
    bool, typer.Option("--replace", help="Replace an existing file without asking.")
]


class InitGroup(TyperGroup):
    """`pamrig init FILE` is `pamrig init rig FILE`."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Name the command that was left out."""
        if args[:1] not in ([name] for name in (*self.commands, "-h", "--help")):
            args = ["rig", *args]
        return super().parse_args(ctx, args)


def add_init(app: typer.Typer) -> None:
    """Add the commands of `pamrig init`."""
    app.command("rig")(rig)
    app.command("protocol")(protocol)
    app.command("copy")(copy)


def rig(
    file: Annotated[Path, typer.Argument(help="Rig file to write.")] = Path("rig.toml"),
    yes: YesOption = False,
    answers: AnswersOption = None,
    answer: AnswerOption = None,
    replace: ReplaceOption = False,
    doctor: Annotated[
        bool, typer.Option("--doctor/--no-doctor", help="Check the rig afterwards.")
    ] = True,
    out: OutOption = RUNS,
    as_json: JsonOption = False,
) -> None:
    """Write a rig file from questions, and check the rig. `pamrig init FILE` does the same."""
    from rigs.bench.doctor import examine, print_findings
    from rigs.rigfile.config import load_rig
    from rigs.setup.rig_file import ask_rig

    with _undisturbed():
        ask = _interview(answers, answer, yes or as_json)
        _may_write(file, replace, ask, yes or as_json)
        if not (yes or as_json):
            ask.tell("Enter takes the answer in brackets. Ctrl-C ends without writing anything.")
        text = ask_rig(ask)
        with _written(file, text) as part:
            load_rig(str(part))
    findings = examine(str(file), out) if doctor else []
    if as_json:
        print_json(
            {"file": str(file), "answers": ask.answers, "doctor": [vars(f) for f in findings]}
        )
    else:
        typer.echo(f"\nwritten: {file}")
        if doctor:
            print_findings(findings)
        typer.echo(
            f"next: enter what the comments in {file} ask for, then pamrig doctor --rig {file}"
        )
    raise typer.Exit(2 if any(f.status == "stop" for f in findings) else 0)


def protocol(
    test: Annotated[str, typer.Argument(help="Name of the test, such as isometric.")],
    file: Annotated[
        Path | None, typer.Argument(help="Protocol file to write. Default: my-TEST.toml.")
    ] = None,
    rig: RigOption = "",
    yes: YesOption = False,
    answers: AnswersOption = None,
    answer: AnswerOption = None,
    replace: ReplaceOption = False,
    as_json: JsonOption = False,
) -> None:
    """Write a protocol file from questions; the rig's limits are checked."""
    from rigs.protocols.names import PROTOCOLS, default_rig
    from rigs.protocols.registry import procedure
    from rigs.rigfile.config import load_rig
    from rigs.setup.protocol_file import ask_protocol

    if test not in PROTOCOLS:
        raise ConfigError(test, "is no test", f"known: {', '.join(PROTOCOLS)}")
    file = file or Path(f"my-{test}.toml")
    config = load_rig(rig or default_rig(test))
    silent = yes or as_json
    with _undisturbed():
        ask = _interview(answers, answer, silent)
        _may_write(file, replace, ask, silent)
        if not silent:
            ask.tell("Enter takes the answer in brackets. Ctrl-C ends without writing anything.")
        before: dict[str, Any] = {}
        while True:
            text = ask_protocol(ask, test, before)
            try:
                with _written(file, text) as part:
                    procedure(test).read(str(part), config)
                break
            except ConfigError as error:
                if silent or not sys.stdin.isatty():
                    raise
                ask.tell("", f"  {error}", "  once more:")
                before = ask.answers
                ask = _interview(answers, answer, silent)
    if as_json:
        print_json(
            {"file": str(file), "protocol": test, "rig": config.source, "answers": ask.answers}
        )
        return
    typer.echo(f"written: {file}")
    typer.echo(f"next: pamrig {test} --protocol {file}" + (f" --rig {rig}" if rig else ""))


def copy(
    name: Annotated[
        str, typer.Argument(help="Shipped rig or protocol; another file as FOLDER/NAME of configs.")
    ],
    file: Annotated[
        Path | None, typer.Argument(help="File to write. Default: NAME.toml here.")
    ] = None,
    replace: Annotated[bool, typer.Option("--replace", help="Replace an existing file.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Copy a shipped file (a rig, a protocol, another file of `configs`), to change the copy."""
    found = _shipped(name)
    source = f"configs/{'/'.join(found.parts)}.toml"
    file = file or Path(f"{found.name}.toml")
    if file.exists() and not replace:
        raise ConfigError(
            str(file), "exists already, and stays as it is", "choose another name, or add --replace"
        )
    text = importlib.resources.files("configs").joinpath(*found.parts[:-1], f"{found.name}.toml")
    with _written(file, text.read_text(encoding="utf-8")):
        pass
    if as_json:
        print_json({"file": str(file), "source": source})
    else:
        typer.echo(f"written: {file}, a copy of {source}")


def _shipped(name: str) -> PurePosixPath:
    """The path in ``configs``, without its suffix, of a file by its path there or its name.

    A bare name is that of a rig or a protocol, as it is in every other command.

    Raises:
        ConfigError: nothing of that name is shipped.
    """
    wanted = PurePosixPath(name.replace("\\", "/").removeprefix("./").removeprefix("configs/"))
    wanted = wanted.with_suffix("") if wanted.suffix == ".toml" else wanted
    there = dict.fromkeys(_toml_files(importlib.resources.files("configs"), PurePosixPath()))
    for path in (wanted, "rigs" / wanted, "protocols" / wanted):
        if path in there:
            return path
    near = difflib.get_close_matches(wanted.name, dict.fromkeys(path.name for path in there), 3)
    alike = [str(path) for one in near for path in there if path.name == one]
    raise ConfigError(
        name,
        "no rig, protocol or other file of that name is shipped",
        f"similar: {', '.join(alike)}" if alike
        else f"folders: {', '.join(sorted({str(path.parent) for path in there}))}",
    )  # fmt: skip


def _toml_files(folder: Traversable, where: PurePosixPath) -> Iterator[PurePosixPath]:
    for entry in sorted(folder.iterdir(), key=lambda entry: entry.name):
        if entry.is_dir():
            yield from _toml_files(entry, where / entry.name)
        elif entry.name.endswith(".toml"):
            yield where / entry.name.removesuffix(".toml")


def _interview(answers: Path | None, more: list[str] | None, silent: bool) -> Interview:
    """The questions, with what a file and options answer already.

    Raises:
        ConfigError: the file cannot be read, or an option is not KEY=VALUE.
    """
    from rigs.rigfile.toml_reader import load_toml
    from rigs.setup.protocol_file import flat
    from rigs.setup.questions import Interview

    given: dict[str, Any] = {}
    if answers is not None:
        given = flat(load_toml(str(answers), "rigs").values())
    for word in more or []:
        key, equals, value = word.partition("=")
        if not equals or not key.strip():
            raise ConfigError("--answer", f"{word!r} is not KEY=VALUE", "write --answer stage=grbl")
        given[key.strip()] = value
    source = str(answers) if answers is not None else "--answer"
    return Interview(
        given, source, None if silent else _say, None if silent else _typed(sys.stdin.isatty())
    )


def _say(text: str) -> None:
    typer.echo(text)


def _typed(at_terminal: bool) -> Callable[[str], str]:
    def read(prompt: str) -> str:
        typer.echo(prompt, nl=False)
        line = sys.stdin.readline()
        if not at_terminal:
            typer.echo(line.strip())
        if not line:
            raise EOFError
        return line

    return read


def _may_write(file: Path, replace: bool, ask: Interview, silent: bool) -> None:
    """Refuse to overwrite a file that nobody gave up.

    Raises:
        ConfigError: it exists, or its folder does not.
    """
    if not file.absolute().parent.is_dir():
        raise ConfigError(str(file), "its folder does not exist", "create it first")
    if not file.exists() or replace:
        return
    if silent or not ask.yes_no("replace", f"{file} exists already. Replace it?", False):
        raise ConfigError(
            str(file), "exists already, and stays as it is", "choose another name, or add --replace"
        )


@contextlib.contextmanager
def _undisturbed() -> Iterator[None]:
    """Ctrl-C is a way to end, not an error."""
    try:
        yield
    except KeyboardInterrupt:
        typer.echo("\nended: nothing was written", err=True)
        raise typer.Exit(130) from None


@contextlib.contextmanager
def _written(file: Path, text: str) -> Iterator[Path]:
    """The text in a file beside ``file``, which takes its name when the block ends without error.

    Raises:
        ConfigError: raised in the block; with the name that the file was to have.
        PamrigError: the file cannot be written.
    """
    with writing(file):
        handle, name = tempfile.mkstemp(".toml", f".{file.stem}-", file.absolute().parent)
    part = Path(name)
    try:
        with writing(file), os.fdopen(handle, "w", encoding="utf-8") as out:
            out.write(text)
        try:
            yield part
        except ConfigError as error:
            where = error.where.replace(str(part), str(file))
            raise ConfigError(where, error.what, error.remedy) from None
        with writing(file):
            os.chmod(part, 0o644)
            os.replace(part, file)
    finally:
        part.unlink(missing_ok=True)
