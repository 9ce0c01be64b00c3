"""`pamrig fit` and `pamrig models`: thin, each command imports what it needs when it runs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Optional

import typer

models_app = typer.Typer(help="Models of the muscle: list, compare, audit.", no_args_is_help=True)

JsonOption = Annotated[bool, typer.Option("--json", help="Print one JSON value, nothing else.")]
RunsOption = Annotated[Path, typer.Option("--runs", help="Folder of runs.")]
FigureOption = Annotated[
    Optional[Path],  # noqa: UP045
    typer.Option("--figure", help="Figure to write, .png or .svg."),
]
RUNS = Path("runs")


def fit(
    run: Annotated[str, typer.Argument(help="Run folder, run id, 'last', or a thesis table: c01.")],
    model: Annotated[str, typer.Option("--model", help="Model name, or a model file.")],
    free: Annotated[
        str, typer.Option(help="Parameters to fit, by commas; else all not fixed.")
    ] = "",
    start: Annotated[str, typer.Option(help="Values to start from or hold: a=1,b=2.")] = "",
    region: Annotated[str, typer.Option(help="Only pressures LOW-HIGH in kPa.")] = "",
    robust: Annotated[bool, typer.Option("--robust", help="Outliers count less.")] = False,
    warm: Annotated[
        bool, typer.Option("--warm", help="Also a thesis table's warm columns.")
    ] = False,
    tables: Annotated[
        bool, typer.Option("--tables", help="Regression tables of a sum of terms.")
    ] = False,
    out: Annotated[Optional[Path], typer.Option("--out", help="Model file to write.")] = None,  # noqa: UP045
    figure: FigureOption = None,
    runs: RunsOption = RUNS,
    as_json: JsonOption = False,
) -> None:
    """Fit a muscle model to a run: values, intervals, what the data cannot tell."""
    from cli.model.models_commands import fit_command

    fit_command(
        run, model, runs, free=free, start=start, region=region, robust=robust, warm=warm,
        tables=tables, out=out, figure=figure, as_json=as_json,
    )  # fmt: skip


@models_app.command("list")
def models_list(as_json: JsonOption = False) -> None:
    """All models, their parameters and where they hold."""
    from cli.model.models_commands import list_command

    list_command(as_json)


@models_app.command("compare")
def models_compare(
    data: Annotated[Optional[list[str]], typer.Argument(help="Runs or thesis tables.")] = None,  # noqa: UP045
    models: Annotated[str, typer.Option(help="Models by commas; else all that fit the data.")] = "",
    holdout: Annotated[
        str, typer.Option(help="Groups: length, temperature, mounting or load.")
    ] = "length",
    train: Annotated[str, typer.Option(help="Fit to this run or table, score on DATA.")] = "",
    region: Annotated[str, typer.Option(help="Only pressures LOW-HIGH in kPa.")] = "",
    nested: Annotated[bool, typer.Option("--nested", help="Also what choosing costs.")] = False,
    warm: Annotated[
        bool, typer.Option("--warm", help="Also a thesis table's warm columns.")
    ] = False,
    preset: Annotated[str, typer.Option(help="A published comparison: table-4-3.")] = "",
    figure: FigureOption = None,
    runs: RunsOption = RUNS,
    as_json: JsonOption = False,
) -> None:
    """Rank models on data none of them has seen; whole groups are held out in turn."""
    from cli.model.models_commands import compare_command

    compare_command(
        data or [], models, holdout, runs, region=region, nested=nested, train=train, warm=warm,
        preset=preset, figure=figure, as_json=as_json,
    )  # fmt: skip


@models_app.command("audit-thesis")
def models_audit(as_json: JsonOption = False) -> None:
    """Every published figure of the thesis beside what its own tables give, and why."""
    from cli.model.models_commands import audit_command

    audit_command(as_json)
