"""What the host does for the controller by hand: console, installing, the RS-232 board."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path

import pytest

import micropython_host
from daq.clock import VirtualClock
from daq.errors import DeviceError, LinkLost, PamrigError, PortError
from daq.link.ports import ModemLines
from rigs.bench import firmware
from rigs.bench.console import converse
from rigs.devices.rs232 import Rs232Board
from rigs.rigfile.config import load_rig
from valvefw import VERSION
from valvefw.wire import encode_frame

# Console.


def talk(capsys: pytest.CaptureFixture[str], *lines: str) -> str:
    assert converse(load_rig("virtual"), io.StringIO("\n".join(lines) + "\n")) == 0
    return capsys.readouterr().out


def test_a_person_can_pressurise_read_and_vent(capsys: pytest.CaptureFixture[str]) -> None:
    out = talk(capsys, "/arm pwm", "/sp 200", "/wait 1.5", "/t", "vent", "/wait 2", "/t", "/quit")
    first, second = [line for line in out.splitlines() if " kPa (" in line]
    assert float(first.split()[0]) == pytest.approx(200, abs=1.5)
    assert "armed" in first
    assert float(second.split()[0]) < 5
    assert "* vented t=" in out


def test_refusals_and_faults_are_shown_in_words(capsys: pytest.CaptureFixture[str]) -> None:
    out = talk(
        capsys,
        "fly",
        "pulse inlet 1",
        "/nonsense",
        "/arm pwm",
        "/sp 100",
        "/wait 1",
        "/beat off",
        "/wait 1",
        "/faults",
    )
    assert "refused: refused 'fly' (verb): unknown verb, try help" in out
    assert "(range)" in out
    assert "not understood: no such word /nonsense; /help" in out
    assert "* fault cause=host_silent" in out
    assert len([line for line in out.splitlines() if len(line.split()) == 5][-64:]) == 64


# Firmware.


class Board:
    """Files of a board, and an mpremote that knows only what ``firmware`` uses."""

    def __init__(self) -> None:
        self.files: dict[str, bytes] = {"boot.py": b"", "valvefw/old.py": b"stale"}
        self.said: list[str] = []
        self.pulled = False
        self.chip = "RP2040"

    def run(self, words: Sequence[str]) -> str:
        assert words[:2] == ("connect", "/dev/pico")
        self.said.append(words[2])
        if words[2] == "fs":
            assert words[3] == "cp"
            for path in words[4:-1]:
                target = words[-1].removeprefix(":")
                name = target + Path(path).name if target.endswith("/") else target
                self.files[name] = Path(path).read_bytes()
        elif words[2] == "exec" and "mkdir" in words[3]:
            self.files = {n: c for n, c in self.files.items() if not n.startswith("valvefw/")}
        elif words[2] == "exec" and "main.py" in words[3] and "remove" in words[3]:
            self.files.pop("main.py", None)
        elif words[2] == "exec" and "_machine" in words[3]:
            return f"Raspberry Pi Pico with {self.chip}\r\n"
        elif words[2] == "exec":
            return self.listing()
        return ""

    def listing(self) -> str:
        """The listing script itself, under MicroPython on a file system with these files."""
        files = {n: c.hex() for n, c in self.files.items()}
        interpreter = micropython_host.MicroPython()
        try:
            interpreter.run(
                "import os, sys, binascii\nos.mkdir('/board')\nos.mkdir('/board/valvefw')\n"
                "os.mkdir('/board/valvefw/inputs')\n"
                "os.mkdir('/board/valvefw/boards')\n"
                "os.mkdir('/board/valvefw/schemes')\nos.chdir('/board')\nsys.path[:] = ['']\n"
            )
            for name, content in files.items():
                interpreter.run(
                    f"f = open('{name}', 'wb')\nf.write(binascii.unhexlify('{content}'))\nf.close()"
                )
            return interpreter.run(firmware.LIST_FILES)
        finally:
            interpreter.close()


def test_install_puts_every_file_there_and_checks_it() -> None:
    board = Board()
    assert not firmware.check("/dev/pico", board.run).equal
    found = firmware.install("/dev/pico", board.run)
    assert found.equal
    assert found.version_there == VERSION
    assert board.files["main.py"].startswith(b"from valvefw.boards.rp2040 import run")
    assert "valvefw/old.py" not in board.files
    assert not any("deskboard" in name for name in board.files)
    assert sum(len(content) for content in board.files.values()) < 100_000  # of 264 kB
    assert board.said[-1] == "reset"


def test_a_pico_2_gets_its_own_board_file_and_machine_code() -> None:
    board = Board()
    firmware.install("/dev/pico", board.run)
    first = dict(board.files)
    board.chip = "RP2350"
    assert firmware.install("/dev/pico", board.run).equal
    assert board.files["main.py"].startswith(b"from valvefw.boards.rp2350 import run")
    assert "valvefw/boards/rp2040.mpy" not in board.files
    assert board.files["valvefw/core.mpy"] != first["valvefw/core.mpy"]


@pytest.mark.parametrize("chip", ["ESP32", "RP2350-RISCV"])
def test_another_chip_is_refused_before_anything_is_written(chip: str) -> None:
    board = Board()
    board.chip = chip
    before = dict(board.files)
    with pytest.raises(DeviceError, match="RP2040 or RP2350"):
        firmware.install("/dev/pico", board.run)
    assert board.files == before


def test_check_names_what_differs() -> None:
    board = Board()
    firmware.install("/dev/pico", board.run)
    board.files["valvefw/safety.mpy"] += b" "
    del board.files["valvefw/schemes/pwm.mpy"]
    board.files["valvefw/extra.py"] = b"x = 1\n"
    board.files["valvefw/__init__.py"] = b'VERSION = "0.0.9"\n'
    found = firmware.check("/dev/pico", board.run)
    assert not found.equal
    assert found.version_there == "0.0.9"
    text = "\n".join(found.wrong)
    for words in ("pwm.mpy is missing", "extra.py does not belong", "safety.mpy differs"):
        assert words in text


def test_a_copy_that_went_wrong_is_an_error() -> None:
    board = Board()

    def lossy(words: Sequence[str]) -> str:
        out = board.run(words)
        if words[2] == "fs":
            board.files["valvefw/wire.mpy"] = b"half"
        return out

    with pytest.raises(DeviceError, match=r"wire\.mpy differs"):
        firmware.install("/dev/pico", lossy)


def test_mpremote_itself_says_that_there_is_no_board() -> None:
    with pytest.raises(PamrigError, match="mpremote"):
        firmware.check("/dev/no-such-port")


# RS-232.


class Port:
    """A serial port's control lines, with the time of each change."""

    def __init__(self, clock: VirtualClock) -> None:
        self._clock = clock
        self._dtr = self._rts = False
        self.cts = self.dsr = False
        self.changes: list[tuple[float, bool, bool]] = []
        self.gone = False
        self.closed = False

    def _note(self) -> None:
        if self.gone:
            raise OSError(5, "Input/output error")
        now = self._clock.now_ns() / 1e6
        if not self.changes or self.changes[-1][1:] != (self._dtr, self._rts):
            self.changes.append((now, self._dtr, self._rts))

    @property
    def dtr(self) -> bool:
        return self._dtr

    @dtr.setter
    def dtr(self, on: bool) -> None:
        self._dtr = on
        self._note()

    @property
    def rts(self) -> bool:
        return self._rts

    @rts.setter
    def rts(self, on: bool) -> None:
        self._rts = on
        self._note()

    def close(self) -> None:
        self.closed = True


