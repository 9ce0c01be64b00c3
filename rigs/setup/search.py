"""Which serial ports and cameras there are, and who answers on a port.

Only requests for an identity (or, of an instrument without one, for a reading) are sent. None of
them moves, sets or stores anything in a device of the kind that it is meant for. What another
device makes of it is not known: so nothing is sent without permission, and only the requests of the
kinds that the bench is said to have.
"""

from __future__ import annotations

import contextlib
import glob
import re
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from daq.clock import RealClock
from daq.errors import DeviceError, PamrigError
from daq.link.codec import decode_reply, encode_request
from daq.link.framer import CobsFramer
from daq.link.ports import PortInfo, list_ports
from daq.link.transport import SerialLink
from rigs.devices.instruments.modbus import modbus_codec
from rigs.devices.motion.tmcl import VERSION, decode, encode
from rigs.rigfile.form import TextForm
from rigs.rigfile.modbus_form import ModbusForm
from valvefw import wire

ANSWER_S = 0.7
RESTART_S = 2.0
"""Some boards restart when their port is opened; the second request waits for that."""
MOST_BYTES = 65536
BINARY = ("tmcl", "modbus")
MOST_CAMERAS = 4


@dataclass(frozen=True)
class Probe:
    """One request that asks a device who it is.

    Attributes:
        device: table of the rig file.
        kind: kind of device.
        bauds: baud rates at which it is asked.
        request: the bytes; empty for a device that sends by itself.
        shown: the same for a person.
        identity: identity in the bytes that came, None where none is in them yet. It is "" for
            a device without a serial number.
    """

    device: str
    kind: str
    bauds: tuple[int, ...]
    request: bytes
    shown: str
    identity: Callable[[bytes], str | None]


@dataclass(frozen=True)
class Answer:
    """A device that answered: which, where, at which baud rate, its identity."""

    probe: Probe
    port: str
    baud: int
    identity: str


def serial_ports() -> list[PortInfo]:
    """The serial ports of this computer, without sockets of the mainboard that may have none."""
    return [p for p in list_ports() if p.serial or not re.fullmatch(r"/dev/ttyS\d+", p.name)]


def _matching(pattern: bytes) -> Callable[[bytes], str | None]:
    """Identity by a pattern over what came, with the group ``serial`` where it has one."""
    compiled = re.compile(pattern)

    def look(data: bytes) -> str | None:
        match = compiled.search(data)
        if match is None:
            return None
        serial = match.groupdict().get("serial") or b""
        return serial.decode("ascii", "replace").strip()

    return look


def _valve(data: bytes) -> str | None:
    for payload in CobsFramer().feed(data):
        if payload and payload[0] == wire.REPLY:
            with contextlib.suppress(ValueError):
                reply = decode_reply(payload)
                if reply.ok and reply.values.get("name") == "valvefw":
                    return reply.values.get("serial", "")
    return None


def _tmcl(address: int) -> Callable[[bytes], str | None]:
    def look(data: bytes) -> str | None:
        for at in range(len(data) - 8):
            reply = decode(data[at : at + 9], address)
            if reply is not None and reply.command == VERSION:
                return f"TMCM-{(reply.value & 0xFFFFFFFF) >> 16}"
        return None

    return look


def text_probe(device: str, name: str, form: TextForm) -> Probe:
    """Asks an instrument of a description for its identity, or else for a reading."""
    asked = form.identify or form.query
    pattern = form.identify_pattern if form.identify else form.pattern

    def look(data: bytes) -> str | None:
        for line in data.split(form.end)[:-1]:
            text = line.decode("ascii", "replace").strip()
            match = pattern.fullmatch(text) if pattern is not None else None
            if match is not None:
                return (match.groupdict().get("serial") or "").strip() if form.identify else ""
        return None

    request = asked.encode("ascii") + form.end if asked else b""
    what = f'"{asked}"' if asked else "nothing; it sends by itself"
    return Probe(device, name, (9600,), request, what, look)


def modbus_probe(device: str, form: ModbusForm, baud: int) -> Probe:
    """Reads the register of the reading once; a transmitter has no identity that all share."""
    codec = modbus_codec()

    def look(data: bytes) -> str | None:
        for at in range(len(data)):
            size = codec.size(data[at:])
            if size and len(data) - at >= size and data[at] == form.device_id:
                pdu = codec.open(data[at : at + size])
                if pdu is not None and not pdu.isError():
                    return ""
        return None

    what = f"Modbus, read register {form.register} of device {form.device_id}"
    return Probe(device, "modbus", (baud,), codec.read(form), what, look)


