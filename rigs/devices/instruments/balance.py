"""Driver of a laboratory balance that speaks MT-SICS (level 0 and 1).

The muscle pulls weight off the balance, so after a tare with the muscle slack a reading of
-1000 g means a pull of 9.8 N; the calibration `force_n` of the rig turns grams to newtons.
"""

from __future__ import annotations

import re
from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from daq.errors import DeviceError
from daq.link.transport import Link
from rigs.devices.event_loop import EventLoop
from rigs.devices.instruments.arrivals import Arrivals
from rigs.devices.lines import LineDevice

# The value is right-aligned in ten characters: a lost or doubled one shows by the length.
_READING = re.compile(r"^S ([SD]) (?=.{10} \S+$) *(-?\d+(?:\.\d+)?) (\S+)$")
_ANSWER = re.compile(r"^(I\d+|TA?|TI|Z|ZI|E[SLT]|@)( |$)")
KEEP_ROWS = 4096
CLOSE_NS = 10_000_000
"""No balance makes two readings so soon after each other: one was repeated or held up, or the
computer was busy."""
PAUSE_NS = 300_000_000
"""A balance makes ten readings a second or more: after this they were held up on the way."""
BALANCE_SCHEMA = {"row": "int64", "host_ns": "int64", "grams": "float64", "stable": "uint8"}
BALANCE_UNITS = {"device_us": "us", "host_ns": "ns", "grams": "g"}
"""Columns and units of the balance's stream in a record."""


class NoBalance:
    """What a bench without a balance has in its place: nothing comes from it.

    A test that needs a force is refused there before it gets so far.
    """

    name = "balance (this rig has none)"
    columns = BALANCE_SCHEMA
    rows = 0
    last_problem = ""

    def __init__(self) -> None:
        self.on_rows: list[Callable[[dict[str, npt.NDArray[np.generic]]], None]] = []
        self.on_bytes: Callable[[int, bytes], None] | None = None

    def recent(self, n: int) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.bool_]]:
        """No readings."""
        del n
        return np.zeros(0), np.zeros(0, dtype=bool)

    def tare(self, seconds: float = 10.0) -> float:
        """Refused.

        Raises:
            DeviceError: always.
        """
        del seconds
        raise DeviceError(self.name, "cannot be tared", "use a rig with a balance")

    def counters(self) -> dict[str, int]:
        """Nothing to count."""
        return {}


