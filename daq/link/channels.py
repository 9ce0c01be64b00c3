"""Readings of the controller's further inputs: frames to rows, each with its device time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

from daq.link.clockfit import DeviceTime
from daq.link.codec import channels_payload
from daq.link.telemetry import Gap
from valvefw import wire

_WRAP = 1 << 32
_HALF = 1 << 31
OK = wire.STATES.index("ok")
OVERLOAD = wire.STATES.index("overload")


@dataclass(frozen=True)
class Arrived:
    """When and from which start of the controller the readings of a frame came."""

    host_ns: int
    boot: int


class ChannelReading(NamedTuple):
    """One reading of an input.

    Attributes:
        device_us: device time without overflow.
        state: index of ``valvefw.wire.STATES``; only the first is a value.
        value: raw reading, or what belongs to the state.
    """

    device_us: int
    state: int
    value: int


Listener = Callable[[Arrived, list[ChannelReading]], object]


class ChannelStream:
    """Sorts readings by input, and counts what was lost on the way.

    Args:
        device_time: that of the telemetry, so that both count overflows alike.

    Attributes:
        listeners: by name of the input (``valvefw.wire.INPUTS``).
        on_gap: called with each place where readings were lost.
        readings, gaps, missing, duplicates, unknown: counts; ``unknown`` are readings of an
            input or in a state that this program does not know.
    """

    def __init__(self, device_time: DeviceTime) -> None:
        self._device_time = device_time
        self.listeners: dict[str, Listener] = {}
        self.on_gap: Callable[[Gap], object] | None = None
        self._boot: int | None = None
        self._next = 0
        self._shift = 0
        self.readings = self.gaps = self.missing = self.duplicates = self.unknown = 0

    def feed(self, payload: bytes, host_ns: int) -> None:
        """Add one payload, received at ``host_ns``.

        Raises:
            CodecError: it is none of these.
        """
        boot, seq0, rows = channels_payload(payload)
        if boot != self._boot:
            self._boot, self._next = boot, seq0
        ahead = (seq0 - self._next + _HALF) % _WRAP - _HALF
        if ahead < 0:  # sent twice: what is new begins further back
            self.duplicates += min(-ahead, len(rows))
            rows = rows[-ahead:]
        elif ahead > 0:
            self.gaps += 1
            self.missing += ahead
            if self.on_gap is not None:
                self.on_gap(Gap(self._next, ahead))
        self._next = (seq0 + len(rows) + max(0, -ahead)) % _WRAP if len(rows) else self._next
        found: dict[str, list[ChannelReading]] = {}
        for t_us, tag, value in zip(*(rows[n].tolist() for n in ("t_us", "tag", "value")),
                                    strict=True):  # fmt: skip
            which, state = tag & 15, tag >> 4
            if which >= len(wire.INPUTS) or state >= len(wire.STATES):
                self.unknown += 1
                continue
            device_us = self._device_time.unwrap(t_us, host_ns)
            found.setdefault(wire.INPUTS[which], []).append(ChannelReading(device_us, state, value))
            self.readings += 1
        arrived = Arrived(host_ns, boot)
        for name, readings in found.items():
            listener = self.listeners.get(name)
            if listener is not None:
                listener(arrived, readings)

    def counters(self) -> dict[str, int]:
        """The counts for final.json; nothing where no reading ever came."""
        names = ("readings", "gaps", "missing", "duplicates", "unknown")
        if not self.readings and not self.unknown:
            return {}
        return {f"channel_{name}": getattr(self, name) for name in names}


class EdgeCount:
    """An encoder's count beyond its 24 bits."""

    def __init__(self) -> None:
        self._last: int | None = None

    def unwrap(self, value: int) -> int:
        """The whole count; two readings are less than half of all steps apart."""
        last = self._last
        if last is None:
            self._last = value
        else:
            self._last = last + (value - last + (1 << 23)) % (1 << 24) - (1 << 23)
        return self._last
