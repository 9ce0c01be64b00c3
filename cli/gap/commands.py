"""`pamrig gap ...`: each command imports what it needs when it runs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from cli.gap.effects import effects
from cli.gap.paths import data_folder
from cli.gap.thesis import thesis
from cli.investigate.command import investigate
from cli.options import (
    RUNS,
    DataArgument,
    JsonOption,
    NoCacheOption,
    OutFileOption,
    PlantOption,
    RunsOption,
    SimulatorOption,
    WithoutOption,
)
from cli.output import many, print_json, state_findings


def add_gap(app: typer.Typer) -> None:
    """Add the commands of `pamrig gap`."""
    app.command("next")(next_experiment)
    for command in (
        check, where, diagnose, shrink, effects, export, investigate, report, thesis,
    ):  # fmt: skip
        app.command()(command)


def check(
    stream: Annotated[
        str, typer.Option(help="practice (open), reserved (each use is in the ledger) or smoke.")
    ] = "smoke",
    sets: Annotated[str, typer.Option(help="Set numbers: 0-59, or 3,5,8.")] = "0-59",
    out: Annotated[Path, typer.Option(help="Folder for results, hashes and totals.")] = Path(
        "out/check"
    ),
    jobs: Annotated[int, typer.Option(help="Processes; 0 = one per core.")] = 0,
    scheduler: Annotated[
        str | None, typer.Option(help="Address of an existing Dask scheduler.")
    ] = None,
    baselines: Annotated[
        bool, typer.Option(help="Run the baseline methods on the same data.")
    ] = True,
    page: Annotated[
        Path | None, typer.Option(help="Write the page (figures go into images/ beside it).")
    ] = None,
    purpose: Annotated[str, typer.Option(help="Why reserved sets are used, for the ledger.")] = "",
    ledger: Annotated[Path, typer.Option(help="Ledger of reserved sets.")] = Path(
        "docs/evidence/gap-check-ledger.csv"
    ),
    held_out: Annotated[
        bool,
        typer.Option(
            "--held-out",
            help="Forms of effects that practice, learning and tests never see, beside seen ones.",
        ),
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Diagnose data whose effect is withheld, and score the verdicts."""
    from cli.gap.check_command import check_command

    check_command(
        stream=stream, sets=sets, out=out, jobs=jobs, scheduler=scheduler, baselines=baselines,
        page=page, purpose=purpose, ledger=ledger, as_json=as_json, held_out=held_out,
    )  # fmt: skip


def where(
    data: DataArgument,
    without: WithoutOption = "",
    out: Annotated[
        Path | None,
        typer.Option("--out", help="Figure of the residual to write (.png, .svg, .pdf)."),
    ] = None,
    simulator: SimulatorOption = None,
    runs: RunsOption = RUNS,
    no_cache: NoCacheOption = False,
    as_json: JsonOption = False,
) -> None:
    """Quality of the data, the gap by stage, and which comparisons show it."""
    folder = data_folder(data, runs, simulator)
    from cli.gap.verdicts import Question, where_command

    where_command(Question(folder, without, simulator, not no_cache), out, as_json)


def diagnose(
    data: DataArgument,
    without: WithoutOption = "",
    simulator: SimulatorOption = None,
    runs: RunsOption = RUNS,
    no_cache: NoCacheOption = False,
    as_json: JsonOption = False,
) -> None:
    """Name the effect behind the gap, or say why it cannot be named."""
    folder = data_folder(data, runs, simulator)
    from cli.gap.verdicts import Question, diagnose_command

    diagnose_command(Question(folder, without, simulator, not no_cache), as_json)


def shrink(
    data: DataArgument,
    without: WithoutOption = "",
    out: OutFileOption = None,
    simulator: SimulatorOption = None,
    runs: RunsOption = RUNS,
    no_cache: NoCacheOption = False,
    as_json: JsonOption = False,
) -> None:
    """How far the named effect reduces the gap; writes the improved plant."""
    folder = data_folder(data, runs, simulator)
    from cli.gap.verdicts import Question, shrink_command

    shrink_command(Question(folder, without, simulator, not no_cache), out, as_json)


def next_experiment(
    data: DataArgument,
    without: WithoutOption = "",
    out: OutFileOption = None,
    simulator: SimulatorOption = None,
    runs: RunsOption = RUNS,
    no_cache: NoCacheOption = False,
    as_json: JsonOption = False,
) -> None:
    """The experiment or reference standard that would resolve what is open."""
    folder = data_folder(data, runs, simulator)
    from cli.gap.verdicts import Question, next_command

    next_command(Question(folder, without, simulator, not no_cache), out, as_json)


def report(
    data: DataArgument,
    out: Annotated[Path, typer.Option("--out", help="HTML file to write.")] = Path("gap.html"),
    pdf: Annotated[
        Path | None,
        typer.Option("--pdf", help="Also write the page as PDF (pip install 'pamrig[pdf]')."),
    ] = None,
    figures: Annotated[
        Path | None, typer.Option("--figures", help="Folder for each figure as PDF and SVG.")
    ] = None,
    without: WithoutOption = "",
    simulator: SimulatorOption = None,
    runs: RunsOption = RUNS,
    no_cache: NoCacheOption = False,
    as_json: JsonOption = False,
) -> None:
    """Diagnose a data set and write the verdict as one self-contained HTML page."""
    folder = data_folder(data, runs, simulator)
    from cli.gap.verdicts import Question, report_command

    question = Question(folder, without, simulator, not no_cache)
    report_command(question, out, as_json, pdf, figures)


def export(
    runs: Annotated[list[str], typer.Argument(help="Run folders, run ids, or 'last'.")],
    out: Annotated[Path, typer.Option("--out", help="Folder to make.")],
    folder: RunsOption = RUNS,
    plant: PlantOption = None,
    points: Annotated[
        bool, typer.Option("--points", help="Only settled points, without time series.")
    ] = False,
    muscle: Annotated[
        str, typer.Option("--muscle", help="Of tests of a joint: which muscle, a or b.")
    ] = "a",
    as_json: JsonOption = False,
) -> None:
    """Write recorded runs as one data set in the dataset format."""
    from daq.store.store import find_run
    from gap.data.from_runs import export_runs

    found = [find_run(folder, run) for run in runs]
    made = export_runs(found, out, plant=plant, form="points" if points else "time", muscle=muscle)
    if as_json:
        print_json({**vars(made), "folder": str(made.folder), "runs": list(made.runs),
                    "problems": list(made.problems)})  # fmt: skip
        return
    typer.echo(
        f"{made.folder}: {many(made.trials, 'trial')} in {many(made.slots, 'slot')}, "
        f"{many(made.rows, 'row')}, of {many(len(made.runs), 'run')}"
    )
    state_findings(made.problems)
