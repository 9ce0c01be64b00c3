"""Decoding of the bytes from the simulated controllers, as by a host, into the record."""

from __future__ import annotations

from collections.abc import Callable

from daq.clock import VirtualClock
from daq.link.codec import decode_event, decode_reply
from daq.link.framer import CobsFramer
from daq.link.telemetry import VALVE_COLUMNS, VALVE_UNITS, TelemetryStream
from daq.record.writer import RecordWriter
from studies.simulation.scenario import Scenario
from valvefw import wire


class Controllers:
    """One serial line per muscle; `refused` describes the last refused request, if any."""

    def __init__(self, scenario: Scenario, record: RecordWriter, clock: VirtualClock) -> None:
        self._record = record
        self._clock = clock
        self.streams = [
            "valve" if k == 0 else f"valve-{m.name}" for k, m in enumerate(scenario.muscles)
        ]
        self._names = [m.name for m in scenario.muscles]
        self.refused = ""
        self._framers = [CobsFramer() for _ in self.streams]
        self.telemetry = [
            TelemetryStream(lambda batch, name=name: record.append(name, batch))  # type: ignore[misc]
            for name in self.streams
        ]
        for name in self.streams:
            record.stream(name, VALVE_COLUMNS, VALVE_UNITS)

    def sink(self, unit: int) -> Callable[[int, bytes], None]:
        """Returns the receiver of bytes from one controller."""

        def take(bench_us: int, data: bytes) -> None:
            host_ns = bench_us * 1000
            self._clock.set_now_ns(host_ns)
            for payload in self._framers[unit].feed(data):
                self._payload(unit, payload, host_ns)

        return take

    def _payload(self, unit: int, payload: bytes, host_ns: int) -> None:
        kind = payload[0]
        if kind == wire.TELEMETRY:
            self.telemetry[unit].feed(payload, host_ns)
        elif kind == wire.EVENT:
            text = decode_event(payload)
            what = "fault" if text.startswith("fault") else "controller"
            self._record.event(what, device=self.streams[unit], muscle=self._names[unit], text=text)
        else:
            reply = decode_reply(payload)
            if not reply.ok:
                self.refused = f"muscle {self._names[unit]!r}: {reply.code}, {reply.text}"
                self._record.event(
                    "refused", device=self.streams[unit], muscle=self._names[unit], text=reply.text
                )

    def flush(self) -> None:
        """Write buffered telemetry to the record."""
        for stream in self.telemetry:
            stream.flush()
