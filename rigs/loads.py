"""A mass that hangs on the muscle: how it gets there, and that it is lowered, never dropped."""

from __future__ import annotations

from typing import TYPE_CHECKING

from daq.errors import PamrigError

if TYPE_CHECKING:
    from rigs.runner import Runner

LOWER_KPA_S = 150.0
LOWER_STEP_S = 0.05


def lower_load(runner: Runner) -> None:
    """Let the pressure down slowly, so that the hung load sinks instead of falling.

    It is the safe state of a rig with a hung load as long as the controller obeys. Where it
    does not (fault, lost link), it has vented by itself, and the load falls as fast as the
    outlet's restrictor lets it: a catcher below the load is for that.
    """
    rig, valve = runner.rig, runner.rig.valve
    start = rig.pressure_kpa
    if not valve.armed or valve.fault_latched:
        runner.record.event("lowered", load_kg=runner.load_kg, done=False, from_kpa=start)
        runner.watch.log("the controller vented by itself: the load came down with it")
        return
    pressure = start
    try:
        while pressure > 0.0:
            pressure = max(0.0, pressure - LOWER_KPA_S * LOWER_STEP_S)
            valve.progress(1.0)
            valve.set_point(float(rig.config.calibrations["pressure_kpa"].raw(pressure)))
            rig.pump.for_seconds(LOWER_STEP_S)
    except PamrigError as error:
        runner.record.event("lowered", load_kg=runner.load_kg, done=False, reason=str(error))
        return
    runner.record.event("lowered", load_kg=runner.load_kg, done=True, from_kpa=start)
