"""Taking the muscle off and putting it back, between replicates."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from rigs.devices.operator import Request, put_request
from rigs.steps.custom_step import CustomStep
from rigs.steps.steps import State, Vent

if TYPE_CHECKING:
    from rigs.steps.context import StepContext


@dataclass(frozen=True)
class Remount(CustomStep):
    """Have the muscle taken off and mounted anew, vented; timed and recorded."""

    mounting: str
    seconds: ClassVar[float] = 60.0

    def perform(self, runner: StepContext) -> None:
        """Ask and wait."""
        runner.do(Vent())
        runner.do(State(f"mounting {self.mounting}"))
        text = (
            f"remove the muscle and mount it again (mounting {self.mounting}), then press Enter"
            " (or type a remark)"
        )
        request = Request("mounting", 0.0, "", text)
        answer, seconds = put_request(runner.rig.operator, runner.rig.event_loop, request)
        runner.record.event("mounted", mounting=self.mounting, waited_s=seconds, remark=answer)