class Balance(LineDevice):
    """A balance that sends its readings by itself (SIR) and is tared before use.

    Every reading becomes a row (row number, host time, grams, stable). Overload, underload,
    "not ready" and other units are counted as faults and never become a value. Readings that an
    adapter delivered together stay, with the time at which they came.
    """

    columns = BALANCE_SCHEMA

    def __init__(self, link: Link, event_loop: EventLoop) -> None:
        super().__init__(link, event_loop, "balance")
        self.rows = 0
        self._grams = np.zeros(KEEP_ROWS)
        self._stable = np.zeros(KEEP_ROWS, dtype=bool)
        self._pending: list[tuple[int, int, float, bool]] = []
        self._held: tuple[int, float, bool] | None = None
        self._heard_ns = 0
        self._burst = self._paused = False
        self._arrivals = Arrivals()
        self.identity: dict[str, str] = {}
        self.on_rows: list[Callable[[dict[str, npt.NDArray[np.generic]]], None]] = []
        self.last_problem = ""

    def on_line(self, line: str, host_ns: int) -> bool:
        """Claim readings and overload marks; leave other answers to whoever made the request."""
        match = _READING.match(line)
        if match:
            if match[3] != "g":
                self._bad("unit", f"unit changed to {match[3]!r}: {line!r}")
            else:
                self._row(host_ns, float(match[2]), match[1] == "S")
            return True
        if line in ("S +", "S -"):
            self._bad("overload" if line == "S +" else "underload")
            return True
        if line == "S I":
            self._bad("refused", "not ready (S I)")
            return True
        if line.startswith("S "):
            dotted = _READING.match(line.replace(",", "."))
            kind = "comma" if "," in line and dotted else "damaged"
            self._bad(kind, f"reading that does not parse: {line!r}")
            return True
        if not _ANSWER.match(line):  # a reading without its head is no answer to a request
            self._bad("damaged", f"line that is not an answer: {line!r}")
            return True
        return False

    def _bad(self, kind: str, what: str = "") -> None:
        self.bad_lines += 1
        self.faults.add(kind, what)
        self.last_problem = what or kind

    def _row(self, host_ns: int, grams: float, stable: bool) -> None:
        """A whole reading; it stands once no other has come on its heels."""
        gap_ns, self._heard_ns = host_ns - self._heard_ns, host_ns
        close = gap_ns < CLOSE_NS
        self._arrivals.heard(host_ns, close)
        bunched = close and not self._paused and self._arrivals.possible(host_ns)
        if close and not bunched and (self._burst or self._odd(grams)):
            for _ in range(1 + (self._held is not None)):
                self._bad("stale", "two readings at once: repeated, or held up on the way")
            self._held = None
            self._burst = True
            return
        self._burst = False
        self._paused = gap_ns > PAUSE_NS
        self._release()
        self._arrivals.add(host_ns)
        self._held = (host_ns, grams, stable)

    def _odd(self, grams: float) -> bool:
        """Whether the held reading and this one, at once, cannot both stand."""
        if self._held is None:
            return False
        last = self._grams[(self.rows - 1) % KEEP_ROWS] if self.rows else None
        return self._paused or grams == self._held[1] or self._held[1] == last

    def _release(self) -> None:
        if self._held is None:
            return
        host_ns, grams, stable = self._held
        self._held = None
        slot = self.rows % KEEP_ROWS
        self._grams[slot] = grams
        self._stable[slot] = stable
        self._pending.append((self.rows, host_ns, grams, stable))
        self.rows += 1

    def poll(self) -> None:
        """Read what has come and hand new rows on."""
        super().poll()
        if self._held is not None and self._event_loop.clock.now_ns() - self._held[0] >= CLOSE_NS:
            self._release()
        if self._pending:
            row, host_ns, grams, stable = zip(*self._pending, strict=True)
            batch: dict[str, npt.NDArray[np.generic]] = {
                "row": np.array(row, dtype=np.int64),
                "host_ns": np.array(host_ns, dtype=np.int64),
                "grams": np.array(grams, dtype=np.float64),
                "stable": np.array(stable, dtype=np.uint8),
            }
            self._pending.clear()
            for listener in self.on_rows:
                listener(batch)

    def counters(self) -> dict[str, int]:
        """Beside what was lost: how late readings came together, in ms, where they did."""
        bunch_ms = self._arrivals.bunch_ms
        return super().counters() | ({"bunch_ms": bunch_ms} if bunch_ms else {})

    def recent(self, n: int) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.bool_]]:
        """The newest ``n`` readings, oldest first: (grams (n,), stable (n,))."""
        n = min(n, self.rows, KEEP_ROWS)
        index = np.arange(self.rows - n, self.rows) % KEEP_ROWS
        return self._grams[index], self._stable[index]

    def connect(self, serial: str) -> dict[str, str]:
        """Cancel what runs, ask who it is, start the stream of readings.

        Raises:
            DeviceError: another serial number than the rig file names.
        """
        self.send("@")
        self._event_loop.for_seconds(0.1)
        answer = self.request("I4", lambda line: line.startswith("I4 A "), 2.0)
        got = answer[5:].strip().strip('"')
        self.identity = {"serial": got, "protocol": "MT-SICS"}
        if serial and got != serial:
            raise DeviceError(
                self.name,
                f"key balance.serial: expected {serial}, got {got}",
                "connect the right balance, or change balance.serial in the rig file",
            )
        self.start()
        return self.identity

    def start(self) -> None:
        """Ask for readings as fast as the balance makes them."""
        self.send("SIR")

    def tare(self, seconds: float = 10.0) -> float:
        """Tare with a stable reading; returns the tare weight in g.

        Raises:
            DeviceError: the balance would not tare (not stable, out of range).
        """
        answer = self.request(
            "T", lambda line: line.startswith("T ") or line in ("ES", "EL"), seconds
        )
        match = re.match(r"^T S +(-?\d+(?:\.\d+)?) g$", answer)
        if not match:
            raise DeviceError(
                self.name,
                f"did not tare, said {answer!r}",
                "let the load come to rest and try again",
            )
        self.start()
        return float(match[1])
