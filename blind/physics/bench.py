"""The bench: constants by name, their tolerances, and one trial run on it without noise."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from blind.physics import alternatives
from blind.physics import numbers as n
from blind.physics.laws import relaxation
from blind.physics.stepping import run

Floats = np.ndarray

# Name in a bench file, place in the array, nominal value, tolerance (1 sd), relative?
CONSTANTS: tuple[tuple[str, int, float, float, bool], ...] = (
    ("supply_kpa", n.SUPPLY, 550.0, 2.0, False),
    ("atmosphere_kpa", n.ATMOSPHERE, 101.325, 1.0, False),
    ("gas_temperature_k", n.GAS_K, 293.15, 3.0, False),
    ("braid_length_mm", n.BRAID, 88.4, 0.003, True),
    ("turns", n.TURNS, 1.855, 0.01, True),
    ("inlet_conductance_m3_s_pa", n.C_IN, 1.25e-9, 0.05, True),
    ("outlet_conductance_m3_s_pa", n.C_OUT, 1.25e-9, 0.05, True),
    ("critical_ratio", n.RATIO, 0.5, 0.03, False),
    ("dead_volume_ml", n.DEAD_ML, 0.5, 0.2, True),
    ("polytropic_exponent", n.EXPONENT, 1.0, 0.0, False),
    ("length_min_mm", n.L_MIN, 51.0, 0.5, False),
    ("length_max_mm", n.L_MAX, 72.5, 0.5, False),
    ("stop_stiffness_n_mm", n.STOP_K, 20.0, 0.0, False),
    ("stop_damping_n_s_mm", n.STOP_C, 0.02, 0.0, False),
    ("load_damping_n_s_mm", n.LOAD_C, 0.005, 0.5, True),
    ("inlet_on_ms", n.IN_ON, 8.70, 0.2, False),
    ("inlet_on_ms_per_kpa", n.IN_ON + 1, 0.00395, 0.1, True),
    ("inlet_off_ms", n.IN_OFF, 8.94, 0.1, False),
    ("inlet_off_ms_per_kpa", n.IN_OFF + 1, -0.00080, 0.2, True),
    ("outlet_on_ms", n.OUT_ON, 9.28, 0.3, False),
    ("outlet_on_ms_per_kpa", n.OUT_ON + 1, 0.00174, 0.2, True),
    ("outlet_off_ms", n.OUT_OFF, 8.82, 0.1, False),
    ("outlet_off_ms_per_kpa", n.OUT_OFF + 1, -0.00058, 0.2, True),
)
KEYS = {key: place for key, place, _, _, _ in CONSTANTS}


class NoSuchBenchError(ValueError):
    """What was asked of the bench no bench can have, such as a load that weighs less than none."""


@dataclass(frozen=True)
class Trial:
    """One trial as commanded: what is prescribed, and when each channel is read.

    Courses are pairs of arrays (time s, value); `edges` rows are (time s, side, state).
    """

    trial: str
    slot: str
    protocol: str
    replicate: int
    mounting: int
    order: int
    duration_s: float
    held_mm: float | None = None
    load_kg: float = 0.0
    temperature_c: float = 21.0
    regulator: tuple[Floats, Floats] | None = None
    edges: Floats = field(default_factory=lambda: np.zeros((0, 3)))
    length: tuple[Floats, Floats] | None = None
    pressure_hz: float = 1000.0
    force_hz: float = 80.0
    camera_hz: float = 0.0
    settled_s: Floats | None = None  # a table: the instants whose readings are kept
    start_s: float = 0.0
    regulator_s: float = 1.0

    @property
    def valved(self) -> bool:
        """Whether the valve drives it."""
        return self.regulator is None


def nominal() -> Floats:
    """Constants of the nominal plant, indexed by `numbers`."""
    c = np.zeros(n.CONSTANTS)
    for _, place, value, _, _ in CONSTANTS:
        c[place] = value
    c[n.SUPPLY] += c[n.ATMOSPHERE]
    c[n.REGULATOR_S] = 1.0
    c[n.MUSCLE_C] = 21.0
    return c


def with_keys(c: Floats, keys: Mapping[str, float]) -> Floats:
    """Constants with some of a bench file's keys changed (gauge supply)."""
    out = c.copy()
    gauge = c[n.SUPPLY] - c[n.ATMOSPHERE]
    for key, value in keys.items():
        out[KEYS[key]] = value
    out[n.SUPPLY] = keys.get("supply_kpa", gauge) + out[n.ATMOSPHERE]
    return out


def tolerances(c: Floats) -> Floats:
    """One standard deviation of each constant around c; zero where a constant is fixed."""
    sd = np.zeros_like(c)
    for _, place, _, tolerance, relative in CONSTANTS:
        sd[place] = abs(c[place]) * tolerance if relative else tolerance
    return sd


def no_effect() -> Floats:
    """The effect matrix with everything off."""
    e = np.zeros((n.ROWS, 5))
    e[:, 0] = n.OFF
    e[n.LINER, 2:] = 1.0
    return e


IDLE = (np.array([0.0, 1e9]), np.zeros(2))


def label_shift(e: Floats, written_mm: float, mounting: int) -> float:
    """True minus written length, mm, of a muscle that is held."""
    if e[n.LABEL, 0] < 0.0:
        return 0.0
    shift = float(e[n.LABEL, 1])
    if e[n.LABEL, 0] == 1.0:  # the scale is misread a little more when long
        shift *= 1.0 + 0.02 * (written_mm - 60.0)
    elif e[n.LABEL, 0] == 2.0:  # set anew at each mounting
        shift *= 1.0 + (0.1 if mounting % 2 else -0.1)
    elif e[n.LABEL, 0] >= 3.0:
        shift *= alternatives.label_shift(e[n.LABEL, 0], written_mm)
    return shift


def run_trial(trial: Trial, c: Floats, e: Floats, times: Floats, scale: float = 1.0) -> Floats:
    """States of one trial at ascending instants; columns are `stepping.OUT_*`.

    `c` are the bench's constants; the trial's own mass, temperature and count are set here.

    Raises:
        NoSuchBenchError: The effects take more load away than the trial has.
    """
    if trial.load_kg > 0.0 and e[n.PAYLOAD, 0] >= 0.0 and trial.load_kg + e[n.PAYLOAD, 1] <= 0.0:
        raise NoSuchBenchError(f"{trial.load_kg} kg with {e[n.PAYLOAD, 1]} kg of payload")
    own = c.copy()
    own[n.MASS] = trial.load_kg
    own[n.MUSCLE_C] = trial.temperature_c
    own[n.TRIAL] = trial.order
    own[n.REGULATOR_S] = trial.regulator_s
    set_t, set_v = trial.regulator or IDLE
    len_t, len_v = trial.length or IDLE
    if trial.held_mm is not None:
        shift = label_shift(e, trial.held_mm, trial.mounting)
        len_t, len_v = np.array([0.0, 1e9]), np.full(2, trial.held_mm + shift)
    w = np.zeros((2, n.MEMORIES))
    w[1] = 1.0
    if e[n.CREEP, 0] >= 0.0:
        w = relaxation(e[n.CREEP, 0], e[n.CREEP, 2])
    return np.asarray(
        run(
            own,
            e,
            w,
            not trial.valved,
            np.ascontiguousarray(trial.edges, dtype=float),
            np.ascontiguousarray(set_t, dtype=float),
            np.ascontiguousarray(set_v, dtype=float),
            np.ascontiguousarray(len_t, dtype=float),
            np.ascontiguousarray(len_v, dtype=float),
            np.ascontiguousarray(times, dtype=float),
            scale,
        )
    )
