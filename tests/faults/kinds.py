"""What can go wrong: each kind of fault, how it is put upon a running test, and where."""

from __future__ import annotations

import random
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from daq.errors import DeviceTimeout
from daq.link.codec import encode_request
from plant.physics.layout import DELAY
from rigs.virtual.emulators.balance import VirtualBalance
from rigs.virtual.emulators.supply import VirtualSupply
from rigs.virtual.emulators.text import VirtualText

from .wires import Rule

if TYPE_CHECKING:
    from .trial import Trial

KINDS: dict[str, tuple[str, ...]] = {
    "wire": ("lost", "flipped", "doubled", "cut", "garbage", "held up", "unplugged"),
    "instrument": ("half", "double", "checksum", "late", "stale", "drop", "garbage", "unit",
                   "overload", "comma"),
    "sensor": ("high", "low", "frozen", "silent"),
    "camera": ("dropped", "black", "repeated", "glare", "torn"),
    "disk": ("full", "slow", "read-only", "one error", "sync fails"),
    "process": ("killed", "killed in a write", "hung", "bug"),
    "clock": ("wall jumps", "drift", "device time wraps"),
    "controller": ("reset", "hung"),
    "supply": ("drop", "surge", "solenoids off", "solenoids low"),
    "valve": ("inlet stuck open", "outlet stuck open", "inlet stuck shut", "outlet stuck shut",
              "slow"),
    "other program": ("sets a pressure", "sets many", "beats", "changes a limit", "arms", "vents",
                      "stops"),
}  # fmt: skip
FROM_THE_START = {"clock"}
KEYPAD = ("unit", "overload", "comma")
FOR_GOOD = 1e9


@dataclass
class Fault:
    """One fault of a run.

    Attributes:
        layer, kind: of ``KINDS``.
        device: whose line or instrument, where there is a choice.
        start_s, end_s: bench time.
        size: how bad, 0 to 1.
        hits: how often it did something; 0: it never came to it.
        must_tell: hits that a record or message has to show.
        begun_us, ended_us: bench time at which it began and was over; -1: not yet.
        first_us: bench time at which it first did something; -1: never.
        scripted: its place is given, as a share of the test's length; it stays.
    """

    layer: str
    kind: str
    device: str = ""
    start_s: float = 0.0
    end_s: float = FOR_GOOD
    size: float = 0.5
    hits: int = 0
    must_tell: int = 0
    begun_us: int = -1
    ended_us: int = -1
    first_us: int = -1
    scripted: bool = False

    @property
    def name(self) -> str:
        """For journals and messages."""
        where = f" ({self.device})" if self.device else ""
        return f"{self.layer}: {self.kind}{where}"


MOMENTS = (0.1, 0.45, 0.8)
"""Of a scripted fault, as shares of the test's length."""


def script(protocol: str) -> list[Fault]:
    """Every kind by itself, early, midway and late in the test, and there for good."""
    kinds = [(layer, kind) for layer in layers_of(protocol) for kind in KINDS[layer]]
    return [Fault(*what, start_s=share, scripted=True) for share in MOMENTS for what in kinds]


def layers_of(protocol: str) -> list[str]:
    """The layers of a protocol: only some look through the camera."""
    return [layer for layer in KINDS if layer != "camera" or protocol in STATIC]


def draw(protocol: str, seed: int) -> list[Fault]:
    """The faults of a run: first the script, one by one, then one to three at random at once."""
    scripted = script(protocol)
    if 0 <= seed < len(scripted):
        return [scripted[seed]]
    rng = random.Random(f"{protocol}/{seed}")
    layers = layers_of(protocol)
    how_many = rng.choices((1, 2, 3), (4, 4, 2))[0]
    chosen = [layers[seed % len(layers)]]
    chosen += rng.sample([k for k in layers if k not in chosen], how_many - 1)
    return [Fault(k, rng.choice(KINDS[k]), size=rng.random()) for k in chosen]


STATIC = ("isometric", "isobaric", "isotonic", "isothermal", "hysteresis")


