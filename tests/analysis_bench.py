"""A record made by hand, with known truth, for the tests of the reduction."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from daq.calibration import Calibration
from daq.clock import VirtualClock
from daq.record.writer import RecordWriter
from rigs.virtual.emulators.pictures.camera import render

GRAVITY = 9.80665
CALIBRATIONS = {
    "pressure_kpa": Calibration(
        "pressure_kpa", "kPa", "count", 0.0, 1000 / 4095, 0.3, 0.003, (-5.0, 1000.0), "P-1"
    ),
    "force_n": Calibration(
        "force_n", "N", "g", 0.0, -GRAVITY / 1000, 0.05, 0.0002, (-50.0, 200.0), "F-1"
    ),
    "length_mm": Calibration(
        "length_mm", "mm", "pixel", 40.0, 0.11, 0.02, 0.0005, (50.0, 73.0), "L-1"
    ),
}
NOISE = {"pressure_kpa": 0.5, "force_n": 0.005}
VALVE = {"seq": "int64", "host_ns": "int64", "counts": "uint16", "setpoint_x16": "uint16"}
BALANCE = {"row": "int64", "host_ns": "int64", "grams": "float64", "stable": "uint8"}


def force_n(pressure_kpa: float, length_mm: float) -> float:
    """Equation 4-7 with the reference bench's b and n."""
    b, n = 88.4e-3, 1.855
    return pressure_kpa * 1e3 * (3 * (length_mm * 1e-3) ** 2 - b**2) / (4 * np.pi * n**2)


@dataclass
class Truth:
    """The record's folder and what the muscle really did at each point."""

    folder: Path
    points: list[dict[str, float]] = field(default_factory=list)


def write_run(
    root: Path,
    rng: np.random.Generator,
    lengths_mm: tuple[float, ...] = (55.0, 60.0, 65.0),
    pressures_kpa: tuple[float, ...] = (200.0, 400.0, 600.0),
    directions: tuple[str, ...] = ("up", "down"),
    errors: bool = True,
    window: int = 500,
    finish: str | None = "clean",
    **manifest: Any,
) -> Truth:
    """Write a run whose sensors err by one draw of zero and gain, as their calibrations allow."""
    clock = VirtualClock()
    given = {
        "protocol": "isometric",
        "specimen": "synthetic",
        "operator": "nobody",
        "calibrations": {k: c.to_dict() for k, c in CALIBRATIONS.items()},
        "conditions": {"temperature_c": 21.0, "u_temperature_c": 0.2},
        **manifest,
    }
    writer = RecordWriter(root, given, clock, durable=False, threaded=False)
    writer.stream("valve", VALVE)
    writer.stream("balance", BALANCE)
    truth = Truth(Path(writer.folder))
    drawn = {
        name: (rng.normal(0, c.u_offset), rng.normal(0, c.u_gain)) if errors else (0.0, 0.0)
        for name, c in CALIBRATIONS.items()
    }

    def reading(name: str, value: Any) -> Any:
        zero, gain = drawn[name]
        calibration = CALIBRATIONS[name]
        return calibration.raw(value + zero + gain * (value - calibration.offset))

    def pressure_window(pressure: float, setpoint: float) -> list[int]:
        first = writer.rows("valve")
        seq = np.arange(first, first + window)
        noisy = pressure + rng.normal(0, NOISE["pressure_kpa"], window)
        counts = np.clip(np.round(reading("pressure_kpa", noisy)), 0, 4095).astype(np.uint16)
        host_ns = clock.now_ns() + np.arange(window) * 1_000_000
        setpoint_x16 = round(16 * float(CALIBRATIONS["pressure_kpa"].raw(setpoint)))
        wanted = np.full(window, setpoint_x16, dtype=np.uint16)
        clock.sleep(window / 1000)
        batch = {"seq": seq, "host_ns": host_ns, "counts": counts, "setpoint_x16": wanted}
        writer.append("valve", batch)
        return [first, first + window]

    def balance_window(force: float, rows: int = 10) -> list[int]:
        first = writer.rows("balance")
        noisy = force + rng.normal(0, NOISE["force_n"], rows)
        grams = np.round(reading("force_n", noisy), 3)
        writer.append(
            "balance",
            {
                "row": np.arange(first, first + rows),
                "host_ns": clock.now_ns() + np.arange(rows) * 100_000_000,
                "grams": grams,
                "stable": np.ones(rows, dtype=np.uint8),
            },
        )
        return [first, first + rows]

    def frame(length_mm: float) -> int:
        zero, gain = drawn["length_mm"]
        seen = length_mm + zero + gain * (length_mm - 40.0)
        ok, jpeg = cv2.imencode(".jpg", render(seen, rng), [cv2.IMWRITE_JPEG_QUALITY, 95])
        assert ok
        return writer.frame(jpeg.tobytes(), clock.now_ns())

    order = 0
    for trial, length in enumerate(lengths_mm, start=1):
        seq = pressure_window(0.0 if not errors else 2.0, 0.0)
        rows = balance_window(0.0)
        writer.event("zero", trial=trial, when="before", valve_seq=seq, balance_rows=rows)
        for direction in directions:
            for pressure in pressures_kpa if direction != "down" else pressures_kpa[::-1]:
                order += 1
                real_pressure = pressure + rng.normal(0, 0.5)
                real_length = length + rng.normal(0, 0.02)
                real_force = force_n(real_pressure, real_length)
                frames = [frame(real_length)]
                truth.points.append(
                    {
                        "pressure_kpa": real_pressure,
                        "length_mm": real_length,
                        "force_n": real_force,
                    }
                )
                writer.event(
                    "point",
                    trial=trial,
                    slot=f"L{length:g}",
                    replicate=1,
                    order=order,
                    mounting="m1",
                    direction=direction,
                    set_pressure_kpa=pressure,
                    set_length_mm=length,
                    valve_seq=pressure_window(real_pressure, pressure),
                    balance_rows=balance_window(real_force),
                    frames=frames,
                    settled=True,
                    waited_s=1.0,
                )
    if finish is None:
        writer.abandon()
    else:
        writer.finalize(finish, reason="", clock_fit={"error_ns": 1000}, duration_s=1.0)
    return truth
