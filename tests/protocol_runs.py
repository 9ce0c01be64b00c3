"""Runs of any protocol on virtual benches, with what only the simulation knows beside them."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

from daq.store.run import Run, open_run
from rigs.execution.runner import Runner
from rigs.execution.session import Result, run_protocol
from rigs.protocols.names import default_rig
from rigs.protocols.registry import procedure
from rigs.rigfile.config import RigConfig, load_rig
from rigs.virtual.bench import VirtualBench

BRAID_MM = 88.4
TURNS = 1.855

Hook = Callable[[Runner], None]


def plan_of(
    name: str, config: RigConfig, method: dict[str, Any] | None = None, **changes: Any
) -> Any:
    """The short test of a protocol, with some of it changed."""
    plan = procedure(name).read(f"{name}-short", config)
    if method:
        for key in ("method", "held", "hung"):
            if hasattr(plan, key):
                changes[key] = dataclasses.replace(getattr(plan, key), **method)
    return dataclasses.replace(plan, **changes)


def run_short(
    name: str,
    root: Path,
    rig: str = "",
    seed: int | None = None,
    config: RigConfig | None = None,
    method: dict[str, Any] | None = None,
    begin: Hook | None = None,
    how: dict[str, Any] | None = None,
    **changes: Any,
) -> tuple[Result, Run, VirtualBench]:
    """Run a short test on an in-process bench; the bench stays to be asked for truths."""
    config = config or load_rig(rig or default_rig(name), seed)
    kept: list[VirtualBench] = []

    def keep(runner: Runner, record: object) -> None:
        del record
        assert runner.rig.bench is not None
        kept.append(runner.rig.bench)
        if begin is not None:
            begin(runner)

    plan = plan_of(name, config, method, **changes)
    result = run_protocol(procedure(name), config, plan, root, on_start=keep, **(how or {}))
    return result, open_run(result.folder), kept[0]


def with_virtual(config: RigConfig, **changes: Any) -> RigConfig:
    """A rig whose virtual bench differs."""
    assert config.virtual is not None
    return dataclasses.replace(config, virtual=dataclasses.replace(config.virtual, **changes))


def events(run: Run, kind: str) -> list[dict[str, Any]]:
    """All events of a kind."""
    return [event for event in run.events if event["kind"] == kind]


def force_n(pressure_kpa: float, length_mm: float) -> float:
    """Equation 4-7 in kPa, mm and N: F = p (3 L^2 - b^2) / (4 pi n^2)."""
    area_mm2 = (3 * length_mm**2 - BRAID_MM**2) / (4 * math.pi * TURNS**2)
    return pressure_kpa * 1e-3 * area_mm2


def hung_length_mm(pressure_kpa: float, weight_n: float) -> float:
    """Equation 4-7 the other way round: where a hung load is at rest."""
    area = weight_n * 4 * math.pi * TURNS**2 / (pressure_kpa * 1e-3)
    return math.sqrt((area + BRAID_MM**2) / 3)
