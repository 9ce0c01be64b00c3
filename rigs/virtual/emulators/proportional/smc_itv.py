"""An SMC ITV regulator with RS-232C at byte level."""

from __future__ import annotations

from plant.simulator.bench import BenchSim
from rigs.rigfile.pressure_source import PressureSourceSettings
from rigs.virtual.emulators.emulator import Send
from rigs.virtual.emulators.injected_fault import Wire
from rigs.virtual.emulators.proportional.outlet import RegulatorOutlet

READY_NS = 10_000_000
FULL = 1023


class VirtualItv:
    """Takes counts of 0 to 1023 over its range.

    Args:
        outlet: the pressure that it makes.
        send: takes the bytes that go to the host.
        full_kpa: pressure at count 1023.

    Attributes:
        mute: True answers nothing.
        wire: injects faults.
    """

    def __init__(self, outlet: RegulatorOutlet, send: Send, full_kpa: float) -> None:
        self.outlet = outlet
        self.mute = False
        self.wire = Wire(send)
        self.count = 0
        self._full_kpa = full_kpa
        self._buffer = b""
        self._now_ns = 0
        self._due: list[tuple[int, str]] = []

    def feed(self, data: bytes) -> None:
        """Bytes from the host."""
        self._buffer = (self._buffer + data)[-256:]
        while b"\r\n" in self._buffer:
            line, self._buffer = self._buffer.split(b"\r\n", 1)
            answer = self._answer(line.decode("ascii", "replace").split())
            self._due.append((self._now_ns + READY_NS, answer))

    def _answer(self, words: list[str]) -> str:
        match words:
            case ["SET", number] if number.isdigit():
                return self._set(int(number))
            case ["INC"]:
                return self._set(self.count + 1)
            case ["DEC"]:
                return self._set(self.count - 1)
            case ["REQ"]:
                return str(self.count)
            case ["MON"]:
                seen = round(self.outlet.sensor_kpa() / self._full_kpa * FULL)
                return str(min(max(seen, 0), FULL))
        return "UNKNOWN COMMAND"

    def _set(self, count: int) -> str:
        if not 0 <= count <= FULL:
            return "OUT OF RANGE"
        self.count = count
        self.outlet.set_point(count / FULL * self._full_kpa)
        return str(count)

    @property
    def next_ns(self) -> int | None:
        """When it next has something to do."""
        times = [at for at, _ in self._due]
        times += [at for at in (self.wire.next_ns, self.outlet.next_ns) if at is not None]
        return min(times) if times else None

    def advance(self, to_ns: int) -> None:
        """Let time pass to ``to_ns`` (bench time)."""
        self.outlet.advance(to_ns)
        self._now_ns = to_ns
        for due in [d for d in self._due if d[0] <= to_ns]:
            self._due.remove(due)
            if not self.mute:
                self.wire.send(due[1].encode("ascii") + b"\r\n", to_ns)
        self.wire.advance(to_ns)


def emulator(settings: PressureSourceSettings, plant: BenchSim, send: Send) -> VirtualItv:
    """The emulator of a rig's ``smc-itv``."""
    return VirtualItv(RegulatorOutlet(plant), send, float(settings.own.get("full_kpa", 900.0)))
