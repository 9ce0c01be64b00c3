"""Entry point of the command line. Each command imports what it needs when it runs."""

from __future__ import annotations

import functools
import os
import sys
from pathlib import Path
from typing import Annotated, Any

import typer
import typer.main

from cli.bench.bench import add_bench, add_firmware
from cli.bench.calibrate import add_calibration
from cli.bench.init import InitGroup, add_init
from cli.data.length import length
from cli.data.pose import pose
from cli.data.reports import add_imports, report, view
from cli.data.runs import add_runs
from cli.data.strain import strain
from cli.gap.commands import add_gap
from cli.model.links import links
from cli.model.models import add_models, fit
from cli.options import RUNS, OutOption
from cli.protocols.protocols import add_protocols
from cli.sections import SectionedGroup, start_text
from cli.simulate.simulate import add_studies, simulate

HELP = {"help_option_names": ["-h", "--help"]}

app = typer.Typer(
    name="pamrig",
    help="Test bench for pneumatic artificial muscles: run tests, view, reduce, report.",
    cls=SectionedGroup,
    invoke_without_command=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings=HELP,
)


def _print_version(asked: bool) -> None:
    if asked:
        from daq.version import version

        typer.echo(f"pamrig {version()}")
        raise typer.Exit


@app.callback()
def options(
    context: typer.Context,
    version: Annotated[
        bool,
        typer.Option(
            "--version", help="Print the version and exit.", is_eager=True, callback=_print_version
        ),
    ] = False,
) -> None:
    """Test bench for pneumatic artificial muscles: run tests, view, reduce, report."""
    if context.invoked_subcommand is None:
        typer.echo(start_text(RUNS))


def _group(name: str, summary: str) -> typer.Typer:
    group = typer.Typer(help=summary, no_args_is_help=True, context_settings=HELP)
    app.add_typer(group, name=name)
    return group


runs_app = _group("runs", "List, show, verify and rebuild recorded runs.")
add_runs(runs_app)
add_models(_group("models", "Models of the muscle: list, compare, audit, rotary."))
add_imports(_group("import", "Make a run or a data set from data measured elsewhere."))
add_calibration(_group("calibrate", "Calibrate an instrument."))
add_gap(
    _group(
        "gap",
        "Where simulation and measurement disagree, which effect causes it, what to measure next.",
    )
)
add_studies(_group("study", "Simulation studies."))
add_firmware(_group("firmware", "Install the firmware on a board, and check it."))
add_bench(app)
init_app = typer.Typer(
    cls=InitGroup,
    help="Write a rig file or a protocol file from questions.",
    context_settings=HELP,
)
add_init(init_app)
app.add_typer(init_app, name="init")
add_protocols(app, runs_app)
for command in (report, view, length, strain, pose, links, fit, simulate):
    app.command()(command)


@app.command("demo")
def demo_command(runs: OutOption = Path("out/demo")) -> None:
    """Run a test on the virtual bench, import a thesis table, report both."""
    from cli.demo import demo

    raise typer.Exit(demo(runs))


@functools.cache
def command_line() -> Any:
    """The whole command line. Once per process: the annotations of all options are read for it."""
    return typer.main.get_command(app)


def main() -> None:
    """Entry point of the console script: user errors become one line and exit status 2."""
    # How a sum is split among threads decides its last digit, and that which of two equals leads.
    # Read when numpy is loaded; the products of a diagnosis are too small to gain by threads.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    from cli.output import plain_output
    from daq.errors import PamrigError, printable
    from daq.interrupt import Stopped
    from plant.errors import PlantError

    with plain_output():
        try:
            command_line()(standalone_mode=True)
        except (PamrigError, PlantError) as error:
            typer.echo(printable(f"pamrig: {error}"), err=True)
            sys.exit(2)
        except Stopped as stopped:
            typer.echo(f"pamrig: {stopped}", err=True)
            sys.exit(130)
        except BrokenPipeError:
            sys.exit(1)


if __name__ == "__main__":
    main()
