"""`pamrig gap report`: the diagnosis of a data set as a letter."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer


def gap_report(
    data: Annotated[Path, typer.Argument(help="Folder in the dataset format, or a run folder.")],
    out: Annotated[Path, typer.Option("--out", help="HTML file to write.")] = Path("gap.html"),
    without: Annotated[
        str, typer.Option("--without", help="Effects to strike from the catalogue, by commas.")
    ] = "",
    as_json: Annotated[
        bool, typer.Option("--json", help="Print one JSON value, nothing else.")
    ] = False,
) -> None:
    """Diagnose a data set and write the verdict as one HTML page that stands alone."""
    from gap.data.sources import open_data
    from gap.output import check_out
    from gap.reporting.examination import examine
    from gap.reporting.report import write_report
    from gap.reporting.text import headline

    check_out(out)
    struck = [word.strip() for word in without.split(",") if word.strip()]
    examined = examine(open_data(data), struck)
    write_report(examined, out)
    if as_json:
        values = {"report": str(out), "verdict": examined.verdict.as_dict()}
        typer.echo(json.dumps(values, indent=2, allow_nan=False))
    else:
        typer.echo(headline(examined.verdict))
        typer.echo(f"report   {out}")
