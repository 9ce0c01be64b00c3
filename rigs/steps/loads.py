"""A mass that hangs on the muscle: how it gets there, and that it is lowered, never dropped."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from daq.errors import DeviceError, PamrigError
from rigs.devices.operator import Request, request_done
from rigs.steps.custom_step import CustomStep
from rigs.steps.steps import Vent

if TYPE_CHECKING:
    from rigs.steps.context import StepContext

LENGTH_READINGS = 5
LOWER_STEP_S = 0.05
LOWEST_KPA = 5.0
"""From here on it vents: no valve holds less."""
RATED_KPA = 300.0
SLOWEST_KPA_S = 30.0
MOST_CATCH = 2.0
"""A catch may be so many times further below the load than requested; who sets another distance
types it."""


@dataclass(frozen=True)
class HangLoad(CustomStep):
    """Have a mass hung on the vented muscle (0: have it taken off); answers what hangs, in kg.

    Who checks it: the rig's axis ``[manual.mass]`` with its sensor where there is one, else
    the person, who may type another mass than was asked for.
    """

    mass_kg: float
    seconds: ClassVar[float] = 6.0

    def perform(self, runner: StepContext) -> float:
        """Ask, wait, record.

        Raises:
            DeviceError: the weight is above the rig's limit of force, or stretches the muscle
                beyond its limit of length.
        """
        config = runner.rig.config
        weight_n = self.mass_kg * config.conditions.gravity_m_s2
        if weight_n > config.limits.force_n:
            raise DeviceError(
                config.source,
                f"{self.mass_kg:g} kg pulls with {weight_n:.1f} N, above limits.force_n ="
                f" {config.limits.force_n:g} N",
                "take a lighter mass",
            )
        LowerLoad().perform(runner)
        if self.mass_kg == self.asked_of(runner):
            return runner.load_kg
        setting = runner.axis("mass", "kg").set(self.mass_kg)
        runner.load_kg = setting.taken
        checked = {} if setting.checked_by == "operator" else {"checked_kg": setting.read}
        runner.record.event(
            "load", asked_kg=self.mass_kg, mass_kg=setting.taken, checked_by=setting.checked_by,
            **checked,
        )  # fmt: skip
        if self.mass_kg:
            check_stretch(runner)
        catch_mm = config.instruments.load.catch_mm
        if self.mass_kg and catch_mm:
            text = f"set the catch {catch_mm:g} mm below the load, then press Enter"
            request = Request("catch", catch_mm, "mm", text)
            rig = runner.rig
            below_mm, seconds = request_done(
                rig.operator, rig.event_loop, request, 0.0, MOST_CATCH * catch_mm
            )
            runner.record.event("catch", below_mm=below_mm, waited_s=seconds)
        return setting.taken

    @staticmethod
    def asked_of(runner: StepContext) -> float:
        """The mass that was asked for last: what hangs may have been read a little differently."""
        settings = runner.rig.axes["mass"].settings if "mass" in runner.rig.axes else []
        return settings[-1].asked if settings else 0.0


def check_stretch(runner: StepContext) -> None:
    """See that the hung load has not stretched the vented muscle, which is at its longest now.

    Where no mark is seen nothing is known; the test itself reports that with its first point.

    Raises:
        DeviceError: the muscle is longer than ``limits.length_max_mm`` and ``load.stretch`` allow.
    """
    config = runner.rig.config
    limit_mm, stretch = config.limits.length_max_mm, config.instruments.load.stretch
    length_mm = _hung_length_mm(runner)
    if length_mm > limit_mm * (1.0 + stretch):
        raise DeviceError(
            config.source,
            f"the vented muscle is {length_mm:.1f} mm long under {runner.load_kg:g} kg: above"
            f" limits.length_max_mm = {limit_mm:g} by more than load.stretch = {stretch:g}"
            f" ({limit_mm * (1.0 + stretch):.1f} mm)",
            "take the load off; hang a lighter one, or correct the limit",
        )


def _hung_length_mm(runner: StepContext) -> float:
    """The length by the instrument or a picture; NaN where neither reads it."""
    from rigs.steps.pictures import take_picture

    rig = runner.rig
    if rig.length_reader is not None:
        return float(rig.length_reader.next_mean(LENGTH_READINGS))
    if not rig.config.camera.source:
        return math.nan
    picture = take_picture(rig, runner.record, runner.camera)
    runner.watch.picture(picture.host_ns, picture.jpeg, picture.gap)
    gap = picture.gap
    calibration = rig.config.calibrations["length_mm"]
    return float(calibration.apply(gap.pixels)) if gap.trusted else math.nan


@dataclass(frozen=True)
class LowerLoad(CustomStep):
    """Let the pressure down slowly, so that a hung load sinks instead of falling; then vent."""

    seconds: ClassVar[float] = 4.0

    def perform(self, runner: StepContext) -> None:
        """Ramp down and vent; only vent where nothing hangs."""
        if runner.load_kg and not runner.vented:
            ramp_down(runner)
        runner.do(Vent())


def ramp_down(runner: StepContext) -> float:
    """Lead the set-point from the pressure of now to none; returns where it began, in kPa.

    The lower the pressure, the further a load sinks for each kPa: the rate, the rig's at 300 kPa,
    falls with the pressure.
    """
    rig = runner.rig
    source = rig.pressure_source
    rate = rig.config.instruments.load.lower_kpa_s
    start = pressure = source.measured_kpa
    while pressure > LOWEST_KPA:
        now = max(rate * min(pressure / RATED_KPA, 2.0), SLOWEST_KPA_S)
        pressure = max(0.0, pressure - now * LOWER_STEP_S)
        source.keep_alive(1.0)
        source.ramp_to(pressure)
        rig.event_loop.for_seconds(LOWER_STEP_S)
    return start


def lower_load(runner: StepContext) -> None:
    """The safe state of a rig with a hung load, as long as the controller obeys: lowered.

    Where it does not (fault, lost link, killed program) the controller vents by itself, and the
    load comes down as fast as the outlet's restrictor lets it: the catch below the load is
    for that.
    """
    valve = runner.rig.valve
    if not runner.rig.pressure_source.armed or valve.fault_latched:
        _not_lowered(runner, "vented already")
        return
    try:
        start = 0.0 if runner.vented else ramp_down(runner)
    except PamrigError as error:
        _not_lowered(runner, str(error))
        return
    runner.record.event("lowered", load_kg=runner.load_kg, done=True, from_kpa=start)


def _not_lowered(runner: StepContext, reason: str) -> None:
    """The load came down by itself: onto its catch, where there is one."""
    catch_mm = runner.rig.config.instruments.load.catch_mm
    runner.record.event(
        "lowered", load_kg=runner.load_kg, done=False, reason=reason,
        catch_mm=catch_mm or None,
    )  # fmt: skip
    runner.watch.log(
        "the muscle was vented without lowering the load: "
        + (f"see that the catch, {catch_mm:g} mm below, holds it" if catch_mm else
           "it came down as fast as the outlet let it; no catch is named ([load] catch_mm)")
    )  # fmt: skip
