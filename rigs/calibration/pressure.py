"""Calibrating the pressure sensor: the laboratory method, top to bottom.

The bench itself makes the pressures, up and down, and a reference says what they are: a
transmitter of the rig, or a gauge that the operator reads. What was read is kept in a record of
its own; the line through it becomes a file that a rig file can name.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import nan
from pathlib import Path

import numpy as np

from analysis.regression.calibration_line import Reference
from daq.calibration import Calibration
from daq.errors import ConfigError
from daq.interrupt import StopFlag
from daq.record.writer import RecordWriter
from rigs.bench.rig import Rig, open_rig
from rigs.calibration.run import (
    Calibrated,
    Point,
    add_point,
    block_mean,
    carry_out,
    check_values,
    finish,
    middle,
    open_record,
    up_and_down,
)
from rigs.devices.operator import Request, request_number
from rigs.execution.runner import Runner, Watch
from rigs.rigfile.config import RigConfig, camera_values
from rigs.steps.custom_step import Steps
from rigs.steps.steps import Dwell, SetPressure, Settle, SettleCriterion, State, Vent

SETTLE = SettleCriterion(window_s=0.5, pressure_kpa=2.0, drift_kpa=0.5, drift_n=1.0, timeout_s=10.0)
VENTED_KPA = 5.0
TOP_COUNT = 4095
MOST_CLIPPED = 0.4
"""A point with more of its samples at the end of the sensor's range tells nothing."""


def calibrate_pressure(
    config: RigConfig,
    pressures_kpa: Sequence[float],
    root: Path,
    *,
    reference: Reference | None = None,
    seconds: float = 2.0,
    who: str = "",
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
        stop, watch: as in a test.

    Raises:
        ConfigError: no reference, too few pressures, or one beyond the rig's limit.
        PamrigError: what ends a test also ends a calibration; the bench is vented.
    """
    _check_pressures(config, pressures_kpa, reference)
    parameters = {"pressures_kpa": list(pressures_kpa), "seconds": seconds}
    with open_rig(config) as rig:
        if reference is None:
            gauge = rig.instruments["pressure_transmitter"]
            cal = gauge.calibration
            assert cal is not None
            serial = config.instruments.modbus["pressure_transmitter"].serial
            known = Reference(
                reference_name(serial, cal),
                u_offset=cal.u_offset,
                u_gain=cal.u_gain,
            )

            def read() -> float:
                return gauge.mean(max(1, round(seconds * gauge.rate_hz)))
        else:
            known = reference

            def read() -> float:
                text = f"read {known.name} in kPa, type it, then press Enter"
                return request_number(
                    rig.operator, rig.event_loop, Request("reference pressure", nan, "kPa", text)
                )

        stop = stop or StopFlag()
        record = open_record(rig, root, "calibrate-pressure", known, parameters, who)
        points: list[Point] = []
        runner = Runner(rig, record, stop, watch or Watch(), camera_values(config))
        steps = pressure_steps(rig, record, up_and_down(pressures_kpa), seconds, read, points)
        carry_out(rig, record, lambda: runner.run(steps, 2 * len(pressures_kpa) - 1), stop)
        serial = rig.identities["valve"].get("serial", "")
        old = config.calibrations["pressure_kpa"]
        return finish(record, rig, old, serial, points, known)


def pressure_steps(
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
        add_point(record, points, Point(raw, u_raw, read()))


def _check_pressures(
    config: RigConfig, pressures_kpa: Sequence[float], reference: Reference | None
) -> None:
    check_values(
        "--pressures-kpa", pressures_kpa, 0.0, config.limits.pressure_kpa, "kPa",
        f"{config.source}: limits.pressure_kpa",
    )  # fmt: skip
    if reference is None and "pressure_transmitter" not in config.instruments.modbus:
        raise ConfigError(
            config.source,
            "there is no [pressure_transmitter] to serve as the reference",
            "add one, or name a gauge that you read: --gauge",
        )


def reference_name(serial: str, calibration: Calibration) -> str:
    """Name of the transmitter as a reference: serial number, certificate and date, if stated."""
    certificate = " ".join(filter(None, (calibration.id, calibration.date)))
    words = ("pressure_transmitter", serial, f"({certificate})" if certificate else "")
    return " ".join(filter(None, words))
