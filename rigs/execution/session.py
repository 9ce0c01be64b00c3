"""One test from start to finish: open, check, record, run, finalise."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from daq.clock import NS_PER_S
from daq.errors import DeviceError, PamrigError, RecordError
from daq.interrupt import StopFlag, Stopped
from daq.link.telemetry import VALVE_COLUMNS, VALVE_UNITS, Gap
from daq.record.disk import check_disk
from daq.record.writer import RecordWriter
from rigs.bench.both import Side, firmware_parameters
from rigs.bench.due import due_calibrations
from rigs.bench.locks import vent_request
from rigs.bench.rig import Rig, open_rig
from rigs.devices.instruments.balance import BALANCE_UNITS, NoBalance
from rigs.devices.instruments.instrument import PortInstrument
from rigs.devices.lines import LineDevice
from rigs.devices.motion.stage import MotorStage
from rigs.devices.operator import ConsoleOperator, Operator, at_a_terminal
from rigs.execution.control import RunControl, control_file, is_request
from rigs.execution.manifest import manifest
from rigs.execution.procedure import Plan, Procedure
from rigs.execution.recording import (
    instrument_counters,
    record_instruments,
    recorder,
)
from rigs.execution.resume import remaining
from rigs.execution.runner import Runner, Watch, outcome_of
from rigs.rigfile.config import RigConfig, camera_values
from rigs.steps.custom_step import Steps
from rigs.steps.schedule import outline
from rigs.steps.watching import LiveView

if TYPE_CHECKING:
    from rigs.virtual.bench import VirtualBench

HEAR_OUT_S = 0.3
"""So long a line, or an answer, may be on its way when all is done."""


@dataclass(frozen=True)
class Result:
    """How a test ended: its record, and how many of the planned points it holds."""

    folder: Path
    outcome: str
    error: BaseException | None
    points: int
    planned: int = 0


def run_protocol(  # noqa: C901, PLR0913 - what may be stated of a run, each by name; its phases stand in one place
    kind: Procedure,
    config: RigConfig,
    plan: Plan,
    root: Path,
    *,
    specimen: str = "muscle",
    operator: str = "",
    note: str = "",
    stop: StopFlag | None = None,
    control: RunControl | None = None,
    make_live: Callable[[str], LiveView] | None = None,
    watch: Watch | None = None,
    on_start: Callable[[Runner, RecordWriter], None] | None = None,
    wire: bool = False,
    continues: dict[str, Any] | None = None,
    bench: VirtualBench | None = None,
    person: Operator | None = None,
) -> Result:
    """Run a test and leave a finished record.

    Args:
        kind: the protocol.
        config: the rig.
        plan: the test's parameters.
        root: folder of runs.
        specimen, operator, note: go into the record.
        stop: set from outside to end the run in good order.
        control: takes pause, resume, skip, repeat and markers; the run's control file is
            listened to in any case.
        make_live: makes the live view once the run's id is known.
        watch: hooks for a progress line.
        on_start: called with the runner just before the first step.
        wire: also record every byte that came in: a fixture, or evidence after a fault.
        continues: the run that this one goes on with (``rigs.execution.resume.continuation``); its
            whole trials are not made again.
        bench: the virtual bench of earlier tests, where this one is to go on with it.
        person: who sets manual axes, where it is not the person at the terminal.

    Raises:
        PamrigError: nothing was recorded yet: device, key and remedy are named. Once a
            record exists, errors come back in the result instead and the run is finalised.
    """

    def method() -> Steps:
        if continues and kind.rest is not None:
            return kind.rest(plan, continues)
        return remaining(plan.steps(), continues["trials"]) if continues else plan.steps()

    kind.check(config)
    points, seconds = (0, 0.0) if kind.open_ended else outline(method(), config.stage.speed_mm_s)
    check_disk(root, points if kind.stored_points is None else kind.stored_points(plan))
    stop = stop or StopFlag()
    watch = watch or Watch()
    control = control or RunControl()
    _prepare(config, watch, bool(plan.frames) or kind.open_ended)
    with open_rig(config, operator=person, bench=bench) as rig:
        virtual = rig.clock.virtual
        if kind.firmware:
            for side in rig.sides:
                side.valve.configure({**firmware_parameters(side.config), **kind.firmware})
        known = manifest(rig, kind.name, plan, specimen, operator, note)
        if continues:
            known["continues"] = continues
        record = RecordWriter(root, known, rig.clock, durable=not virtual, threaded=not virtual)
        record.on_wait = watch.log
        _open_streams(rig, record)
        error: BaseException | None = None
        live: LiveView | None = None
        camera = camera_values(config)
        runner = Runner(rig, record, stop, watch, camera, control)
        try:
            if make_live is not None:  # starting it takes a second: before anything is recorded
                live = make_live(record.run_id)
            _connect(rig, record, watch)
            if wire:
                _record_bytes(rig, record)
            if plan.frames and config.camera.source:
                _check_camera(rig, record, camera)
            if live is not None:
                live.attach(rig, record, watch, runner.progress)
            if on_start is not None:
                on_start(runner, record)
            control.listen(
                control_file(record.folder), None if config.is_virtual else vent_request(config)
            )
            if at_a_terminal():
                # A simulated person answers the requests; the keys are of the person here.
                console = rig.operator if isinstance(rig.operator, ConsoleOperator) else None
                keyboard = console or ConsoleOperator()
                keyboard.on_line, keyboard.is_command = control.typed, is_request
                keyboard.listen()
            runner.progress.seconds = seconds
            runner.run(method(), points, arm=not kind.open_ended)
        except (PamrigError, Stopped) as caught:
            error = caught
        except BaseException as caught:
            error = caught
            raise
        finally:
            outcome = outcome_of(error)
            control.close()
            _end_live(live, outcome, error)
            if _finish(runner, record, outcome, error) != outcome:
                # The last words did not reach the disk: the run is not what it seemed to be.
                error = error or record.failed
                outcome = outcome_of(error)
    return Result(record.folder, outcome, error, runner.progress.done, points)


def _end_live(live: LiveView | None, outcome: str, error: BaseException | None) -> None:
    """The live view says how the run ended, and closes."""
    if live is not None:
        live.ended(outcome, error)
        live.close()


def _open_streams(rig: Rig, record: RecordWriter) -> None:
    """The streams that a rig has without further instruments."""
    for side in rig.sides:
        record.stream(side.name, VALVE_COLUMNS, VALVE_UNITS)
    if not isinstance(rig.balance, NoBalance):
        columns = rig.balance.columns
        units = {name: unit for name, unit in BALANCE_UNITS.items() if name in columns}
        record.stream("balance", columns, units)


def _prepare(config: RigConfig, watch: Watch, pictures: bool) -> None:
    """What comes before the bench is opened: a word on calibrations that are due, and imports."""
    for late in due_calibrations(config):
        watch.log(f"WARNING: calibration of {late.device}: {late.text}")
    if not config.is_virtual:
        _load(config, pictures=pictures and bool(config.camera.source))


def _load(config: RigConfig, pictures: bool) -> None:
    """Load what would otherwise be loaded, for seconds, on the loop that records and beats."""
    import pyarrow  # noqa: F401 - the record's encoder, with the first batch

    if pictures:
        from rigs.execution import camera_sync  # noqa: F401
        from rigs.steps.pictures import load_measuring

        load_measuring(config.camera.jpeg_quality)


def _check_camera(rig: Rig, record: RecordWriter, camera: dict[str, Any]) -> None:
    """Take and measure one picture before anything is armed.

    It tells a covered or displaced camera before the test. With marks, each must have a pose; the
    gap of a single marker is not needed then.

    Raises:
        DeviceError: no length, or no pose of a mark, can be had of the picture.
    """
    from rigs.execution.camera_sync import measure_camera_delay
    from rigs.steps.pictures import take_picture

    replayed = rig.config.camera.replayed
    if replayed:  # stated among the faults of the report: lengths are not those of this bench
        record.event("replayed_pictures", **rig.camera.identity)
    picture = take_picture(rig, record, camera)
    gap = picture.gap
    if picture.pose is not None:
        for pose in picture.pose.poses.values():
            if not pose.trusted:
                raise DeviceError(
                    "camera",
                    f"no pose of mark {pose.name} in its picture: {pose.reason}",
                    "check marks, light and lens; `pamrig pose` shows what it sees",
                )
    elif not gap.trusted:
        raise DeviceError(
            f"camera ({rig.config.source}: camera.source = {rig.config.camera.source!r})",
            f"no length can be measured in its picture: {gap.reason}",
            "check lens, light and both marks; `pamrig length` shows what it sees",
        )
    if rig.config.camera.sync is not None and not replayed:
        rig.valve.progress(60.0)  # nothing is armed yet; the beats are the clock's pings
        rig.event_loop.until(lambda: rig.valve.clock_fit.pings >= 5, 2.0)
        measure_camera_delay(rig, record, rig.config.camera.sync)


def _connect(rig: Rig, record: RecordWriter, watch: Watch) -> None:
    """Everything that comes in goes to the record as it came."""
    for side in rig.sides:
        _connect_controller(rig, side, record, watch)
    if not isinstance(rig.balance, NoBalance):
        rig.balance.on_rows.append(recorder(record, "balance"))
    record_instruments(rig, record)


def _connect_controller(rig: Rig, side: Side, record: RecordWriter, watch: Watch) -> None:
    """Telemetry, events and gaps of one controller."""
    name, valve = side.name, side.valve

    def event(text: str) -> None:
        # A restart that nobody asked for is a fault, in the closing vent too.
        kind = "fault" if text.startswith(("fault", "reboot")) else "controller"
        record.event(kind, device=name, text=text)
        if text.startswith("reboot"):
            watch.log("WARNING: the valve controller restarted; check its power supply")
        if text.startswith("foreign"):
            watch.log("WARNING: another program sends commands to the valve controller (refused)")

    def gap(found: Gap) -> None:
        record.event("gap", stream=name, seq=found.seq, missing=found.missing)

    valve.on_gap = gap
    valve.on_batch.append(recorder(record, name))
    if not rig.clock.virtual:  # on the virtual clock a killed run is simply run again
        valve.telemetry.on_ahead = lambda frame: record.write_ahead(name, frame)
    valve.on_event = event


def _record_bytes(rig: Rig, record: RecordWriter) -> None:
    """Every byte that comes in goes to the record, before anything has looked at it."""

    def listener(name: str) -> Callable[[int, bytes], None]:
        def listen(host_ns: int, data: bytes) -> None:
            with contextlib.suppress(RecordError):  # see recorder
                record.wire(name, host_ns, data)

        return listen

    for side in rig.sides:
        side.valve.on_bytes = listener(side.name)
    rig.balance.on_bytes = listener("balance")
    rig.stage.on_bytes = listener("stage")
    for name, instrument in rig.instruments.items():
        instrument.on_bytes = listener(name)
    if rig.supply is not None:
        rig.supply.on_bytes = listener("supply")
    if rig.pressure_source.own_device is not None:
        rig.pressure_source.own_device.on_bytes = listener("pressure_source")


def _hear_out(rig: Rig) -> None:
    """Let what is on its way come, so that all that came damaged is counted."""
    devices: list[Any] = [*(side.valve for side in rig.sides), *rig.instruments.values()]
    lines = (rig.balance, rig.stage, rig.supply, rig.pressure_source.own_device)
    devices += [d for d in lines if isinstance(d, LineDevice | PortInstrument)]
    with contextlib.suppress(PamrigError):
        rig.event_loop.until(lambda: not any(device.midway for device in devices), HEAR_OUT_S)
    for device in devices:
        device.finish()


def _finish(runner: Runner, record: RecordWriter, outcome: str, error: BaseException | None) -> str:
    """Flush what is held back, write the last events and close the record; how it ended then."""
    rig = runner.rig
    _hear_out(rig)
    with contextlib.suppress(RecordError):  # a failed record is the outcome already
        for side in rig.sides:
            side.valve.telemetry.flush()
    fit = _clock_fits(rig, record)
    if error is not None:
        record.event("end", outcome=outcome, reason=str(error) or type(error).__name__)
    try:
        final = record.finalize(
            outcome,
            reason=str(error) if error is not None else "",
            clock_fit=fit,
            counters={
                **{side.name: side.valve.counters() for side in rig.sides},
                **(
                    {}
                    if isinstance(rig.balance, NoBalance)
                    else {"balance": rig.balance.counters()}
                ),
                **({"stage": rig.stage.counters()} if isinstance(rig.stage, MotorStage) else {}),
                **({"camera": rig.camera.counters()} if rig.config.camera.source else {}),
                **instrument_counters(rig),
            },
            duration_s=(rig.clock.now_ns() - record.start_ns) / NS_PER_S,
            **({} if rig.clock.virtual else {"lateness": runner.computer.as_dict()}),
        )
    except RecordError:
        if error is None:
            raise
        return outcome
    return str(final["outcome"])


def _clock_fits(rig: Rig, record: RecordWriter) -> dict[str, Any]:
    """The clock fit of the controller, or that of each of two by its name; also as events."""
    fits = {
        side.name: side.valve.clock_fit.final().as_dict() if side.valve.clock_fit.ready else {}
        for side in rig.sides
    }
    if len(fits) == 1:
        (fit,) = fits.values()
        record.event("clockfit", **fit)
        return fit
    for name, fit in fits.items():
        record.event("clockfit", device=name, **fit)
    return fits
