"""One simulated instrument on a desk: its driver, its wire and a clock, nothing else."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

from daq.clock import VirtualClock
from daq.errors import LinkLost, PortError
from daq.link.transport import Link, MemoryLink, memory_pair
from rigs.devices.event_loop import EventLoop


class Device(Protocol):
    @property
    def next_ns(self) -> int | None: ...

    def feed(self, data: bytes) -> None: ...

    def advance(self, now_ns: int) -> None: ...


class Desk:
    """Joins an emulator (made by ``make(send)``) to links that can be pulled and put back.

    ``truth`` is the quantity now; it changes at each millisecond, so that a reading that is
    not of its own time shows as a wrong value.
    """

    def __init__(self, make: Callable[[Callable[[], float], Callable[[bytes], None]], Any]) -> None:
        self.clock = VirtualClock()
        self.event_loop = EventLoop(self.clock, 0.005)
        self.plugged = True
        self._end: Link | None = None
        self.host: MemoryLink = self._make_link()
        self.device = make(lambda: self.truth(self.clock.now_ns()), self._send)
        self.clock.on_advance(self._advance)
        self.rows: list[tuple[int, float]] = []

    def truth(self, now_ns: int) -> float:
        """A ramp: 10 and a little more each second."""
        return 10.0 + now_ns * 1e-9 * 0.1

    def _make_link(self) -> MemoryLink:
        host, self._end = memory_pair(self.clock, "desk")
        return host

    def _send(self, data: bytes) -> None:
        if self.plugged and self._end is not None:
            self._end.write(data)

    def _advance(self, until_ns: int) -> None:
        if self.plugged and self._end is not None:
            try:
                for chunk in self._end.read():
                    self.device.feed(chunk.data)
            except LinkLost:  # the host closed the port
                self._end = None
        while self.clock.now_ns() < until_ns:
            due = self.device.next_ns
            stop = until_ns if due is None else min(until_ns, max(due, self.clock.now_ns() + 1))
            self.clock.set_now_ns(stop)
            self.device.advance(stop)

    def reopen(self) -> Link:
        """What the driver calls to find its port again."""
        if not self.plugged:
            raise PortError("desk", "no such port", "plug the device in")
        self.host = self._make_link()
        return self.host

    def unplug(self) -> None:
        self.plugged = False
        self._end = None
        self.host.unplug()

    def replug(self) -> None:
        self.plugged = True

    def watch(self, driver: Any, column: str = "reading") -> None:
        """Collect every row that the driver hands on."""
        driver.on_rows.append(
            lambda batch: self.rows.extend(
                zip(batch["host_ns"].tolist(), batch[column].tolist(), strict=True)
            )
        )

    def worst(self, delay_ns: int = 0) -> float:
        """Largest difference between a row and the truth at its own time."""
        return max((abs(v - self.truth(t - delay_ns)) for t, v in self.rows), default=0.0)
