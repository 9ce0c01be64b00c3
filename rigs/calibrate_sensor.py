"""Calibrating the pressure and the force sensor: the laboratory method, top to bottom.

Pressure: the bench itself makes the pressures, up and down, and a reference says what they
are: a transmitter of the rig, or a gauge that the operator reads. Force: dead weights, hung on
the load cell one after the other, up and down; on a balance they all stand on the pan, are
tared away, and are taken off one after the other, as the muscle takes weight off. What was read
is kept in a record of its own; the line through it becomes a file that a rig file can name.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from math import nan
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from daq.calibration import Calibration
from daq.clock import NS_PER_S
from daq.errors import ConfigError, PamrigError
from daq.record import RecordWriter
from rigs.balance import Balance
from rigs.calibration_file import CalibrationFile
from rigs.config import RigConfig
from rigs.instruments.load_cell import LoadCell
from rigs.interrupt import StopFlag
from rigs.linefit import LEAST_POINTS, Reference, fit_line
from rigs.operator import Operator, Request, ask, ask_number
from rigs.rig import Rig, open_rig
from rigs.runner import Runner, Watch, outcome_of
from rigs.session import camera_values, software
from rigs.steps import Dwell, SetPressure, Settle, SettleCriterion, State, Steps, Vent

SETTLE = SettleCriterion(window_s=0.5, pressure_kpa=2.0, drift_kpa=0.5, drift_n=1.0, timeout_s=10.0)
VENTED_KPA = 5.0
TOP_COUNT = 4095
MOST_CLIPPED = 0.4
"""A point with more of its samples at the end of the sensor's range tells nothing."""
BLOCKS = 10


@dataclass(frozen=True)
class Point:
    """One point of a calibration: mean reading, its standard uncertainty, the reference."""

    raw: float
    u_raw: float
    reference: float


@dataclass(frozen=True)
class Calibrated:
    """The result, its points (reading, reference, residual) and the record's folder."""

    file: CalibrationFile
    points: tuple[tuple[float, float, float], ...]
    folder: Path


def up_and_down(values: Sequence[float]) -> list[float]:
    """Rising, then falling, the highest once: what a reference meets it meets from both sides."""
    rising = sorted(set(values))
    return rising + rising[-2::-1]


def block_mean(values: npt.ArrayLike, resolution: float = 0.0) -> tuple[float, float]:
    """(mean, its standard uncertainty) of readings that follow each other closely.

    From the scatter of block means, because neighbours are not independent; never below what
    the resolution leaves open.
    """
    v = np.asarray(values, dtype=np.float64)
    blocks = [b.mean() for b in np.array_split(v, min(BLOCKS, len(v))) if len(b)]
    spread = float(np.std(blocks, ddof=1) / np.sqrt(len(blocks))) if len(blocks) > 1 else 0.0
    return float(v.mean()), float(np.hypot(spread, resolution / np.sqrt(12 * len(v))))


def middle(counts: npt.ArrayLike) -> float:
    """Median of whole counts, interpolated within its count."""
    v = np.asarray(counts, dtype=np.float64)
    median = float(np.floor(np.median(v)))
    below, at = float(np.mean(v < median)), float(np.mean(v == median))
    return median - 0.5 + (0.5 - below) / at if at else median


# ---- pressure -------------------------------------------------------------------------


def calibrate_pressure(
    config: RigConfig,
    pressures_kpa: Sequence[float],
    root: Path,
    *,
    reference: Reference | None = None,
    seconds: float = 2.0,
    who: str = "",
    operator: Operator | None = None,
    stop: StopFlag | None = None,
    watch: Watch | None = None,
) -> Calibrated:
    """Calibrate the controller's pressure sensor against a reference.

    Args:
        config: the rig.
        pressures_kpa: to stop at, each once going up and once going down.
        root: folder for the record.
        reference: a gauge that the operator reads; None takes [pressure_transmitter].
        seconds: how long each point is measured.
        who: goes into the record.
        operator: reads the gauge; the terminal, or a simulated person, by default.
        stop, watch: as in a test.

    Raises:
        ConfigError: no reference, too few pressures, or one beyond the rig's limit.
        PamrigError: what ends a test also ends a calibration; the bench is vented.
    """
    _check_pressures(config, pressures_kpa, reference)
    parameters = {"pressures_kpa": list(pressures_kpa), "seconds": seconds}
    with open_rig(config, operator=operator) as rig:
        if reference is None:
            gauge = rig.instruments["pressure_transmitter"]
            cal = gauge.calibration
            assert cal is not None
            serial = config.instruments.modbus["pressure_transmitter"].serial
            known = Reference(
                f"pressure_transmitter {serial} ({cal.id} {cal.date})".strip(),
                u_offset=cal.u_offset,
                u_gain=cal.u_gain,
            )

            def read() -> float:
                return gauge.mean(max(1, round(seconds * gauge.rate_hz)))
        else:
            known = reference

            def read() -> float:
                text = f"read {known.name} in kPa, type it, then press Enter"
                return ask_number(
                    rig.operator, rig.pump, Request("reference pressure", nan, "kPa", text)
                )

        record = _record(rig, root, "calibrate-pressure", known, parameters, who)
        points: list[Point] = []
        runner = Runner(rig, record, stop or StopFlag(), watch or Watch(), camera_values(config))
        steps = _pressure_steps(rig, record, up_and_down(pressures_kpa), seconds, read, points)
        _carry_out(rig, record, lambda: runner.run(steps, 2 * len(pressures_kpa) - 1))
        serial = rig.identities["valve"].get("serial", "")
        old = config.calibrations["pressure_kpa"]
        return _result(record, rig, old, serial, points, known)


