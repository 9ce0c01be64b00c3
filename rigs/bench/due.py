"""Which calibrations of a rig are due again, or will be soon."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, date, datetime
from pathlib import Path
from typing import Any

from daq.calibration import Calibration
from rigs.rigfile.config import SENSORS, RigConfig

SOON_DAYS = 14
"""A calibration that is due within so many days is worth a warning."""


@dataclass(frozen=True)
class DueCalibration:
    """A calibration that is due, or will be within `SOON_DAYS`.

    Attributes:
        device: table of the rig file whose readings it concerns.
        calibration: the calibration.
        due: the day from which on it is due.
        days_left: until then; 0 or less where it is past.
    """

    device: str
    calibration: Calibration
    due: date
    days_left: int

    @property
    def text(self) -> str:
        """For a person."""
        cal = self.calibration
        named = f"{cal.quantity}: {cal.id or 'no id'} of {cal.date}"
        if self.days_left > 0:
            return f"{named} is due on {self.due} ({self.days_left} days left)"
        return f"{named} was due on {self.due} ({-self.days_left} days ago)"

    def as_dict(self) -> dict[str, Any]:
        """For run.json."""
        return {
            "device": self.device, "quantity": self.calibration.quantity,
            "id": self.calibration.id, "date": self.calibration.date,
            "due": self.due.isoformat(), "days_left": self.days_left,
        }  # fmt: skip


def calibrations_of(config: RigConfig) -> Iterator[tuple[str, Calibration]]:
    """(device, calibration) of every calibration of a rig, each once."""
    readers = config.instruments.readers()
    for quantity, calibration in config.calibrations.items():
        device = SENSORS.get(quantity, "camera")
        if quantity == "force_n":
            device = config.force_source
        if quantity == "length_mm" and config.length_source in readers:
            continue
        yield device, calibration
    for name, reader in readers.items():
        yield name, reader.calibration
    dynamics = config.pressure_source.dynamics
    if dynamics is not None:
        yield (
            "pressure_source",
            Calibration(
                "regulator dynamics", "", "", 0.0, 1.0,
                id=Path(dynamics.path).name, date=dynamics.date, valid_days=dynamics.valid_days,
            ),
        )  # fmt: skip


def due_calibrations(config: RigConfig, today: date | None = None) -> list[DueCalibration]:
    """The calibrations of a rig that are due by ``today`` or within `SOON_DAYS` of it."""
    today = today or datetime.now(UTC).date()
    out = []
    for device, calibration in calibrations_of(config):
        due = calibration.due
        if due is not None and (left := (due - today).days) <= SOON_DAYS:
            out.append(DueCalibration(device, calibration, due, left))
    return out