PROBES: tuple[Probe, ...] = (
    Probe("valve", "controller", (115200,), encode_request(1, "id"), 'frame "id"', _valve),
    Probe("balance", "mt-sics", (9600,), b"I4\r\n", '"I4"',
          _matching(rb'I4 A "(?P<serial>[^"\r\n]*)"')),
    Probe("stage", "grbl", (115200,), b"$I\n", '"$I"',
          _matching(rb"\[VER:[^\r\n]*?(?P<serial>[^:\]\r\n]*)\]")),
    Probe("stage", "marlin", (115200, 250000), b"M115\n", '"M115"',
          _matching(rb"FIRMWARE_NAME:[^\r\n]*?(?:UUID:(?P<serial>[-0-9a-fA-F]{36})[^\r\n]*)?\r?\n")),
    Probe("stage", "zaber", (115200, 9600), b"/1 get system.serial\n", '"/1 get system.serial"',
          _matching(rb"@01 0 OK \w+ \S+ (?P<serial>\d+)")),
    Probe("stage", "tmcl", (9600, 115200), encode(1, VERSION, 1, 0, 0),
          "TMCL 136 (version of the firmware) to module 1", _tmcl(1)),
    Probe("pressure_source", "alicat-pcd", (19200,), b"A??M*\r", '"A??M*"',
          _matching(rb"A M05 Serial Number\s+(?P<serial>\w+)")),
    Probe("pressure_source", "smc-itv", (9600,), b"REQ\r\n", '"REQ"',
          _matching(rb"(?:^|\n)\d{1,4}\r?\n")),
)  # fmt: skip
"""Of the kinds that have one request for all devices."""


def probes(device: str, kind: str) -> list[Probe]:
    """The request of a kind of device, if it has one."""
    return [probe for probe in PROBES if (probe.device, probe.kind) == (device, kind)]


def requests_text(wanted: Iterable[Probe], ports: Sequence[str]) -> list[str]:
    """What would be sent, line by line, for the person who allows it."""
    lines = [f"On {', '.join(ports)} this would be sent:"]
    for probe in wanted:
        bauds = " and ".join(str(baud) for baud in probe.bauds)
        lines.append(f"  {probe.device} ({probe.kind}) at {bauds} baud: {probe.shown}")
    lines += [
        "These requests set and move nothing in the devices that they are meant for. What another",
        "device makes of them is not known; some boards restart when their port is opened.",
    ]
    return lines


def search(
    wanted: Sequence[Probe], ports: Sequence[str], say: Callable[[str], None] = lambda text: None
) -> list[Answer]:
    """Ask on each port until somebody answers, each device once.

    Args:
        wanted: the requests that may be sent.
        ports: names of ports.
        say: shows each port as it is asked, and what is wrong with one.
    """
    left = list(wanted)
    found: list[Answer] = []
    for port in ports:
        answer = None
        for baud in dict.fromkeys(baud for probe in left for baud in probe.bauds):
            try:
                answer = _on_port(port, baud, [p for p in left if baud in p.bauds])
            except PamrigError as error:
                say(f"  {error}")
                break
            if answer is not None:
                break
        if answer is None:
            say(f"  {port}: no answer")
            continue
        named = f", {answer.identity}" if answer.identity else ""
        say(f"  {port}: {answer.probe.device} ({answer.probe.kind}) at {answer.baud} baud{named}")
        found.append(answer)
        left.remove(answer.probe)
    return found


def _on_port(port: str, baud: int, wanted: Sequence[Probe]) -> Answer | None:
    """Who answers on a port at a baud rate.

    Raises:
        PortError: the port cannot be opened.
        LinkLost: it went away.
    """
    clock = RealClock()
    link = SerialLink(port, baud, clock)
    try:
        # What one does not understand may spoil its next request: the second round is the other
        # way round, and telegrams without an end come first, then last.
        first = sorted(wanted, key=lambda probe: probe.kind not in BINARY)
        for pause_s, order in ((0.0, first), (RESTART_S, first[::-1])):
            clock.sleep(pause_s)
            for probe in order:
                identity = _asked(link, clock, probe)
                if identity is not None:
                    return Answer(probe, port, baud, identity)
        return None
    finally:
        link.close()


def _asked(link: SerialLink, clock: RealClock, probe: Probe) -> str | None:
    data = b"".join(chunk.data for chunk in link.read()) if not probe.request else b""
    if probe.request:
        link.read()  # what came before belongs to no request
        link.write(probe.request)
    end_ns = clock.now_ns() + round(ANSWER_S * 1e9)
    while clock.now_ns() < end_ns and len(data) < MOST_BYTES:
        clock.sleep(0.02)
        data += b"".join(chunk.data for chunk in link.read())
        identity = probe.identity(data)
        if identity is not None:
            return identity
    return None


def cameras(gentl: str = "", package: Any = None) -> Iterator[tuple[str, str]]:
    """(source, what it is) of each camera: UVC by index, GenICam with a producer by serial number.

    No picture is taken. On Linux the indices are those of /dev/video*, otherwise the first ones.
    """
    if sys.platform.startswith("linux"):
        numbers = sorted(int(found) for path in glob.glob("/dev/video*")
                         if (found := path.removeprefix("/dev/video")).isdigit())  # fmt: skip
    else:
        numbers = list(range(MOST_CAMERAS))
    for number in numbers:
        yield f"uvc:{number}", "webcam or UVC camera"
    if gentl:
        from rigs.devices.cameras.genicam import found_cameras

        with contextlib.suppress(DeviceError):
            for serial, model in found_cameras(gentl, package):
                yield f"genicam:{serial}", model
