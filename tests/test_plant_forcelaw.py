"""Force law of whole arrays against the compiled bench, all muscle effects at once."""

from __future__ import annotations

import numpy as np
import pytest

from plant.constants import nominal
from plant.effects.effects import Effects
from plant.errors import PlantError
from plant.simulator.force_law import ForceLaw
from plant.simulator.readings import lagged, readings
from plant.simulator.simulate import Commands, commands, run_commands

C = nominal()
ALL = Effects.from_config(
    {
        "liner_threshold": {"threshold_kpa": 60.0},
        "bladder_elasticity": {"stiffness_n_mm": 0.4, "hardening_per_mm2": 0.002},
        "contraction_limit": {"force_n": 4.0},
        "end_cap": {"shortening_mm": 1.5},
        "fibre_stretch": {"stretch_percent": 0.8},
        "braid_friction": {"friction_n": 2.0},
        "viscosity": {"damping_n_s_mm": 0.1, "exponent": 0.6, "pressure_share": 0.4},
        "creep": {"relaxation_percent": 6.0},
        "temperature_stiffening": {"percent_per_k": 0.8, "flat_share": 0.3},
        "wear": {"percent_per_100_trials": -6.0},
        "pressure_lag": {"time_ms": 30.0},
    }
)


def test_the_array_form_and_the_compiled_bench_agree_along_a_path() -> None:
    rows = commands([(0.0, "inlet", 1.0), (0.3, "regulator_kpa", 450.0)]) + Commands(
        np.array([1.0, 3.0, 4.0]), ("length_rate_mm_s",) * 3, np.array([3.0, -4.0, 0.0])
    )
    more = {"source": "regulator", "length_m": 0.060, "temperature_c": 28.0, "trials": 40.0}
    trace = run_commands(C, rows, 6.0, 1000.0, ALL, **more)  # type: ignore[arg-type]
    rate = np.select([trace.time_s < 1.0, trace.time_s < 3.0, trace.time_s < 4.0], [0, 3e-3, -4e-3])
    told = ForceLaw(C, ALL).force(
        trace.time_s, trace.pressure_kpa * 1e3, trace.length_mm * 1e-3, 28.0, 40.0, rate
    )
    away = np.ones(len(told), dtype=bool)
    for turn in (1000, 3000, 4000):  # the rate of that very sample is on either side of the turn
        away[turn - 1 : turn + 2] = False
    assert np.abs(told - trace.force_n)[away].max() < 1e-3
    seen = lagged(trace.time_s, trace.pressure_kpa, 0.030)
    assert np.abs(readings(trace, C, ALL).pressure_kpa - seen).max() < 2e-3


def test_without_effects_it_is_the_nominal_muscle_and_refuses_the_same() -> None:
    law = ForceLaw(C)
    assert law.lasting(600e3, [0.052, 0.060]) == pytest.approx([4.13, 41.42], abs=0.005)
    with pytest.raises(PlantError, match="outside the braid"):
        law.lasting(1e5, 0.09)
