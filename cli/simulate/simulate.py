"""`pamrig simulate`, `pamrig study`: the whole bench in simulation."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Optional

import typer

from cli.simulate.finger import add_finger_studies
from cli.simulate.studies import add_valve_studies

JsonOption = Annotated[bool, typer.Option("--json", help="Print one JSON value, nothing else.")]
RUNS = Path("runs")


def add_simulation(app: typer.Typer) -> None:
    """Add the commands that simulate to `app`."""
    app.command("simulate")(simulate)
    study_app = typer.Typer(help="Questions put to the simulation.", no_args_is_help=True)
    app.add_typer(study_app, name="study")
    add_finger_studies(study_app)
    add_valve_studies(study_app)


def simulate(
    scenario: Annotated[str, typer.Argument(help="Scenario file, or the name of a shipped one.")],
    out: Annotated[Path, typer.Option("--out", help="Folder of runs.")] = RUNS,
    seed: Annotated[
        Optional[int],  # noqa: UP045
        typer.Option(min=0, max=2**31 - 1, help="Another seed of the noise."),
    ] = None,
    plant: Annotated[
        Optional[Path],  # noqa: UP045
        typer.Option("--plant", help="Plant file in place of the scenario's own plant."),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Simulate the whole bench with the firmware in the loop; leaves a run like any other."""
    from studies.simulation.command import simulate_command

    raise typer.Exit(simulate_command(scenario, out, seed, as_json, plant))
