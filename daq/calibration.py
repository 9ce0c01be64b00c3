"""A linear calibration with uncertainty, valid range and provenance."""

from __future__ import annotations

import datetime as dt
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from typing import Any

import numpy as np
import numpy.typing as npt

from daq.errors import ConfigError

Floats = npt.NDArray[np.float64]
MOST_DAYS = 36500
BEYOND = 0.005
"""Part of the calibrated range by which a value may lie outside it without a warning."""


@dataclass(frozen=True)
class Calibration:
    """``value = offset + scale * raw``.

    Attributes:
        quantity: name of the calibrated column, with unit: ``pressure_kpa``.
        unit: unit of the value: ``kPa``.
        raw_unit: unit of the raw reading: ``counts``, ``g``, ``pixel``.
        offset: value at raw zero, in ``unit``.
        scale: value per raw unit; not zero.
        u_offset: standard uncertainty of the offset, in ``unit``.
        u_gain: relative standard uncertainty of the scale.
        domain: calibrated range of the value, ``(low, high)``.
        id: certificate or file of origin.
        date: date of the calibration, ISO.
        note: free text.
        valid_days: days after ``date`` at which it is due again; 0 where none are stated.
    """

    quantity: str
    unit: str
    raw_unit: str
    offset: float
    scale: float
    u_offset: float = 0.0
    u_gain: float = 0.0
    domain: tuple[float, float] = (-np.inf, np.inf)
    id: str = ""
    date: str = ""
    note: str = ""
    valid_days: int = 0

    def __post_init__(self) -> None:
        where = f"calibration {self.quantity}"
        numbers = (self.offset, self.scale, self.u_offset, self.u_gain)
        if not all(np.isfinite(n) for n in numbers) or self.scale == 0:
            raise ConfigError(
                where,
                f"offset {self.offset}, scale {self.scale}, u_offset {self.u_offset}, "
                f"u_gain {self.u_gain}: expected finite numbers and a scale other than 0",
            )
        if self.u_offset < 0 or self.u_gain < 0:
            raise ConfigError(where, "an uncertainty is negative", "give it as a positive number")
        if not self.domain[0] < self.domain[1]:
            raise ConfigError(where, f"domain {self.domain} is empty", "give it as [low, high]")
        whole = isinstance(self.valid_days, int) and not isinstance(self.valid_days, bool)
        if not whole or not 0 <= self.valid_days <= MOST_DAYS:
            what = f"valid_days = {self.valid_days!r}: expected a whole number"
            raise ConfigError(where, f"{what} from 0 to {MOST_DAYS}", "0: no due date")
        if self.valid_days and self.due is None:
            what = f"valid_days is stated, and date = {self.date!r} is no date"
            raise ConfigError(where, what, "write the date as YYYY-MM-DD")

    @property
    def due(self) -> dt.date | None:
        """The day from which on it is due again; None where nothing says so."""
        try:
            made = dt.date.fromisoformat(self.date[:10])
            return made + dt.timedelta(days=self.valid_days) if self.valid_days else None
        except (ValueError, OverflowError):
            return None

    def apply(self, raw: npt.ArrayLike) -> Floats:
        """Convert raw readings to values in ``unit``, same shape."""
        return np.asarray(self.offset + self.scale * np.asarray(raw, dtype=np.float64))

    def raw(self, value: npt.ArrayLike) -> Floats:
        """Convert values in ``unit`` to raw readings: the inverse of :meth:`apply`."""
        return np.asarray((np.asarray(value, dtype=np.float64) - self.offset) / self.scale)

    def u(self, value: npt.ArrayLike) -> Floats:
        """Standard uncertainty of calibrated values, in ``unit``."""
        span = self.u_gain * (np.asarray(value, dtype=np.float64) - self.offset)
        return np.asarray(np.hypot(self.u_offset, span))

    def outside(self, value: npt.ArrayLike) -> npt.NDArray[np.bool_]:
        """True where a value lies clearly outside the calibrated range.

        Clearly: by more than its expanded uncertainty and than `BEYOND` of the range. A sensor
        calibrated from 0 upwards reads a little below zero without load.
        """
        v = np.asarray(value, dtype=np.float64)
        low, high = self.domain
        width = BEYOND * (high - low) if np.isfinite(high - low) else 0.0
        margin = np.maximum(2.0 * self.u(v), width)
        return np.asarray((v < low - margin) | (v > high + margin))

    def to_dict(self) -> dict[str, Any]:
        """The attributes for run.json; an open end of the domain is None."""
        plain = asdict(self)
        plain["domain"] = [d if np.isfinite(d) else None for d in self.domain]
        if not self.valid_days:
            del plain["valid_days"]
        return plain

    @staticmethod
    def from_dict(given: Mapping[str, Any], where: str = "calibration") -> Calibration:
        """Create a calibration from run.json or a rig file.

        Args:
            given: the attributes by name.
            where: file and key for the error message.

        Raises:
            ConfigError: a key is unknown or missing, or a value is invalid.
        """
        known = {f.name for f in fields(Calibration)}
        needed = {"quantity", "unit", "raw_unit", "offset", "scale"}
        unknown, missing = sorted(set(given) - known), sorted(needed - set(given))
        if unknown or missing:
            lists = {"unknown key": unknown, "missing key": missing}
            what = "; ".join(f"{kind} {', '.join(keys)}" for kind, keys in lists.items() if keys)
            raise ConfigError(where, what, f"known keys: {', '.join(sorted(known))}")
        plain = dict(given)
        for f in fields(Calibration):
            if f.type == "str" and not isinstance(plain.get(f.name, ""), str):
                raise ConfigError(where, f"{f.name}: expected text, got {plain[f.name]!r:.60}")
        try:
            for key in ("offset", "scale", "u_offset", "u_gain"):
                if key in plain:
                    plain[key] = float(plain[key])
            if "domain" in plain:
                low, high = plain["domain"]
                plain["domain"] = (
                    -np.inf if low is None else float(low),
                    np.inf if high is None else float(high),
                )
        except (TypeError, ValueError) as error:
            raise ConfigError(where, f"not a number: {error}") from error
        return Calibration(**plain)


@dataclass(frozen=True)
class StandardReading:
    """What an instrument read of a reference standard.

    Attributes:
        channel: "length_mm" (a block before the camera), "held_length_mm" (the length that is
            written down with a block between the holders), "pressure_kpa" or "force_n".
        true: value of the standard, in the unit of the channel.
        read: what the instrument read.
        u: standard uncertainty of read minus true.
    """

    channel: str
    true: float
    read: float
    u: float
