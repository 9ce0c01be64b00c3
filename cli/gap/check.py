"""`pamrig gap check`: the blind check on the command line."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Optional

import typer

StreamOption = Annotated[
    str, typer.Option(help="practice (free to look at), reserved (booked in the ledger) or smoke.")
]
SetsOption = Annotated[str, typer.Option(help="Set numbers: 0-59, or 3,5,8.")]
OutOption = Annotated[Path, typer.Option(help="Folder for results, seals and totals.")]
JobsOption = Annotated[int, typer.Option(help="Processes; 0 = one a core.")]
SchedulerOption = Annotated[
    Optional[str],  # noqa: UP045
    typer.Option(help="Address of an existing Dask scheduler."),
]
BaselinesOption = Annotated[bool, typer.Option(help="Run the naive methods on the same data.")]
PageOption = Annotated[
    Optional[Path],  # noqa: UP045
    typer.Option(help="Write the page (figures go into images/ beside it)."),
]
PurposeOption = Annotated[str, typer.Option(help="Why reserved sets are used, for the ledger.")]
LedgerOption = Annotated[Path, typer.Option(help="Ledger of reserved sets.")]
JsonOption = Annotated[bool, typer.Option("--json", help="Print one JSON value, nothing else.")]


def gap_check(
    stream: StreamOption = "smoke",
    sets: SetsOption = "0-59",
    out: OutOption = Path("out/check"),
    jobs: JobsOption = 0,
    scheduler: SchedulerOption = None,
    baselines: BaselinesOption = True,
    page: PageOption = None,
    purpose: PurposeOption = "",
    ledger: LedgerOption = Path("docs/evidence/gap-check-ledger.csv"),
    as_json: JsonOption = False,
) -> None:
    """Diagnose data whose effect is withheld, and score the verdicts."""
    from cli.gap.check_command import check_command

    check_command(
        stream=stream, sets=sets, out=out, jobs=jobs, scheduler=scheduler, baselines=baselines,
        page=page, purpose=purpose, ledger=ledger, as_json=as_json,
    )  # fmt: skip


def add_check(app: typer.Typer) -> None:
    """Hang the command into `pamrig gap`."""
    app.command("check")(gap_check)
