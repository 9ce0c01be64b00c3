"""The loop of tests and diagnosis on virtual benches, plain and withheld."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

import rigs.investigate as loop
import rigs.virtual.bench as virtual
from daq.clock import VirtualClock
from rigs.config import RigConfig, load_rig
from rigs.investigate import investigate, protocol_text
from rigs.protocols.registry import procedure
from rigs.protocols.schedule import outline
from rigs.virtual.bench import VirtualBench
from rigs.virtual.withheld import WithheldBench, draw


def rig_with(folder: Path, effects: str) -> RigConfig:
    path = folder / "rig.toml"
    path.write_text(load_rig("virtual").text + "\n" + effects)
    return load_rig(str(path))


@pytest.mark.parametrize("name", loop.BATTERY)
def test_every_test_of_the_battery_is_one_that_the_rig_can_run(name: str, tmp_path: Path) -> None:
    config = load_rig("virtual")
    path = tmp_path / f"{name}.toml"
    path.write_text(protocol_text(name, config, {}))
    usual, _ = outline(procedure(name).read(str(path), config).steps())
    path.write_text(protocol_text(name, config, {"repeats": 6, "no_such_setting": 1}))
    more, _ = outline(procedure(name).read(str(path), config).steps())
    assert usual > 20
    assert more == 2 * usual
    assert loop.REPEATS == 3


def test_an_effect_of_the_plant_is_named_in_the_first_round(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def few(name: str, config: RigConfig) -> dict[str, Any]:
        del config
        assert name == "isometric"
        return {"lengths_mm": [54.0, 60.0, 66.0], "pressures_kpa": [60, 150, 350, 550],
                "repeats": 3}  # fmt: skip

    monkeypatch.setattr(loop, "_usual", few)
    config = rig_with(tmp_path, "[effects.liner_threshold]\nthreshold_kpa = 80\n")
    told: list[str] = []
    found = investigate(config, tmp_path / "runs", tell=told.append)
    assert found.conclusion == "named"
    assert found.rounds[0].effects[0] == "liner_threshold"
    value = found.verdict.effects[0].parameters["threshold_kpa"].value
    assert float(value) == pytest.approx(80.0, rel=0.2)
    written = json.loads((tmp_path / "runs" / "investigation" / "investigation.json").read_text())
    assert written["conclusion"] == "named"
    assert len(told) == 2


@pytest.mark.campaign
def test_withheld_benches_over_forty_seeds(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Right family in at least 85 %; the rest may only be what the generator calls alike."""
    right = alike = 0
    for seed in range(40):
        secret = draw(load_rig("virtual"))
        (hidden,) = secret.answer()["effects"]

        def make(
            config: RigConfig, clock: VirtualClock | None = None, origin_ns: int = 0,
            secret: Any = secret,
        ) -> VirtualBench:  # fmt: skip
            return WithheldBench(config, secret, clock, origin_ns)

        monkeypatch.setattr(virtual, "VirtualBench", make)
        found = investigate(load_rig("virtual", seed), tmp_path / str(seed))
        families = [effect.family for effect in found.verdict.effects]
        mimicked = float(secret.measured.get("mimic_index", 0.0)) >= 0.9  # type: ignore[arg-type]
        named = found.conclusion == "named" and families[:1] == [hidden["family"]]
        right += named
        alike += not named and mimicked and hidden["family"] in families
        print(seed, hidden["id"], found.conclusion, families)
    assert right >= 34, (right, alike)
    assert right + alike == 40
