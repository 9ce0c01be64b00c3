"""How this bench's instruments shake: families of noise, zeros and gains drawn per trial.

Levels are those of docs/reference/plant.md, a third more or less; shapes are drawn: normal,
Student's t, Laplace, correlated over other times, drifting; changed conditions take families
never used otherwise.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

Rng = np.random.Generator
Floats = np.ndarray


@dataclass(frozen=True)
class Noise:
    """One set's noise: levels (1 sd), families and times."""

    pressure_kpa: float
    pressure_family: str
    pressure_slow_kpa: float
    pressure_slow_s: float
    pressure_step_kpa: float
    pressure_zero_kpa: float
    pressure_gain: float
    force_n: float
    force_family: str
    force_slow_n: float
    force_slow_s: float
    force_drift_n: float
    force_step_n: float
    force_zero_n: float
    force_gain: float
    balance: bool
    length_mm: float
    length_family: str
    glitch_share: float
    dropped_share: float
    length_zero_mm: float
    length_gain: float
    mounting_mm: float
    temperature_k: float


def draw_noise(rng: Rng, changed: bool) -> Noise:
    """A bench's noise."""

    def near() -> float:
        return float(rng.uniform(0.7, 1.35))

    families = ("t3", "laplace") if changed else ("normal", "t6")
    return Noise(
        pressure_kpa=0.5 * near(),
        pressure_family=str(rng.choice(families)),
        pressure_slow_kpa=float(rng.uniform(0.1, 0.3)) if changed else 0.0,
        pressure_slow_s=float(rng.uniform(0.02, 0.5)),
        pressure_step_kpa=1000.0 / 4096.0,
        pressure_zero_kpa=0.3 * near(),
        pressure_gain=0.003 * near(),
        force_n=0.05 * near(),
        force_family=str(rng.choice(families)),
        force_slow_n=0.2 * near(),
        force_slow_s=float(rng.choice([0.4, 8.0]) if changed else rng.uniform(1.0, 3.0)),
        force_drift_n=float(rng.uniform(0.0, 0.2)) if changed else 0.0,
        force_step_n=0.05 if changed and rng.random() < 0.5 else 0.01,
        force_zero_n=0.2 * near(),
        force_gain=0.003 * near(),
        balance=bool(rng.random() < 0.2),
        length_mm=0.01 * near(),
        length_family=str(rng.choice(families)),
        glitch_share=0.01 if changed else 0.0,
        dropped_share=0.03 if changed else float(rng.choice([0.0, 0.005])),
        length_zero_mm=0.02 * near(),
        length_gain=0.0005 * near(),
        mounting_mm=0.03 * near(),
        temperature_k=0.05,
    )


def shaken(rng: Rng, family: str, size: int) -> Floats:
    """Unit-variance white noise of a family."""
    if family == "t3":
        return np.asarray(np.clip(rng.standard_t(3.0, size) / np.sqrt(3.0), -12.0, 12.0))
    if family == "t6":
        return np.asarray(rng.standard_t(6.0, size) / np.sqrt(1.5))
    if family == "laplace":
        return np.asarray(rng.laplace(0.0, 1.0 / np.sqrt(2.0), size))
    return np.asarray(rng.standard_normal(size))


def slow(rng: Rng, t: Floats, tau: float) -> Floats:
    """Unit-variance noise with correlation time tau (s), at even instants."""
    if len(t) < 2:
        return np.asarray(rng.standard_normal(len(t)))
    a = float(np.exp(-(t[1] - t[0]) / tau))
    start = rng.standard_normal()
    drive = np.sqrt(1.0 - a * a) * rng.standard_normal(len(t))
    drive[0] = start
    return np.asarray(lfilter([1.0], [1.0, -a], drive))


def quantised(values: Floats, step: float) -> Floats:
    """Rounded to a converter's step."""
    return np.asarray(np.round(values / step) * step)


def shake_pressure(rng: Rng, q: Noise, t: Floats, p: Floats) -> Floats:
    """A pressure channel as recorded, kPa."""
    out = p * (1.0 + q.pressure_gain * rng.standard_normal())
    out += q.pressure_zero_kpa * rng.standard_normal()
    out += q.pressure_kpa * shaken(rng, q.pressure_family, len(t))
    if q.pressure_slow_kpa > 0.0:
        out += q.pressure_slow_kpa * slow(rng, t, q.pressure_slow_s)
    return quantised(out, q.pressure_step_kpa)


def shake_force(rng: Rng, q: Noise, t: Floats, f: Floats, balance: bool) -> Floats:
    """A force channel as recorded, N."""
    if balance:
        out = f * (1.0 + 0.0002 * rng.standard_normal()) + 0.05 * rng.standard_normal()
        return np.asarray(out + 0.005 * shaken(rng, q.force_family, len(t)))
    out = f * (1.0 + q.force_gain * rng.standard_normal())
    out += q.force_zero_n * rng.standard_normal()
    out += q.force_n * shaken(rng, q.force_family, len(t))
    out += q.force_slow_n * slow(rng, t, q.force_slow_s)
    if q.force_drift_n > 0.0 and len(t):
        out += q.force_drift_n * rng.standard_normal() * t / max(float(t[-1]), 1.0)
    return quantised(out, q.force_step_n)


def shake_length(rng: Rng, q: Noise, length: Floats) -> Floats:
    """A length channel as recorded, mm; dropped frames are nan."""
    out = length * (1.0 + q.length_gain * rng.standard_normal())
    out += q.length_zero_mm * rng.standard_normal()
    out += q.length_mm * shaken(rng, q.length_family, len(length))
    if q.glitch_share > 0.0:
        glitch = rng.random(len(length)) < q.glitch_share
        out[glitch] += 0.15 * rng.standard_normal(int(glitch.sum()))
    if q.dropped_share > 0.0:
        out[rng.random(len(length)) < q.dropped_share] = np.nan
    return out
