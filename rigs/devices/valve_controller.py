"""Driver of the valve controller: text requests with ids, heartbeat, telemetry.

The heartbeat is also the clock ping. It is sent only while the protocol reports progress:
a protocol that hangs stops beating, and the firmware vents. On a port that the acquisition's
process reads, that process sends it, until the time that the last report of progress allowed.
"""

from __future__ import annotations

import contextlib
import re
import secrets
from collections import deque
from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from daq.clock import NS_PER_S, Clock
from daq.errors import DeviceError, DeviceTimeout, LinkLost
from daq.link.channels import ChannelStream
from daq.link.clockfit import ClockFit
from daq.link.codec import CodecError, Reply, decode_event, decode_reply, encode_request
from daq.link.framer import CobsFramer
from daq.link.telemetry import Gap, TelemetryStream
from daq.link.transport import Link, SerialLink
from rigs.devices.event_loop import EventLoop
from valvefw import wire

HEARTBEAT_S = 0.1
REPLY_S = 1.0
RECENT_SAMPLES = 8000
PROTOCOL_VERSION = "1"

_COUNT = re.compile(r"\d{1,10}\Z", re.ASCII)

Batch = dict[str, npt.NDArray[np.generic]]
ALIVE_S = 1.0
"""A step must report progress at least so often, or the heartbeat stops."""
ALIVE_STEP_NS = 50_000_000
"""The process that beats is told of progress in steps of this."""
FIRST_BEAT, LAST_BEAT = 32768, 65535
"""Request ids of heartbeats that a process of their own sends."""
BEATS_AHEAD = 40
"""So many frames it has in hand: more than may be sent without progress being reported."""


