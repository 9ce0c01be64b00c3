"""An instrument that gives readings: polled or by itself, and never a wrong one.

A text or Modbus answer does not say which question it answers, so the driver keeps order
itself. A question is put only when the line is quiet. Its answer is held back for a moment: a
second one in that time makes both worthless. After a question without an answer the line is
drained: by asking something whose answer cannot be mistaken for a reading (the *sentinel*: an
identity, a Modbus loop-back) where the instrument knows such a thing, by silence otherwise.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

from daq.calibration import Calibration
from daq.clock import NS_PER_S
from daq.errors import DeviceError, DeviceTimeout, LinkLost, PamrigError
from daq.link.transport import Chunk, Link
from rigs.devices.event_loop import EventLoop
from rigs.devices.instruments.readings import Readings
from rigs.rigfile.form import Parsed, TextForm
from rigs.rigfile.modbus_form import ModbusForm
from rigs.rigfile.tables.regulator import MonitorForm

HOLD_S = 0.05
"""An answer is held this long (or half a period, if less) in case a second one comes."""
SLOW_NS = 40_000_000
"""From this period on, two readings at once cannot be blamed on the adapter."""
REOPEN_S = 1.0
CONNECT_S = 3.0
QUIET_TIMEOUTS = 4
"""Without a sentinel the line must be silent for so many time-outs before the next question."""


class PortInstrument(Readings):
    """An `Instrument` (`rigs.devices.interfaces`) behind a port; subclasses know the bytes.

    Args:
        link: bytes to and from it.
        event_loop: of the bench; add :meth:`poll` to it.
        name: its name in the rig file.
        form: its description: quantity, unit of its readings, rate and time-out.
        polled: True when it must be polled.
        rate_hz: readings a second, instead of the description's.
        calibration: turns readings into ``quantity``; None takes them as they are.
        reopen: opens the port anew after the link was lost. Without it the loss is an error:
            so it must be for an instrument that a test cannot do without.
    """

    def __init__(
        self,
        link: Link,
        event_loop: EventLoop,
        name: str,
        form: ModbusForm | TextForm | MonitorForm,
        *,
        polled: bool,
        rate_hz: float = 0.0,
        calibration: Calibration | None = None,
        reopen: Callable[[], Link] | None = None,
    ) -> None:
        super().__init__(form.quantity, form.unit, calibration)
        rate_hz = rate_hz or form.rate_hz
        self._link: Link | None = link
        self._event_loop = event_loop
        self._port = link.name
        self.key = name
        self.rate_hz = rate_hz
        self.identity: dict[str, str] = {}
        self.on_bytes: Callable[[int, bytes], None] | None = None
        self._expected_serial = ""
        self._reopen = reopen
        self._polled = polled
        self._period_ns = round(NS_PER_S / rate_hz)
        self._timeout_ns = round(form.timeout_s * NS_PER_S)
        self._hold_ns = min(round(HOLD_S * NS_PER_S), self._period_ns // 2)
        self._state = "idle"  # idle, waiting, holding, drain
        self._until_ns = 0
        self._due_ns = 0
        self._held: tuple[int, Parsed] | None = None
        self._timed_out = False
        self._last_ns = event_loop.clock.now_ns()
        self._burst = False
        self._paused = False
        self._skip_first = not polled
        self._said_silent = False

    # ---- what a subclass knows --------------------------------------------------------

    def _query(self) -> bytes:
        """The question for one reading."""
        return b""

    def _sentinel(self) -> bytes:
        """A question whose answer cannot be taken for a reading; empty when there is none."""
        return b""

    def _decode(self, chunk: Chunk) -> Iterator[Parsed | None]:
        """What a chunk completes; None stands for the sentinel's answer."""
        raise NotImplementedError

    def _partial(self) -> bool:
        """Whether a message has begun to come whose end has not."""
        raise NotImplementedError

    def _drop_partial(self) -> int:
        """Forget the beginning of an unfinished message; how many bytes it had."""
        raise NotImplementedError

    def _start(self) -> bytes:
        """Sent once whenever the port has been opened."""
        return b""

    # ---- one round --------------------------------------------------------------------

    @property
    def name(self) -> str:
        """Which instrument and where, for messages."""
        return f"{self.key} on {self._port}"

    def poll(self) -> None:
        """Read what came, send a request when it is time, hand new rows on.

        Raises:
            LinkLost: the link is gone and this instrument may not come back by itself.
        """
        if self._link is None:
            if self._reopen is not None:
                self._find_again(self._reopen)
            return  # a loss for good was said once: what follows (venting) must go on
        try:
            for chunk in self._link.read():
                if self.on_bytes is not None:
                    self.on_bytes(chunk.host_ns, chunk.data)
                for item in self._decode(chunk):
                    self._item(item, chunk.host_ns)
            if self._link is not None:
                self._turn(self._event_loop.clock.now_ns())
        except LinkLost as error:
            self._lost(error)
        self._hand_on()

    def _item(self, item: Parsed | None, host_ns: int) -> None:
        """One whole message came."""
        if self._is_stranger:
            return
        if item is None:  # the sentinel's answer: nothing older is on its way any more
            if self._state == "drain":
                self._state = "idle"
                self._timed_out = False
            return
        if not self._polled:
            self._streamed(item, host_ns)
        elif self._state == "waiting":
            self._held = (host_ns, item)
            self._state = "holding"
            self._until_ns = host_ns + self._hold_ns
        elif self._state == "drain":
            if self._timed_out:
                self.faults.add("late", item.detail)
            self._until_ns = max(self._until_ns, host_ns + QUIET_TIMEOUTS * self._timeout_ns)
        else:
            self.faults.add("stale", item.detail)
            self._drain(host_ns, timed_out=False)

    def _streamed(self, item: Parsed, host_ns: int) -> None:
        """A message of an instrument that sends by itself.

        Two messages much closer than the rate allows were held up on the way if they follow a
        pause, and one was repeated if it says the same as the one before. Then they are
        dropped, and so is what follows as closely. Two that differ, without a pause, are a
        busy computer's. Instruments too fast to tell (an adapter collects bytes for 16 ms) are
        only held to that after a pause.
        """
        gap_ns, self._last_ns = host_ns - self._last_ns, host_ns
        self._said_silent = False
        if self._state == "drain":
            return
        if self._skip_first:  # the port may have been opened in mid-line
            self._skip_first = False
            return
        close = gap_ns < 0.3 * self._period_ns
        held = self._held[1] if self._held is not None else None
        if close and (self._burst or (held is not None and self._odd(held, item))):
            kind = "late" if self._paused else "stale"
            if self._held is not None:
                self.faults.add(kind, self._held[1].detail)
            self.faults.add(kind, item.detail)
            self._held = None
            self._burst = True
            return
        self._burst = False
        self._release()
        self._paused = gap_ns > max(2.5 * self._period_ns, 0.25 * NS_PER_S)
        if self._paused or self._period_ns >= SLOW_NS:
            self._held = (host_ns, item)
            self._until_ns = host_ns + round(0.3 * self._period_ns)
        else:
            self._take(host_ns, item)

    def _odd(self, held: Parsed, item: Parsed) -> bool:
        """Whether two messages at once cannot both stand."""
        repeated = item.value == held.value or (
            self.rows > 0 and held.value == float(self.recent(1)[0][0])
        )
        return self._paused or repeated or bool(held.fault or item.fault)

    def _turn(self, now_ns: int) -> None:
        """What time itself brings about."""
        if self._held is not None and now_ns >= self._until_ns:
            self._release()
            if self._polled:
                self._state = "idle"
        if self._state == "waiting" and now_ns >= self._until_ns:
            half = self._drop_partial()
            self.faults.add("half", f"{half} bytes") if half else self.faults.add("no_answer")
            self._drain(now_ns, timed_out=True)
        elif self._state == "drain" and now_ns >= self._until_ns:
            self._drain_on(now_ns)
        elif self._polled and self._state == "idle" and now_ns >= self._due_ns:
            self._ask_reading(now_ns)
        elif not self._polled and self._state == "idle":
            self._listen(now_ns - self._last_ns)

    def _listen(self, silent_ns: int) -> None:
        """Say once when a stream has stopped."""
        if not self._said_silent and silent_ns > 3 * self._period_ns + self._timeout_ns:
            self._said_silent = True
            self.faults.add("silent", f"for {silent_ns / NS_PER_S:.1f} s")

    def _ask_reading(self, now_ns: int) -> None:
        half = self._drop_partial()
        if half:
            self.faults.add("half", f"{half} bytes")
        self._due_ns = max(self._due_ns + self._period_ns, now_ns)
        self._state = "waiting"
        self._until_ns = now_ns + self._timeout_ns
        self._write(self._query())

    def _drain(self, now_ns: int, timed_out: bool) -> None:
        self._held = None
        self._state = "drain"
        self._timed_out = timed_out
        quiet = 1 if self._sentinel() else QUIET_TIMEOUTS
        self._until_ns = now_ns + quiet * self._timeout_ns

    def _drain_on(self, now_ns: int) -> None:
        """The line was quiet for a while: put the sentinel's question, or go on without one."""
        half = self._drop_partial()
        if half:
            self.faults.add("half", f"{half} bytes")
        sentinel = self._sentinel()
        if sentinel:
            self._until_ns = now_ns + self._timeout_ns
            self._write(sentinel)
        else:
            self._state = "idle"
            self._timed_out = False

    def _release(self) -> None:
        if self._held is not None:
            held, self._held = self._held, None
            self._take(*held)

    # ---- the link ---------------------------------------------------------------------

    def _write(self, data: bytes) -> None:
        if self._link is None:
            raise LinkLost(self.name, "the link is lost", "check cable and power")
        self._link.write(data)

    def _lost(self, error: LinkLost) -> None:
        self.faults.add("unplugged", error.what)
        self._drop_partial()
        self._held = None
        self._link = None
        self._due_ns = self._event_loop.clock.now_ns() + round(REOPEN_S * NS_PER_S)
        if self._reopen is None:
            raise LinkLost(self.name, error.what, error.remedy) from None

    def _find_again(self, reopen: Callable[[], Link]) -> None:
        """Try the port once a second; whoever answers must be who was there before."""
        now_ns = self._event_loop.clock.now_ns()
        if now_ns < self._due_ns:
            return
        self._due_ns = now_ns + round(REOPEN_S * NS_PER_S)
        try:
            self._link = reopen()
            self._begin(now_ns)
        except PamrigError:
            self._link = None
            return
        self.faults.add("replugged")

    def _begin(self, now_ns: int) -> None:
        """Fresh start on an open port: nothing is taken before the line is in order."""
        self._drop_partial()
        self._skip_first = not self._polled
        self._burst = False
        self._last_ns = self._due_ns = now_ns
        start = self._start()
        if start:
            self._write(start)
        if self._sentinel():
            self._drain(now_ns, timed_out=False)
            self._until_ns = now_ns  # poll at once
        else:
            self._state = "idle"

    def _identified(self, serial: str) -> None:
        """The instrument identified itself."""
        if self._expected_serial and serial != self._expected_serial:
            self.faults.add("stranger", f"{serial} instead of {self._expected_serial}")
            if self._reopen is not None and self._link is not None and self.rows:
                self._link.close()
        self.identity["serial"] = serial

    # ---- for the rig ------------------------------------------------------------------

    @property
    def midway(self) -> bool:
        """Whether a message has begun to come, or is held back, that is not yet counted."""
        return self._held is not None or self._partial()

    def finish(self) -> None:
        """Nothing more is waited for: what has begun to come is half a message, and counted."""
        half = self._drop_partial()
        if half:
            self.faults.add("half", f"{half} bytes")

    def connect(self, serial: str) -> dict[str, str]:
        """Check who it is, where it can say so, and that readings come.

        Raises:
            DeviceError: another serial number than the rig file names.
            DeviceTimeout: nothing that reads came; names the last fault.
        """
        self._expected_serial = serial
        self._begin(self._event_loop.clock.now_ns())
        self._event_loop.add(self.poll)
        wait_s = max(CONNECT_S, 3.0 / self.rate_hz + 5 * self._timeout_ns / NS_PER_S)
        came = self._event_loop.until(lambda: self.rows > 0 or self._is_stranger, wait_s)
        if self._is_stranger:
            got = self.identity["serial"]
            raise DeviceError(
                self.name,
                f"key {self.key}.serial: expected {serial}, got {got}",
                f"connect the right instrument, or change {self.key}.serial in the rig file",
            )
        if not came:
            raise DeviceTimeout(
                self.name,
                f"no reading within {wait_s:g} s"
                + (f"; last: {self.faults.last}" if self.faults.last else ""),
                "check port, cable, baud rate, power and the instrument's output settings",
            )
        if "serial" not in self.identity:
            self.identity["serial"] = serial
            self.identity["identity"] = "not verifiable"
        return self.identity

    @property
    def _is_stranger(self) -> bool:
        got = self.identity.get("serial")
        return bool(self._expected_serial) and got is not None and got != self._expected_serial

    def next_mean(self, n: int) -> float:
        """Wait for ``n`` new readings and return their mean in ``quantity``.

        Raises:
            DeviceTimeout: they did not come.
        """
        start = self.rows
        seconds = 3.0 * n / self.rate_hz + 10 * self._timeout_ns / NS_PER_S + 1.0
        if not self._event_loop.until(lambda: self.rows >= start + n, seconds):
            raise DeviceTimeout(
                self.name,
                f"{self.rows - start} of {n} readings within {seconds:g} s",
                self.faults.last or "check cable and power",
            )
        return self.mean(n)
