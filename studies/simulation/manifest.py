"""The run.json of a simulation."""

from __future__ import annotations

from typing import Any

from daq.calibration import Calibration
from plant.constants import CHOICES, KEYS, nominal
from rigs.virtual.board.pressure_sensor import ADC_TOP
from studies.simulation.scenario import Scenario, as_plain

PROTOCOL = "simulate"


def plant_stated(scenario: Scenario) -> dict[str, Any]:
    """Constants of the first muscle that differ from the nominal ones, by their keys.

    Effects are left out on purpose: the diagnosis has to find them.
    """
    own, usual = scenario.muscles[0].constants, nominal()
    numbers = {key: own.value(key) for key in KEYS if own.value(key) != usual.value(key)}
    words = {key: getattr(own, key) for key in CHOICES if getattr(own, key) != getattr(usual, key)}
    return {**numbers, **words}


def manifest(scenario: Scenario) -> dict[str, Any]:
    """The contents of run.json before the run."""
    from rigs.execution.manifest import software

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
        "virtual": {"seed": scenario.seed, "plant": plant_stated(scenario)},
        "software": software(),
    }
