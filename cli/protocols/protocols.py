"""One command for each test protocol; each imports what it needs when it runs."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer

from cli.completion import run_names, shipped
from cli.options import (
    RUNS,
    JsonOption,
    NoteOption,
    OperatorOption,
    OutOption,
    RigOption,
    RunArgument,
    RunsOption,
    SeedOption,
)
from rigs.protocols.names import PROTOCOLS, default_rig, default_specimen

ProtocolOption = Annotated[
    str,
    typer.Option(
        "--protocol",
        help="Protocol file, or the name of a shipped one.",
        autocompletion=shipped("protocols"),
    ),
]

LiveOption = Annotated[bool, typer.Option("--live", help="Show the test in the live view.")]
BrowserOption = Annotated[
    bool, typer.Option("--browser/--no-browser", help="Open the live view in the browser.")
]


OWN = "Run a protocol of your own: a Python file, or one that an installed package brings."


def _command(name: str) -> Callable[..., None]:
    """The command of one protocol."""
    usual_rig, usual_specimen = default_rig(name), default_specimen(name)

    def command(
        rig: RigOption = usual_rig,
        protocol: ProtocolOption = name,
        out: OutOption = RUNS,
        specimen: Annotated[str, typer.Option(help="What is tested.")] = usual_specimen,
        operator: OperatorOption = "",
        note: NoteOption = "",
        seed: SeedOption = None,
        live: LiveOption = False,
        browser: BrowserOption = True,
        wire: Annotated[
            bool, typer.Option("--wire", help="Also record every received byte.")
        ] = False,
        as_json: JsonOption = False,
        predict: Annotated[
            Path | None,
            typer.Option("--predict", help="Plant or rig file: draw its prediction, live."),
        ] = None,
    ) -> None:
        from cli.protocols.protocol_command import TestOptions, protocol_command

        options = TestOptions(
            rig, protocol, out, specimen, operator, note, seed, live or predict is not None,
            browser, wire, as_json, predict,
        )  # fmt: skip
        raise typer.Exit(protocol_command(name, options))

    return command


def _own_command() -> Callable[..., None]:
    """The command of the user's own protocols: the options of all tests behind one argument."""

    def command(test: str, **options: Any) -> None:
        _command(test)(**options)

    shared = inspect.signature(_command(""), eval_str=True)
    test = Annotated[str, typer.Argument(help="Python file, or name of an installed protocol.")]
    first = inspect.Parameter("test", inspect.Parameter.POSITIONAL_OR_KEYWORD, annotation=test)
    parameters = [first, *shared.parameters.values()]
    command.__signature__ = shared.replace(parameters=parameters)  # type: ignore[attr-defined]
    return command


def add_protocols(app: typer.Typer, runs_app: typer.Typer) -> None:
    """Add the commands that run tests to `app`, and those on recorded runs to `runs_app`."""
    for name, summary in PROTOCOLS.items():
        app.command(name, help=summary)(_command(name))
    app.command("test", help=OWN)(_own_command())
    runs_app.command("tell")(send_request)
    app.command("continue")(continue_test)
    app.command("run")(run_plan)


def send_request(
    what: Annotated[str, typer.Argument(help="pause, resume, skip, repeat, mark or stop.")],
    words: Annotated[str, typer.Argument(help="Text of the marker.")] = "",
    run: Annotated[
        str,
        typer.Option("--run", help="Run folder, run id, or 'last'.", autocompletion=run_names),
    ] = "last",
    runs: RunsOption = RUNS,
) -> None:
    """Send a request to a running test: pause, resume, skip, repeat, mark, stop."""
    from cli.protocols.request import tell_run

    typer.echo(tell_run(run, runs, f"{what} {words}".strip()))


def continue_test(
    run: RunArgument = "last",
    rig: Annotated[str, typer.Option("--rig", help="Rig file, if it was moved.")] = "",
    protocol: Annotated[
        str, typer.Option("--protocol", help="Protocol file, if it was moved.")
    ] = "",
    operator: OperatorOption = "",
    note: NoteOption = "",
    runs: RunsOption = RUNS,
    live: LiveOption = False,
    browser: BrowserOption = True,
    as_json: JsonOption = False,
) -> None:
    """Continue an interrupted test after its last complete trial, as a run linked to the first."""
    from cli.protocols.resume import continue_command

    raise typer.Exit(
        continue_command(run, runs, rig, protocol, operator, note, as_json, live, browser)
    )


def run_plan(
    plan: Annotated[Path, typer.Argument(help="Plan file (TOML): tests, one after another.")],
    again: Annotated[
        bool, typer.Option("--again", help="From the start, even if part of the plan is done.")
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Run a plan of tests; after Ctrl-C, running it again continues it."""
    from cli.protocols.plan import plan_command

    raise typer.Exit(plan_command(plan, again, as_json))