def place(fault: Fault, rng: random.Random, seconds: float) -> None:
    """Give a fault its time, in bench seconds from the start of the test."""
    if fault.scripted:
        fault.start_s *= seconds
        return
    fault.start_s = rng.uniform(0.0, 0.85 * seconds)
    short = () if fault.layer in ("camera", "instrument") else (0.1, 0.4)
    lasts = rng.choice((*short, 1.0, 3.0, FOR_GOOD))
    fault.end_s = fault.start_s + lasts


def begin(trial: Trial, fault: Fault) -> None:
    """The moment has come."""
    fault.begun_us = trial.bench.board.bench_us
    _BEGIN[fault.layer](trial, fault)


def count(trial: Trial, fault: Fault) -> None:
    """Put down what it did up to now."""
    counter = _COUNT.get(fault.layer)
    if counter is not None:
        counter(trial, fault)


def undo(trial: Trial, fault: Fault) -> None:
    """It is over."""
    over = _UNDO.get(fault.layer)
    if over is not None:
        over(trial, fault)


def acted(trial: Trial, fault: Fault) -> bool:
    """Whether it did anything yet."""
    if fault.layer == "wire" and fault.kind != "unplugged":
        return bool(trial.rules[id(fault)].altered)
    if fault.layer == "instrument" and fault.kind not in KEYPAD:
        return len(_device(trial, fault).wire.done) > trial.rules[id(fault)]
    return fault.hits > 0 or fault.layer == "instrument"


# ---- wire ---------------------------------------------------------------------------


def _wire(trial: Trial, fault: Fault) -> None:
    devices = [d for d in trial.bench.devices if d in trial.spoken()]
    fault.device = trial.rng.choice(["valve", "valve", "balance", *devices])
    if fault.kind == "unplugged":
        fault.hits = fault.must_tell = 1
        trial.bench.unplug(fault.device)
        return
    inward = trial.rng.random() < 0.75 or fault.kind == "held up"
    share = trial.rng.choice((0.02, 0.2, 1.0))
    rule = Rule(fault.device, inward, fault.kind, share, fault.start_s, fault.end_s)
    trial.rules[id(fault)] = rule
    trial.wires.rules.append(rule)


def _wire_undo(trial: Trial, fault: Fault) -> None:
    if fault.kind == "unplugged":
        trial.bench.replug(fault.device)


def _wire_count(trial: Trial, fault: Fault) -> None:
    if fault.kind == "unplugged":
        return
    rule = trial.rules[id(fault)]
    fault.hits = rule.altered
    # Outward: a command or heartbeat that is lost, doubled or late and did no harm is retried
    # or renewed; what a valve or instrument refused shows in its answers, if it has any.
    checked = fault.device == "valve" and rule.inward
    late = fault.kind == "held up"
    lost = fault.kind in ("lost", "doubled") and fault.device != "valve"
    if rule.inward and not late and not lost:
        fault.must_tell = rule.altered if checked else rule.altered - rule.plain


# ---- instruments --------------------------------------------------------------------


def _instrument(trial: Trial, fault: Fault) -> None:
    there: dict[str, Any] = {"balance": trial.bench.balance, **trial.bench.extras.devices}
    there = {name: d for name, d in there.items() if name in trial.spoken()}
    fault.device = trial.rng.choice(list(there))
    device = there[fault.device]
    if fault.kind in KEYPAD:
        _keypad(device, fault.kind, True)
        return
    count = 1 + int(fault.size * 12)
    device.wire.arrange(*[fault.kind] * count)
    trial.rules[id(fault)] = len(device.wire.done)


def _keypad(device: Any, kind: str, on: bool) -> None:
    """What somebody does at the instrument itself."""
    if kind == "overload":
        device.flag = "overload" if on else ""
    elif kind == "comma" and hasattr(device, "comma"):
        device.comma = on
    elif kind == "unit" and hasattr(device, "unit_code"):
        device.unit_code += 1 if on else -1
    elif kind == "unit" and isinstance(device, VirtualSupply):
        device.suffix = "mV" if on else ""
    elif kind == "unit" and isinstance(device, (VirtualBalance, VirtualText)):
        device.unit = (
            "oz" if on else "g" if isinstance(device, VirtualBalance) else device._form.unit
        )


