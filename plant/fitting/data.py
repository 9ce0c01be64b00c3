"""Settled points for a fit: SI arrays, their uncertainties, their groups."""

from __future__ import annotations

import dataclasses
import hashlib
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from plant.arrays import Array
from plant.errors import PlantError
from plant.models.law import History

Labels = npt.NDArray[np.str_]


@dataclass(frozen=True)
class SensorErrors:
    """Zero and gain uncertainty (1 sd) of one sensor, common to all points of a run.

    A reading is value + zero + gain (value - origin); `zero` and `origin` in SI (Pa, m, N).
    `zero_per_trial`: the zero error is independent for each trial, as after a tare.
    """

    zero: float
    gain: float
    origin: float = 0.0
    zero_per_trial: bool = False


@dataclass(frozen=True)
class Points:
    """Settled points, each array of shape (n,).

    Attributes:
        pressure_pa, length_m, temperature_c, force_n: the readings.
        sd_pressure_pa, sd_length_m, sd_force_n: noise of each reading, 1 sd; None if unknown.
        sensors: common errors of all readings of a sensor; empty if unknown.
        length_label, temperature_label, mounting_label, pressure_label: groups that a fold can
            hold out.
        cell: name of the set-points; repeated points have the same name.
        path: order of the points, for laws with memory.
        source: origin of the data.
    """

    pressure_pa: Array
    length_m: Array
    temperature_c: Array
    force_n: Array
    sd_pressure_pa: Array | None = None
    sd_length_m: Array | None = None
    sd_force_n: Array | None = None
    sensors: dict[str, SensorErrors] = field(default_factory=dict)
    length_label: Labels | None = None
    temperature_label: Labels | None = None
    mounting_label: Labels | None = None
    pressure_label: Labels | None = None
    cell: Labels | None = None
    path: History | None = None
    source: str = ""

    def __post_init__(self) -> None:
        arrays = {n: getattr(self, n) for n in ("pressure_pa", "length_m", "temperature_c")}
        for name, array in {**arrays, "force_n": self.force_n}.items():
            if array.shape != (self.force_n.size,):
                raise PlantError(f"points {self.source}: {name} has shape {array.shape}")
            if not np.all(np.isfinite(array)):
                raise PlantError(f"points {self.source}: {name} has a value that is not finite")

    def __len__(self) -> int:
        return int(self.force_n.size)

    def take(self, which: npt.NDArray[np.bool_]) -> Points:
        """The points where `which` is true; a trial without its first point starts at the next.

        The remaining points of a trial are treated as consecutive.
        """
        changes: dict[str, object] = {}
        for item in dataclasses.fields(self):
            value = getattr(self, item.name)
            if isinstance(value, np.ndarray):
                changes[item.name] = value[which]
        if self.path is not None:
            changes["path"] = _part(self.path, which)
        return dataclasses.replace(self, **changes)  # type: ignore[arg-type]

    def labels(self, kind: str) -> Labels:
        """Names of groups: "length", "pressure", "temperature", "mounting" or "load" (isotonic)."""
        given = getattr(self, f"{kind}_label", None)
        if given is not None:
            return np.asarray(given)
        if kind == "length":
            return np.array([f"{x:.2f} mm" for x in self.length_m * 1e3])
        if kind == "pressure":
            return np.array([f"{x:.0f} kPa" for x in self.pressure_pa / 1e3])
        if kind == "temperature":
            return np.array([f"{x:.0f} °C" for x in self.temperature_c])
        if kind == "mounting":
            return np.full(len(self), "m1")
        if kind == "load":
            return np.array([f"{x:.2f} N" for x in self.force_n])
        raise PlantError(
            f"cannot hold out {kind!r}; choose length, pressure, temperature, mounting or load"
        )

    def trials(self) -> npt.NDArray[np.int64]:
        """Number of the trial of each point; all 0 if the trials are unknown."""
        if self.path is None or self.path.start is None:
            return np.zeros(len(self), dtype=np.int64)
        return np.cumsum(self.path.start)

    def pulling(self, least_n: float) -> Points:
        """The points with at least this force; below, the muscle counts as slack.

        Raises `PlantError` if none is left.
        """
        use = self.force_n >= least_n
        if not np.any(use):
            raise PlantError(
                f"{self.source}: no point pulls {least_n:g} N, the largest force is "
                f"{self.force_n.max():g} N; state a smaller least force"
            )
        return self.take(use)

    def sha256(self) -> str:
        """Hash of the readings, independent of the machine."""
        digest = hashlib.sha256()
        for array in (self.pressure_pa, self.length_m, self.temperature_c, self.force_n):
            digest.update(np.ascontiguousarray(array, dtype="<f8").tobytes())
        return digest.hexdigest()


def joined(parts: list[Points], source: str = "") -> Points:
    """Several sets of points as one; noise and labels are kept if all parts have them.

    Sensor errors are kept only for a single part, because different runs do not share them.
    """
    if len(parts) == 1:
        return parts[0]
    if not parts:
        raise PlantError("no points given; name at least one run or table")
    values: dict[str, object] = {}
    for item in dataclasses.fields(Points):
        arrays = [getattr(part, item.name) for part in parts]
        if all(isinstance(a, np.ndarray) for a in arrays):
            values[item.name] = np.concatenate(arrays)
    starts = []
    for part in parts:
        start = np.zeros(len(part), dtype=np.bool_)
        if part.path is not None and part.path.start is not None:
            start |= part.path.start
        start[:1] = True
        starts.append(start)
    times = [p.path.time_s for p in parts if p.path is not None and p.path.time_s is not None]
    time_s = np.concatenate(times) if len(times) == len(parts) else None
    values["path"] = History(time_s, np.concatenate(starts))
    return Points(**values, source=source or " + ".join(p.source for p in parts))  # type: ignore[arg-type]


def _part(path: History, which: npt.NDArray[np.bool_]) -> History:
    time_s = None if path.time_s is None else path.time_s[which]
    if path.start is None:
        return History(time_s, None)
    trial = np.cumsum(path.start)[which]
    start = np.ones(trial.size, dtype=np.bool_)
    start[1:] = trial[1:] != trial[:-1]
    return History(time_s, start)
