"""What would stop a run: every part of a rig looked at, one line each."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import typer

from daq.clock import Clock
from daq.errors import PamrigError
from rigs.bench.both import Side, sides_of
from rigs.bench.computer import Computer
from rigs.bench.due import due_calibrations
from rigs.bench.rig import Rig, open_rig
from rigs.devices.valve_controller import ALIVE_S
from rigs.rigfile.config import NONE, RigConfig, load_rig
from valvefw.board import DRIVE_SILENCE_US
from valvefw.core import LOOP
from valvefw.wire import TICK_US

MARKS = {"ok": "ok  ", "warn": "WARN", "stop": "STOP"}
LISTEN_S = 2.0
EVEN_US = 100
"""Samples further from an even millisecond than this are worth a warning."""
STEP_US = 300
"""A step of the safety core that takes longer leaves the loop too little time."""


@dataclass(frozen=True)
class Finding:
    """One thing looked at. ``status`` is ok, warn (a run is possible) or stop."""

    what: str
    status: str
    detail: str


def examine(name: str, out: Path, clock: Clock | None = None) -> list[Finding]:
    """Look at a rig as a run would use it, without arming it.

    Args:
        name: rig file or shipped name.
        out: folder of runs, for the disk.
        clock: only for tests.
    """
    try:
        config = load_rig(name)
    except PamrigError as error:
        return [Finding("rig file", "stop", str(error))]
    findings = [Finding("rig file", "ok", f"{config.source}, CRC {config.crc32}"), _disk(out)]
    findings += list(_config(config))
    try:
        with open_rig(config, clock) as rig:
            findings += list(_devices(rig))
    except PamrigError as error:
        findings.append(Finding("devices", "stop", str(error)))
    return findings


def _disk(out: Path) -> Finding:
    here = out
    while not here.exists():
        here = here.parent
    free = shutil.disk_usage(here).free
    hours = free / 250e6
    status = "ok" if free > 1e9 else "warn" if free > 1e8 else "stop"
    return Finding(
        "disk", status, f"{free / 1e9:.1f} GB free in {here}, about {hours:.0f} h of test"
    )


def _config(config: RigConfig) -> Iterator[Finding]:
    for name, side in sides_of(config).items():
        if side.valve.outlet_normally != "closed":
            continue
        yield Finding(
            "outlet" if name == "valve" else f"outlet of {name}",
            "warn",
            "normally closed: when power fails the air stays in the muscle "
            "(a normally open outlet vents by itself)",
        )
    for quantity, cal in config.calibrations.items():
        made = f" of {cal.date}" if cal.date else ", no date"
        yield Finding(
            f"calibration {quantity}",
            "ok" if cal.date else "warn",
            f"{cal.id}{made}, {cal.domain[0]:.4g} to {cal.domain[1]:.4g} {cal.unit}, "
            f"u = {cal.u_offset:.3g} {cal.unit} + {cal.u_gain * 100:.3g} %",
        )
    for late in due_calibrations(config):
        yield Finding(f"calibration of {late.device}", "warn", f"{late.text}: calibrate it again")


def _devices(rig: Rig) -> Iterator[Finding]:
    """Identities, then a short listen to every sensor."""
    config = rig.config
    yield from _identities(rig)
    for side in rig.sides:
        side.valve.progress(LISTEN_S + ALIVE_S)
        side.valve.request("timing")  # begins anew with each request
    rig.event_loop.for_seconds(LISTEN_S)
    for side in rig.sides:
        yield _timing(side.valve.request("timing"), _which(side))
    if not rig.clock.virtual:
        yield computer_finding(Computer(rig.event_loop, config))
    for side in rig.sides:
        counts = len(side.valve.recent_counts(1000))
        if counts < 500:
            detail = f"only {counts} samples in {LISTEN_S:g} s"
            yield Finding(f"telemetry{_which(side)}", "stop", detail)
            return
        yield _pressure(side, rig.clock.virtual)
    yield from _readings(rig)
    yield from _clocks(rig)
    ram = config.virtual is not None and config.virtual.load == "ram"  # no muscle, so no marks
    if config.camera.source and config.joint is None and not ram:  # a joint's marks: an instrument
        yield _camera(rig)
    for side in rig.sides:
        if side.valve.fault_latched:
            words = ", ".join(side.valve.faults) or "see pamrig vent"
            yield Finding(f"fault{_which(side)}", "warn", f"latched: {words}")


def _identities(rig: Rig) -> Iterator[Finding]:
    """Who each device says it is."""
    for side in rig.sides:
        v = side.valve.identity
        yield Finding(
            f"valve controller{_which(side)}",
            "ok",
            f"{v.get('board')} {v.get('serial') or '(no serial number)'}, firmware {v.get('fw')},"
            f" config CRC {v.get('conf')}, boot {v.get('boot')} ({v.get('cause')})",
        )
    for name in [n for n in rig.identities if n not in sides_of(rig.config)]:
        words = ", ".join(f"{k} {x}" for k, x in rig.identities[name].items() if x)
        yield Finding(name, "ok", words)


def _clocks(rig: Rig) -> Iterator[Finding]:
    """How well each controller's clock is known."""
    for side in rig.sides:
        fit = side.valve.clock_fit
        if fit.ready:
            mark = "ok" if fit.error_ns < 2e6 else "warn"
            detail = f"error {fit.error_ns / 1e6:.3f} ms, drift {round(fit.drift_ppm) + 0:+d} ppm"
            yield Finding(f"clock fit{_which(side)}", mark, detail)


def _which(side: Side) -> str:
    """Which of two controllers; nothing for the only or first one."""
    return "" if side.name == "valve" else f" of {side.name}"


