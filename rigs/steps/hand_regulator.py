"""A pressure that a person makes with a regulator, behind a valve that the controller keeps."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rigs.steps.context import StepContext


def turn_by_hand(runner: StepContext, pressure_kpa: float) -> None:
    """Have the regulator turned, where the rig has ``[manual.pressure]``; checked and recorded.

    The inlet stands open between regulator and muscle meanwhile, and is shut by the controller
    whenever the muscle is vented: nobody has to turn anything back for that.
    """
    if "pressure" not in runner.rig.config.instruments.manual:
        return
    axis = runner.axis("pressure", "kPa")
    if not axis.settings or axis.settings[-1].asked != pressure_kpa:
        axis.set(pressure_kpa)
