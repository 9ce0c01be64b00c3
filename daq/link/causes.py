"""What the controller's events mean in words, and what to do about each fault.

The record keeps each event as the controller sent it (``fault cause=over_pressure t=...``).
Terminal and live view show these words.
"""

from __future__ import annotations

CAUSES: dict[str, tuple[str, str]] = {
    "host_silent": (
        "the computer's heartbeat stopped, so the controller vented",
        "check cable and computer: `pamrig doctor`; end other heavy programs, then run again",
    ),
    "over_pressure": (
        "the pressure reached the limit of the firmware",
        "lower the supply pressure, check the transducer's calibration and limits.pressure_kpa",
    ),
    "sensor_saturated": (
        "the pressure reading is at the end of its range",
        "check the transducer's supply, cable and range",
    ),
    "sensor_silent": (
        "the pressure transducer gives no readings",
        "check the transducer's cable and the converter",
    ),
    "sensor_stuck": (
        "the pressure reading does not change at all",
        "check the transducer's cable; a working sensor has noise",
    ),
    "sensor_jump": (
        "the pressure reading jumped faster than the air can flow",
        "check the transducer's cable for a loose contact, and the hose for a leak",
    ),
    "sensor_no_rise": (
        "the inlet was open, but the pressure did not rise",
        "open the air supply; check hose, inlet valve and transducer",
    ),
    "inlet_stuck": (
        "both valves were commanded closed, but the pressure rose",
        "shut the supply by hand; check whether the inlet valve closes",
    ),
    "outlet_stuck": (
        "both valves were commanded closed, but the pressure fell",
        "look for a leak: hose, muscle and outlet valve",
    ),
    "inlet_bound": (
        "the inlet was open for longer than allowed",
        "check the supply pressure and look for a leak",
    ),
    "vent_failed": (
        "vented, but the pressure did not fall in time",
        "SHUT THE SUPPLY BY HAND; check the outlet valve and its exhaust",
    ),
    "vent_lost": (
        "vented, but the pressure rose again",
        "SHUT THE SUPPLY BY HAND; check inlet valve and outlet valve",
    ),
    "loop_stalled": (
        "the controller's program stood still, so its watchdog vented",
        "switch the controller off and on, then `pamrig doctor`; keep the record",
    ),
}
"""By cause: what happened, and what to do."""


def fields_of(event: str) -> dict[str, str]:
    """The ``name=value`` fields of an event."""
    return dict(part.split("=", 1) for part in event.split() if "=" in part)


def cause_of(event: str) -> str:
    """The cause that a fault event names; empty for other events and for unknown causes."""
    if not event.startswith("fault"):
        return ""
    cause = fields_of(event).get("cause", "")
    return cause if cause in CAUSES else ""


def event_words(event: str) -> str:
    """An event in words; one that is not known stays as it came."""
    cause = cause_of(event)
    if cause:
        what, remedy = CAUSES[cause]
        return f"fault {cause}: {what}. What to do: {remedy}"
    if event.startswith("vented"):
        ms = fields_of(event).get("ms", "")
        return f"vented within {int(ms) / 1000:.2f} s" if ms.isdigit() else event
    return event
