"""One command for each test protocol; each imports what it needs when it runs."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Optional

import typer

from rigs.protocols.names import PROTOCOLS, default_rig, default_specimen

OutOption = Annotated[Path, typer.Option("--out", help="Folder of runs.")]
RUNS = Path("runs")
RunArgument = Annotated[str, typer.Argument(help="Run folder, run id, or 'last'.")]
RunsOption = Annotated[Path, typer.Option("--runs", help="Folder of runs.")]
JsonOption = Annotated[bool, typer.Option("--json", help="Print one JSON value, nothing else.")]


def _command(name: str, summary: str) -> Callable[..., None]:
    """The command of one protocol."""

    def command(
        rig: Annotated[
            str, typer.Option("--rig", help="Rig file, or the name of a shipped one.")
        ] = default_rig(name),
        protocol: Annotated[
            str, typer.Option("--protocol", help="Protocol file, or the name of a shipped one.")
        ] = name,
        out: OutOption = RUNS,
        specimen: Annotated[str, typer.Option(help="What is tested.")] = default_specimen(name),
        operator: Annotated[str, typer.Option(help="Who tests.")] = "",
        note: Annotated[str, typer.Option(help="Anything worth remembering.")] = "",
        seed: Annotated[Optional[int], typer.Option(help="Seed of a virtual bench.")] = None,  # noqa: UP045
        live: Annotated[
            bool, typer.Option("--live", help="Show the test in the live view.")
        ] = False,
        browser: Annotated[
            bool, typer.Option("--browser/--no-browser", help="Open the live view in the browser.")
        ] = True,
        wire: Annotated[
            bool, typer.Option("--wire", help="Record every received byte, too.")
        ] = False,
        as_json: JsonOption = False,
        predict: Annotated[
            Optional[Path],  # noqa: UP045
            typer.Option("--predict", help="Plant or rig file: draw what it predicts, live."),
        ] = None,
    ) -> None:
        from cli.protocols.protocol_command import Order, protocol_command

        order = Order(
            rig, protocol, out, specimen, operator, note, seed, live or predict is not None,
            browser, wire, as_json, predict,
        )  # fmt: skip
        raise typer.Exit(protocol_command(name, order))

    command.__doc__ = summary
    return command


def add_protocols(app: typer.Typer, runs_app: typer.Typer) -> None:
    """Add the commands that run tests to `app`, and those on recorded runs to `runs_app`."""
    for name, summary in PROTOCOLS.items():
        app.command(name)(_command(name, summary))
    runs_app.command("tell")(tell)
    app.command("continue")(go_on)
    app.command("run")(run_plan)


def tell(
    what: Annotated[str, typer.Argument(help="pause, resume, skip, repeat, mark or stop.")],
    words: Annotated[str, typer.Argument(help="What to mark.")] = "",
    run: Annotated[str, typer.Option("--run", help="Run folder, run id, or 'last'.")] = "last",
    runs: Annotated[Path, typer.Option("--runs", help="Folder of runs.")] = RUNS,
) -> None:
    """Ask something of a test that is running: pause, resume, skip, repeat, mark, stop."""
    from cli.protocols.request import tell_run

    typer.echo(tell_run(run, runs, f"{what} {words}".strip()))


def go_on(
    run: RunArgument = "last",
    rig: Annotated[str, typer.Option("--rig", help="Rig file, if it has moved since.")] = "",
    protocol: Annotated[
        str, typer.Option("--protocol", help="Protocol file, if it has moved since.")
    ] = "",
    operator: Annotated[str, typer.Option(help="Who tests.")] = "",
    note: Annotated[str, typer.Option(help="Anything worth remembering.")] = "",
    runs: RunsOption = RUNS,
    as_json: JsonOption = False,
) -> None:
    """Go on with an interrupted test after its last whole trial, as a run linked to the first."""
    from cli.protocols.resume import continue_command

    raise typer.Exit(continue_command(run, runs, rig, protocol, operator, note, as_json))


def run_plan(
    plan: Annotated[Path, typer.Argument(help="Plan file (TOML): tests, one after another.")],
    again: Annotated[
        bool, typer.Option("--again", help="From the start, even if the plan was begun before.")
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Run a chain of tests; stopped with Ctrl-C it goes on where it was when run again."""
    from cli.protocols.plan import plan_command

    raise typer.Exit(plan_command(plan, again, as_json))
