"""Files derived from a record: samples in engineering units and the output of other makers.

``samples.parquet`` holds the valve stream, ``<stream>.parquet`` each other stream. The folder
``derived/`` may be deleted at any time; the record is sufficient to create it again.
"""

from __future__ import annotations

import contextlib
import shutil
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from daq.calibration import Calibration
from daq.errors import RecordError
from daq.link.clockfit import ClockMap
from daq.progress import stage
from daq.record.disk import disk_error
from daq.record.safe_read import read_inside, sum_inside
from daq.record.sealed import open_file, write_sealed
from daq.record.segments import Columns
from daq.store.annotations import annotation_sums
from daq.store.run import PARTIAL, Run, time_s
from valvefw import wire

Maker = Callable[[Run, Path], object]
"""Creates further derived files of a run in the given folder."""

# (stream, column) -> quantity of its calibration
CALIBRATED = {
    ("valve", "counts"): "pressure_kpa",
    ("valve", "setpoint_x16"): "pressure_kpa",
    ("valve_b", "counts"): "pressure_b_kpa",
    ("valve_b", "setpoint_x16"): "pressure_b_kpa",
    ("balance", "grams"): "force_n",
    **{
        ("columns", name): name
        for name in ("pressure_kpa", "force_n", "length_mm", "temperature_c")
    },
}
COMMANDS = {"inlet_u5": "inlet_cmd", "vent_u5": "outlet_cmd"}
"""Names of the valve commands, here as in the dataset format; 1 is open for the whole tick."""
VALVE_STREAM = "valve"
VALVE_STREAMS = (VALVE_STREAM, "valve_b")
"""Streams of controllers: of the only or first one, and of the second on a rig with a joint."""
_TICK_U5 = wire.TICK_US / wire.PULSE_UNIT_US


def derive(run: Run, makers: Iterable[Maker] = (), kept: Iterable[str] = ()) -> Path:
    """Create ``derived/`` again: samples in engineering units, then the files of ``makers``.

    The old folder stays unchanged until the new one is complete.

    Args:
        run: an opened run.
        makers: create the other files.
        kept: names of files that are taken over from the old folder, each if it agrees with its
            checksum there; the others are made again.

    Returns:
        the folder.

    Raises:
        RecordError: run.json is damaged, or the folder cannot be written.
    """
    fresh = run.folder / PARTIAL
    target = run.folder / "derived"
    try:
        shutil.rmtree(fresh, ignore_errors=True)
        fresh.mkdir()
        _take_over(run, set(kept), target, fresh)
        for stream in run.streams:
            path = fresh / samples_file(stream)
            if not path.exists():
                stage(f"derived files: {path.name}")
                write_samples(run, stream, path)
        for number, make in enumerate(makers, 1):
            stage(f"derived files: {getattr(make, '__name__', '').strip('_') or number}")
            make(run, fresh)
        seal_folder(run, fresh)
        if target.exists():
            shutil.rmtree(target)
        fresh.rename(target)
    except OSError as error:
        raise disk_error(target, "derived files cannot be written", error) from error
    finally:
        with contextlib.suppress(OSError):
            shutil.rmtree(fresh, ignore_errors=True)
    return target


def samples_file(stream: str) -> str:
    """Name of the file with the samples of a stream."""
    return f"{'samples' if stream == VALVE_STREAM else stream}.parquet"


def _take_over(run: Run, names: set[str], old: Path, fresh: Path) -> None:
    """Copy the named files of ``old`` that agree with its manifest."""
    with contextlib.suppress(RecordError, KeyError, TypeError, ValueError):
        manifest = open_file(read_inside(old, "manifest.json"))
        if manifest["run_id"] != run.belonging.run_id:
            return
        for name in names & set(manifest["files"]):
            about = manifest["files"][name]
            if sum_inside(old, name) == (about["size"], about["crc32"]):
                shutil.copyfile(old / name, fresh / name)


def seal_folder(run: Run, folder: Path, **more: Any) -> None:
    """Write ``manifest.json`` with size and CRC of every file in ``folder``, and ``more``."""
    files = {}
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder).as_posix()
        if path.is_file() and name != "manifest.json":
            size, crc32 = sum_inside(folder, name)
            files[name] = {"size": size, "crc32": crc32}
    write_sealed(
        folder / "manifest.json",
        {
            "schema": "pamrig-derived/2",
            "run_id": run.belonging.run_id,
            "annotations": annotation_sums(run.folder),
            **more,
            "files": files,
        },
        durable=False,
    )


