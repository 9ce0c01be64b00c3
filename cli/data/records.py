"""Commands on recorded runs: index, find, export, annotate, exclude."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Optional

import typer

RunArgument = Annotated[str, typer.Argument(help="Run folder, run id, or 'last'.")]
RunsOption = Annotated[Path, typer.Option("--runs", help="Folder of runs.")]
JsonOption = Annotated[bool, typer.Option("--json", help="Print one JSON value, nothing else.")]
PointsOption = Annotated[
    str, typer.Option("--points", help="Numbers of points (order): 3,7-9. None: the run itself.")
]
ReasonOption = Annotated[str, typer.Option("--reason", help="Why; it stays in the record.")]
WhoOption = Annotated[str, typer.Option("--who", help="By whom.")]
RUNS = Path("runs")


def add_records(runs_app: typer.Typer) -> None:
    """Add these commands."""
    runs_app.command("index")(index)
    runs_app.command("find")(find)
    runs_app.command("export")(export)
    runs_app.command("annotate")(annotate)
    runs_app.command("exclude")(exclude)
    runs_app.command("include")(include)


def index(runs: RunsOption = RUNS, as_json: JsonOption = False) -> None:
    """Make the index of a folder of runs anew; lists use it from then on."""
    from cli.data.records_commands import index_command

    index_command(runs, as_json)


def find(
    specimen: Annotated[str, typer.Option(help="Part of the specimen's name.")] = "",
    protocol: Annotated[str, typer.Option(help="Protocol.")] = "",
    outcome: Annotated[str, typer.Option(help="clean, stopped, faulted, ...")] = "",
    operator: Annotated[str, typer.Option(help="Part of the operator's name.")] = "",
    since: Annotated[str, typer.Option(help="Started on this day or later: 2026-01-31.")] = "",
    until: Annotated[str, typer.Option(help="Started on this day or earlier.")] = "",
    runs: RunsOption = RUNS,
    as_json: JsonOption = False,
) -> None:
    """Runs that fit, oldest first."""
    from cli.data.records_commands import find_command

    find_command(
        runs, as_json, specimen=specimen, protocol=protocol, outcome=outcome, operator=operator,
        since=since, until=until,
    )  # fmt: skip


def export(
    run: RunArgument = "last",
    to: Annotated[str, typer.Option("--to", help="csv, parquet or mat.")] = "csv",
    out: Annotated[Optional[Path], typer.Option("--out", help="Folder to write to.")] = None,  # noqa: UP045
    what: Annotated[str, typer.Option("--what", help="table, samples or all.")] = "all",
    runs: RunsOption = RUNS,
    as_json: JsonOption = False,
) -> None:
    """Write a run's table and samples for other programs, units in the names."""
    from cli.data.records_commands import export_command

    export_command(run, runs, to, out, what, as_json)


def annotate(
    run: RunArgument = "last",
    points: PointsOption = "",
    reason: ReasonOption = "",
    who: WhoOption = "",
    runs: RunsOption = RUNS,
    as_json: JsonOption = False,
) -> None:
    """Say something about a run or some of its points; it stays in the record."""
    from cli.data.records_commands import remark_command

    remark_command("note", run, runs, points, reason, who, as_json)


def exclude(
    run: RunArgument = "last",
    points: PointsOption = "",
    reason: ReasonOption = "",
    who: WhoOption = "",
    runs: RunsOption = RUNS,
    as_json: JsonOption = False,
) -> None:
    """Leave points out of table, fits and figures from now on, with a reason that stays."""
    from cli.data.records_commands import remark_command

    remark_command("exclude", run, runs, points, reason, who, as_json)


def include(
    run: RunArgument = "last",
    points: PointsOption = "",
    reason: ReasonOption = "",
    who: WhoOption = "",
    runs: RunsOption = RUNS,
    as_json: JsonOption = False,
) -> None:
    """Take an exclusion back; both stay in the record."""
    from cli.data.records_commands import remark_command

    remark_command("include", run, runs, points, reason, who, as_json)
