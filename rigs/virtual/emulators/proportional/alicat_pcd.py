"""An Alicat dual-valve pressure controller at byte level."""

from __future__ import annotations

import string

from plant.simulator.bench import BenchSim
from rigs.rigfile.pressure_source import PressureSourceSettings
from rigs.virtual.emulators.emulator import Send
from rigs.virtual.emulators.injected_fault import Wire
from rigs.virtual.emulators.proportional.outlet import RegulatorOutlet

READY_NS = 4_000_000
LINE_NS = 2_000_000
STREAM_NS = 50_000_000
PER_KPA = {"PSIG": 1 / 6.894757293168, "kPaG": 1.0, "barG": 0.01, "PSIA": 1 / 6.894757293168}
CODES = {"PSIG": "010", "kPaG": "005", "barG": "007", "PSIA": "010"}
DIGITS = {"PSIG": 2, "kPaG": 1, "barG": 3, "PSIA": 2}
COLUMNS = "ID_ NAME______________________ TYPE_______ WIDTH NOTES___________________"


class VirtualAlicat:
    """Answers as a PCD with firmware 10v does.

    Args:
        outlet: the pressure that it makes.
        send: takes the bytes that go to the host.
        serial: in its list of facts.
        unit: its letter; "@" while it streams.
        label: pressure unit set at the panel.

    Attributes:
        codes: status codes at the end of each frame.
        mute: True answers nothing.
        wire: injects faults.
    """

    def __init__(
        self,
        outlet: RegulatorOutlet,
        send: Send,
        serial: str,
        unit: str = "A",
        label: str = "kPaG",
        full_kpa: float = 700.0,
    ) -> None:
        self.outlet = outlet
        self.serial = serial
        self.unit = unit
        self.label = label
        self.model = f"PCD-{full_kpa:.0f}KPAG-D"
        self.codes: list[str] = []
        self.mute = False
        self.wire = Wire(send)
        self.set_text = 0.0
        self._full_kpa = full_kpa
        self._buffer = b""
        self._now_ns = 0
        self._due: list[tuple[int, str]] = []
        self._stream_ns = 0

    def panel(self, kpa: float) -> None:
        """Somebody sets it at its front panel."""
        self.set_text = kpa * PER_KPA[self.label]
        self.outlet.set_point(kpa)

    def feed(self, data: bytes) -> None:
        """Bytes from the host."""
        *lines, self._buffer = (self._buffer + data).split(b"\r")
        self._buffer = self._buffer[-64:]
        for line in lines:
            self._command(line.decode("ascii", "replace").strip())

    def _say(self, *texts: str) -> None:
        for k, text in enumerate(texts):
            self._due.append((self._now_ns + READY_NS + k * LINE_NS, text))

    def _command(self, line: str) -> None:
        if not line or line[0].upper() != self.unit:
            return
        rest = line[1:].strip().upper()
        if rest.startswith("@"):
            letter = rest.removeprefix("@").lstrip("= ")
            if len(letter) == 1 and letter in string.ascii_uppercase + "@":
                self.unit = letter
                self._stream_ns = self._now_ns
            return
        if rest == "":
            self._say(self._frame())
        elif rest == "??M*":
            self._say(*self._facts())
        elif rest == "??D*":
            self._say(*self._columns())
        elif rest in ("HP", "HC"):
            self.outlet.holding = True
            self.codes = [*self.codes, "HLD"]
            self._say(self._frame())
        elif rest == "C":
            self.outlet.holding = False
            self.codes = [code for code in self.codes if code != "HLD"]
            self._say(self._frame())
        elif rest.startswith("S"):
            self._set(rest[1:].strip())
        else:
            self._say("?")

    def _set(self, text: str) -> None:
        try:
            value = float(text)
        except ValueError:
            self._say("?")
            return
        kpa = value / PER_KPA[self.label]
        if not 0.0 <= kpa <= 1.02 * self._full_kpa:
            self._say("?")
            return
        digits = DIGITS[self.label]
        self.set_text = round(value, digits)
        self.outlet.set_point(self.set_text / PER_KPA[self.label])
        self._say(self._frame())

    def _frame(self) -> str:
        now = self.outlet.sensor_kpa() * PER_KPA[self.label]
        numbers = " ".join(self._number(value) for value in (now, self.set_text))
        return " ".join([self.unit, numbers, *self.codes])

    def _number(self, value: float) -> str:
        return f"{value:+07.{DIGITS[self.label]}f}"

    def _facts(self) -> list[str]:
        facts = ("Alicat Scientific", "www.example.com", "Ph   555-000-0000", "info@example.com",
                 f"Model Number {self.model}", f"Serial Number {self.serial}",
                 "Date Manufactured 03/02/2025", "Date Calibrated   03/02/2025",
                 "Calibrated By     BL", "Software Revision 10v20.0-R24")  # fmt: skip
        return [f"{self.unit} M{k:02d} {text}" for k, text in enumerate(facts)]

    def _columns(self) -> list[str]:
        u, width = self.unit, f"7/{DIGITS[self.label]}"
        notes = f"{CODES[self.label]} 02 {self.label}"
        return [
            f"{u} D00 {COLUMNS}",
            f"{u} D01 700 Unit ID                    string          1",
            f"{u} D02 006 {'Gauge Press':<26} s decimal     {width} {notes}",
            f"{u} D03 038 {'Ga Press Setpt':<26} s decimal     {width} {notes}",
            f"{u} D04 702 {'*Status':<26} string          3 HLD",
        ]

    @property
    def next_ns(self) -> int | None:
        """When it next has something to do."""
        times = [at for at, _ in self._due]
        times += [at for at in (self.wire.next_ns, self.outlet.next_ns) if at is not None]
        if self.unit == "@":
            times.append(self._stream_ns + STREAM_NS)
        return min(times) if times else None

    def advance(self, to_ns: int) -> None:
        """Let time pass to ``to_ns`` (bench time)."""
        self.outlet.advance(to_ns)
        self._now_ns = to_ns
        while self.unit == "@" and self._stream_ns + STREAM_NS <= to_ns:
            self._stream_ns += STREAM_NS
            self._due.append((self._stream_ns, self._frame()))
        for due in sorted(d for d in self._due if d[0] <= to_ns):
            self._due.remove(due)
            if not self.mute:
                self.wire.send(due[1].encode("ascii") + b"\r", to_ns)
        self.wire.advance(to_ns)


def emulator(settings: PressureSourceSettings, plant: BenchSim, send: Send) -> VirtualAlicat:
    """The emulator of a rig's ``alicat-pcd``."""
    return VirtualAlicat(
        RegulatorOutlet(plant),
        send,
        settings.serial or "000001",
        str(settings.own.get("unit", "A")),
        full_kpa=float(settings.own.get("full_kpa", 700.0)),
    )
