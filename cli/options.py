"""Options and arguments that several commands share."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from cli.completion import run_names, shipped
from daq.errors import ConfigError

RUNS = Path("runs")

DataArgument = Annotated[
    str,
    Argument(
        help="Folder in the dataset format, run folder, run id, or 'last'.",
        autocompletion=run_names,
    ),
]
RunArgument = Annotated[
    str, Argument(help="Run folder, run id, or 'last'.", autocompletion=run_names)
]

FigureOption = Annotated[Path | None, Option("--figure", help="Figure to write, .png or .svg.")]
JsonOption = Annotated[bool, Option("--json", help="Print one JSON value, nothing else.")]
NoCacheOption = Annotated[
    bool,
    Option("--no-cache", help="Compute the diagnosis again; neither read nor write the cache."),
]
NoteOption = Annotated[str, Option(help="A note for the record.")]
OperatorOption = Annotated[str, Option(help="Name of the operator.")]
OutFileOption = Annotated[Path | None, Option("--out", help="File to write.")]
PlantOption = Annotated[
    Path | None, Option("--plant", help="Constants of the bench, in the format of bench.toml.")
]
RegionOption = Annotated[str, Option(help="Only pressures LOW-HIGH in kPa.")]
RigOption = Annotated[
    str,
    Option("--rig", help="Rig file, or the name of a shipped one.", autocompletion=shipped("rigs")),
]
RunsOption = Annotated[Path, Option("--runs", help="Folder of runs.")]
OutOption = Annotated[Path, Option("--runs", "--out", help="Folder of runs.")]
SeedOption = Annotated[int | None, Option(help="Seed of a virtual bench.")]
SimulatorOption = Annotated[
    Path | None,
    Option(
        "--simulator",
        help="Your own simulator: its description. It may name a program, which is then run.",
    ),
]
WarmOption = Annotated[
    bool, Option("--warm", help="Also the warm columns of a thesis table, which are a formula.")
]
WithoutOption = Annotated[
    str, Option("--without", help="Effects to remove from the catalogue, separated by commas.")
]


def bounded(
    option: str, value: float, low: float, high: float, unit: str = "", *, above: bool = False
) -> None:
    """Refuse an option's number outside ``low`` to ``high``.

    Args:
        option: its name.
        value: what was given.
        low, high: the ends; both are allowed.
        unit: for the message.
        above: ``low`` itself is not allowed.

    Raises:
        ConfigError: names option, range and value.
    """
    if math.isfinite(value) and low <= value <= high and not (above and value == low):
        return
    unit = f" {unit}" if unit else ""
    wanted = f"above {low:g} up to {high:g}" if above else f"from {low:g} to {high:g}"
    raise ConfigError(option, f"expected a number {wanted}{unit}, got {value:g}")
