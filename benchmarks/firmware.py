"""The firmware's step under a real MicroPython interpreter: time, jitter, and 1 kHz held.

    python -m benchmarks.firmware            # a table
    python -m benchmarks.firmware --json

The interpreter is WebAssembly under Node on this machine: a figure for comparing schemes and
versions, and for what a collection of garbage costs, not the time on an RP2040. What the board
itself takes it can tell by its telemetry: ``dt_us`` of every sample.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))

import micropython_host

TICKS = 20_000
REAL_SECONDS = 5.0

SCHEME = """
import gc, js
from array import array
from valvefw.deskboard import DeskBoard
from valvefw.schemes.valves import Valves
now = js.performance.now
NAME = '%s'
board = DeskBoard(has_regulator=NAME == 'reg')
c = board.controller
c.values['stuck_ms'] = 0
c.safety.arm(c.values)
if NAME != 'idle':
    c.choose(NAME)
    if NAME == 'open':
        c.openloop.begin(False, 5000, 10000, 20000)
    else:
        c.set_setpoint(16000)
took = array('f', [0.0] * %d)
gc.collect()
k = 0
while k < len(took):
    if not k & 63:
        c.safety.heartbeat(k >> 6)
        if k & 1024 and NAME not in ('idle', 'open'):
            c.setpoint_x16 = 16000 if k & 2048 else 9000
    board.now_us += 1000
    begin = now()
    c.tick()
    took[k] = now() - begin
    board._flow()
    board._sent.clear()
    k += 1
assert not c.safety.faults, c.safety.faults
if NAME != 'idle':
    valves = Valves()
    scheme = c.schemes[NAME]
    begin = now()
    for k in range(2000):
        scheme.step(900 + (k & 1), 16000 if k & 512 else 12000, 1000, valves)
    step = (now() - begin) / 2000
else:
    step = 0.0
print('[%%r,' %% (step * 1e3), ','.join(['%%.2f' %% (t * 1e3) for t in took]), ']')
"""

REAL_TIME = """
import gc, js
from array import array
from valvefw.deskboard import DeskBoard
now = js.performance.now
board = DeskBoard()
c = board.controller
c.values['hb_ms'] = 1000
origin = now()
c.safety.arm(c.values)
c.choose('burst')
n = int(%f * 1000)
late = array('f', [0.0] * n)
k = 0
frames = []
start = now()
while k < n:
    due = start + k + 1
    while now() < due:
        pass
    late[k] = now() - due
    board.now_us = int((now() - origin) * 1000) & 0xFFFFFFFF
    if k %% 100 == 0:
        c.safety.heartbeat(k // 100)
        c.set_setpoint(16000 if k %% 2000 < 1000 else 9000)
    c.tick()
    board._flow()
    if board._sent:
        frames += board._sent
        board._sent.clear()
    k += 1
took = now() - start
samples = 0
from valvefw.wire import decode_frame
gaps = 0
expected = None
for frame in frames:
    p = decode_frame(frame[:-1])
    if p[0] == 84:
        seq = p[5] | p[6] << 8 | p[7] << 16
        if expected is not None and seq != expected:
            gaps += 1
        expected = seq + p[13]
        samples += p[13]
late = sorted(late)
print('[%%d, %%d, %%f, %%f, %%f, %%f]' %% (
    samples, gaps, took, late[n // 2], late[n * 999 // 1000], late[-1]))
"""


def schemes() -> dict[str, dict[str, float]]:
    """Microseconds of a whole tick (median, p99, p99.9, worst) and of the scheme's step alone."""
    out = {}
    for name in ("idle", "pwm", "open", "reg", "two", "duty_in", "duty", "slide", "ram", "burst"):
        interpreter = micropython_host.MicroPython()
        try:
            step, *took = json.loads(interpreter.run(SCHEME % (name, TICKS)))
        finally:
            interpreter.close()
        took.sort()
        out[name] = {
            "step_us": step,
            "tick_median_us": took[len(took) // 2],
            "tick_p99_us": took[len(took) * 99 // 100],
            "tick_p99.9_us": took[len(took) * 999 // 1000],
            "tick_worst_us": took[-1],
        }
    return out


def real_time(seconds: float = REAL_SECONDS) -> dict[str, float]:
    """The burst scheme paced by the wall clock: samples a second, gaps, lateness in ms."""
    interpreter = micropython_host.MicroPython()
    try:
        samples, gaps, took_ms, median, p999, worst = json.loads(
            interpreter.run(REAL_TIME % seconds)
        )
    finally:
        interpreter.close()
    return {
        "samples_per_s": samples / took_ms * 1e3,
        "gaps": gaps,
        "late_median_ms": median,
        "late_p99.9_ms": p999,
        "late_worst_ms": worst,
    }


def main() -> None:
    """Print both."""
    rows, paced = schemes(), real_time()
    if "--json" in sys.argv:
        print(json.dumps({"schemes": rows, "real_time": paced}, indent=2))
        return
    print("us under MicroPython      step    tick: median     p99   p99.9   worst")
    for name, row in rows.items():
        print(
            f"{name:22} {row['step_us']:7.2f} {row['tick_median_us']:15.1f} "
            f"{row['tick_p99_us']:7.1f} {row['tick_p99.9_us']:7.1f} {row['tick_worst_us']:7.1f}"
        )
    print(", ".join(f"{key} {value:.3f}" for key, value in paced.items()))


if __name__ == "__main__":
    main()