def engineering(run: Run, stream: str) -> tuple[Columns, dict[str, str]]:
    """Columns of a stream in engineering units, and their units by column.

    ``time_s`` is the time since the start of the run on the host's clock. A raw column without
    calibration in the run stays raw.
    """
    raw = run.samples(stream)
    columns: Columns = {}
    units: dict[str, str] = {}
    if raw and ("host_ns" in raw or "device_us" in raw):
        start_ns = int(run.manifest["started"]["monotonic_ns"])
        columns["time_s"] = time_s(sample_host_ns(run, stream, raw), start_ns)
        units["time_s"] = "s"
    calibrations = {**run.calibrations, **run.instrument_calibrations}
    more, more_units = scaled(stream, raw, calibrations, run.schema(stream).units)
    return {**columns, **more}, {**units, **more_units}


def scaled(
    stream: str, raw: Columns, calibrations: Mapping[str, Calibration], raw_units: Mapping[str, str]
) -> tuple[Columns, dict[str, str]]:
    """Convert a stream's raw columns to engineering units, except times; also units by column.

    The live view and the derived files both use this function, so their values agree. The column
    ``reading`` of an instrument's stream uses the calibration with the stream's name.
    """
    columns: Columns = {}
    units: dict[str, str] = {}
    for name, values in raw.items():
        quantity = stream if name == "reading" else CALIBRATED.get((stream, name))
        calibration = calibrations.get(quantity) if quantity else None
        if name in ("host_ns", "device_us"):
            continue
        unit = raw_units.get(name)
        if calibration is not None:
            unit = calibration.unit
            if name == "setpoint_x16":
                name, values = "setpoint_kpa", calibration.apply(values / 16.0)
            else:
                name, values = calibration.quantity, calibration.apply(values)
        elif stream in VALVE_STREAMS and name in COMMANDS:
            name, values, unit = COMMANDS[name], values / _TICK_U5, "share of 1 ms"
        columns[name] = values
        if unit is not None:
            units[name] = unit
    return columns, units


def sample_host_ns(run: Run, stream: str, raw: Columns) -> npt.NDArray[np.int64]:
    """Host monotonic time of each sample, from the run's clock fit if there is one.

    The fit is that of ``final.json``, else of the last ``clockfit`` event. It is valid for the boot
    of most samples; other samples keep their time of arrival.
    """
    arrival = raw.get("host_ns")
    fit = clock_map(run, stream) if "device_us" in raw else None
    if fit is None or not len(raw["device_us"]):
        return np.asarray(arrival if arrival is not None else raw["device_us"] * 1000)
    fitted = fit.to_host_ns(raw["device_us"])
    if "boot" in raw and arrival is not None:
        boots, counts = np.unique(raw["boot"], return_counts=True)
        fitted = np.where(raw["boot"] == boots[counts.argmax()], fitted, arrival)
    return np.asarray(fitted)


def clock_map(run: Run, stream: str) -> ClockMap | None:
    """The clock fit of the device of ``stream``; None if the run has none.

    Any other stream with a device time is of an input of the first controller.
    """
    if stream not in VALVE_STREAMS:
        stream = VALVE_STREAM
    found: Any = (run.final or {}).get("clock_fit")
    if isinstance(found, dict) and "knots" not in found:
        found = found.get(stream)
    if found is None:
        for event in run.events:
            if event["kind"] == "clockfit" and event.get("device", stream) == stream:
                found = event if "knots" in event else event.get("fit")
    return ClockMap.from_dict(found) if found else None


def write_samples(run: Run, stream: str, path: Path) -> None:
    """Write the columns of :func:`engineering` as Parquet with units and run id as metadata."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    columns, units = engineering(run, stream)
    fields = [
        pa.field(
            name,
            pa.from_numpy_dtype(values.dtype),
            nullable=False,
            metadata={"unit": units[name]} if name in units else None,
        )
        for name, values in columns.items()
    ]
    schema = pa.schema(fields, metadata={"pamrig.run_id": run.run_id, "pamrig.stream": stream})
    table = pa.Table.from_arrays([pa.array(v) for v in columns.values()], schema=schema)
    pq.write_table(table, path, compression="zstd")
