"""Runs of the shipped rigs with the bench's true state beside every point of their tables."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from analysis.run_table import reduce_run
from daq.store.run import Run, open_run
from daq.store.verify import verify
from protocol_runs import force_n
from rigs.execution.runner import Runner
from rigs.execution.session import Result, run_protocol
from rigs.protocols.registry import procedure
from rigs.rigfile.config import RigConfig
from rigs.virtual.bench import VirtualBench

Begin = Callable[[Runner, VirtualBench], None]


@dataclass
class Truth:
    """The true state of a bench, sampled as the host's loop turns.

    Attributes:
        rows: (bench time in us, pressure in kPa, length in mm, pull in N).
    """

    bench: VirtualBench
    rows: list[tuple[float, ...]] = field(default_factory=list)

    def look(self) -> None:
        """Take the state of now."""
        plant, now_us = self.bench.plant, self.bench.board.bench_us
        if self.rows and self.rows[-1][0] == now_us:
            return
        pull = self.bench.extras.pull_n()
        self.rows.append((now_us, plant.pressure_kpa, plant.length_mm, pull))

    def between(self, samples: Any) -> np.ndarray:
        """Mean pressure, length and pull, and half of what they moved by, (2, 3)."""
        rows, at_us = np.array(self.rows), samples["device_us"]
        inside = rows[(rows[:, 0] >= at_us[0] - 2e4) & (rows[:, 0] <= at_us[-1] + 2e4), 1:]
        return np.array([inside.mean(axis=0), np.ptp(inside, axis=0) / 2])


def run_file(
    config: RigConfig, protocol: str, file: str, root: Path, begin: Begin | None = None
) -> tuple[Result, Run, Truth]:
    """Run a protocol file on the virtual clock and look at the truth all the time."""
    kept: list[Truth] = []

    def start(runner: Runner, record: object) -> None:
        del record
        assert runner.rig.bench is not None
        kept.append(Truth(runner.rig.bench))
        runner.rig.event_loop.add(kept[0].look)
        if begin is not None:
            begin(runner, runner.rig.bench)

    kind = procedure(protocol)
    result = run_protocol(kind, config, kind.read(file, config), root, on_start=start)
    return result, open_run(result.folder), kept[0]


def pulls(run: Run, between: Callable[[Any], np.ndarray]) -> dict[str, list[float]]:
    """(value - truth) / u of each value of the table, by quantity.

    Args:
        run: with a table of points.
        between: mean and half of the movement of (pressure, length, pull), (2, 3), from the
            samples of the controller of a point.
    """
    table = reduce_run(run).table
    events = [e for e in run.events if e["kind"] == "point"]
    assert len(events) == len(table)
    out: dict[str, list[float]] = {"pressure_kpa": [], "length_mm": [], "force_n": []}
    for row, event in zip(table.to_dict("records"), events, strict=True):
        true, moved = between(run.between("valve", "seq", *event["valve_seq"]))
        for k, name in enumerate(out):
            value, u = row.get(name), row.get(f"u_{name}")
            if value is None or u is None or math.isnan(value):
                continue
            # The table means other instants than the truth's: what moved meanwhile is no error.
            out[name].append((value - true[k]) / math.hypot(u, moved[k] / math.sqrt(3)))
    return out


def told(bench: list[dict[str, Any]]) -> Callable[[Any], np.ndarray]:
    """The truth of a bench in real time, as `pamrig virtual --truth` writes it."""
    rows = np.array(
        [[t["t_ns"], t["pressure_kpa"], t["length_mm"],
          force_n(t["pressure_kpa"], t["length_mm"])] for t in bench]
    )  # fmt: skip

    def between(samples: Any) -> np.ndarray:
        first, last = samples["host_ns"][0] - 2e7, samples["host_ns"][-1] + 2e7
        inside = rows[(rows[:, 0] >= first) & (rows[:, 0] <= last), 1:]
        return np.array([inside.mean(axis=0), np.ptp(inside, axis=0) / 2])

    return between


def sound(run: Run) -> dict[str, Any]:
    """What must hold of any record, however its run ended; its counters."""
    assert verify(run) == []
    assert run.problems == []
    assert run.final is not None
    if [e for e in run.events if e["kind"] == "armed"]:
        assert [e for e in run.events if e["kind"] == "vented"][-1]["confirmed"]
    counters: dict[str, Any] = run.final["counters"]
    return counters