def _pressure_steps(
    rig: Rig,
    record: RecordWriter,
    pressures_kpa: list[float],
    seconds: float,
    read: Callable[[], float],
    points: list[Point],
) -> Steps:
    """The method: make a pressure, let it settle, read sensor and reference together."""
    for pressure in pressures_kpa:
        yield State(f"calibrate pressure: {pressure:g} kPa")
        yield Vent() if pressure < VENTED_KPA else SetPressure(pressure)
        yield Settle(SETTLE, pressure)
        yield Dwell(seconds)
        counts = rig.valve.recent_counts(round(seconds * 1000))
        raw, u_raw = block_mean(counts, 1.0)
        clipped = float(np.mean((counts == 0) | (counts >= TOP_COUNT)))
        if clipped > MOST_CLIPPED:
            record.event("left_out", pressure_kpa=pressure, raw=raw, clipped=clipped)
            continue
        if clipped:  # the mean leans away from the sensor's end, the middle does not
            raw, u_raw = middle(counts), float(np.hypot(1.25 * u_raw, 0.3))
        _point(record, points, Point(raw, u_raw, read()))


def _check_pressures(
    config: RigConfig, pressures_kpa: Sequence[float], reference: Reference | None
) -> None:
    if len(set(pressures_kpa)) < LEAST_POINTS:
        raise ConfigError(
            "pressures", f"at least {LEAST_POINTS} different ones are needed", "add some"
        )
    for pressure in pressures_kpa:
        if not 0.0 <= pressure <= config.limits.pressure_kpa:
            raise ConfigError(
                "pressures",
                f"{pressure:g} kPa is outside 0 to {config.limits.pressure_kpa:g} kPa "
                f"({config.source}: limits.pressure_kpa)",
                "correct the list or the limit",
            )
    if reference is None and "pressure_transmitter" not in config.instruments.modbus:
        raise ConfigError(
            config.source,
            "there is no [pressure_transmitter] to serve as the reference",
            "add one, or name a gauge that you read: --gauge",
        )


# ---- force ----------------------------------------------------------------------------


def calibrate_force(
    config: RigConfig,
    masses_kg: Sequence[float],
    root: Path,
    *,
    weights: Reference,
    seconds: float = 4.0,
    who: str = "",
    operator: Operator | None = None,
    stop: StopFlag | None = None,
    watch: Watch | None = None,
) -> Calibrated:
    """Calibrate the source of force with dead weights.

    Args:
        config: the rig; the load cell or the balance, whichever is its force_source.
        masses_kg: of the weights, each once going up and once going down; 0 is hung empty.
        root: folder for the record.
        weights: the set's identity; ``u_gain`` its relative uncertainty (class of the
            weights, local g), ``u_each`` of a single one in N.
        seconds: how long each weight is measured, after it has come to rest.
        who, operator, stop, watch: as for the pressure.

    Raises:
        ConfigError: too few weights, or one beyond the rig's limit.
        DeviceTimeout: the load would not come to rest.
    """
    gravity = config.conditions.gravity_m_s2
    if len(set(masses_kg)) < LEAST_POINTS:
        raise ConfigError(
            "masses", f"at least {LEAST_POINTS} different ones are needed", "add some"
        )
    for mass in masses_kg:
        if not 0.0 <= mass * gravity <= config.limits.force_n:
            raise ConfigError(
                "masses",
                f"{mass:g} kg is {mass * gravity:.4g} N, limits.force_n is "
                f"{config.limits.force_n:g} N ({config.source})",
                "correct the list or the limit",
            )
    stop, watch = stop or StopFlag(), watch or Watch()
    parameters = {"masses_kg": list(masses_kg), "seconds": seconds, "gravity_m_s2": gravity}
    with open_rig(config, operator=operator) as rig:
        record = _record(rig, root, "calibrate-force", weights, parameters, who)
        points: list[Point] = []

        def method() -> None:
            _say(rig, "muscle off", 0.0, "take the muscle off the force sensor")
            most = max(masses_kg)
            hangs = isinstance(rig.balance, LoadCell)
            _hang(rig, 0.0 if hangs else most)
            _at_rest(rig)
            if isinstance(rig.balance, Balance):
                record.event("tare", grams=rig.balance.tare())
            for mass in up_and_down(masses_kg):
                stop.check()
                watch.state(f"calibrate force: {mass:g} kg")
                _hang(rig, mass if hangs else most - mass)
                raw, u_raw = _weigh(rig, seconds)
                _point(record, points, Point(raw, u_raw, mass * gravity))
            _hang(rig, 0.0)
            _say(rig, "muscle", 0.0, "mount the muscle again")

        _carry_out(rig, record, method)
        if isinstance(rig.balance, LoadCell):
            raw_unit, device = (
                rig.balance.indicator.unit,
                config.instruments.text["load_cell"].serial,
            )
        else:
            raw_unit, device = "g", rig.identities["balance"].get("serial", "")
        old = replace(config.calibrations["force_n"], raw_unit=raw_unit)
        return _result(record, rig, old, device, points, weights)