def _device(trial: Trial, fault: Fault) -> Any:
    bench = trial.bench
    return bench.balance if fault.device == "balance" else bench.extras.devices[fault.device]


def _instrument_undo(trial: Trial, fault: Fault) -> None:
    if fault.kind in KEYPAD:
        _keypad(_device(trial, fault), fault.kind, False)


def _instrument_count(trial: Trial, fault: Fault) -> None:
    device = _device(trial, fault)
    if fault.kind in KEYPAD:
        seconds = min(fault.end_s, trial.bench.board.bench_us * 1e-6) - fault.start_s
        fault.hits = int(seconds > 0.0)
        talks = fault.device != "supply" and not (
            fault.kind == "comma" and not hasattr(device, "comma")
        )
        if fault.kind == "unit" and isinstance(device, VirtualText) and not device._form.unit:
            talks = False
        fault.must_tell = int(talks and seconds > 3.0)
        return
    done = len(device.wire.done) - trial.rules[id(fault)]
    fault.hits = done
    # One message that never came, or came a little late, harms nothing; a stream that pauses does.
    fault.must_tell = done if fault.kind in ("half", "checksum", "stale", "garbage") else 0
    if fault.kind == "checksum" and not has_checksum(device):
        fault.must_tell = 0


def has_checksum(device: Any) -> bool:
    """Whether what a virtual instrument sends shows by itself that a digit was flipped."""
    form = getattr(device, "_form", None)
    return getattr(form, "checksum", "none") != "none" or hasattr(form, "register")


# ---- sensor and controller ----------------------------------------------------------


def _sensor(trial: Trial, fault: Fault) -> None:
    board = trial.bench.board
    board.sensor_override = {"high": 4095, "low": 0, "frozen": board.adc(), "silent": -1}[
        fault.kind
    ]
    fault.hits = 1


def _sensor_undo(trial: Trial, fault: Fault) -> None:
    trial.bench.board.sensor_override = None


def _controller(trial: Trial, fault: Fault) -> None:
    fault.hits = fault.must_tell = 1
    if fault.kind == "reset":
        trial.bench.board.reset("brownout")
    else:
        trial.bench.board.freeze()


# ---- camera -------------------------------------------------------------------------


def _camera(trial: Trial, fault: Fault) -> None:
    trial.camera_fault = fault


def _camera_undo(trial: Trial, fault: Fault) -> None:
    if trial.camera_fault is fault:
        trial.camera_fault = None


