"""`pamrig console`: talk to a valve controller by hand.

What is typed goes to the controller as it stands (``id``, ``conf 3``, ``pulse inlet 9000``); what
begins with a slash is for the console. Events show as they come, telemetry only on request.
"""

from __future__ import annotations

import queue
import sys
import threading
from collections.abc import Callable
from typing import TextIO

from daq.errors import DeviceError, DeviceTimeout
from rigs.bench.rig import open_valve
from rigs.devices.event_loop import EventLoop
from rigs.devices.valve_controller import ValveController
from rigs.rigfile.config import RigConfig
from valvefw import wire

HELP = """\
Anything without a slash is sent to the controller; `help` there lists its verbs.
  /beat            send heartbeats from now on (needed while armed); /beat off stops
  /arm [scheme]    heartbeats on, arm with the present parameters, choose a scheme
  /sp <kPa>        set-point in kPa, by the rig's calibration
  /t               newest reading: pressure, valves, flags
  /faults          latched faults with the samples before the first
  /wait <s>        let time pass, showing events
  /quit            vent, disarm and leave (so does the end of input)"""

FLAGS = (
    (wire.FLAG_INLET, "inlet"),
    (wire.FLAG_VENT, "vent"),
    (wire.FLAG_ARMED, "armed"),
    (wire.FLAG_FAULT, "FAULT"),
    (wire.FLAG_LED, "led"),
    (wire.FLAG_HEARTBEAT, "heartbeat"),
    (wire.FLAG_PROX_A, "prox A"),
    (wire.FLAG_PROX_B, "prox B"),
)
HOUR_S = 3600.0


class Console:
    """One person's words to one controller.

    Args:
        valve: the connected controller.
        event_loop: of the bench.
        config: for pressures in kPa.
        output: takes each line of output.
    """

    def __init__(
        self,
        valve: ValveController,
        event_loop: EventLoop,
        config: RigConfig,
        output: Callable[[str], None],
    ) -> None:
        self._valve = valve
        self._event_loop = event_loop
        self._pressure = config.calibrations["pressure_kpa"]
        self._print = output
        valve.on_event = lambda text: output(f"* {text}")

    def line(self, text: str) -> bool:
        """Obey one line; False when it was the last."""
        words = text.split()
        if not words:
            return True
        if words[0] in ("/quit", "/exit"):
            return False
        try:
            if words[0].startswith("/"):
                self._own(words[0], words[1:])
            else:
                self._request(" ".join(words))
        except DeviceTimeout as error:
            self._print(f"no answer: {error}")
        except DeviceError as error:
            self._print(f"refused: {error.what}: {error.remedy}")
        except ValueError as error:
            self._print(f"not understood: {error}; /help")
        return True

    def _request(self, text: str) -> dict[str, str]:
        values = self._valve.request(text)
        self._print("ok" + "".join(f" {key}={value}" for key, value in values.items()))
        return values

    def _own(self, word: str, args: list[str]) -> None:
        if word == "/help":
            self._print(HELP)
        elif word == "/beat":
            if args == ["off"]:
                self._valve.still()
                self._print("heartbeats off: an armed controller vents")
            else:
                self._valve.progress(HOUR_S)
                self._print("heartbeats on, for an hour")
        elif word == "/arm":
            self._valve.progress(HOUR_S)
            self._valve.arm()
            self._request(f"scheme {args[0] if args else 'idle'}")
        elif word == "/sp":
            counts = float(self._pressure.raw(float(args[0] if args else "")))
            self._request(f"sp {round(counts * 16)}")
        elif word == "/wait":
            self._event_loop.for_seconds(float(args[0] if args else "1"))
        elif word == "/t":
            self._newest()
        elif word == "/faults":
            self._faults()
        else:
            raise ValueError(f"no such word {word}")

    def _newest(self) -> None:
        counts = self._valve.recent_counts(50)
        if not len(counts):
            self._print("no telemetry yet")
            return
        on = [name for bit, name in FLAGS if self._valve.flags & bit]
        kpa = float(self._pressure.apply(counts.mean()))
        self._print(f"{kpa:.2f} kPa ({counts[-1]:.0f} counts), {', '.join(on) or 'nothing on'}")

    def _faults(self) -> None:
        known = self._request("faults")
        rows: list[str] = []
        while len(rows) < int(known["samples"]):
            part = self._valve.request(f"blackbox {len(rows)}")
            data = bytes.fromhex(part["data"])
            for at in range(0, len(data), wire.SAMPLE_SIZE):
                row = data[at : at + wire.SAMPLE_SIZE]
                dt_us, counts = row[0] | row[1] << 8, row[2] | row[3] << 8
                rows.append(f"{dt_us:6d} {counts:5d} {row[4]:02x} {row[5] * 5:5d} {row[6] * 5:5d}")
        if rows:
            self._print("dt_us counts flags inlet_us vent_us, to the fault")
            for line in rows:
                self._print(line)


def converse(config: RigConfig, source: TextIO | None = None, beat: bool = False) -> int:
    """Read lines until the end of input; vent and disarm on the way out.

    Raises:
        PamrigError: the controller cannot be reached, or is not the rig's.
    """
    source = source or sys.stdin

    def output(text: str) -> None:
        sys.stdout.write(text + "\n")
        sys.stdout.flush()

    with open_valve(config) as (valve, event_loop, _, bench):
        console = Console(valve, event_loop, config, output)
        output(f"{valve.name}: " + " ".join(f"{k}={v}" for k, v in valve.identity.items()))
        output("/help for help" + (" (virtual: time passes with each line)" if bench else ""))
        if beat:
            console.line("/beat")
        if event_loop.clock.virtual:
            for text in source:
                if not console.line(text):
                    break
                event_loop.for_seconds(0.05)
            return 0
        lines: queue.Queue[str | None] = queue.Queue()

        def read() -> None:
            for text in source:
                lines.put(text)
            lines.put(None)

        threading.Thread(target=read, name="console", daemon=True).start()
        while True:
            event_loop.step()
            try:
                text = lines.get_nowait()
            except queue.Empty:
                continue
            if text is None or not console.line(text):
                return 0
