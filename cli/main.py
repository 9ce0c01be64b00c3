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

USAGE_ERROR: type[Exception] = typer.BadParameter.__mro__[2]
"""Every error of a command line: the base of typer's, which exports only its leaves."""

NEAR = " (Possible options: "
"""How typer begins a list of similar options."""

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
            status = command_line()(prog_name="pamrig", standalone_mode=False)
        except USAGE_ERROR as error:
            sys.exit(_refuse(error))
        except typer.Abort:  # a question, and an input that ended
            typer.echo("pamrig: stopped", err=True)
            sys.exit(1)
        except (PamrigError, PlantError) as error:
            typer.echo(printable(f"pamrig: {error}"), err=True)
            sys.exit(2)
        except Stopped as stopped:
            typer.echo(f"pamrig: {stopped}", err=True)
            sys.exit(130)
        except BrokenPipeError:
            sys.exit(1)
    sys.exit(status if isinstance(status, int) else 0)


def _refuse(error: Any) -> int:
    """Say in one line what is wrong with a command line, and where its options are listed.

    A group without a command prints its help, as it would with --help.
    """
    context = getattr(error, "ctx", None)
    path = context.command_path if context is not None else "pamrig"
    if type(error).__name__ == "NoArgsIsHelpError":
        typer.echo(error.format_message(), err=True)
        return 2
    what = " ".join(error.format_message().split()).rstrip(".")
    if what.endswith(")") and NEAR in what:
        what = what[:-1].replace(NEAR, "; similar: ")
    what = what[:1].lower() + what[1:]
    where = path.removeprefix("pamrig").strip()
    line = f"pamrig: {where}{': ' if where else ''}{what} ({path} --help shows how it is used)"
    from daq.errors import printable

    typer.echo(printable(line), err=True)
    return 2


if __name__ == "__main__":
    main()
