"""A bench that hides an effect: like any other on its ports, sealed, revealed only when asked."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from blind.live import Secret
from blind.physics.entries import ENTRIES, Hidden
from blind.seal import text_of
from cli.investigate.runnable import draw_runnable, refusal
from daq.clock import VirtualClock
from daq.errors import ConfigError, PamrigError
from plant.effects.catalogue import CATALOGUE
from rigs.rigfile.config import RigConfig, load_rig
from rigs.virtual.withheld.bench import Envelope, WithheldBench, draw, request_answer
from vision.marker.edge import measure_gap
from withheld_campaign import RIG, entropy_of


def quiet(rig: str = "virtual") -> RigConfig:
    config = load_rig(rig)
    assert config.virtual is not None
    exact = dataclasses.replace(
        config.virtual,
        draw_calibration_errors=False,
        pressure_noise_kpa=0.0,
        force_noise_n=0.0,
    )
    return dataclasses.replace(config, virtual=exact)


def stated(config: RigConfig) -> np.ndarray:
    from blind.physics.bench import nominal, with_keys
    from rigs.virtual.withheld.bench import _STATED

    assert config.virtual is not None
    return with_keys(nominal(), {k: v for k, v in config.virtual.plant.items() if k in _STATED})


def hiding(effect: str | None = None, strength: float = 0.0) -> tuple[WithheldBench, VirtualClock]:
    """A bench of exactly the stated constants that hides one effect in its plainest form."""
    config = quiet()
    hidden = (Hidden(effect, 0, strength),) if effect else ()
    clock = VirtualClock()
    return WithheldBench(config, Secret(hidden, stated(config), {}), clock), clock


def at_pressure(bench: WithheldBench, clock: VirtualClock, seconds: float = 0.25) -> None:
    """Let air in by hand, past the firmware: inlet for a while, outlet held shut."""
    bench.board.outlet_normally_open = False
    step = bench.plant.step  # type: ignore[attr-defined]
    for _ in range(round(seconds * 1000)):
        step(bench.plant.state, bench.plant.params, 1e-3, 1e-3, 0.0)
    del clock


def counts_kpa(bench: WithheldBench) -> float:
    bench.board._sample()
    return bench.board.adc() * 1000.0 / 4095


def seen_mm(bench: WithheldBench) -> float:
    gap = measure_gap(bench.expose()[2])
    assert gap.trusted
    return 40.0 + 0.11 * gap.pixels


def test_without_an_effect_it_is_the_nominal_bench_to_another_integrator_s_accuracy() -> None:
    bench, clock = hiding()
    at_pressure(bench, clock, 0.25)
    from plant.constants import nominal
    from plant.simulator.bench import BenchSim

    assert bench.config.virtual is not None
    twin = BenchSim(nominal().with_overrides(bench.config.virtual.plant), length_m=0.06175)
    twin.advance(1e-6, 0.0, 1e-6)
    for _ in range(250):
        twin.advance(1e-3, 1e-3, 0.0)
    assert twin.pressure_kpa > 250.0
    assert bench.plant.pressure_kpa == pytest.approx(twin.pressure_kpa, rel=2e-3)
    assert bench.plant.force_n == pytest.approx(twin.force_n, rel=2e-3)
    assert counts_kpa(bench) == pytest.approx(twin.pressure_kpa, abs=1.5)
    assert seen_mm(bench) == pytest.approx(61.75, abs=0.03)


def test_hidden_sensor_effects_reach_the_instruments() -> None:
    zero, clock = hiding("pressure_zero", 12.0)
    at_pressure(zero, clock)
    assert counts_kpa(zero) == pytest.approx(zero.plant.pressure_kpa + 12.0, abs=0.3)
    scale, _ = hiding("camera_scale", 2.0)
    assert abs(seen_mm(scale) - 61.75) > 0.3
    label, clock = hiding("length_label", 1.0)
    label.links["stage"].write(b"G1 X60.000 F600\r\n")
    clock.sleep(2.0)
    assert label.stage._where() == pytest.approx(60.0)
    assert seen_mm(label) == pytest.approx(61.0, abs=0.03)


def test_a_hidden_force_zero_survives_the_tare() -> None:
    told = {}
    for name, strength in (("plain", 0.0), ("zero", 2.0)):
        bench, clock = hiding("force_zero" if strength else None, strength)
        clock.sleep(1.0)
        bench.links["balance"].write(b"T\r\n")
        clock.sleep(1.0)
        bench.links["balance"].write(b"SI\r\n")
        clock.sleep(0.3)
        text = b"".join(chunk.data for chunk in bench.links["balance"].read()).decode()
        line = [line for line in text.splitlines() if line.startswith(("S S", "S D"))][-1]
        told[name] = -float(line.split()[2]) * 9.80665e-3
    assert told["zero"] - told["plain"] == pytest.approx(2.0, abs=0.01)


def test_a_muscle_that_was_filled_and_emptied_has_one_more_trial_behind_it() -> None:
    bench, clock = hiding("wear", -20.0)
    before = bench.live.trial.order
    at_pressure(bench, clock)
    clock.sleep(0.1)
    bench.board.outlet_normally_open = True
    clock.sleep(3.0)
    assert bench.plant.pressure_kpa < 20.0
    assert bench.live.trial.order == before + 1


def test_the_seal_is_the_salted_hash_of_the_answer_and_the_answer_names_a_known_effect() -> None:
    secret = draw(quiet(), effects=["pressure_gain"], entropy=5)
    bench = WithheldBench(quiet(), secret, VirtualClock())
    envelope = bench.reveal()
    text = envelope["salt"] + text_of(envelope["answer"])
    assert hashlib.sha256(text.encode()).hexdigest() == bench.digest
    assert envelope["answer"]["effects"][0]["id"] == "pressure_gain"
    assert {e for e in ENTRIES if e in CATALOGUE} == set(CATALOGUE)


def test_on_a_rig_whose_delays_have_no_slope_mimics_are_measured_and_the_answer_sealed() -> None:
    secret = draw(load_rig("virtual-instruments"), ["valve_delay_pressure"], entropy=1002)
    members: Any = secret.measured["members"]
    shares = [mimic["share"] for mimic in members[0]["mimics"]]
    assert shares
    assert np.isfinite(shares).all()
    assert "valve_delay:inlet_on" in text_of(secret.answer())


def test_a_secret_that_the_rig_s_protections_refuse_is_seen_to_be_refused() -> None:
    """Vented, this sensor reads 24 kPa: nobody could clear a fault, nor begin a test."""
    config = load_rig(RIG)
    zero = Secret((Hidden("pressure_zero", 0, 24.0),), stated(config), {})
    assert "vent first" in str(refusal(config, zero))


@pytest.mark.campaign
def test_a_refused_secret_is_drawn_again_and_named_to_nobody() -> None:
    told: list[str] = []
    secret = draw_runnable(load_rig(RIG, 87), entropy=entropy_of(87), report=told.append)
    first = draw(load_rig(RIG, 87), entropy=entropy_of(87))
    assert first.hidden[0].id == "pressure_zero"
    assert len(told) >= 1
    assert "pressure_zero" not in "".join(told)
    assert secret.answer() != first.answer()


def test_two_draws_from_the_system_s_entropy_differ() -> None:
    answers = [json.dumps(draw(quiet(), effects=["pressure_gain"]).answer()) for _ in range(2)]
    assert answers[0] != answers[1]


def asked(folder: Path, envelope: Envelope) -> dict[str, Any]:
    done = threading.Event()

    def serve() -> None:
        while not done.is_set():
            envelope.step()

    thread = threading.Thread(target=serve)
    thread.start()
    try:
        return request_answer(folder)
    finally:
        done.set()
        thread.join()


def test_the_answer_is_told_when_asked_and_a_changed_one_is_refused(tmp_path: Path) -> None:
    bench, _ = hiding("pressure_gain", 4.0)
    envelope = Envelope(tmp_path, bench.digest, bench.reveal(), {})
    note = (tmp_path / "withheld.json").read_text()
    assert bench.digest in note
    assert "pressure_gain" not in note
    assert asked(tmp_path, envelope)["effects"][0]["id"] == "pressure_gain"
    envelope.close()
    assert b"pressure_gain" not in (tmp_path / "withheld.sealed").read_bytes()
    assert request_answer(tmp_path)["effects"][0]["id"] == "pressure_gain"
    other, _ = hiding("pressure_gain", 5.0)
    Envelope(tmp_path, bench.digest, other.reveal(), {}).close()
    with pytest.raises(PamrigError, match="does not match its seal"):
        request_answer(tmp_path)
    with pytest.raises(PamrigError, match="holds no withheld bench"):
        request_answer(tmp_path / "elsewhere")


def test_a_rig_that_states_an_effect_is_refused() -> None:
    config = quiet()
    assert config.virtual is not None
    own = dataclasses.replace(config.virtual, effects={"leak": {"conductance_m3_s_pa": 1e-12}})
    with pytest.raises(ConfigError, match="states effects of its own"):
        draw(dataclasses.replace(config, virtual=own))


@pytest.mark.campaign
def test_the_command_prints_the_seal_and_never_the_answer(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "cli.main", "virtual", "--dir", str(tmp_path)]
    done = subprocess.run(
        [*command, "--withheld", "--seconds", "1"],
        text=True, capture_output=True, timeout=900, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    digest = json.loads((tmp_path / "withheld.json").read_text())["sha256"]
    assert f"sha256:{digest}" in done.stdout
    told = subprocess.run(
        [*command, "--reveal"], text=True, capture_output=True, timeout=900, check=True
    )
    answer = json.loads(told.stdout)
    assert answer["effects"][0]["id"] not in done.stdout
    assert "[effects" not in (tmp_path / "rig.toml").read_text()