class Rs232:
    def __init__(self) -> None:
        self.clock = VirtualClock()
        self.port = Port(self.clock)
        self.lines = ModemLines("/dev/ttyS0", self.port)
        self.board = Rs232Board(self.lines, self.clock)
        self.n = 0

    def ask(self, text: str) -> None:
        self.n += 1
        self.board.feed(encode_frame(f"Q{self.n} {text}".encode()))
        self.board.run(0.002)

    def arm(self, scheme: str) -> None:
        c = self.board.controller
        c.values["rise_ms"] = 0
        c.safety.arm(c.values)
        self.ask(f"scheme {scheme}")


def test_the_inlet_is_dtr_and_the_outlet_rts_timed_to_a_millisecond() -> None:
    rig = Rs232()
    rig.board.run(0.05)
    assert rig.port.changes[-1][1:] == (False, True)  # vented: energised, as in the thesis
    rig.arm("open")
    assert rig.port.changes[-1][1:] == (False, False)
    rig.port.changes.clear()
    rig.ask("pulse inlet 12000")
    rig.board.run(0.03)
    (on, *up), (off, *down) = rig.port.changes
    assert (up, down) == ([True, False], [False, False])
    assert off - on == pytest.approx(12.0, abs=1.0)
    rig.board.run(0.3)
    assert rig.board.controller.safety.faults[0][0] == "host_silent"
    assert rig.port.changes[-1][1:] == (False, True)
    rig.board.close()
    assert rig.port.closed
    assert rig.port.changes[-1][1:] == (False, False)


def test_the_ram_stops_at_cts_and_dsr() -> None:
    for line in ("cts", "dsr"):
        rig = Rs232()
        rig.board.run(0.01)
        rig.arm("ram")
        rig.ask("sp 20000")
        rig.board.run(0.02)
        assert rig.port.dtr
        setattr(rig.port, line, True)
        rig.board.run(0.005)
        assert not rig.port.dtr
        assert not rig.port.rts


def test_a_port_that_vanishes_is_a_lost_link_and_a_missing_one_is_named() -> None:
    rig = Rs232()
    rig.port.gone = True
    with pytest.raises(LinkLost, match="ttyS0"):
        rig.lines.set(True, False)
    with pytest.raises(PortError, match="no-such-port"):
        ModemLines("/dev/no-such-port")
