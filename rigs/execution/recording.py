"""The optional instruments in a run's record: streams, faults, calibrations, temperature."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from daq.errors import RecordError
from rigs.devices.instruments import supply
from rigs.devices.instruments.instrument import PortInstrument
from rigs.devices.instruments.marks import NOT_STORED, MarkReader
from rigs.devices.instruments.readings import COLUMNS, Batch
from rigs.devices.operator import ManualSetting
from rigs.rigfile.config import NONE

if TYPE_CHECKING:
    from daq.record.writer import RecordWriter
    from rigs.bench.rig import Rig
    from rigs.devices.camera import Frame

REGULATOR = "regulator"
"""Stream of a proportional regulator's own reading."""
TIMES = {"device_us": "us", "host_ns": "ns"}
TOLD = 20
"""So many faults of a kind become events of their own; then each hundredth. All are counted."""


def temperature(rig: Rig) -> dict[str, Any]:
    """Temperature of the record: by the thermometer, or as typed into the rig file."""
    typed = rig.config.conditions
    thermometer = rig.instruments.get("thermometer")
    if thermometer is None or not thermometer.rows or thermometer.calibration is None:
        return {
            "temperature_c": typed.temperature_c,
            "u_temperature_c": typed.u_temperature_c,
            "temperature_source": "rig file",
        }
    value = thermometer.mean(5)
    return {
        "temperature_c": value,
        "u_temperature_c": float(thermometer.calibration.u(value)),
        "temperature_source": "thermometer",
    }


def instrument_manifest(rig: Rig) -> dict[str, Any]:
    """What goes into run.json: nothing at all for a rig without such instruments."""
    out: dict[str, Any] = {}
    frozen = {
        name: instrument.calibration.to_dict()
        for name, instrument in rig.instruments.items()
        if instrument.calibration is not None
    }
    source = rig.config.pressure_source
    if source.dynamics is not None:
        out["regulator"] = source.dynamics.to_dict()
    if frozen:
        out["instrument_calibrations"] = frozen
    if rig.config.force_source not in ("balance", NONE):
        out["force_source"] = rig.config.force_source
    if rig.length_reader is not None:
        out["length_source"] = rig.config.length_source
    if source.sensor:
        out["pressure_sensor"] = {
            "instrument": source.sensor,
            "band_kpa": source.sensor_band_kpa or None,
            "lag_s": source.sensor_lag_s,
            "stale_s": source.sensor_stale_s,
        }
    if rig.config.joint is not None:
        out["joint"] = rig.config.joint.as_dict()
    if "thermometer" in rig.instruments:
        out["conditions"] = {**vars(rig.config.conditions), **temperature(rig)}
    return out


def record_instruments(rig: Rig, record: RecordWriter) -> None:
    """A stream for each instrument as it reads, and an event for each fault and hand setting."""
    if rig.config.camera.source:
        rig.camera.faults.on_fault.append(_teller(record, "camera", rig.camera.faults.counts))
    for name, instrument in rig.instruments.items():
        columns = instrument.columns
        units = {n: u for n, u in TIMES.items() if n in columns}
        if isinstance(instrument, MarkReader):
            units["u_deg"] = "deg"
            instrument.keep = _keeper(record)
        record.stream(name, columns, {**units, "reading": instrument.unit})
        instrument.on_rows.append(recorder(record, name))
        instrument.faults.on_fault.append(_teller(record, name, instrument.faults.counts))
    if rig.supply is not None:
        record.stream("supply", supply.COLUMNS, supply.UNITS)
        rig.supply.on_rows.append(recorder(record, "supply"))
        rig.supply.faults.on_fault.append(_teller(record, "supply", rig.supply.faults.counts))
    own = rig.pressure_source.own_device
    if isinstance(own, PortInstrument):  # its own reading, never the pressure of a test
        record.stream(REGULATOR, COLUMNS, {"host_ns": "ns", "reading": own.unit})
        own.on_rows.append(recorder(record, REGULATOR))
    if own is not None:
        own.faults.on_fault.append(_teller(record, "pressure_source", own.faults.counts))
    for axis in _axes(rig):
        axis.on_setting.append(lambda setting: _set(record, setting))


def instrument_counters(rig: Rig) -> dict[str, dict[str, int]]:
    """Rows and faults by kind of every optional instrument."""
    out = {name: instrument.counters() for name, instrument in rig.instruments.items()}
    if rig.supply is not None:
        out["supply"] = rig.supply.counters()
    if rig.pressure_source.own_device is not None:
        out["pressure_source"] = rig.pressure_source.own_device.counters()
    return out


def _axes(rig: Rig) -> list[Any]:
    axis = getattr(rig.stage, "axis", None)
    return [*rig.axes.values(), *([axis] if axis is not None else [])]


def recorder(record: RecordWriter, stream: str) -> Callable[[Batch], None]:
    """Appends batches to a stream of the record.

    A disk that fails ends the run by ``record.failed``, which the runner looks at in every round;
    the drivers read on, so that the closing vent is seen to its end.
    """

    def append(batch: Batch) -> None:
        with contextlib.suppress(RecordError):
            record.append(stream, batch)

    return append


def _keeper(record: RecordWriter) -> Callable[[Frame, bytes], int]:
    """Stores a picture; a disk that fails ends the run as for readings."""

    def keep(frame: Frame, jpeg: bytes) -> int:
        with contextlib.suppress(RecordError):
            return record.frame(jpeg, frame.host_ns, seq=frame.seq)
        return NOT_STORED

    return keep


def _teller(record: RecordWriter, name: str, counts: dict[str, int]) -> Callable[[str, str], None]:
    def report(kind: str, words: str) -> None:
        n = counts[kind]
        if n <= TOLD or n % 100 == 0:
            record.event("instrument", device=name, fault=kind, count=n, text=words)

    return report


def _set(record: RecordWriter, setting: ManualSetting) -> None:
    record.event("manual", **vars(setting))
