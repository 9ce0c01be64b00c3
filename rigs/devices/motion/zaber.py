"""Driver of a Zaber stage by its ASCII protocol, with message numbers and checksums both ways.

A command is ``/01 1 07 move abs 20000:D9``, its reply ``@01 1 07 OK BUSY -- 0:7E``: device, axis,
message number, OK or RJ, BUSY or IDLE, warning flag, data, checksum. Positions are microsteps, the
unit of ``maxspeed`` is 1/1.6384 microsteps a second. Source: Zaber ASCII Protocol Manual, firmware
6 and 7.

The package ``zaber-motion`` is not used: it reads its port in a library of its own, outside the
bench's clock, record and event loop, so that no byte would be recorded and the heartbeat of the
valve controller would wait for it.
"""

from __future__ import annotations

import re

from daq.errors import DeviceError, DeviceTimeout
from daq.link.transport import Link
from rigs.devices.event_loop import EventLoop
from rigs.devices.lines import LineDevice
from rigs.devices.motion.stage import CLOSE_MM, TRIES, Motion, MotorStage
from rigs.rigfile.tables.stage import StageDevice

_REPLY = re.compile(
    r"@(?P<address>\d\d) (?P<axis>\d) (?P<number>\d\d) (?P<taken>OK|RJ) (?P<motion>IDLE|BUSY)"
    r" (?P<flag>--|[A-Z][A-Z0-9]) (?P<data>[^:]*)"
)
SPEED_UNIT = 1.6384
"""``maxspeed`` for one microstep a second."""
ANSWER_S = 0.5
LOST = {
    "WR": "it has no reference position",
    "WH": "it was not homed since it was switched on",
    "WL": "it met a limit sensor where none should be",
    "WM": "it was pushed away while it stood still",
    "FS": "it stalled and stopped",
    "FE": "it ran into its limit",
    "FD": "its driver is switched off",
    "FQ": "its encoder reports an error",
}
"""Flags after which the position is not believed; every other one that begins with F as well."""


def checksum(message: str) -> str:
    """Two hexadecimal digits: the negative sum of all characters after the first one, mod 256."""
    return f"{-sum(message[1:].encode('ascii')) & 0xFF:02X}"


class ZaberStage(LineDevice, MotorStage):
    """One axis whose position, in microsteps, stands for the muscle's length."""

    def __init__(self, link: Link, event_loop: EventLoop, device: StageDevice) -> None:
        super().__init__(link, event_loop, "stage", end=b"\n")
        self.speed_mm_s = device.speed_mm_s
        self.identity: dict[str, str] = {}
        self.close_mm = CLOSE_MM + 0.5 / abs(device.counts_per_mm)
        self._device = device
        self._number = 0
        self._summed = False
        self._ready = False

    def on_line(self, line: str, host_ns: int) -> bool:
        """Keep only a whole reply of this device to the message that waits for one."""
        if not line.startswith("@"):
            if line[:1] not in "!#":
                self.faults.add("damaged", repr(line))
            return True
        text, colon, given = line.partition(":")
        match = _REPLY.fullmatch(text)
        if match is None or "@" in text[1:]:
            self.faults.add("damaged", repr(line))
            return True
        if (colon or self._summed) and given != checksum(text):
            self.faults.add("checksum", repr(line))
            return True
        if int(match["address"]) != self._device.address:
            return True  # another device of the chain
        if int(match["number"]) != self._number:
            self.faults.add("stale", repr(line))
            return True
        return False

    def _exchange(self, text: str, axis: int) -> re.Match[str]:
        """Send a message until its own reply comes.

        Raises:
            DeviceTimeout: no reply in three tries.
            DeviceError: the device refused it, or its flag says that its position is lost.
        """
        for attempt in range(TRIES):
            self._check()
            self._number = self._number % 99 + 1
            message = f"/{self._device.address:02d} {axis} {self._number:02d} {text}"
            try:
                line = self.request(f"{message}:{checksum(message)}", lambda _: True, ANSWER_S)
            except DeviceTimeout:
                self.faults.add("no_answer", text)
                if attempt == TRIES - 1:
                    raise
                continue
            match = _REPLY.fullmatch(line.partition(":")[0])
            assert match is not None
            self._look_at(match["flag"])
            if match["taken"] == "RJ":
                self.faults.add("refused", line)
                raise DeviceError(self.name, f"refused {text!r}: {match['data']}", "see its manual")
            return match
        raise AssertionError("unreachable")

    def _look_at(self, flag: str) -> None:
        why = LOST.get(flag, "it reports a fault" if flag.startswith("F") else "")
        if not why or self._stopped:
            return
        self._stopped = f"{why} (flag {flag})"
        if self._ready:
            self.faults.add("refused", self._stopped)
        self._check()

    def connect(self, serial: str) -> dict[str, str]:
        """Switch its checksums on, ask who it is, and check that it knows its position.

        Raises:
            DeviceError: another serial number, or a flag that says that its position is lost.
        """
        self._exchange("set comm.checksum 1", 0)
        self._summed = True
        got = self._exchange("get system.serial", 0)["data"]
        kind = self._exchange("get device.id", 0)["data"]
        version = self._exchange("get version", 0)["data"]
        self.identity = {"serial": got, "device_id": kind, "version": version}
        self._check_serial(serial, got)
        self.status()
        self._ready = True
        return self.identity

    def status(self) -> tuple[Motion, float]:
        """(motion, position in mm).

        Raises:
            DeviceTimeout: no whole reply in three tries.
            DeviceError: a flag says that the position is lost.
        """
        for _ in range(TRIES):
            reply = self._exchange("get pos", self._device.axis)
            try:
                position = self._device.length_mm(int(reply["data"]))
            except ValueError:
                self.faults.add("damaged", reply[0])
                continue
            return Motion.IDLE if reply["motion"] == "IDLE" else Motion.RUN, position
        raise DeviceError(self.name, "gives no position", "check stage.address and stage.axis")

    def _start(self, length_mm: float, speed_mm_s: float) -> None:
        speed = speed_mm_s * abs(self._device.counts_per_mm) * SPEED_UNIT
        self._exchange(f"set maxspeed {speed:.0f}", self._device.axis)
        self._exchange(f"move abs {self._device.counts(length_mm)}", self._device.axis)


def open_stage(link: Link, event_loop: EventLoop, device: StageDevice) -> MotorStage:
    """The driver for a rig's stage."""
    return ZaberStage(link, event_loop, device)