def _pressure(side: Side, virtual: bool) -> Finding:
    """What a transducer reads of the vented muscle."""
    cal = side.config.calibrations["pressure_kpa"]
    counts = side.valve.recent_counts(1000)
    p = cal.apply(counts)
    noise, mean = float(np.std(p)), float(np.mean(p))
    distinct = len(np.unique(counts))
    what = f"pressure{_which(side)}"
    detail = f"reads {mean:.2f} kPa vented, noise {noise:.2f} kPa, {distinct} distinct values"
    if abs(mean) > max(5.0, 5 * cal.u_offset):
        return Finding(what, "stop", detail + ": not near zero; vent, check sensor and wiring")
    if distinct == 1 and not virtual:
        return Finding(what, "warn", detail + ": a stuck sensor looks like this")
    return Finding(what, "ok", detail)


def _readings(rig: Rig) -> Iterator[Finding]:
    """The force as a test takes it, where something measures it, and the optional instruments."""
    config = rig.config
    grams, stable = rig.balance.recent(10)
    source = f"from [{config.force_source}]"
    if config.force_source == NONE:
        pass
    elif not len(grams):
        yield Finding("force", "stop", f"{source}: {rig.balance.last_problem or 'no reading came'}")
    else:
        newton = abs(config.calibrations["force_n"].scale)
        spread = float(np.std(grams)) * newton
        mark = "ok" if stable.all() else "warn"
        detail = f"{source}, noise {spread:.3f} N, {stable.mean():.0%} of readings stable"
        yield Finding("force", mark, detail)
    yield from _instruments(rig)


def computer_finding(computer: Computer) -> Finding:
    """How late the computer was during the listen, and what to expect of it in a run."""
    late_s, spare_s = computer.heartbeat.max_s, computer.spare_s
    about = computer.as_dict()
    detail = (
        f"the computer was late by up to {late_s * 1e3:.1f} ms"
        f" (99 %: {about['heartbeat']['p99_ms']:.1f} ms, the program itself"
        f" {computer.program.max_s * 1e3:.0f} ms, priority {about['priority']['heartbeat']});"
        f" the heartbeat limit is {computer.limit_s * 1e3:.0f} ms"
    )
    if late_s >= spare_s:
        return Finding("computer", "stop", f"{detail}: a run would be vented; close other programs")
    if late_s >= spare_s / 4:
        return Finding("computer", "warn", f"{detail}: a busier moment may vent a run")
    return Finding("computer", "ok", f"{detail}: enough")


def _timing(answer: dict[str, str], which: str) -> Finding:
    """How evenly the controller has sampled, and how late its loop was, during the listen."""
    step, low, high, loop, missed = (
        int(answer[key]) for key in ("step_us", "dt_min_us", "dt_max_us", "loop_ms", "missed")
    )
    away = max(high - TICK_US, TICK_US - low)
    detail = f"samples every {low} to {high} us, loop at most {loop} ms apart"
    if step:
        detail += f", longest safety step {step} us"
    if missed:
        detail += f", {missed} ms in all without a pass of the loop"
    if high >= DRIVE_SILENCE_US or loop * TICK_US >= LOOP:
        mark = "stop"
        detail += ": an armed controller would latch loop_stalled; install the firmware again"
    elif away > EVEN_US or step > STEP_US:
        mark = "warn"
        detail += (
            ": slower than a Pico with this firmware; is it the MicroPython named in the docs?"
        )
    else:
        mark = "ok"
    return Finding(f"controller timing{which}", mark, detail)


def _instruments(rig: Rig) -> Iterator[Finding]:
    """The optional instruments after the listen: what they read and what went wrong."""
    for name, instrument in rig.instruments.items():
        readings, _ = instrument.recent(20)
        if not len(readings):
            yield Finding(f"{name} readings", "stop", instrument.last_problem or "none came")
            continue
        values = instrument.apply(readings)
        cal = instrument.calibration
        detail = f"{instrument.quantity} {values.mean():.4g}, noise {values.std():.2g}"
        if cal is not None and bool(cal.outside(values).any()):
            low, high = cal.domain
            detail += f": outside the calibrated {low:g} to {high:g} {cal.unit}"
            yield Finding(f"{name} readings", "warn", detail)
        elif instrument.faults.total:
            words = f"{instrument.faults.total} faults, last: {instrument.faults.last}"
            yield Finding(f"{name} readings", "warn", f"{detail}; {words}")
        else:
            yield Finding(f"{name} readings", "ok", detail)
    if rig.supply is not None:
        volts, amps = rig.supply.measure()
        mark = "ok" if abs(volts - rig.supply.set_v) <= rig.supply.settle_v else "warn"
        yield Finding("supply", mark, f"gives {volts:.3f} V, {amps:.3f} A to the solenoids")
    for name, axis in rig.config.instruments.manual.items():
        looked = f"checked by {axis.check}" if axis.check else "not checked by any sensor"
        yield Finding(f"manual {name}", "ok", f"set by hand in {axis.unit}, {looked}")


def _camera(rig: Rig) -> Finding:
    from vision.marker.edge import measure_gap

    gap = measure_gap(rig.camera.trigger().gray)
    if not gap.trusted:
        return Finding("camera", "stop", f"no trusted length: {gap.reason}")
    cal = rig.config.calibrations["length_mm"]
    length = float(cal.apply(gap.pixels))
    u = gap.u_pixels * abs(cal.scale)
    return Finding("camera length", "ok", f"{length:.3f} mm, repeatability {u * 1000:.1f} um")


def print_findings(findings: list[Finding]) -> None:
    """For a person: one line each, and a verdict."""
    for f in findings:
        typer.echo(f"{MARKS[f.status]}  {f.what}: {f.detail}")
    stops = sum(f.status == "stop" for f in findings)
    typer.echo(f"{stops} thing(s) would stop a run" if stops else "ready to run")
