"""Before a test: is the muscle tight? Both valves shut, the pressure watched."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from rigs.steps.custom_step import CustomStep
from rigs.steps.steps import SetPressure, Settle, SettleCriterion, State, Vent

if TYPE_CHECKING:
    from rigs.steps.context import StepContext

REST_S = 0.3
"""After the valves have shut: what moves in this time is no leak."""
MEAN_SAMPLES = 200
LEAKS_OUT = "look for the leak (fittings, clamps, liner, valve seats)"
LEAKS_IN = "the inlet valve lets air in: clean or replace it"
CRITERION = SettleCriterion(0.5, 5.0, 1.0, None, 20.0)


@dataclass(frozen=True)
class LeakCheck(CustomStep):
    """Fill, shut both valves, and hold the loss of pressure against a limit.

    The gas has no time to cool on a bench whose valves are slow; where it does, the first
    moments (``REST_S``) are left out.
    """

    pressure_kpa: float
    hold_s: float
    limit_kpa_s: float
    seconds: ClassVar[float] = 8.0

    def perform(self, runner: StepContext) -> float:
        """The loss in kPa/s, positive where the pressure falls; also recorded.

        Raises:
            RunFault: the pressure fell, or rose, faster than the limit.
        """
        from rigs.steps.context import RunFault

        runner.do(State("leak check"))
        runner.do(SetPressure(self.pressure_kpa))
        runner.do(Settle(CRITERION, self.pressure_kpa))
        runner.shut()
        runner.rig.event_loop.for_seconds(REST_S)
        first = self._mean(runner)
        runner.rig.event_loop.for_seconds(self.hold_s)
        last = self._mean(runner)
        loss = (first - last) / (self.hold_s + MEAN_SAMPLES * 1e-3)
        tight = abs(loss) <= self.limit_kpa_s
        runner.record.event(
            "leak", pressure_kpa=first, loss_kpa_s=loss, limit_kpa_s=self.limit_kpa_s,
            hold_s=self.hold_s, tight=tight,
        )  # fmt: skip
        runner.do(Vent())
        what = (
            f"{first:.0f} kPa {'fell' if loss >= 0 else 'rose'} by {abs(loss):.3f} kPa/s with"
            f" both valves shut (limit {self.limit_kpa_s:g} kPa/s)"
        )
        if not tight:
            raise RunFault(
                "leak check",
                what,
                f"{LEAKS_OUT if loss > 0 else LEAKS_IN}; leak_check.limit_kpa_s",
            )
        runner.watch.log(f"leak check: {what}")
        return loss

    def _mean(self, runner: StepContext) -> float:
        seq, _ = runner.window(MEAN_SAMPLES * 1e-3)
        counts = runner.rig.valve.recent_counts(seq[1] - seq[0])
        return float(runner.rig.config.calibrations["pressure_kpa"].apply(np.mean(counts)))
