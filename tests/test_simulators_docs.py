"""The page on one's own simulator is run as it stands; its examples predict what they should."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest

from gap.simulators.open import open_simulator
from simulator_files import EXAMPLES, built_fmu, chou_hannaford, trial, valve_trial

HOUSE = EXAMPLES.parent.parent.parent
PAGE = HOUSE / "docs" / "use" / "your-simulator.md"


@pytest.fixture(scope="module")
def walked(tmp_path_factory: pytest.TempPathFactory) -> dict[str, subprocess.CompletedProcess[str]]:
    """Every command of the page, run in its order in a copy of the example; by command."""
    folder = tmp_path_factory.mktemp("first") / "first"
    shutil.copytree(EXAMPLES / "first", folder)
    done = {}
    for line in re.findall(r"^    ((?:python|pamrig) .*)$", PAGE.read_text(), flags=re.MULTILINE):
        words = shlex.split(line)
        start = ["-m", "cli.main"] if words[0] == "pamrig" else []
        done[line] = subprocess.run(
            [sys.executable, *start, *words[1:]],
            cwd=folder, text=True, capture_output=True, timeout=600, check=False,
            env={**os.environ, "PYTHONPATH": str(HOUSE)},
        )  # fmt: skip
    done["folder"] = subprocess.CompletedProcess([str(folder)], 0, "", "")
    return done


def test_every_command_of_the_page_works(
    walked: dict[str, subprocess.CompletedProcess[str]],
) -> None:
    assert len(walked) >= 7
    for line, ran in walked.items():
        expected = 0 if "--simulator" in line or "pamrig" not in line else 2
        assert ran.returncode == expected, f"{line}\n{ran.stdout}{ran.stderr}"


def test_the_page_shows_what_the_commands_print(
    walked: dict[str, subprocess.CompletedProcess[str]],
) -> None:
    text = PAGE.read_text()
    shown = re.findall(r"\n\n```\n(.*?)```", text, flags=re.DOTALL)
    printed = "\n".join(ran.stdout for ran in walked.values())
    assert len(shown) == 3
    for block in shown:
        for line in block.strip().splitlines():
            assert line.strip() in printed, line


def test_the_hidden_friction_is_found_and_the_improved_simulator_leaves_no_gap(
    walked: dict[str, subprocess.CompletedProcess[str]],
) -> None:
    folder = Path(walked["folder"].args[0])
    assert (folder / "where.png").stat().st_size > 10_000
    improved = tomllib.loads((folder / "improved.toml").read_text())
    assert improved["effects"]["braid_friction"]["friction_n"] == pytest.approx(4.0, rel=0.1)
    assert improved["function"] == "muscle.py:force"
    # The muscle of the bench has 4.55 mm, the user's simulator states 4.5 +- 0.05 mm.
    assert improved["parameters"]["radius_mm"]["nominal"] == pytest.approx(4.55, abs=0.02)


def test_every_description_on_the_page_is_toml() -> None:
    for block in re.findall(r"```toml\n(.*?)```", PAGE.read_text(), flags=re.DOTALL):
        tomllib.loads(block)


def test_the_chamber_of_scipy_fills_and_holds() -> None:
    opened = open_simulator(EXAMPLES / "chamber" / "simulator.toml")
    made = opened.simulate(valve_trial(), {})
    assert set(made) == {"pressure", "force"}
    t, p = made["pressure"].time_s, made["pressure"].value
    assert p[t < 1.0] == pytest.approx(3.0), "it starts at the measured pressure and holds it"
    held = p[(t > 1.3) & (t < 5.0)]
    assert 50.0 < held[0] < 600.0
    assert held == pytest.approx(held[0], rel=1e-6), "both valves are closed"
    assert p[-1] < 0.8 * held[0], "the outlet was open"
    more = opened.simulate(valve_trial(), {"conductance_ml_s": 17.0})["pressure"].value
    assert more[(t > 1.3) & (t < 5.0)][0] > held[0]


def test_the_force_of_scipy_settles_at_the_static_one() -> None:
    opened = open_simulator(EXAMPLES / "chamber" / "simulator.toml")
    t = np.arange(0.0, 1.0, 0.005)
    step = trial({"pressure_kpa": (t, np.where(t < 0.1, 0.0, 300.0)), "force_n": (t, t)})
    made = opened.simulate(step, {})["force"].value
    whole = chou_hannaford(np.array([300.0]), np.array([60.0]))[0]
    assert made[-1] == pytest.approx(whole, rel=1e-3)
    after = made[np.searchsorted(t, 0.1 + 0.02)]
    assert 0.5 * whole < after < 0.75 * whole, "one time constant later: 63 %"


def test_the_cylinder_of_mujoco_follows_the_pressure() -> None:
    pytest.importorskip("mujoco")
    opened = open_simulator(EXAMPLES / "mujoco" / "simulator.toml")
    t = np.arange(0.0, 0.5, 0.005)
    step = trial({"pressure_kpa": (t, np.where(t < 0.1, 0.0, 300.0)), "force_n": (t, t)})
    made = opened.simulate(step, {})["force"].value
    whole = chou_hannaford(np.array([300.0]), np.array([60.0]))[0]
    assert made[0] == 0.0
    assert made[-1] == pytest.approx(whole, rel=1e-3)
    slower = opened.simulate(step, {"lag_s": 0.03})["force"].value
    assert slower[25] < made[25]


@pytest.mark.parametrize("fmi", [2, 3])
def test_the_example_s_fmu_is_the_braid(fmi: int, tmp_path: Path) -> None:
    shutil.copy(EXAMPLES / "fmu" / "simulator.toml", tmp_path)
    built_fmu(tmp_path, fmi)
    opened = open_simulator(tmp_path / "simulator.toml")
    p, length = np.array([100.0, 300.0]), np.array([55.0, 65.0])
    assert opened.force_n(p, length, {}) == pytest.approx(  # type: ignore[attr-defined]
        chou_hannaford(p, length)
    )