def _say(rig: Rig, axis: str, value: float, text: str) -> None:
    ask(rig.operator, rig.pump, Request(axis, value, "kg", f"{text}, then press Enter"))


def _hang(rig: Rig, mass_kg: float) -> None:
    text = f"load the force sensor with {mass_kg:g} kg" if mass_kg else "take all weights off"
    _say(rig, "dead weight", mass_kg, text)


def _at_rest(rig: Rig, seconds: float = 20.0) -> None:
    """Wait for readings that all say that they are stable."""
    source = rig.balance
    start, n = source.rows, 5
    rig.pump.until(lambda: source.rows >= start + n and bool(source.recent(n)[1].all()), seconds)


def _weigh(rig: Rig, seconds: float) -> tuple[float, float]:
    """Mean raw reading (g of a balance, the indicator's unit of a load cell) and its u."""
    source = rig.balance
    _at_rest(rig)
    rate_hz = source.indicator.rate_hz if isinstance(source, LoadCell) else 10.0
    n = max(3, round(seconds * rate_hz))
    start = source.rows
    if not rig.pump.until(lambda: source.rows >= start + n, 3 * seconds + 2.0):
        raise PamrigError(source.name, "sent too few readings", source.last_problem)
    if isinstance(source, LoadCell):
        return block_mean(source.indicator.recent(n)[0], 0.001)
    return block_mean(source.recent(n)[0], 0.001)


# ---- both -----------------------------------------------------------------------------


def _record(
    rig: Rig, root: Path, protocol: str, known: Reference, parameters: dict[str, Any], who: str
) -> RecordWriter:
    config = rig.config
    manifest = {
        "protocol": protocol,
        "parameters": {**parameters, "reference": dict(vars(known))},
        "specimen": "sensor",
        "operator": who,
        "rig": {"name": config.name, "description": config.description, "source": config.source,
                "crc32": config.crc32, "text": config.text},
        "calibrations": {k: c.to_dict() for k, c in config.calibrations.items()},
        "devices": rig.identities,
        "software": software(),
    }  # fmt: skip
    virtual = rig.clock.virtual
    return RecordWriter(root, manifest, rig.clock, durable=not virtual, threaded=not virtual)


def _carry_out(rig: Rig, record: RecordWriter, method: Callable[[], None]) -> None:
    """Run the method and close the record however it ends."""
    error: BaseException | None = None
    try:
        method()
    except BaseException as caught:
        error = caught
        raise
    finally:
        with contextlib.suppress(PamrigError):
            record.finalize(
                outcome_of(error),
                reason=str(error) if error is not None else "",
                duration_s=(rig.clock.now_ns() - record.start_ns) / NS_PER_S,
            )


def _point(record: RecordWriter, points: list[Point], point: Point) -> None:
    points.append(point)
    record.event("calibration_point", **vars(point))


def _result(
    record: RecordWriter,
    rig: Rig,
    old: Calibration,
    serial: str,
    points: list[Point],
    known: Reference,
) -> Calibrated:
    reference = np.array([p.reference for p in points])
    fit = fit_line(
        [p.raw for p in points], [p.u_raw for p in points], reference, known,
        f"calibration {old.quantity}",
    )  # fmt: skip
    date = datetime.fromtimestamp(rig.clock.wall_ns() / NS_PER_S, tz=UTC).date().isoformat()
    letter = old.quantity[0].upper()
    calibration = Calibration(
        quantity=old.quantity,
        unit=old.unit,
        raw_unit=old.raw_unit,
        offset=fit.offset,
        scale=fit.scale,
        u_offset=fit.u_offset,
        u_gain=fit.u_gain,
        domain=(float(reference.min()), float(reference.max())),
        id=f"{letter}-{serial or rig.config.name}-{date}",
        date=date,
        note=f"record {record.run_id}; {len(points)} points, up and down",
    )
    file = CalibrationFile(calibration, serial, fit.linearity, known.name)
    rows = tuple((p.raw, p.reference, float(r)) for p, r in zip(points, fit.residuals, strict=True))
    return Calibrated(file, rows, record.folder)
