"""Effects on the virtual bench: what its instruments send is what the effect says."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

from daq.clock import VirtualClock
from daq.errors import ConfigError
from plant.effects.catalogue import CATALOGUE
from rigs.rigfile.config import RigConfig, load_rig
from rigs.virtual.bench import VirtualBench
from vision.marker.edge import measure_gap


def rig(**effects: dict[str, Any]) -> RigConfig:
    """The default virtual rig without sensor errors or noise, with these effects."""
    config = load_rig("virtual")
    assert config.virtual is not None
    exact = dataclasses.replace(
        config.virtual,
        effects=effects,
        draw_calibration_errors=False,
        pressure_noise_kpa=0.0,
        force_noise_n=0.0,
        source="regulator",
    )
    return dataclasses.replace(config, virtual=exact)


def bench(**effects: dict[str, Any]) -> tuple[VirtualBench, VirtualClock]:
    clock = VirtualClock()
    return VirtualBench(rig(**effects), clock), clock


def counts_kpa(b: VirtualBench) -> float:
    return b.board.adc() * 1000.0 / 4095


def weigh_n(b: VirtualBench, clock: VirtualClock) -> float:
    """Pull that the balance tells after a tare of the vented muscle."""
    link = b.links["balance"]
    b.plant.set_pressure(0.0)
    clock.sleep(1.0)
    link.write(b"T\r\n")
    clock.sleep(1.0)
    b.plant.set_pressure(400.0)
    b.plant.state[8] = 0.0  # the outlet is held shut
    clock.sleep(0.11)
    link.write(b"SI\r\n")
    clock.sleep(0.3)
    text = b"".join(chunk.data for chunk in link.read()).decode()
    grams = [line for line in text.splitlines() if line.startswith(("S S", "S D"))][-1]
    return -float(grams.split()[2]) * 9.80665e-3


def seen_mm(b: VirtualBench) -> float:
    _, _, gray = b.expose()
    gap = measure_gap(gray)
    assert gap.trusted
    return 40.0 + 0.11 * gap.pixels


@pytest.mark.parametrize("name", list(CATALOGUE))
def test_a_rig_file_may_name_every_effect(name: str) -> None:
    words = {"edge": "inlet_on", "side": "inlet"}
    sizes = {"exponent": 1.1, "ratio": 1.2, "critical_ratio": 0.4, "conductance_m3_s_pa": 1e-12}
    table = {
        p.name: words.get(p.name, sizes.get(p.name, 0.01))
        for p in CATALOGUE[name].parameters
        if p.default is None
    }
    b, clock = bench(**{name: table})
    clock.sleep(0.05)
    assert name in b.plant.effects


def test_pressure_zero_and_gain_are_in_the_counts_of_the_transducer() -> None:
    b, clock = bench(pressure_zero={"offset_kpa": 5.0}, pressure_gain={"percent": 3.0})
    for kpa in (0.0, 400.0):
        b.plant.set_pressure(kpa)
        b.plant.state[8] = 0.0
        clock.sleep(0.002)
        true = b.plant.pressure_kpa
        assert counts_kpa(b) == pytest.approx(true * 1.03 + 5.0, abs=0.3)


def test_pressure_lag_is_in_the_counts_of_the_transducer() -> None:
    b, clock = bench(pressure_lag={"time_ms": 50.0})
    b.board.outlet_jammed = False
    b.plant.params[7] = 0.0  # no way out, so that the true pressure stays
    b.plant.set_pressure(400.0)
    clock.sleep(0.0501)
    assert counts_kpa(b) == pytest.approx(400.0 * (1 - np.exp(-1)), abs=4.0)
    clock.sleep(0.5)
    assert counts_kpa(b) == pytest.approx(400.0, abs=0.5)


def test_force_zero_survives_the_tare_and_gain_scales_the_pull() -> None:
    told = {}
    for name, effects in {
        "plain": {},
        "zero": {"force_zero": {"offset_n": 0.7}},
        "gain": {"force_gain": {"percent": 2.0}},
    }.items():
        b, clock = bench(**effects)  # type: ignore[arg-type]
        b.plant.params[7] = 0.0
        told[name] = weigh_n(b, clock)
    assert told["plain"] > 20.0
    assert told["zero"] - told["plain"] == pytest.approx(0.7, abs=0.01)
    assert told["gain"] / told["plain"] == pytest.approx(1.02, abs=0.001)


def test_the_label_is_what_the_stage_says_and_the_camera_sees_the_truth() -> None:
    b, clock = bench(length_label={"offset_mm": 0.8})
    link = b.links["stage"]
    link.write(b"G1 X60.000 F600\r\n")
    clock.sleep(3.0)
    link.write(b"?")
    clock.sleep(0.1)
    text = b"".join(chunk.data for chunk in link.read()).decode()
    assert "MPos:60.000" in text
    assert b.plant.length_mm == pytest.approx(60.8, abs=1e-6)
    assert seen_mm(b) == pytest.approx(60.8, abs=0.03)


@pytest.mark.parametrize(
    ("effects", "expected"),
    [
        ({"camera_scale": {"percent": 2.0}}, 65.0 * 1.02),
        (
            {"camera_distortion": {"distortion_mm": 1.0}},
            65.0 + ((65.0 - 61.75) / 10.75) ** 3,
        ),
    ],
)
def test_scale_and_distortion_are_in_the_picture(effects: dict[str, Any], expected: float) -> None:
    b, _ = bench(**effects)
    b.plant.set_length(65.0)
    assert seen_mm(b) == pytest.approx(expected, abs=0.03)


@pytest.mark.parametrize("delay_ms", [40.0, -40.0])
def test_camera_delay_is_the_age_of_the_muscle_in_a_picture(delay_ms: float) -> None:
    lengths = {}
    for name, effects in {"plain": {}, "late": {"camera_delay": {"delay_ms": delay_ms}}}.items():
        b, clock = bench(**effects)  # type: ignore[arg-type]
        b.plant.set_length(58.0)
        b.plant.set_length_rate(20.0)
        _, stamp, gray = b.expose()
        # Where the muscle was at the time that the stamp tells.
        there = 58.0 + 20.0 * (stamp - 12e6) * 1e-9
        lengths[name] = 40.0 + 0.11 * measure_gap(gray).pixels - there
        del clock
    assert lengths["plain"] == pytest.approx(0.0, abs=0.05)
    assert lengths["late"] == pytest.approx(-20.0 * delay_ms * 1e-3, abs=0.05)


def test_wear_counts_pressurisations_and_warmth_follows_the_bench() -> None:
    b, clock = bench(wear={"percent_per_100_trials": -50.0})
    b.plant.params[7] = 0.0
    for _ in range(4):
        b.plant.set_pressure(0.0)
        clock.sleep(0.3)
        b.plant.set_pressure(300.0)
        clock.sleep(0.3)
    fresh, _ = bench()
    fresh.plant.set_pressure(b.plant.pressure_kpa)
    assert b.plant.force_n / fresh.plant.force_n == pytest.approx(1 - 0.5 * 4 / 100, rel=1e-6)
    warm, clock = bench(temperature_stiffening={"percent_per_k": 1.0})
    warm.plant.params[7] = 0.0
    warm.plant.set_pressure(500.0)
    warm.extras.temperature_c = 31.0
    clock.sleep(0.3)
    fresh.plant.set_pressure(500.0)
    assert warm.plant.force_n / fresh.plant.force_n == pytest.approx(1.10, rel=1e-6)


def test_a_scale_that_changes_is_refused_with_the_rig_named() -> None:
    for name, numbers in (("pressure_gain", {"power": 1.0}), ("force_gain", {"at_1": 1.4})):
        with pytest.raises(ConfigError, match=rf"effects.*{name}.*straight"):
            bench(**{name: {"percent": 3.0, **numbers}})


def test_an_effect_that_cannot_be_is_refused_with_the_rig_named() -> None:
    with pytest.raises(ConfigError, match=r"effects.*camera_distortion.*centre_mm"):
        bench(camera_distortion={"distortion_mm": 1.0, "centre_mm": 10.0})
