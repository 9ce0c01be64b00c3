"""Any instrument that speaks in lines, by its description: no code of its own."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from daq.calibration import Calibration
from daq.clock import NS_PER_S
from daq.errors import DeviceTimeout
from daq.link.framer import LineFramer
from daq.link.transport import Chunk, Link
from rigs.devices.event_loop import EventLoop
from rigs.devices.instruments.instrument import PortInstrument
from rigs.rigfile.form import Parsed, TextForm

LINE_GAP_S = 0.2
"""A line whose characters stop for so long is a half line; the next one starts anew."""


class TextInstrument(PortInstrument):
    """A line-based instrument, sending by itself or polled.

    Args:
        link, event_loop, name, calibration, reopen: see :class:`PortInstrument`.
        form: what it says and how.
        rate_hz: instead of the description's, where the instrument is set so.
    """

    def __init__(
        self,
        link: Link,
        event_loop: EventLoop,
        name: str,
        form: TextForm,
        *,
        rate_hz: float = 0.0,
        calibration: Calibration | None = None,
        reopen: Callable[[], Link] | None = None,
    ) -> None:
        super().__init__(
            link, event_loop, name, form, polled=bool(form.query), rate_hz=rate_hz,
            calibration=calibration, reopen=reopen,
        )  # fmt: skip
        self.form = form
        self._framer = LineFramer(form.end[-1:])
        self._heard_ns = 0

    def _query(self) -> bytes:
        return self.form.query.encode("ascii") + self.form.end

    def _sentinel(self) -> bytes:
        text = self.form.identify
        return text.encode("ascii") + self.form.end if text else b""

    def _start(self) -> bytes:
        text = self.form.start
        return text.encode("ascii") + self.form.end if text else b""

    def _partial(self) -> bool:
        return bool(self._framer.partial)

    def _drop_partial(self) -> int:
        return self._framer.discard()

    def _decode(self, chunk: Chunk) -> Iterator[Parsed | None]:
        pause_ns = chunk.host_ns - self._heard_ns
        self._heard_ns = chunk.host_ns
        if self._framer.partial.strip() and pause_ns > LINE_GAP_S * NS_PER_S:
            self.faults.add("half", repr(self._framer.partial))
            self._framer.discard()
        for text, wrong in self._framer.texts(chunk.data):
            if wrong:
                yield Parsed("damaged", detail=wrong)
                continue
            pattern = self.form.identify_pattern
            who = pattern.fullmatch(text.strip()) if pattern is not None else None
            if who is not None:
                self._identified(who["serial"])
                yield None
            else:
                yield self.form.parse(text)

    def tare(self, seconds: float = 10.0) -> float:
        """Send the tare command and wait until the readings are at rest near zero.

        Returns:
            The mean reading after the tare, in the instrument's unit.

        Raises:
            DeviceTimeout: the readings did not come to rest.
        """
        self._write(self.form.tare.encode("ascii") + self.form.end)
        return self.at_rest(seconds)

    def at_rest(self, seconds: float = 10.0) -> float:
        """Mean of the next half second of readings that all say "stable"; unit as it comes.

        Raises:
            DeviceTimeout: they did not come.
        """
        n = max(3, round(self.rate_hz * 0.5))
        start = self.rows

        def still() -> bool:
            return self.rows >= start + n and bool(self.recent(n)[1].all())

        if not self._event_loop.until(still, seconds):
            raise DeviceTimeout(
                self.name,
                f"readings did not come to rest within {seconds:g} s",
                self.faults.last or "let the load come to rest and try again",
            )
        return float(self.recent(n)[0].mean())
