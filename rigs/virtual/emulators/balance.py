"""A balance at byte level: MT-SICS over whatever carries the bytes."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

import numpy as np

from rigs.virtual.emulators.emulator import Send
from rigs.virtual.emulators.injected_fault import Wire

SAMPLE_NS = 100_000_000
STABLE_READINGS = 5
STABLE_G = 5.0
CAPACITY_G = 21_000.0


class VirtualBalance:
    """A mass on a balance, with the muscle pulling at the mass.

    Args:
        force_n: the muscle's true pull now, in N (positive lifts).
        send: takes the bytes that go to the host.
        rng: draws noise and the residual zero of each tare.
        serial: what I4 answers.
        gravity_m_s2: turns pull into grams.
        gain: relative error of the reading.
        zero_n: standard deviation of the residual zero that each tare leaves, in N
            (hose pull, pan friction); 0 for none.
        noise_n: standard deviation of a reading, in N.
        offset_n: pull that every reading shows beyond the true one, whenever it was tared.

    Attributes:
        unit: unit set at the keypad.
        comma: True prints decimal commas.
        flag: "overload" or "underload" is printed in place of a reading.
        wire: injects faults.
        period_ns: time between two readings.
    """

    def __init__(  # noqa: PLR0913 - a balance has that many named properties
        self,
        force_n: Callable[[], float],
        send: Send,
        rng: np.random.Generator,
        serial: str,
        gravity_m_s2: float,
        gain: float = 0.0,
        zero_n: float = 0.0,
        noise_n: float = 0.005,
        offset_n: float = 0.0,
    ) -> None:
        self._force_n = force_n
        self._rng = rng
        self._serial = serial
        self._grams_per_n = 1000.0 / gravity_m_s2
        self._gain = gain
        self._zero_g = zero_n * self._grams_per_n
        self._noise_g = noise_n * self._grams_per_n
        self._offset_g = offset_n * self._grams_per_n
        self._buffer = bytearray()
        self._tare_g = -5000.0  # a mass of 5 kg rests on the pan until it is tared away
        self._history: deque[float] = deque(maxlen=STABLE_READINGS)
        self._streaming = False
        self._pending: str | None = None
        self.unit = "g"
        self.comma = False
        self.flag = ""
        self.wire = Wire(send)
        self._now_ns = 0
        self._sample_ns = SAMPLE_NS
        self.period_ns = SAMPLE_NS

    def feed(self, data: bytes) -> None:
        """Bytes from the host."""
        self._buffer += data
        while (end := self._buffer.find(b"\n")) >= 0:
            line = self._buffer[:end].decode("ascii", "replace").strip()
            del self._buffer[: end + 1]
            if line:
                self._command(line)
        del self._buffer[:-256]

    def _send_line(self, line: str) -> None:
        self.wire.send(line.encode("ascii") + b"\r\n", self._now_ns)

    def _command(self, line: str) -> None:
        if line in ("S", "SI", "@", "SIR", "SR"):
            self._streaming = False
        if line == "@":
            self._pending = None
            self._send_line(f'I4 A "{self._serial}"')
        elif line == "I4":
            self._send_line(f'I4 A "{self._serial}"')
        elif line == "SI":
            self._reading()
        elif line == "SIR":
            self._streaming = True
        elif line in ("S", "T", "Z"):
            self._pending = line  # answered by the next stable reading
        else:
            self._send_line("ES")

    @property
    def next_ns(self) -> int:
        """When it next has something to do."""
        held = self.wire.next_ns
        return self._sample_ns if held is None else min(held, self._sample_ns)

    def advance(self, to_ns: int) -> None:
        """Take every sample that is due by ``to_ns`` (bench time)."""
        while self._sample_ns <= to_ns:
            self._now_ns = self._sample_ns
            self._sample_ns += self.period_ns
            self._sample()
        self._now_ns = to_ns
        self.wire.advance(to_ns)

    def _sample(self) -> None:
        pull = self._force_n() * (1.0 + self._gain) * self._grams_per_n
        self._history.append(-pull + self._rng.normal(0.0, self._noise_g))
        if self._pending is not None and self._stable:
            self._answer(self._pending)
            self._pending = None
        if self._streaming:
            self._reading()

    def _answer(self, command: str) -> None:
        if command == "S":
            self._reading()
            return
        residual = self._rng.normal(0.0, self._zero_g) if self._zero_g else 0.0
        self._tare_g = self._history[-1] + residual
        if command == "T":
            self._send_line(f"T S {self._tare_g:10.3f} g")
        else:
            self._send_line("Z A")

    @property
    def _stable(self) -> bool:
        h = self._history
        return len(h) == STABLE_READINGS and max(h) - min(h) < STABLE_G

    def _reading(self) -> None:
        if not self._history:
            self._send_line("S I")
            return
        grams = self._history[-1] - self._tare_g - self._offset_g
        if self.flag or abs(grams) > CAPACITY_G:
            over = self.flag == "overload" or (not self.flag and grams > 0)
            self._send_line("S +" if over else "S -")
        else:
            line = f"S {'S' if self._stable else 'D'} {grams:10.3f} {self.unit}"
            self._send_line(line.replace(".", ",") if self.comma else line)
