"""The scene against the single bench, against itself at half the step, and against its own laws."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest

from plant.constants import nominal
from plant.effects.effects import NONE, Effects
from plant.errors import PlantError
from plant.links.reader import load_arm
from plant.physics import layout as at
from plant.scene import kernel as scene_kernel
from plant.scene.ram import Ram, RamConstants, ram_scene
from plant.scene.scene import Coordinate, Scene, Switch, Unit
from plant.simulator.bench import BenchSim

C = nominal()


def hung(
    mass_kg: float = 3.0, start_m: float = 0.066, step_share: float = 1.0, effects: Effects = NONE
) -> Scene:
    load = Coordinate(
        "load",
        mass=mass_kg,
        pull=mass_kg * 9.80665,
        damping=C.load_damping_n_s_m,
        low=C.length_min_m,
        high=C.length_max_m,
        stop_stiffness=C.stop_stiffness_n_m,
        stop_damping=C.stop_damping_n_s_m,
        start=start_m,
    )
    return Scene([Unit("muscle", C, effects, reach={"load": 1.0})], [load], step_share=step_share)


def finger(step_share: float = 1.0, pressure_pa: float = 200e3) -> Scene:
    arm = load_arm("finger")
    units = [
        Unit(f"{joint} {side}", C, reach={joint: way * 8e-3}, rest_m=0.062, tendon=True,
             pressure_pa=pressure_pa)
        for joint in arm.joints
        for side, way in (("agonist", -1), ("antagonist", 1))
    ]  # fmt: skip
    return Scene(units, arm=arm, step_share=step_share)


def pulses(rng: np.random.Generator, units: int, ticks: int) -> np.ndarray:
    """Valve times (ticks, 2, units): whole and part ticks, long enough to move something."""
    out = np.zeros((ticks, 2, units))
    for unit in range(units):
        for which in range(2):
            tick = int(rng.integers(0, 20))
            while tick < ticks - 40:
                width = int(rng.integers(11, 20))
                out[tick : tick + width, which, unit] = 1e-3
                out[tick + width, which, unit] = float(rng.uniform(0, 1e-3))
                tick += width + int(rng.integers(20, 120))
    return out


def run(scene: Scene, valves: np.ndarray) -> np.ndarray:
    rows = []
    for fill, vent in valves:
        scene.advance(1e-3, fill, vent)
        rows.append([*scene.pressures_kpa, *scene.lengths_mm, *scene.places])
    return np.array(rows)


@pytest.mark.parametrize("mass", [0.8, 3.0])
def test_one_muscle_and_a_hung_mass_are_the_single_bench(mass: float) -> None:
    valves = pulses(np.random.default_rng(1), 1, 1500)
    scene, bench = hung(mass), BenchSim(C, load="isotonic", length_m=0.066, mass_kg=mass)
    here = run(scene, valves)
    there = []
    for fill, vent in valves:
        bench.advance(1e-3, fill[0], vent[0])
        there.append([bench.pressure_kpa, bench.length_mm])
    assert np.ptp(here[:, 0]) > 100.0
    assert np.abs(here[:, :2] - there).max() < 5e-3


@pytest.mark.parametrize(
    "effect",
    [
        {"viscosity": {"damping_n_s_mm": 0.05}},
        {"creep": {"relaxation_percent": 8.0}},
        {"link_friction": {"friction_n": 3.0}},
        {"braid_friction": {"friction_n": 4.0}},
        {"supply_droop": {"droop_kpa": 40.0}, "leak": {"conductance_m3_s_pa": 2e-11}},
    ],
)
def test_effects_act_in_the_scene_as_on_the_single_bench(
    effect: dict[str, dict[str, float]],
) -> None:
    effects = Effects.from_config(effect)
    valves = pulses(np.random.default_rng(5), 1, 600)
    # At a quarter of the step: neither ends a step where an elasto-slip element yields.
    scene = hung(effects=effects, step_share=0.25)
    bench = BenchSim(C, effects, load="isotonic", length_m=0.066, mass_kg=3.0)
    bench.params[[at.STEP_MAX, at.STEP_SAFETY]] *= 0.25
    plain = run(hung(), valves)
    here = run(scene, valves)
    there = []
    for fill, vent in valves:
        bench.advance(1e-3, fill[0], vent[0])
        there.append([bench.pressure_kpa, bench.length_mm])
    assert np.abs(here[:, :2] - plain[:, :2]).max() > 0.05
    assert np.abs(here[:, :2] - there).max() < 1e-2


def test_a_held_muscle_passes_the_pulse_ladder() -> None:
    """Pulses of 11.2 ms into the muscle held at 60 mm: 0, 21, 41, 61, 79, 92, 99, 100 %."""
    for share in (1.0, 0.5):
        scene = Scene([Unit("muscle", C, rest_m=0.060)], step_share=share)
        ladder = [0.0]
        for _ in range(7):
            for tick in range(100):
                on = 1e-3 if tick < 11 else (0.2e-3 if tick == 11 else 0.0)
                scene.advance(1e-3, [on], [0.0])
            ladder.append(float(scene.pressures_kpa[0]) / 5.5)
        assert ladder == pytest.approx([0, 21, 41, 61, 79, 92, 99, 100], abs=1.0)


@pytest.mark.parametrize(("make", "units"), [(hung, 1), (finger, 8), (partial(ram_scene, C), 1)])
def test_halving_the_step_changes_nothing_that_is_reported(make, units: int) -> None:  # type: ignore[no-untyped-def]
    valves = pulses(np.random.default_rng(3), units, 800)
    whole, half = (run(make(step_share=share), valves) for share in (1.0, 0.5))
    for column in range(whole.shape[1]):
        span = max(np.ptp(whole[:, column]), 1e-9)
        assert np.abs(whole[:, column] - half[:, column]).max() < 1e-3 * span


def test_shut_valves_keep_their_gas_whatever_the_finger_does() -> None:
    """P V is constant to 1e-9 while a kicked finger swings with all valves shut."""
    scene = finger()
    before = content(scene)
    scene.world.motion[1] = (1.0, -2.0, 3.0, -4.0)
    for _ in range(2000):
        scene.advance(1e-3, np.zeros(8), np.zeros(8))
    assert np.ptp(scene.lengths_mm) > 0.0
    assert content(scene) == pytest.approx(before, rel=1e-9)


def content(scene: Scene) -> np.ndarray:
    from plant.physics.muscle import chamber_volume

    absolute = scene.pressures_kpa * 1e3 + C.atmosphere_pa
    return np.asarray(absolute * chamber_volume(scene.lengths_mm * 1e-3, C))


def test_an_undamped_swing_on_shut_muscles_keeps_its_energy() -> None:
    """Kinetic, gravity's and the gas's energy: the isothermal gas stores -P0 V0 ln V + p_atm V."""
    from plant.links.dynamics import total_energy
    from plant.physics.muscle import chamber_volume

    arm = load_arm("planar2")
    units = [
        Unit(f"{j}{w}", C, reach={j: w * 8e-3}, rest_m=0.062, pressure_pa=200e3)
        for j in arm.joints
        for w in (-1, 1)
    ]
    scene = Scene(units, [Coordinate(j, low=-0.8, high=0.8) for j in arm.joints], arm)
    scene.world.motion[1] = (3.0, -2.0)

    def energy() -> float:
        v = chamber_volume(scene.lengths_mm * 1e-3, C)
        absolute = scene.pressures_kpa * 1e3 + C.atmosphere_pa
        gas = float(np.sum(-absolute * v * np.log(v / 6e-6) + C.atmosphere_pa * v))
        return gas + float(total_energy(arm, scene.places, scene.rates))

    scene.refresh()
    energies, places = [energy()], []
    for _ in range(1000):
        scene.advance(1e-3, np.zeros(4), np.zeros(4))
        energies.append(energy())
        places.append(scene.places)
    kinetic = 0.5 * 1e-4 * 9.0
    assert np.ptp(places, axis=0).min() > 0.01
    assert np.ptp(energies) < 1e-3 * kinetic


def test_the_ram_is_held_by_friction_and_moves_beyond_it() -> None:
    ram = Ram(C, height_mm=100.0)
    scene = ram.scene
    area, weight = ram.ram.area_m2, 5.0 * 9.80665
    scene.world.units[0, at.PRESSURE] = (weight + 19.9) / area
    for _ in range(200):
        ram.advance(1e-3)
    assert ram.height_mm == 100.0
    scene.world.units[0, at.PRESSURE] = (weight + 40.0) / area
    for _ in range(500):
        ram.advance(1e-3)
    assert ram.height_mm > 101.0
    assert ram.rate_mm_s == 0.0
    assert [e.kind for e in ram.take_events()][-1] == "stuck"


def test_switches_and_edges_have_times_of_their_own() -> None:
    """A mass that coasts at 0.25 m/s passes a switch at a time that can be worked out."""
    rod = Coordinate("slide", mass=2.0, low=0.0, high=0.2, start=0.06, start_rate=0.25)
    unit = Unit("muscle", C, rest_m=0.060)
    scene = Scene([unit], [rod], switches=[Switch("slide", 0.1, 2e-3, 0.5e-3)])
    for _ in range(300):
        scene.advance(1e-3, [1e-3], [0.0])
    events = scene.take_events()
    on, off = (e.time_s for e in events if e.kind == "switch")
    assert on == pytest.approx((0.098 - 0.06) / 0.25, abs=1e-12)
    assert off == pytest.approx((0.1025 - 0.06) / 0.25, abs=1e-12)
    (edge,) = (e.time_s for e in events if e.kind == "inlet")
    assert edge == pytest.approx(8.70e-3 + 0.00395e-3 * 550.0, abs=1e-12)


def test_a_recording_and_the_same_ticks_agree() -> None:
    ticked, replayed = hung(), hung()
    traces = []
    for tick in range(400):
        ticked.advance(1e-3, [1e-3 if tick % 100 < 13 else 0.0], [1e-3 if tick % 100 > 80 else 0.0])
        traces.append([ticked.pressures_kpa[0] * 1e3, ticked.lengths_mm[0] * 1e-3])
    edges = []
    for k in range(4):
        edges += [(0.1 * k, 0, 1.0), (0.1 * k + 0.013, 0, 0.0)]
        edges += [(0.1 * k + 0.081, 1, 1.0), (0.1 * k + 0.1, 1, 0.0)]
    edges.sort()
    time, channel, value = (np.array(c) for c in zip(*edges, strict=True))
    sample = np.arange(1, 401) * 1e-3
    out = np.zeros((400, 7))
    scene_kernel.replay(
        replayed.world, time, np.zeros(len(time), np.int64), channel.astype(np.int64),
        value.astype(float), sample, out,
    )  # fmt: skip
    assert np.abs(out[:, :2] - traces).max() < 1e-6 * 550e3


@pytest.mark.parametrize(
    ("units", "coordinates", "words"),
    [
        ([], [], "at least one muscle"),
        ([Unit("a", C, reach={"elbow": 1.0})], [], "unknown joint 'elbow'"),
        ([Unit("a", C, rest_m=0.06)], [Coordinate("x", mass=-1.0)], "mass -1.0"),
        ([Unit("a", C, rest_m=0.095)], [], "outside the braid"),
        (
            [Unit("a", C, rest_m=0.06, reach={"x": 1.0})],
            [Coordinate("x", mass=1.0, low=-0.01, high=0.04)],
            "100 mm long, outside the braid",
        ),
        ([Unit("a", C, rest_m=0.06)], [Coordinate("x", mass=1.0, low=1.0, high=0.0)], "must incr"),
        ([Unit("a", C, rest_m=0.06), Unit("a", C, rest_m=0.06)], [], "more than one part"),
    ],
)
def test_what_cannot_be_is_refused_by_name(units, coordinates, words: str) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(PlantError, match=words):
        Scene(units, coordinates)


def test_a_ram_that_cannot_be_is_refused() -> None:
    with pytest.raises(PlantError, match="outside the stroke"):
        RamConstants(switches_m=(0.3,))
