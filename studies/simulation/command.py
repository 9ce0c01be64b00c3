"""The command `pamrig simulate`."""

from __future__ import annotations

import dataclasses
import json
import sys
from pathlib import Path

import typer

STATUS = {"clean": 0, "stopped": 130}


def simulate_command(
    name: str, out: Path, seed: int | None, as_json: bool, plant: Path | None = None
) -> int:
    """Read and simulate a scenario, record it and print the result; returns the exit status."""
    from analysis.reporting.derived import try_derive
    from daq.interrupt import stop_on_signals
    from studies.first_use import ProgressLine, compilation_message

    with compilation_message(quiet=as_json):
        from studies.simulation.scenario import load_scenario
        from studies.simulation.session import simulate

    scenario = load_scenario(name, plant)
    if seed is not None:
        scenario = dataclasses.replace(scenario, seed=seed)
    line = ProgressLine(quiet=as_json or not sys.stderr.isatty())

    def progress(now_s: float, total_s: float) -> None:
        line.show(f"simulating  {now_s:.1f} of {total_s:g} s")

    with stop_on_signals() as stop:
        result = simulate(scenario, out, stop=stop, progress=progress)
    line.close()
    not_derived = try_derive(result.folder)
    if as_json:
        from analysis.reporting.report import report_json
        from daq.store.run import open_run

        typer.echo(json.dumps(report_json(open_run(result.folder)), indent=2, allow_nan=False))
        return STATUS.get(result.outcome, 2)
    speed = result.simulated_s / max(result.took_s, 1e-9)
    typer.echo(
        f"{result.outcome}: {result.simulated_s:g} of {scenario.duration_s:g} s simulated, "
        f"{speed:.0f} times real time, in {result.folder}"
    )
    if result.reason:
        typer.echo(f"  reason: {result.reason}")
    if not_derived:
        typer.echo(f"  table and report could not be made: {not_derived}")
    else:
        typer.echo(f"  report: {result.folder / 'derived' / 'report.html'}")
    return STATUS.get(result.outcome, 2)
