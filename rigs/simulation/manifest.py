"""What is known of a simulation before it runs: its run.json."""

from __future__ import annotations

from typing import Any

from daq.calibration import Calibration
from rigs.simulation.scenario import Scenario, as_plain
from rigs.virtual.pressuresensor import ADC_TOP

PROTOCOL = "simulate"


def manifest(scenario: Scenario) -> dict[str, Any]:
    """What is known before the run."""
    from rigs.session import software

    range_kpa = scenario.sensors.pressure_range_kpa
    pressure = Calibration(
        "pressure_kpa", "kPa", "count", 0.0, range_kpa / ADC_TOP, 0.3, 0.003,
        (0.0, range_kpa), id="simulated",
    )  # fmt: skip
    force = Calibration(
        "force_n", "N", "g", 0.0, 9.80665e-3, 0.2, 0.003, (-2000.0, 2000.0), id="simulated"
    )
    return {
        "protocol": PROTOCOL,
        "simulated": True,
        "parameters": as_plain(scenario),
        "specimen": scenario.name,
        "operator": "",
        "note": scenario.description,
        "rig": {
            "name": scenario.name,
            "description": scenario.description,
            "source": scenario.source,
            "crc32": scenario.crc32,
            "text": scenario.text,
        },
        "conditions": {
            "temperature_c": scenario.temperature_c,
            "u_temperature_c": 0.0,
            "gravity_m_s2": 9.80665,
        },
        "calibrations": {c.quantity: c.to_dict() for c in (pressure, force)},
        "devices": {
            "valve": {"name": "simulated board", "serial": "SIM-0001"},
        },
        "virtual": {"seed": scenario.seed},
        "software": software(),
    }
