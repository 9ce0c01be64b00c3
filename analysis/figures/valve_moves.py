"""Pressure against time in the step and ram tests, with the set-points."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from analysis.figures.drawing import MEASURED, SET
from analysis.figures.timeline import min_max
from analysis.reduction.valve import Samples, ValveRecord

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes

    from daq.store.run import Run


class ValveMoves:
    """The windows of a test of steps or moves, and its first replicate.

    Attributes:
        first: rows of the first replicate.
        windows: (first, end) sequence numbers of each point, by order.
    """

    def __init__(self, run: Run, table: pd.DataFrame) -> None:
        self.record = ValveRecord(run, "switching-time")
        self.first = table[table["repeat"] == table["repeat"].min()] if len(table) else table
        self.windows = {int(e["order"]): e["valve_seq"] for e in self.record.events}

    def draw_pressure(
        self, axes: Axes, rows: pd.DataFrame
    ) -> tuple[Samples, Any, list[tuple[float, float]]]:
        """Draw measured pressure and set-points of consecutive points.

        Returns:
            The samples and their times in s, and begin and end of each point in s.
        """
        orders = [int(order) for order in rows["order"]]
        start = self.windows[orders[0]][0]
        samples = self.record.samples([start, self.windows[orders[-1]][1]])
        seconds = np.empty(0)
        if len(samples.get("counts", ())):
            seconds = (samples["seq"].astype(np.float64) - start) * 1e-3
            kpa = self.record.kpa(samples["counts"])
            axes.plot(*min_max(seconds, kpa), color=MEASURED, linewidth=0.8)
        spans = [
            ((a - start) * 1e-3, (b - start) * 1e-3)
            for a, b in map(self.windows.__getitem__, orders)
        ]
        times = np.ravel(spans)
        goals = np.repeat(rows["set_pressure_kpa"].to_numpy(dtype=np.float64), 2)
        axes.plot(times, goals, color=SET, linewidth=1.1, linestyle=(0, (4, 2)))
        return samples, seconds, spans
