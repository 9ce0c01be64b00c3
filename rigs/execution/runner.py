"""Carries a protocol's steps out on a rig, and ends the run the same way whatever happens.

One loop does everything: it lets time pass, reads every device, beats the heart and checks
for faults. A protocol that hangs therefore stops the heartbeat by itself, and the firmware
vents; so does a record that can no longer be written.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from daq.clock import NS_PER_S
from daq.errors import DeviceError, LinkLost, PamrigError, RecordError
from daq.interrupt import StopFlag
from daq.link.causes import CAUSES, cause_of
from daq.record.writer import RecordWriter
from rigs.bench.both import Side
from rigs.bench.computer import REMEDY, Computer, raised_priority
from rigs.bench.ports import most_kg
from rigs.bench.pressure import SAFE_KPA
from rigs.bench.rig import Rig
from rigs.devices.instruments.balance import Balance, NoBalance
from rigs.devices.instruments.load_cell import LoadCell
from rigs.devices.interfaces import Actuator
from rigs.devices.operator import ManualAxis, ManualSetting
from rigs.devices.valve_controller import ALIVE_S, ValveController
from rigs.execution.control import RunControl
from rigs.execution.joint_watch import JointWatch
from rigs.execution.length_sensor import LengthSensor
from rigs.execution.pressure_sensor import PressureSensor
from rigs.execution.recording import temperature
from rigs.execution.settling import SAMPLE_S, has_settled, still_settled
from rigs.execution.steering import Steering
from rigs.steps.context import RunFault
from rigs.steps.custom_step import Answer, CustomStep, Step, Steps
from rigs.steps.loads import lower_load
from rigs.steps.schedule import cost_s
from rigs.steps.steps import (
    Dwell,
    EndTrial,
    Measure,
    SetLength,
    SetPressure,
    Settle,
    State,
    Tare,
    Trial,
    Vent,
    Zero,
)
from rigs.steps.watching import Progress as Progress
from rigs.steps.watching import Watch as Watch

Rows = dict[str, list[int]]
BALANCE_SILENCE_S = 2.0
TELEMETRY_SILENCE_S = 0.5
BLIND_S = 3.0
"""So long a computer may keep a run from reading its ports; the firmware keeps the muscle safe."""


@dataclass
class _Controller:
    """A controller as the run has seen it: restarts before arming; newest sample, and when."""

    side: Side
    reboots: int = 0
    last_seq: tuple[int, int] = (0, 0)


class Runner:
    """Runs one protocol on one rig into one record.

    Args:
        rig: open instruments.
        record: where everything goes.
        stop: set by Ctrl-C and its kin; looked at in every round.
        watch: hooks of the live view and the progress line.
        camera: how pictures are measured, as run.json says it.
        control: where pause, resume, skip, repeat and markers come from.

    Attributes:
        load_kg: mass that hangs on the muscle now; it is lowered before the muscle vents.
        computer: how late the computer lets the program be.
        sensor: whose reading is the pressure.
        joint: looks after angle and torque, on a rig with a joint.
        length: whose reading is the length.
    """

    def __init__(
        self,
        rig: Rig,
        record: RecordWriter,
        stop: StopFlag,
        watch: Watch,
        camera: Mapping[str, Any],
        control: RunControl | None = None,
    ) -> None:
        self.rig = rig
        self.camera = camera
        self.record = record
        self.stop = stop
        self.watch = watch
        self.progress = Progress(0)
        self.steering = Steering(self, control or RunControl())
        self.load_kg = 0.0
        self.computer = Computer(rig.event_loop, rig.config)
        self.sensor = PressureSensor(rig)
        self.joint = JointWatch(rig)
        self.length = LengthSensor(rig)
        self._armed = False
        self._controllers = [_Controller(side) for side in rig.sides]
        self._balance_speaks = not isinstance(rig.balance, NoBalance)
        self._round_ns = self._last_round_ns = rig.clock.now_ns()
        self._last_row = (0, 0)

    # ---- one round ------------------------------------------------------------------

    def _alive(self) -> None:
        """Report progress, then look for every reason to end the run."""
        for controller in self._controllers:
            controller.side.source.keep_alive(ALIVE_S)
        if self.record.failed is not None:
            raise self.record.failed
        self.steering.look()
        self.stop.check()
        self.computer.look()
        self._last_round_ns, self._round_ns = self._round_ns, self.rig.clock.now_ns()
        now_ns = self.rig.clock.now_ns()
        for controller in self._controllers:
            valve = controller.side.valve
            if self._armed:
                self._check_armed(controller)
            controller.last_seq = self._silent(valve, valve.seq_end, controller.last_seq, now_ns)
        if self._armed:
            self.sensor.look(self.computer.blind_s > 0.0)
            self.joint.look(self.computer.blind_s > 0.0)
            self.length.look(self.computer.blind_s > 0.0)
        if self._balance_speaks:
            balance = self.rig.balance
            self._last_row = self._silent(balance, balance.rows, self._last_row, now_ns)

    def _check_armed(self, controller: _Controller) -> None:
        """Look for what an armed controller must not do."""
        side, valve = controller.side, controller.side.valve
        if valve.faults or valve.fault_latched:
            raise self._fault(valve)
        if valve.telemetry.reboots > controller.reboots:
            raise RunFault(
                valve.name,
                "restarted during the run (new boot id)",
                "check its power supply; the run up to here is kept",
            )
        if valve.other_set_point is not None:
            apply = side.config.calibrations["pressure_kpa"].apply
            got, sent = (float(apply(counts)) for counts in valve.other_set_point)
            raise RunFault(
                valve.name,
                f"its set-point reads back as {got:.1f} kPa, {sent:.1f} kPa was sent",
                "another program or person commands the controller: end that first",
            )
        if not side.source.armed:
            raise RunFault(valve.name, "disarmed itself", "see its fault list")

    def _fault(self, valve: ValveController) -> RunFault:
        """The fault that a controller reported; with a busy computer where that explains it."""
        words = valve.faults[-1] if valve.faults else "fault latched (telemetry flag)"
        busy = self.computer.busy() if "host_silent" in words else ""
        if busy:
            return RunFault(valve.name, f"reported {words!r}; {busy}", REMEDY)
        cause = cause_of(words)
        what, remedy = CAUSES.get(cause, ("", "find the cause, then `pamrig doctor`"))
        return RunFault(
            valve.name,
            f"reported the fault {cause}: {what}" if cause else f"reported {words!r}",
            f"{remedy}; the fault is cleared by the next run",
        )

    def _silent(
        self,
        device: ValveController | Balance | LoadCell | NoBalance,
        count: int,
        last: tuple[int, int],
        now_ns: int,
    ) -> tuple[int, int]:
        if count != last[0] or last[1] == 0:
            return count, now_ns
        if 0.0 < self.computer.blind_s < BLIND_S:  # not the device's silence
            return count, last[1] + now_ns - self._last_round_ns
        telemetry = isinstance(device, ValveController)
        limit = TELEMETRY_SILENCE_S if telemetry else BALANCE_SILENCE_S
        if now_ns - last[1] > limit * NS_PER_S:
            what = "telemetry" if telemetry else "balance readings"
            detail = "" if isinstance(device, ValveController) else device.last_problem
            busy = self.computer.busy()
            raise RunFault(
                device.name,
                f"no {what} for {limit:g} s"
                + (f" (last: {detail})" if detail else "")
                + (f"; {busy}" if busy else ""),
                REMEDY if busy else "check its cable and power",
            )
        return last

    # ---- the run --------------------------------------------------------------------

    def arm(self) -> None:
        """Start the heartbeat, wait for telemetry, clear an old fault and arm."""
        sides = self.rig.sides
        balance = self.rig.balance
        self.rig.event_loop.until(
            lambda: (
                all(side.valve.seq_end > 0 for side in sides)
                and (balance.rows > 0 or isinstance(balance, NoBalance))
            ),
            3.0,
        )
        for controller in self._controllers:  # all are ready before the first is armed
            valve = controller.side.valve
            if not valve.seq_end:
                raise DeviceError(valve.name, "sends no telemetry", "check firmware and baud rate")
            if valve.fault_latched:
                valve.request("clear")
                valve.faults.clear()
            controller.reboots = valve.telemetry.reboots
        for side in sides:
            side.source.arm()
            if not self.rig.event_loop.until(lambda side=side: side.source.armed, 2.0):  # type: ignore[misc]
                if side.valve.faults:
                    raise self._fault(side.valve)
                raise DeviceError(side.valve.name, "took `arm` but the telemetry does not show it")
        self.joint.begin()
        self._armed = True
        for side in sides:
            which = {} if side.name == "valve" else {"device": side.name}
            self.record.event("armed", **which, identity=side.valve.identity)

    def disarm(self) -> float:
        """Vent, disarm and confirm it; the pressure afterwards in kPa. :meth:`arm` may follow."""
        self._armed = False
        if self.load_kg:
            lower_load(self)
        pressure = self.rig.vent()
        self.record.event("disarmed", pressure_kpa=pressure, confirmed=bool(pressure < SAFE_KPA))
        return pressure

    @property
    def armed(self) -> bool:
        """Whether this test has armed the bench."""
        return self._armed

    def run(self, steps: Steps, points: int, arm: bool = True) -> None:
        """Carry out every step. Ends the run venting, whatever is raised.

        Args:
            steps: the method.
            points: how many points it makes.
            arm: arm before the first step; otherwise a step does.
        """
        with contextlib.ExitStack() as stack:
            if not self.rig.clock.virtual:
                self.computer.granted = stack.enter_context(raised_priority())
                self.computer.begin()
            self._run(steps, points, arm)

    def _run(self, steps: Steps, points: int, arm: bool) -> None:
        self.progress.points = points
        answer: Answer = None
        event_loop = self.rig.event_loop
        event_loop.add(self._alive)  # in every round, also while a driver waits for a reply
        try:
            if arm:
                self.arm()
            while True:
                try:
                    step = steps.send(answer)
                except StopIteration:
                    break
                self.steering.hold()
                if isinstance(step, Measure) or (isinstance(step, CustomStep) and step.points):
                    answer = self.steering.point(step)
                else:
                    self.steering.note(step)
                    answer = self.do(step)
                self.progress.spent_s += cost_s(step, self.rig.config.stage.speed_mm_s)
        finally:
            event_loop.remove(self._alive)
            steps.close()
            self._safe()

    def _safe(self) -> None:
        """Vent and confirm; a link that is gone leaves it to the firmware's deadline."""
        self._armed = False
        try:
            if self.load_kg:
                lower_load(self)
            for side in self.rig.sides:
                side.source.release()
            pressure = self.rig.vent()
            for side in self.rig.sides:
                refused = side.valve.foreign_commands()
                if refused:
                    self.record.event("foreign_commands", device=side.name, refused=refused)
            self.record.event("vented", pressure_kpa=pressure, confirmed=bool(pressure < SAFE_KPA))
            if not pressure < SAFE_KPA:
                self.watch.log(f"WARNING: pressure still reads {pressure:.0f} kPa after venting")
        except PamrigError as error:
            self.record.event("vent_unconfirmed", reason=str(error))
            self.watch.log(f"venting could not be confirmed: {error}")

    def do(self, step: Step) -> Answer:
        """One step that makes no point."""
        match step:
            case State(name):
                self.report_state(name)
            case Trial():
                held = dict(step.held)
                fields = {k: v for k, v in vars(step).items() if k != "held"}
                self.record.event("trial", phase="begin", **fields, **held)
            case EndTrial(trial):
                self.record.event("trial", phase="end", trial=trial)
            case Vent():
                self._vent()
            case SetLength(length_mm):
                self._set_length(length_mm)
            case Tare():
                grams = self._tare()
                self.record.event("tare", grams=grams)
            case SetPressure(pressure_kpa):
                self._set_pressure(pressure_kpa)
            case Dwell(seconds):
                self.rig.event_loop.for_seconds(seconds)
            case Settle():
                return self._settle(step)
            case Zero():
                self._zero(step)
            case CustomStep():
                return step.perform(self)
        return None

    def make(self, step: Measure | CustomStep) -> Answer:
        """One step that makes a point."""
        if isinstance(step, Measure):
            return self._measure(step)
        return step.perform(self)

    def report_state(self, state: str) -> None:
        """The test enters a state: record, live view and terminal."""
        self.progress.state = state
        self.record.event("state", state=state)
        self.watch.state(state)

    def report_result(self, x: float, y: float, label: str, chart: str = "points") -> None:
        """A result of the test as it goes: record and live view, so that the view file has it.

        ``chart`` is the panel's origin, where a test has several charts.
        """
        where = {} if chart == "points" else {"chart": chart}
        self.record.event("result", x=float(x), y=float(y), label=label, **where)
        self.watch.result(x, y, label, *where.values())

    @property
    def vented(self) -> bool:
        """Whether the last command to the pressure source was to vent."""
        return all(side.source.vented for side in self.rig.sides)

    def axis(self, name: str, unit: str) -> ManualAxis:
        """What a person sets: the rig's axis of that name, or one that nothing looks after."""
        axes = self.rig.axes
        if name not in axes:
            highest = most_kg(self.rig.config) if name == "mass" else math.inf
            axes[name] = ManualAxis(
                name, unit, self.rig.operator, self.rig.event_loop, highest=highest
            )
            axes[name].on_setting.append(self._was_set)
        return axes[name]

    def _was_set(self, setting: ManualSetting) -> None:
        self.record.event("manual", **vars(setting))

    def shut(self) -> None:
        """Shut the air in; the next set-point takes the air up again."""
        for side in self.rig.sides:
            side.source.hold()

    def _vent(self) -> None:
        sides = self.rig.sides
        for side in sides:
            side.source.vent()
            self.watch.set_point("pressure" if side is sides[0] else "pressure b", 0.0)
        self.rig.event_loop.until(
            lambda: all(side.source.measured_kpa < SAFE_KPA / 2 for side in sides), 10.0
        )
        for side in sides:
            if not side.source.measured_kpa < SAFE_KPA / 2:
                raise RunFault(
                    side.source.name,
                    f"commanded to vent, pressure reads {side.source.measured_kpa:.0f} kPa"
                    " after 10 s",
                    "shut the supply by hand; check the outlet and the pressure zero",
                )
        self.rig.event_loop.for_seconds(0.3)

    def _set_length(self, length_mm: float) -> None:
        """Move the stage and wait until it is there."""
        self.record.event("command", device="stage", length_mm=length_mm)
        self.watch.set_point("length", length_mm)
        stage: Actuator = self.rig.stage
        stage.set_value(length_mm)

    def _tare(self) -> float:
        self._balance_speaks = False  # a balance that tares sends no readings meanwhile
        self.watch.taring()
        try:
            grams = self.rig.balance.tare()
            self.watch.tared()
            return grams
        finally:
            self._balance_speaks = True
            self._last_row = (0, 0)

    def _set_pressure(self, pressure_kpa: float) -> None:
        """Record what will be commanded, then command it."""
        source = self.rig.pressure_source
        source.prepare(pressure_kpa)
        self.record.event("command", **source.command(pressure_kpa).fields())
        self.watch.set_point("pressure", pressure_kpa)
        source.set_pressure(pressure_kpa)

    def _settle(self, step: Settle) -> Answer:
        start_ns = self.rig.clock.now_ns()
        settled = has_settled(self.rig, self.sensor, self.length, self.camera, step)
        done = self.rig.event_loop.until(
            lambda: self.steering.skip or settled(), step.criterion.timeout_s
        )
        waited_s = (self.rig.clock.now_ns() - start_ns) / NS_PER_S
        return done and not self.steering.skip, waited_s

    def window(
        self, seconds: float, pictures: int = 0, take: Callable[[], object] = lambda: None
    ) -> tuple[list[int], list[int]]:
        """Let ``seconds`` pass; half-open ranges of valve samples and balance rows in it.

        ``take`` is called ``pictures`` times, evenly spread over the window.
        """
        valve, balance = self.rig.valve, self.rig.balance
        seq, row = valve.seq_end, balance.rows
        samples, rows = round(seconds / SAMPLE_S), max(1, round(seconds * 10))
        for k in range(pictures):
            due = seq + round(samples * (k + 0.5) / pictures)
            self.rig.event_loop.until(lambda due=due: valve.seq_end >= due, seconds + 1.0)  # type: ignore[misc]
            take()
        came = self.rig.event_loop.until(
            lambda: valve.seq_end >= seq + samples and balance.rows >= row + rows, seconds * 3 + 1.0
        )
        if not came:
            raise RunFault(
                balance.name if valve.seq_end >= seq + samples else valve.name,
                f"sent too little during a window of {seconds:g} s",
                "check rates, cable and baud rate",
            )
        return [seq, seq + samples], [row, balance.rows]

    def _pressure_rows(self, first: int, seconds: float, seq: list[int], settled: bool) -> Rows:
        """The range of a transducer's readings in a window; nothing where there is none."""
        sensor = self.sensor
        if sensor.instrument is None:
            return {}
        rows = sensor.window(first, seconds)
        if settled:
            sensor.settled(seq, rows)
        return {"pressure_rows": rows}

    def _zero(self, step: Zero) -> None:
        first = self.sensor.rows
        seq, rows = self.window(step.seconds)
        more = self._pressure_rows(first, step.seconds, seq, False)
        self.record.event(
            "zero", trial=step.trial, when=step.when, valve_seq=seq, balance_rows=rows, **more
        )

    def _measure(self, step: Measure) -> None:
        from rigs.steps.pictures import take_picture

        frames, lengths = [], []

        def look() -> None:
            picture = take_picture(self.rig, self.record, self.camera)
            frames.append(picture.number)
            self.watch.picture(picture.host_ns, picture.jpeg, picture.gap)
            if picture.gap.trusted:
                lengths.append(picture.gap.pixels)

        pictures = step.frames if self.rig.config.camera.source else 0
        first_length = self.length.rows
        if step.mass_kg is None:  # a held length is looked at first, then left in peace
            for _ in range(pictures):
                look()
            first_length = self.length.rows
            first = self.sensor.rows
            seq, rows = self.window(step.seconds)
        else:
            first = self.sensor.rows
            seq, rows = self.window(step.seconds, pictures, look)
        pressure_rows = self._pressure_rows(first, step.seconds, seq, step.settled)
        length_rows = self.length.length_rows(first_length, step.seconds)
        if self.steering.skip:
            return
        step = self._judged_again(step)
        take = self.steering.take
        more: dict[str, Any] = pressure_rows | length_rows
        more = more if take == 1 else {"take": take, **more}
        if "thermometer" in self.rig.instruments:
            at = temperature(self.rig)
            more |= {k: at[k] for k in ("temperature_c", "u_temperature_c")}
        self.record.event(
            "point", **step.fields(), **more, valve_seq=seq, balance_rows=rows, frames=frames
        )
        self.progress.done += take == 1
        cal = self.rig.config.calibrations
        pressures = self.sensor.recent_kpa(seq[1] - seq[0], self.sensor.rows - first)
        grams, _ = self.rig.balance.recent(rows[1] - rows[0])
        self.watch.point(
            step,
            float(pressures.mean()),
            float(cal["force_n"].apply(grams.mean())),
            self._length_mm(lengths, length_rows),
        )

    def _length_mm(self, pixels: list[float], rows: Rows) -> float:
        """Length of a point for the live view: by the instrument, or by its pictures."""
        if rows:
            first, end = rows["length_rows"]
            return float(self.length.recent_mm(end - first).mean())
        calibration = self.rig.config.calibrations["length_mm"]
        return float(calibration.apply(np.mean(pixels))) if pixels else float("nan")

    def _judged_again(self, step: Measure) -> Measure:
        """The point as not settled if it moved while it was measured."""
        settle = self.steering.settle
        if not step.settled or settle is None or settle.pressure_kpa != step.set_pressure_kpa:
            return step
        if still_settled(self.rig, self.sensor, settle, step.seconds):
            return step
        self.record.event("moved", order=step.order, set_pressure_kpa=step.set_pressure_kpa)
        self.watch.log(f"point {step.order} moved while it was measured; marked as not settled")
        return replace(step, settled=False)


def outcome_of(error: BaseException | None) -> str:
    """The word for how a run ended."""
    from daq.interrupt import Stopped

    if error is None:
        return "clean"
    if isinstance(error, Stopped):
        return "stopped"
    known = isinstance(error, (RunFault, LinkLost, DeviceError, RecordError))
    return "faulted" if known else "aborted"
