"""Camera time against controller time, measured in each run by the sync LED.

The controller shows a pseudo-random pattern on an LED that the camera sees. The shift of
that pattern along the frames' stamps is what the camera's stamps are late by; the clock fit
joins it to the pressure's clock. Done once at the start of a run, before anything is armed.
"""

from __future__ import annotations

import math

import numpy as np

from analysis.reduction.pictures import decode
from daq.record.writer import RecordWriter
from rigs.bench.rig import Rig
from rigs.rigfile.config import CameraSync
from rigs.steps.pictures import store
from vision.syncled import SyncError, find_delay, led_level, patch_row_shift

SEED = 0xACE1
PERIOD_S = 0.02
LONGEST_S = 0.2
CRYSTAL = 50e-6


def measure_camera_delay(rig: Rig, record: RecordWriter, sync: CameraSync) -> bool:
    """Show the pattern, take frames, find the delay and record it as event ``camera_sync``.

    Returns:
        Whether a delay was found; if not, the event says why. A test at settled points can
        do without, so it is no fault.
    """
    valve = rig.valve
    valve.request("led 0")
    started = valve.request(f"led sync {SEED} {sync.bit_ms}")
    # The reply is stamped by the controller at the moment the pattern begins.
    start_ns = rig.clock.now_ns()
    rig.event_loop.for_seconds(LONGEST_S + 0.05)
    levels, stamps, same, last = [], [], [], None
    for _ in range(sync.frames):
        frame = rig.camera.trigger()
        _, jpeg = store(rig, record, frame, sync=1)
        gray = decode(jpeg)
        assert gray is not None
        levels.append(led_level(gray, sync.patch))
        stamps.append(frame.host_ns)
        same.append(last is not None and np.array_equal(frame.gray, last))
        last = frame.gray
        rig.event_loop.step(PERIOD_S)
    valve.request("led 0")
    fields: dict[str, object] = {"frames": len(levels)}
    try:
        begin_us = valve.telemetry.device_time.unwrap(int(started["t"]), start_ns)
        begin_ns = valve.clock_fit.to_host_ns(begin_us)
        origin = stamps[0]
        found = find_delay(
            np.array(levels, dtype=np.float64),
            np.array([(s - origin) * 1e-9 for s in stamps], dtype=np.float64),
            (begin_ns - origin) * 1e-9,
            SEED,
            sync.bit_ms,
            exposure_s=sync.exposure_ms * 1e-3,
            row_shift_s=patch_row_shift(sync.patch, last.shape[0], sync.readout_ms * 1e-3)
            if last is not None
            else 0.0,
            longest_s=LONGEST_S,
            repeated=np.array(same),
        )
    except (SyncError, ValueError) as error:
        record.event("camera_sync", found=False, reason=str(error), **fields)
        return False
    # Two standard uncertainties are what the clock fit states as its bound; the pattern runs
    # on a crystal whose rate is not well known yet.
    span_s = (stamps[-1] - stamps[0]) * 1e-9
    u_s = math.hypot(found.u_delay_s, valve.clock_fit.error_ns * 1e-9 / 2, CRYSTAL * span_s / 2)
    record.event(
        "camera_sync",
        found=True,
        delay_ms=found.delay_s * 1e3,
        u_delay_ms=u_s * 1e3,
        contrast=found.contrast,
        dropped=found.dropped,
        repeated=found.repeated,
        **fields,
    )
    return True
