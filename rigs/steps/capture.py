"""A block of fast samples around one valve pulse, taken by the controller."""

from __future__ import annotations

import numpy as np

from analysis.reduction.switching import Block
from rigs.devices.event_loop import EventLoop
from rigs.devices.valve_controller import ValveController


def capture_block(
    controller: ValveController, event_loop: EventLoop, valve: str, width_us: int, source: int = 1
) -> Block:
    """One pulse on an armed controller in scheme ``open``, with the samples around it.

    Args:
        controller: the valve controller.
        event_loop: of the bench.
        valve: "inlet" or "vent".
        width_us: length of the command, at most 30000, a multiple of 5.
        source: 0 the pressure sensor, 1 the second sensor.

    Raises:
        DeviceError: refused, in the controller's words.
    """
    answer = controller.request(f"capture {valve} {width_us} {source}")
    n, period_us = int(answer["n"]), int(answer["period_us"])
    event_loop.for_seconds(n * period_us * 1e-6 + 0.02)
    samples: list[int] = []
    lead_us = 0
    while len(samples) < n:
        part = controller.request(f"block {len(samples)}")
        data = part["data"]
        samples += [int(data[k : k + 3], 16) for k in range(0, len(data), 3)]
        lead_us = int(part["lead_us"])
    return Block(valve, width_us, lead_us, period_us, np.array(samples, dtype=np.float64))