class ValveController:
    """One valve controller on one link.

    Args:
        link: bytes in and out.
        clock: stamps requests and replies.
        event_loop: of the bench.
        key: its table in the rig file, for messages.

    Attributes:
        other_set_point: set-point in telemetry that was never sent, and the one that was, in
            counts; None if all agree.
    """

    def __init__(self, link: Link, clock: Clock, event_loop: EventLoop, key: str = "valve") -> None:
        self._link = link
        self._key = key
        self._beating = link if isinstance(link, SerialLink) and link.beats else None
        self._clock = clock
        self._event_loop = event_loop
        self._framer = CobsFramer()
        self._next_id = 1
        self._last_id = FIRST_BEAT - 1 if self._beating is not None else LAST_BEAT
        self._next_beat_id = FIRST_BEAT
        self._beats_queued = 0
        self._told_until_ns = 0
        self._replies: dict[int, Reply] = {}
        self._waiting: dict[int, str] = {}
        # From the beginning: heartbeats are made up ahead of arming. As long in every run.
        self._session = 10_000 + secrets.randbelow(55_536)
        self._expected: tuple[int, int] | None = None
        self.other_set_point: tuple[float, float] | None = None
        self._pings: dict[int, int] = {}
        self._beat_count = 0
        self._next_beat_ns = 0
        self._alive_until_ns = 0
        self._recent = np.zeros(2 * RECENT_SAMPLES, dtype=np.uint16)
        self._driven = np.zeros((2, 2 * RECENT_SAMPLES), dtype=np.uint8)
        self._filled = 0
        self.seq_end = 0
        self.flags = 0
        self.identity: dict[str, str] = {}
        self.faults: deque[str] = deque(maxlen=64)
        self.events: deque[str] = deque(maxlen=256)
        self.on_event: Callable[[str], None] | None = None
        self.on_bytes: Callable[[int, bytes], None] | None = None
        self.on_batch: list[Callable[[Batch], None]] = []
        self.on_gap: Callable[[Gap], None] | None = None
        self.bad_payloads = 0
        self.unanswered = 0
        self.clock_fit = ClockFit()
        self.telemetry = TelemetryStream(self._batch, on_gap=self._gap, on_boot=self._boot)
        self.channels = ChannelStream(self.telemetry.device_time)

    @property
    def name(self) -> str:
        """Where the controller is, for messages."""
        return f"valve controller on {self._link.name}"

    # ---- bytes in -------------------------------------------------------------------

    def poll(self) -> None:
        """Read what has come, hand it on, and beat if it is time and the test is alive."""
        chunks = self._link.read()
        if self._beating is not None:
            self._note_beats(self._beating)
        for chunk in chunks:
            if self.on_bytes is not None:
                self.on_bytes(chunk.host_ns, chunk.data)
            for payload in self._framer.feed(chunk.data):
                try:
                    self._payload(payload, chunk.host_ns)
                except CodecError:
                    self.bad_payloads += 1
        now_ns = self._clock.now_ns()
        if self._beating is not None:
            self._tell_alive(self._beating, now_ns)
        elif self._next_beat_ns <= now_ns < self._alive_until_ns:
            self._beat(now_ns)

    def _payload(self, payload: bytes, host_ns: int) -> None:
        kind = payload[0] if payload else 0
        if kind == wire.TELEMETRY:
            self.telemetry.feed(payload, host_ns)
        elif kind == wire.CHANNELS:
            self.channels.feed(payload, host_ns)
        elif kind == wire.REPLY:
            self._reply(decode_reply(payload), host_ns)
        elif kind == wire.EVENT:
            self._event(decode_event(payload))
        else:
            self.bad_payloads += 1

    def _reply(self, reply: Reply, host_ns: int) -> None:
        sent_ns = self._pings.get(reply.id)
        if sent_ns is None:
            if reply.id in self._waiting:
                if reply.ok:
                    self._took(self._waiting[reply.id])
                self._replies[reply.id] = reply
            return
        for earlier in list(self._pings):  # answers keep their order: those before it are lost
            del self._pings[earlier]
            if earlier == reply.id:
                break
            self.unanswered += 1
        if reply.ok and "t" in reply.values:
            if not _COUNT.match(reply.values["t"]):
                raise CodecError(f"a reply has t={reply.values['t'][:20]!r}, expected a number")
            device_us = self.telemetry.device_time.unwrap(int(reply.values["t"]), host_ns)
            self.clock_fit.add(sent_ns, host_ns, device_us)

    def _took(self, text: str) -> None:
        """A command was carried out: all telemetry from now on must have its set-point."""
        verb, *args = text.split()
        if verb in ("sp", "scheme", "vent", "stop", "arm"):
            setpoint_x16 = int(args[0]) if verb == "sp" else 0
            self._expected = (setpoint_x16, self.telemetry.next_seq or 0)

    def _check_set_point(self, batch: Batch) -> None:
        """Compare the set-point that telemetry reads back with the one that was sent."""
        if self._expected is None or self.other_set_point is not None:
            return
        sent, first_seq = self._expected
        seq = batch["seq"].astype(np.int64)
        other = (seq >= first_seq) & (batch["setpoint_x16"] != sent)
        if other.any():
            got = int(batch["setpoint_x16"][other][0])
            self.other_set_point = (got / 16.0, sent / 16.0)

    def _event(self, text: str) -> None:
        self.events.append(text)
        if text.startswith("fault"):
            self.faults.append(text)
        if self.on_event is not None:
            self.on_event(text)

    def _gap(self, gap: Gap) -> None:
        if self.on_gap is not None:
            self.on_gap(gap)

    def _boot(self, old: int, new: int) -> None:
        # The old clock is gone with the old boot: its pings would bend the new fit.
        self.clock_fit = ClockFit()
        self._pings.clear()
        self._expected = None
        if self.on_event is not None:
            self.on_event(f"reboot old={old} new={new}")

    def _batch(self, batch: Batch) -> None:
        counts = batch["counts"]
        n = len(counts)
        if self._filled + n > len(self._recent):
            keep = self._recent[self._filled - RECENT_SAMPLES : self._filled].copy()
            self._recent[:RECENT_SAMPLES] = keep
            driven = self._driven[:, self._filled - RECENT_SAMPLES : self._filled].copy()
            self._driven[:, :RECENT_SAMPLES] = driven
            self._filled = RECENT_SAMPLES
        self._recent[self._filled : self._filled + n] = counts
        self._driven[0, self._filled : self._filled + n] = batch["inlet_u5"]
        self._driven[1, self._filled : self._filled + n] = batch["vent_u5"]
        self._filled += n
        self.seq_end = int(batch["seq"][-1]) + 1
        self.flags = int(batch["flags"][-1])
        self._check_set_point(batch)
        for listener in self.on_batch:
            listener(batch)

    def recent_counts(self, n: int) -> npt.NDArray[np.float64]:
        """The newest ``n`` pressure readings in raw counts, or as many as there are."""
        return self._recent[max(0, self._filled - n) : self._filled].astype(np.float64)

    def recent_commands(self, n: int) -> npt.NDArray[np.uint8]:
        """Commanded fill and vent times of the same samples, in 5 us, shape (2, n)."""
        return self._driven[:, max(0, self._filled - n) : self._filled].copy()

    # ---- requests -------------------------------------------------------------------

    def _send(self, text: str) -> int:
        request_id = self._next_id
        self._next_id = request_id % self._last_id + 1
        text = self._signed(text)
        self._link.write(encode_request(request_id, text))
        return request_id

    def _signed(self, text: str) -> str:
        """A command that only the host that armed may give names its session."""
        guarded = text.split(" ", 1)[0] in wire.GUARDED
        return f"{text} @{self._session}" if guarded else text

    def request(self, text: str, seconds: float = REPLY_S) -> dict[str, str]:
        """Send one command and wait for the reply that carries its id.

        Raises:
            DeviceTimeout: no reply in time.
            DeviceError: the controller refused, with its own words.
        """
        return self.answer(self.ask(text), seconds)

    def ask(self, text: str) -> int:
        """Send one command; :meth:`answer` waits for its reply. Returns its number."""
        request_id = self._next_id
        self._waiting[request_id] = text
        try:
            self._send(text)
        except LinkLost:
            self._waiting.pop(request_id)
            raise
        return request_id

    def answer(self, request_id: int, seconds: float = REPLY_S) -> dict[str, str]:
        """Wait for the reply to a command of :meth:`ask`; errors as of :meth:`request`."""
        text = self._waiting[request_id]
        try:
            if not self._event_loop.until(lambda: request_id in self._replies, seconds):
                raise DeviceTimeout(
                    self.name,
                    f"no reply to {text!r} within {seconds:g} s",
                    "check cable, power and that no other program talks to it",
                )
            reply = self._replies.pop(request_id)
        finally:
            self._waiting.pop(request_id, None)
        if not reply.ok:
            raise DeviceError(self.name, f"refused {text!r} ({reply.code})", reply.text)
        return reply.values

    def progress(self, seconds: float) -> None:
        """The protocol lives: keep beating for at most ``seconds`` from now."""
        self._alive_until_ns = self._clock.now_ns() + round(seconds * NS_PER_S)

    def still(self) -> None:
        """Stop beating at once."""
        self._alive_until_ns = 0
        if self._beating is not None:
            self._tell_alive(self._beating, self._clock.now_ns())

    def _tell_alive(self, link: SerialLink, now_ns: int) -> None:
        """Tell the process that beats until when it may, and see that it has frames.

        It may never for longer than ``ALIVE_S`` from now, so that it stops under a program that
        hangs or is suspended.
        """
        told_ns = self._told_until_ns
        until_ns = min(self._alive_until_ns, now_ns + round(ALIVE_S * NS_PER_S))
        if told_ns <= until_ns < told_ns + ALIVE_STEP_NS:
            return
        if until_ns and self._beats_queued < BEATS_AHEAD:
            frames = [self._beat_frame() for _ in range(BEATS_AHEAD)]
            self._beats_queued += len(frames)
            link.queue_beats(round(HEARTBEAT_S * NS_PER_S), frames)
        self._told_until_ns = until_ns
        link.keep_alive(until_ns)

    def _beat_frame(self) -> tuple[int, bytes]:
        self._beat_count = (self._beat_count + 1) % 65536  # after 1.8 h it begins anew
        request_id = self._next_beat_id
        self._next_beat_id = FIRST_BEAT if request_id == LAST_BEAT else request_id + 1
        return request_id, encode_request(request_id, self._signed(f"hb {self._beat_count}"))

    def _note_beats(self, link: SerialLink) -> None:
        """Which frames the process has sent, and when: the pings of the clock."""
        for request_id, sent_ns in link.take_beats():
            self._beats_queued -= 1
            if len(self._pings) > 50:  # replies that never came
                self.finish()
            self._pings[request_id] = sent_ns

    def _beat(self, now_ns: int) -> None:
        self._beat_count = (self._beat_count + 1) % 65536  # after 1.8 h it begins anew
        if len(self._pings) > 50:  # replies that never came
            self.finish()
        # Stamped before the write, because the write is part of the round trip.
        request_id = self._next_id
        self._pings[request_id] = now_ns
        self._send(f"hb {self._beat_count}")
        self._next_beat_ns = now_ns + round(HEARTBEAT_S * NS_PER_S)

    # ---- what a bench does ----------------------------------------------------------

    def connect(self, serial: str, firmware: str) -> dict[str, str]:
        """Ask for the identity until it comes, and check it.

        Raises:
            DeviceError: another serial number, protocol or firmware version.
        """
        for attempt in range(6):
            try:
                self.identity = self.request("id", 0.5)
                break
            except DeviceTimeout:
                if attempt == 5:
                    raise
        got = self.identity
        if got.get("proto") != PROTOCOL_VERSION:
            raise DeviceError(
                self.name,
                f"expected wire protocol {PROTOCOL_VERSION}, got {got.get('proto')}",
                "install the firmware that belongs to this version of pamrig",
            )
        if not f"{got.get('fw', '')}.".startswith(f"{firmware}."):
            raise DeviceError(
                self.name,
                f"key {self._key}.firmware: expected version {firmware}, got {got.get('fw')}",
                f"install that firmware, or change {self._key}.firmware in the rig file",
            )
        if serial and got.get("serial") != serial:
            raise DeviceError(
                self.name,
                f"key {self._key}.serial: expected {serial}, got {got.get('serial')}",
                f"connect the right controller, or change {self._key}.serial in the rig file",
            )
        return got

    def configure(self, parameters: dict[str, int]) -> None:
        """Set firmware parameters; each is checked against its bounds by the firmware."""
        for key, value in parameters.items():
            self.request(f"set {key} {value}")

    def arm(self) -> None:
        """Allow the inlet to open; the heartbeat must already be running.

        From now on the firmware refuses the commands of every other session.
        """
        now = self.request("id")
        if not {"conf", "boot"} <= now.keys():
            raise DeviceError(
                self.name,
                f"expected conf= and boot= in its identity, got {' '.join(sorted(now))!r}",
                "install the firmware that belongs to this version of pamrig",
            )
        self.identity = now
        self.other_set_point = None
        self.request(f"arm {now['conf']} {now['boot']} @{self._session}")

    def set_point(self, counts: float) -> None:
        """Regulate to a pressure given in raw counts (sent as sixteenths)."""
        self.request(f"sp {round(counts * 16)}")

    def ask_set_point(self, counts: float) -> int:
        """As :meth:`set_point`, without waiting for the reply; see :meth:`ask`."""
        return self.ask(f"sp {round(counts * 16)}")

    def foreign_commands(self) -> int:
        """Commands of other programs that the firmware has refused since arming.

        It is asked only if the firmware has reported one.
        """
        if not any(text.startswith("foreign") for text in self.events):
            return 0
        return int(self.request("stat").get("foreign", "0"))

    def stop(self) -> None:
        """Vent and disarm."""
        self.request("stop")

    def tell_stop(self) -> None:
        """Send that it is to vent and disarm; nobody waits for the answer."""
        with contextlib.suppress(LinkLost):  # the firmware vents without a heartbeat
            self._send("stop")

    @property
    def armed(self) -> bool:
        """As the newest telemetry says."""
        return bool(self.flags & 4)

    @property
    def fault_latched(self) -> bool:
        """As the newest telemetry says."""
        return bool(self.flags & 8)

    @property
    def midway(self) -> bool:
        """Whether a frame has begun to come, or the answer to a beat has not."""
        return bool(self._pings or self._framer.partial)

    def finish(self) -> None:
        """Nothing more is waited for: beats without an answer are counted."""
        self.unanswered += len(self._pings)
        self._pings.clear()

    def counters(self) -> dict[str, int]:
        """Everything that was lost or refused on the link so far."""
        framer = self._framer
        return {
            "frames": framer.frames,
            "damaged": framer.damaged,
            "oversize": framer.oversize,
            "dropped_bytes": framer.dropped_bytes,
            "bad_payloads": self.bad_payloads,
            "unanswered": self.unanswered,
            **self.telemetry.counters(),
            **self.channels.counters(),
        }
