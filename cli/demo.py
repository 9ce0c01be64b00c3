"""`make demo`: an isometric test on the virtual bench, and the isometric table of the thesis."""

from __future__ import annotations

import sys
from pathlib import Path

import typer

from daq.clock import RealClock
from daq.errors import PamrigError


def demo(root: Path) -> int:
    """Run, report, import, report; then print the files made and how to view them."""
    from analysis.formats.importer import import_thesis
    from analysis.reporting.derived import derive_all
    from cli.protocols.protocol_command import TestOptions, protocol_command

    typer.echo(
        "1. an isometric test on the virtual bench: 5 lengths, 8 pressures, up and down, twice"
    )
    options = TestOptions(out=root, specimen="demo-muscle", operator="demo")
    status = protocol_command("isometric", options)
    if status:
        return status
    virtual = max(root.glob("*demo-muscle*"))
    typer.echo(
        "2. the isometric table of the 1996 thesis (measured columns), through the same reduction"
    )
    thesis = derive_all(import_thesis("c01", root, RealClock())).folder
    typer.echo(f"""
made:
  {virtual / "derived" / "report.html"}
  {thesis / "derived" / "report.html"}
  (open both in a browser; table.csv and samples.parquet are in the same folders)

next steps (if `pamrig` is not found: first `source .venv/bin/activate`):
  pamrig runs list --runs {root}
  pamrig view {virtual}        the whole test in the viewer
  pamrig isometric --live         the same test in the live view
  pamrig doctor                   what would prevent a run on this rig""")
    return 0


def main() -> None:
    """Entry point of ``python -m cli.demo [FOLDER]``."""
    try:
        sys.exit(demo(Path(sys.argv[1] if len(sys.argv) > 1 else "out/demo")))
    except PamrigError as error:
        typer.echo(f"pamrig: {error}", err=True)
        sys.exit(2)


if __name__ == "__main__":
    main()
