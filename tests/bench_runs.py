"""Isometric runs on virtual benches, with what only the simulation knows beside them."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

from analysis.reporting.derived import try_derive
from daq.store.run import Run, open_run
from rigs.execution.runner import Runner
from rigs.execution.session import Result, run_protocol
from rigs.protocols.isometric import Isometric, load_isometric
from rigs.protocols.registry import procedure
from rigs.rigfile.config import RigConfig, load_rig
from rigs.virtual.bench import VirtualBench


def quick(config: RigConfig, **changes: Any) -> Isometric:
    """A short isometric test of a rig: two lengths, four pressures, up and down."""
    base = load_isometric("isometric-short", config.limits)
    values: dict[str, Any] = {
        "lengths_mm": (57.0, 65.0),
        "pressures_kpa": (100.0, 250.0, 450.0, 600.0),
        "precondition_cycles": 0,
    }
    return dataclasses.replace(base, **{**values, **changes})


def run_isometric(
    config: RigConfig, plan: Isometric, root: Path, derive: bool = True, **how: Any
) -> Result:
    """Run an isometric test and, with ``derive``, make its table, report and view as a command."""
    result = run_protocol(procedure("isometric"), config, plan, root, **how)
    if derive:
        try_derive(result.folder, result.error)
    return result


def run_bench(
    root: Path, rig: str = "virtual", seed: int | None = None, derive: bool = False, **changes: Any
) -> tuple[Result, Run, VirtualBench]:
    """Run a short test on an in-process bench; the bench stays open to be asked for truths."""
    config = load_rig(rig, seed)
    kept: list[VirtualBench] = []

    def keep(runner: Runner, record: object) -> None:
        del record
        assert runner.rig.bench is not None
        kept.append(runner.rig.bench)

    result = run_isometric(config, quick(config, **changes), root, on_start=keep, derive=derive)
    return result, open_run(result.folder), kept[0]
