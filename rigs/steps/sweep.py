"""The stage goes through a stretch and back at a set speed while the camera looks on."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from daq.clock import NS_PER_S
from daq.errors import DeviceError
from rigs.devices.motion.stage import MotorStage
from rigs.rigfile.toml_reader import Table
from rigs.steps.custom_step import CustomStep
from rigs.steps.steps import SetLength

if TYPE_CHECKING:
    from rigs.rigfile.config import RigConfig
    from rigs.steps.context import StepContext

PICTURES_HZ = (10.0, 25.0)
PICTURES_MM = 1.0 / 3.0
"""Pictures come every third of a millimetre, within these rates."""
REST_S = 0.3
"""At each end, so that what needs time shows beside what needs movement."""


@dataclass(frozen=True)
class Sweep(CustomStep):
    """There and back between two lengths at one speed, with pictures all the way."""

    from_mm: float
    to_mm: float
    speed_mm_s: float
    points: ClassVar[int] = 0

    @property
    def seconds(self) -> float:  # type: ignore[override]
        """About how long it takes."""
        return 2.0 * abs(self.to_mm - self.from_mm) / self.speed_mm_s + 4.0 * REST_S

    def perform(self, runner: StepContext) -> None:
        """Begin at the first length, go to the other, and come back.

        Raises:
            DeviceError: the stage is moved by hand, or did not arrive.
        """
        from rigs.steps.pictures import take_picture

        stage = runner.rig.stage
        if not isinstance(stage, MotorStage):
            raise DeviceError("stage", "is moved by hand; a sweep needs one with a motor")
        clock = runner.rig.clock
        rate_hz = min(max(self.speed_mm_s / PICTURES_MM, PICTURES_HZ[0]), PICTURES_HZ[1])
        due_ns = [clock.now_ns()]

        def look() -> None:
            if clock.now_ns() >= due_ns[0]:
                due_ns[0] = clock.now_ns() + round(NS_PER_S / rate_hz)
                picture = take_picture(runner.rig, runner.record, runner.camera)
                runner.watch.picture(picture.host_ns, picture.jpeg, picture.gap)

        def rest() -> bool:
            look()
            return False

        runner.do(SetLength(self.from_mm))
        for goal in (self.to_mm, self.from_mm):
            runner.rig.event_loop.until(rest, REST_S)
            runner.record.event(
                "command", device="stage", length_mm=goal, speed_mm_s=self.speed_mm_s
            )
            runner.watch.set_point("length", goal)
            stage.move(goal, speed_mm_s=self.speed_mm_s, meanwhile=look)
        runner.rig.event_loop.until(rest, REST_S)


@dataclass(frozen=True)
class Sweeps:
    """Sweeps of a trial: between two lengths, at each of some speeds."""

    from_mm: float
    to_mm: float
    speeds_mm_s: tuple[float, ...]

    def steps(self) -> list[Sweep]:
        """One sweep a speed."""
        return [Sweep(self.from_mm, self.to_mm, speed) for speed in self.speeds_mm_s]

    def as_dict(self) -> dict[str, object]:
        """Plain values for run.json."""
        return {**vars(self), "speeds_mm_s": list(self.speeds_mm_s)}


def read_sweeps(root: Table, config: RigConfig) -> Sweeps | None:
    """The table [sweeps] of a protocol file; None where there is none.

    Raises:
        ConfigError: unknown key, a value beyond the rig's limit, or a stage without a motor.
    """
    if "sweeps" not in root:
        return None
    t = root.table("sweeps")
    low, high = config.limits.length_min_mm, config.limits.length_max_mm
    if config.stage.kind == "manual":
        raise root.fail(
            "sweeps",
            f"need a stage with a motor, and that of {config.source} is moved by hand",
            "leave the table out",
        )
    out = Sweeps(
        t.number("from_mm", low, high, unit="mm"),
        t.number("to_mm", low, high, unit="mm"),
        t.numbers("speeds_mm_s", 0.05, config.stage.speed_mm_s, unit="mm/s"),
    )
    if abs(out.to_mm - out.from_mm) < 0.1:
        raise t.fail("to_mm", "is where from_mm is")
    t.finish()
    return out