def spoil_frame(trial: Trial, fault: Fault, frame: Any, last: Any) -> Any:
    """A frame as the faulty camera gives it."""
    seq, host_ns, gray = frame
    fault.hits += 1
    if fault.kind == "dropped":
        fault.must_tell += 1
        raise DeviceTimeout("camera", "no frame within 2 s", "check its cable")
    if fault.kind == "black":
        fault.must_tell += 1
        return seq, host_ns, np.zeros_like(gray)
    if fault.kind == "repeated":
        if last is None:
            fault.hits -= 1
            return frame
        fault.must_tell += 1
        # Some cameras count a picture anew that they send again.
        return last if fault.size < 0.5 else (seq, host_ns, last[2])
    out = gray.copy()
    if fault.kind == "glare":
        height, width = gray.shape
        y, x = trial.rng.randrange(height), trial.rng.randrange(width)
        reach = int(40 + 260 * fault.size)
        out[max(0, y - reach) : y + reach, max(0, x - reach) : x + reach] = 255
    elif last is not None:
        out[gray.shape[0] // 2 :] = last[2][gray.shape[0] // 2 :]
    return seq, host_ns, out


# ---- disk, process ------------------------------------------------------------------


def _disk(trial: Trial, fault: Fault) -> None:
    trial.disk.begin(fault)


def _disk_undo(trial: Trial, fault: Fault) -> None:
    trial.disk.end(fault)


class Bug(Exception):
    """An error that nobody expected."""


def _process(trial: Trial, fault: Fault) -> None:
    fault.hits = fault.must_tell = 1
    if fault.kind == "killed":
        trial.die()
    elif fault.kind == "killed in a write":
        trial.disk.die_in_write = True
    elif fault.kind == "bug":
        raise Bug("an error that nobody expected")
    else:
        trial.hang_s = 0.05 + 3.0 * fault.size
        fault.must_tell = int(trial.hang_s > 0.4)


# ---- supply, valve ------------------------------------------------------------------


def _supply(trial: Trial, fault: Fault) -> None:
    bench = trial.bench
    volts = bench.extras.devices.get("supply")
    fault.hits = 1
    if fault.kind.startswith("solenoids"):
        if volts is None:
            fault.hits = 0
        elif fault.kind == "solenoids off":
            volts.is_on = False
        else:
            volts.set_v *= 0.3 + 0.4 * fault.size
        return
    trial.supply_kpa = float(bench.plant.params[0] * 0 + bench.plant.state[5]) * 1e-3
    factor = 0.2 + 0.7 * fault.size if fault.kind == "drop" else 1.05 + 0.55 * fault.size
    bench.plant.set_supply(min(1200.0, trial.supply_kpa * factor))


def _supply_undo(trial: Trial, fault: Fault) -> None:
    if not fault.kind.startswith("solenoids"):
        trial.bench.plant.set_supply(trial.supply_kpa)


def _valve(trial: Trial, fault: Fault) -> None:
    board = trial.bench.board
    fault.hits = 1
    if fault.kind == "inlet stuck open":
        board.inlet_jammed = True
    elif fault.kind == "outlet stuck open":
        board.outlet_jammed = True
    elif fault.kind == "slow":
        trial.delays = trial.bench.plant.params[DELAY : DELAY + 4].copy()
        trial.bench.plant.params[DELAY : DELAY + 4] *= 1.5 + 6.0 * fault.size
    else:
        trial.shut.add(fault.kind.split()[0])


def _valve_undo(trial: Trial, fault: Fault) -> None:
    board = trial.bench.board
    if fault.kind == "inlet stuck open":
        board.inlet_jammed = False
    elif fault.kind == "outlet stuck open":
        board.outlet_jammed = False
    elif fault.kind == "slow":
        trial.bench.plant.params[DELAY : DELAY + 4] = trial.delays
    else:
        trial.shut.discard(fault.kind.split()[0])


# ---- another program on the controller's line -----------------------------------------

OTHERS = ("", " @1", " @40001")
"""Its session: none, or one that is not the test's."""


def _other_program(trial: Trial, fault: Fault) -> None:
    """Requests of a program that found the port too; they pass no line that could spoil them."""
    controller = trial.bench.board.controller
    mark = trial.rng.choice(OTHERS)
    high = 2000 + int(fault.size * 60_000)
    arm = f"arm {controller.checksum.of(controller.values):04x} {controller.telemetry.boot_id}"
    words = {
        "sets a pressure": [f"sp {high}{mark}"],
        "sets many": [f"sp {(high + 997 * k) % 65_000}{mark}" for k in range(30)],
        "beats": [f"hb {k}{mark}" for k in range(1, 41)],
        "changes a limit": ["set trip 4095", "set hb_ms 5000"],
        "arms": [arm + mark],
        "vents": ["vent"],
        "stops": ["stop"],
    }[fault.kind]
    armed = bool(controller.safety.armed)
    fault.hits = len(words)
    fault.must_tell = int(armed and fault.kind in ("sets a pressure", "sets many", "beats"))
    for number, request in enumerate(words):
        trial.wires.direct("valve", encode_request(60_000 + number, request))


def _nothing(trial: Trial, fault: Fault) -> None:
    """Clock faults are there from the start; see Trial."""
    fault.hits = 1


_BEGIN = {
    "wire": _wire, "instrument": _instrument, "sensor": _sensor, "controller": _controller,
    "camera": _camera, "disk": _disk, "process": _process, "supply": _supply, "valve": _valve,
    "clock": _nothing, "other program": _other_program,
}  # fmt: skip
_COUNT = {"wire": _wire_count, "instrument": _instrument_count}
_UNDO = {
    "wire": _wire_undo, "instrument": _instrument_undo, "sensor": _sensor_undo,
    "camera": _camera_undo, "disk": _disk_undo, "supply": _supply_undo, "valve": _valve_undo,
}  # fmt: skip
