"""Driver of a Trinamic module by TMCL: binary telegrams of nine bytes with a checksum.

To the module: address, command, type, motor, value (four bytes, highest first), sum of the eight.
From it: host address, module address, status, command, value, sum. Source: TMCL firmware manuals
(TMCM-1140, TMCM-3314), chapters "binary command format" and "reply format".

A reply names its command but not what was asked for, so that a late one could be taken for another.
Therefore each reading is closed by a number that the driver writes to a user variable and reads
back: what came before that number and was not the one reply to the reading makes the reading void.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import NamedTuple

from daq.errors import DeviceError, DeviceTimeout, LinkLost
from daq.link.transport import Link
from rigs.devices.event_loop import EventLoop
from rigs.devices.faults import Faults
from rigs.devices.motion.stage import CLOSE_MM, TRIES, Motion, MotorStage
from rigs.rigfile.tables.stage import StageDevice

LENGTH = 9
MVP, SAP, GAP, SGP, GGP, VERSION = 4, 5, 6, 9, 10, 136
COMMANDS = (MVP, SAP, GAP, SGP, GGP, VERSION)
ABSOLUTE = 0
POSITION, SPEED, MAX_SPEED = 1, 3, 4
"""Axis parameters: actual position, actual speed, maximum positioning speed."""
USER_BANK, MARK_VARIABLE, NUMBER_VARIABLE = 2, 54, 55
"""User variables that the driver writes: a mark that a restart clears, and the closing number."""
MARK = 0x50414D
OK, LOADED = 100, 101
STATUS = {
    1: "wrong checksum",
    2: "invalid command",
    3: "wrong type",
    4: "invalid value",
    5: "configuration memory locked",
    6: "command not available",
    OK: "",
    LOADED: "",
}
ANSWER_S = 0.3


class Reply(NamedTuple):
    """One whole telegram from the module; ``value`` is signed, 32 bits."""

    status: int
    command: int
    value: int


def encode(address: int, command: int, kind: int, motor: int, value: int) -> bytes:
    """A telegram to the module.

    Raises:
        OverflowError: the value needs more than 32 bits.
    """
    body = bytes((address, command, kind, motor)) + value.to_bytes(4, "big", signed=True)
    return body + bytes((sum(body) & 0xFF,))


def decode(telegram: bytes, address: int) -> Reply | None:
    """A telegram from the module, or None where these nine bytes are none."""
    known = telegram[1] == address and telegram[2] in STATUS and telegram[3] in COMMANDS
    if not known or sum(telegram[:-1]) & 0xFF != telegram[-1]:
        return None
    return Reply(telegram[2], telegram[3], int.from_bytes(telegram[4:8], "big", signed=True))


class TmclStage(MotorStage):
    """One motor whose position, in microsteps, stands for the muscle's length."""

    homing = "make its reference search"

    def __init__(self, link: Link, event_loop: EventLoop, device: StageDevice) -> None:
        self._link = link
        self._event_loop = event_loop
        self._device = device
        self.speed_mm_s = device.speed_mm_s
        self.close_mm = CLOSE_MM + 0.5 / abs(device.counts_per_mm)
        self.identity: dict[str, str] = {}
        self.faults = Faults()
        self.on_bytes: Callable[[int, bytes], None] | None = None
        self._buffer = b""
        self._replies: deque[Reply] = deque(maxlen=64)
        self._telegrams = self._dropped = 0
        self._astray = False
        self._number = 0
        self._lost = False

    @property
    def name(self) -> str:
        """Device and port, for messages."""
        return f"stage on {self._link.name}"

    @property
    def midway(self) -> bool:
        """Whether a telegram has begun to come."""
        return bool(self._buffer)

    def finish(self) -> None:
        """What has begun to come is half a telegram."""
        if self._buffer:
            self._buffer = b""
            self.faults.add("half")

    def counters(self) -> dict[str, int]:
        """Telegrams, bytes that were in none, and faults by kind."""
        return {
            "telegrams": self._telegrams, "dropped_bytes": self._dropped, **self.faults.counts
        }  # fmt: skip

    def poll(self) -> None:
        """Read what has come.

        Raises:
            LinkLost: once; see `rigs.devices.lines.LineDevice.poll`.
        """
        if self._lost:
            return
        try:
            chunks = self._link.read()
        except LinkLost as error:
            self._lose(error)
            raise
        for chunk in chunks:
            if self.on_bytes is not None:
                self.on_bytes(chunk.host_ns, chunk.data)
            self._take(chunk.data)

    def _lose(self, error: LinkLost) -> None:
        if not self._lost:
            self._lost = True
            self.faults.add("unplugged", error.what)

    def _take(self, data: bytes) -> None:
        """Find the telegrams; a byte that begins none is dropped, a row of them counted once."""
        self._buffer += data
        while len(self._buffer) >= LENGTH:
            reply = decode(self._buffer[:LENGTH], self._device.address)
            if reply is None:
                if not self._astray:
                    self.faults.add("checksum", self._buffer[:LENGTH].hex(" "))
                self._astray = True
                self._buffer = self._buffer[1:]
                self._dropped += 1
                continue
            self._astray = False
            self._buffer = self._buffer[LENGTH:]
            self._telegrams += 1
            self._replies.append(reply)

    def _send(self, command: int, kind: int, motor: int, value: int) -> None:
        try:
            self._link.write(encode(self._device.address, command, kind, motor, value))
        except LinkLost as error:
            self._lose(error)
            raise

    def _wait(self, want: Callable[[Reply], bool]) -> list[Reply] | None:
        """Replies up to and with the first that is wanted; None when it did not come in time."""
        seen: list[Reply] = []

        def look() -> bool:
            while self._replies:
                seen.append(self._replies.popleft())
                if want(seen[-1]):
                    return True
            return False

        return seen if self._event_loop.until(look, ANSWER_S) else None

    def _close(self) -> list[Reply] | None:
        """Write a new number and read it back; what came before it, None when it did not come."""
        self._number = self._number % 1_000_000 + 1
        number = self._number
        self._send(SGP, NUMBER_VARIABLE, USER_BANK, number)
        before = self._wait(lambda reply: reply.command == SGP)
        if before is None:
            return None
        self._send(GGP, NUMBER_VARIABLE, USER_BANK, 0)
        rest = self._wait(lambda reply: reply.command == GGP and reply.value == number)
        return None if rest is None else before + rest

    def _exchange(self, command: int, kind: int, motor: int, value: int = 0) -> int:
        """Send a telegram that may be sent twice, until it has exactly one reply.

        Raises:
            DeviceTimeout: no certain reply in three tries.
            DeviceError: the module refused it.
        """
        for _ in range(TRIES):
            self._check()
            self._replies.clear()
            self._send(command, kind, motor, value)
            got = self._wait(lambda reply: reply.command == command)
            if got is None:
                self.faults.add("no_answer", f"command {command}, type {kind}")
            after = self._close()
            for _ in range(TRIES):
                if after is not None:
                    break
                self.faults.add("no_answer", "closing number")
                after = self._close()
            same = [r for r in [*(got or []), *(after or [])] if r.command == command]
            if command in (SGP, GGP):  # the closing number uses the same commands
                same = same[:-1]
            if got is None or after is None:
                continue
            if len(same) != 1:
                self.faults.add("stale", f"{len(same)} replies to command {command}")
                continue
            if STATUS[got[-1].status]:
                self.faults.add("refused", STATUS[got[-1].status])
                raise DeviceError(
                    self.name,
                    f"refused command {command}, type {kind}: {STATUS[got[-1].status]}",
                    "check stage.address, stage.axis and the module's manual",
                )
            return got[-1].value
        raise DeviceTimeout(
            self.name,
            f"no certain reply to command {command}, type {kind}, in {TRIES} tries",
            "check port, cable, baud rate, power and stage.address",
        )

    def connect(self, serial: str) -> dict[str, str]:
        """Ask who it is, leave a mark that a restart clears, and look where it is.

        TMCL reports a module's type and version; it has no serial number, and no word for "not
        referenced".

        Raises:
            DeviceError: another type.
        """
        version = self._exchange(VERSION, 1, 0) & 0xFFFFFFFF
        got = f"TMCM-{version >> 16}"
        self.identity = {"serial": got, "version": f"{version >> 8 & 0xFF}.{version & 0xFF:02d}"}
        self._check_serial(serial, got)
        self._exchange(SGP, MARK_VARIABLE, USER_BANK, MARK)
        self.status()
        return self.identity

    def status(self) -> tuple[Motion, float]:
        """(motion, position in mm).

        Raises:
            DeviceTimeout: no certain reply in three tries.
            DeviceError: the module restarted.
        """
        count = self._exchange(GAP, POSITION, self._device.axis)
        speed = self._exchange(GAP, SPEED, self._device.axis)
        if self._exchange(GGP, MARK_VARIABLE, USER_BANK) != MARK:
            self.faults.add("restarted", "its mark is gone")
            self._stopped = "it restarted"
            self._check()
        return Motion.RUN if speed else Motion.IDLE, self._device.length_mm(count)

    def _start(self, length_mm: float, speed_mm_s: float) -> None:
        motor = self._device.axis
        speed = max(1, round(speed_mm_s * abs(self._device.counts_per_mm)))
        self._exchange(SAP, MAX_SPEED, motor, speed)
        self._exchange(MVP, ABSOLUTE, motor, self._device.counts(length_mm))


def open_stage(link: Link, event_loop: EventLoop, device: StageDevice) -> MotorStage:
    """The driver for a rig's stage."""
    return TmclStage(link, event_loop, device)
