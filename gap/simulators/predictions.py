"""A simulator that ran elsewhere: its predictions in a table beside the measured channels.

The table has the columns of `samples.csv`: trial, time_s, and pressure_kpa or force_n as they were
predicted. A parameter may be given by further tables, predicted with the parameter higher and
lower by one tolerance; in between a parabola goes through the three, or a line through two.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gap.data.simulator import Stage
from gap.data.tables import numbers, read_table, unit_check
from gap.data.trial import CHANNELS, COMMANDS, Trial
from gap.errors import GapError
from gap.simulators.description import Description
from gap.simulators.external import External
from plant.arrays import Array
from plant.constants import nominal

_SLACK_S = 1e-6
_SLACK_STEPS = 1.5
"""A table with steps of its own need not end on the last measured sample."""


class Predictions(External):
    """Predictions by trial and time."""

    def __init__(self, about: Description) -> None:
        super().__init__(about)
        self._middle = _Table.read(about, about.text("table"), "table")
        self._moved: dict[str, tuple[_Table | None, _Table | None]] = {}
        stated = about.inner("parameters")
        for parameter in self._parameters:
            pair = []
            for key in ("table_high", "table_low"):
                name = stated[parameter.name].get(key)
                shown = f"parameters.{parameter.name}.{key}"
                if name is not None and not isinstance(name, str):
                    raise about.error(shown, f"expected the name of a table, got {name!r}")
                pair.append(_Table.read(about, name, shown) if name else None)
            if pair == [None, None]:
                raise about.error(
                    f"parameters.{parameter.name}", "has neither table_high nor table_low",
                    "a table of predictions cannot be changed otherwise",
                )  # fmt: skip
            if parameter.tolerance == 0.0:
                raise about.error(
                    f"parameters.{parameter.name}.tolerance",
                    "is 0, and its tables are predicted one tolerance away",
                )
            self._moved[parameter.name] = (pair[0], pair[1])

    def _stage(
        self, trial: Trial, stage: Stage, wanted: Array, values: Mapping[str, float]
    ) -> Array | None:
        middle = self._middle.at(trial, stage, wanted)
        made = middle.copy()
        for parameter in self._parameters:
            x = (values[parameter.name] - parameter.nominal) / parameter.tolerance
            if x == 0.0:
                continue
            high, low = (
                table.at(trial, stage, wanted) - middle if table is not None else None
                for table in self._moved[parameter.name]
            )
            if high is not None and low is not None:
                made += x * (high - low) / 2.0 + x * x * (high + low) / 2.0
            elif high is not None:
                made += x * high
            elif low is not None:
                made -= x * low
        return made


@dataclass(frozen=True)
class _Table:
    """One table: predicted values by trial, time (None if there is none) and output."""

    path: Path
    rows: Mapping[str, np.ndarray]
    time_s: Array | None
    columns: Mapping[str, Array]

    @classmethod
    def read(cls, about: Description, name: str, key: str) -> _Table:
        path = about.file(name)
        if not path.is_file():
            raise about.error(key, f"no such file {name}", "it is relative to this file")
        table = read_table(path, ("trial", *(stage.output for stage in about.stages)), ("trial",))
        unit_check(table, ("trial", "time_s", "direction", *CHANNELS, *COMMANDS))
        constants = nominal()
        owner = table.frame["trial"]
        return cls(
            path,
            {str(k): np.sort(rows) for k, rows in owner.groupby(owner, sort=False).indices.items()},
            numbers(table, "time_s", constants) if "time_s" in table.frame else None,
            {s.output: numbers(table, s.output, constants) for s in about.stages},
        )

    def at(self, trial: Trial, stage: Stage, wanted: Array) -> Array:
        """Predicted output at `wanted`; for settled points `wanted` counts the rows."""
        rows = self.rows.get(trial.name)
        if rows is None:
            raise self._error(trial, "has no predictions")
        value = self.columns[stage.output][rows]
        if trial.settled:
            at = np.round(wanted).astype(np.int64)
            if at.max(initial=-1) >= len(value):
                raise self._error(
                    trial, f"has {len(value)} predicted rows, measured are {int(at.max()) + 1}"
                )
            made = value[at]
        else:
            made = self._between(trial, stage, rows, value, wanted)
        bad = np.flatnonzero(~np.isfinite(made))
        if len(bad):
            raise self._error(trial, f"{stage.output} is empty at {wanted[bad[0]]:g}")
        return np.asarray(made)

    def _between(
        self, trial: Trial, stage: Stage, rows: np.ndarray, value: Array, wanted: Array
    ) -> Array:
        if self.time_s is None:
            raise self._error(trial, "the table has no column time_s, the measured trial has time")
        here = np.isfinite(value)
        time_s, value = self.time_s[rows][here], value[here]
        if not len(time_s):
            raise self._error(trial, f"{stage.output} is empty")
        if not np.all(np.diff(time_s) > 0.0):
            raise self._error(trial, "time_s does not ascend")
        step = float(np.median(np.diff(time_s))) if len(time_s) > 1 else 0.0
        slack = _SLACK_S + _SLACK_STEPS * step
        if wanted[0] < time_s[0] - slack or wanted[-1] > time_s[-1] + slack:
            raise self._error(
                trial, f"is predicted from {time_s[0]:g} to {time_s[-1]:g} s, measured from "
                f"{wanted[0]:g} to {wanted[-1]:g} s",
            )  # fmt: skip
        return np.interp(wanted, time_s, value)

    def _error(self, trial: Trial, what: str) -> GapError:
        return GapError(f"{self.path}, trial {trial.name}", what)
