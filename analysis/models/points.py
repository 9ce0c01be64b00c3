"""Settled points for models, from a recorded or imported run or from a table of the thesis."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from daq.errors import PamrigError

if TYPE_CHECKING:
    from daq.store.run import Run
    from plant.fitting.data import Points

_SI = {"pressure_kpa": 1e3, "length_mm": 1e-3, "force_n": 1.0}
_SENSOR = {
    "pressure_kpa": ("pressure", "sd_pressure_pa"),
    "length_mm": ("length", "sd_length_m"),
    "force_n": ("force", "sd_force_n"),
}
"""Quantity to sensor and to the field of ``Points`` with its noise."""
_THESIS = re.compile(r"^c-?0?[1-6]$", re.IGNORECASE)


def load_points(data: str, runs: Path, warm: bool = False) -> Points:
    """Points of a thesis table ("c01", "C-1") or of a run (folder, id, part of an id, "last").

    Args:
        data: name of the run or table.
        runs: folder of runs.
        warm: include the columns of a thesis table above 21 °C, which follow a formula.

    Raises:
        PamrigError: there is no such run or table, or it has no usable points.
    """
    from daq.store.store import find_run
    from plant.errors import PlantError
    from plant.fitting.thesis_points import thesis_points

    if _THESIS.match(data) and not Path(data).exists():
        try:
            return thesis_points(f"c0{data[-1]}", warm)
        except PlantError as error:
            raise PamrigError(data, str(error), "name a run or one of those tables") from None
    return run_points(find_run(runs, data))


def run_points(run: Run) -> Points:
    """The settled points of a run, with the known errors of their sensors.

    Raises:
        PamrigError: the run has no points with pressure, length and force.
    """
    from analysis.reduction.points import reduce_isometric
    from analysis.regression.force_lines import nominal_kpa
    from plant.fitting.data import Points, SensorErrors
    from plant.models.law import History

    reduction = reduce_isometric(run)
    table = reduction.table
    rows = table[table[list(_SI)].notna().all(axis=1) & table["settled"]]
    if not len(rows):
        why = reduction.notes[0] if reduction.notes else "none of its points is settled"
        raise PamrigError(run.run_id, why, "a model needs settled points: name another run")
    # At the start of each trial the muscle is vented and the balance is tared.
    slots = rows["trial"].astype(str) + "/" + rows["slot"].astype(str)
    start = (slots != slots.shift()).to_numpy(dtype=np.bool_)
    temperature = rows["temperature_c"].to_numpy(dtype=np.float64)
    noise: dict[str, Any] = {
        field: rows[f"u_{name}_noise"].to_numpy(dtype=np.float64) * _SI[name]
        for name, (_, field) in _SENSOR.items()
    }
    if not all(np.all(np.isfinite(values)) and np.any(values > 0) for values in noise.values()):
        noise = dict.fromkeys(noise)
    sensors = {}
    for name, calibration in reduction.calibrations.items():
        if name not in _SENSOR:  # the models do not use this quantity, such as a hung load
            continue
        sensors[_SENSOR[name][0]] = SensorErrors(
            zero=calibration.u_offset * _SI[name],
            gain=calibration.u_gain,
            origin=calibration.offset * _SI[name],
            zero_per_trial=name == "force_n",  # the balance is tared before each trial
        )
    lengths = rows["set_length_mm"].fillna(rows["length_mm"].round(1))
    cells = [
        f"{p:g} kPa {x:g} mm {d}"
        for p, x, d in zip(nominal_kpa(rows), lengths, rows["direction"], strict=True)
    ]
    return Points(
        pressure_pa=rows["pressure_kpa"].to_numpy(dtype=np.float64) * 1e3,
        length_m=rows["length_mm"].to_numpy(dtype=np.float64) * 1e-3,
        temperature_c=np.where(np.isfinite(temperature), temperature, 21.0),
        force_n=rows["force_n"].to_numpy(dtype=np.float64),
        **noise,
        sensors=sensors,
        length_label=np.array([f"{x:g} mm" for x in lengths]),
        mounting_label=rows["mounting"].astype(str).to_numpy(dtype=np.str_),
        pressure_label=np.array([f"{p:g} kPa" for p in nominal_kpa(rows)]),
        cell=np.array(cells),
        path=History(None, start),
        source=f"run {run.run_id}",
    )
