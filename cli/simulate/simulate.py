"""`pamrig simulate`, and `pamrig study schemes|ram|orifice|delay`."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import typer

from cli.options import RUNS, JsonOption, OutOption
from cli.simulate.finger import add_finger_studies

VALVE_STUDIES = {
    "schemes": "The results of section 5.8 on the four schemes, statement by statement.",
    "ram": "The results of section 5.9 on the pneumatic ram, and why its position was held.",
    "orifice": "Which orifice size and valve speed would have prevented the oscillation.",
    "delay": "Inertial and transport delay: whether the difference matters, and how to tell.",
}


def add_studies(app: typer.Typer) -> None:
    """Add the commands of `pamrig study`."""
    add_finger_studies(app)
    for name, summary in VALVE_STUDIES.items():
        app.command(name, help=summary)(_valve_study(name))


def _valve_study(name: str) -> Callable[..., None]:
    def command(
        full: Annotated[
            bool, typer.Option("--full", help="At the size of the docs; takes minutes.")
        ] = False,
        out: Annotated[
            Path | None, typer.Option("--out", help="Folder for figures; default: no figures.")
        ] = None,
        as_json: JsonOption = False,
    ) -> None:
        from studies.schemes.command import study_command

        raise typer.Exit(study_command(name, full, out, as_json))

    return command


def simulate(
    scenario: Annotated[str, typer.Argument(help="Scenario file, or the name of a shipped one.")],
    out: OutOption = RUNS,
    seed: Annotated[
        int | None, typer.Option(min=0, max=2**31 - 1, help="Another seed of the noise.")
    ] = None,
    plant: Annotated[
        Path | None, typer.Option("--plant", help="Plant file instead of the scenario's plant.")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Simulate the whole bench with the firmware in the loop; records a run like any other."""
    from studies.simulation.command import simulate_command

    raise typer.Exit(simulate_command(scenario, out, seed, as_json, plant))
