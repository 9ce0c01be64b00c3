"""The finger in simulation: links, muscles and gas together, and what holds them to the truth."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from plant.constants import PlantConstants, nominal
from plant.effects.effects import Effects
from plant.errors import PlantError
from plant.finger import FingerSim, load_finger
from plant.finger.body import Finger
from plant.finger.reader import load_valve
from plant.links.dynamics import forward_dynamics, gravity_torque, kinetic_energy
from plant.physics import layout
from plant.physics.flow import mass_flow_kg_s
from plant.physics.muscle import braid_force, braid_volume
from studies.controllers.muscles import Pairs

TICK_S = 1e-3


@pytest.fixture(scope="module")
def finger() -> Finger:
    return load_finger()


def pulses(ticks: int, seed: int) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Random pulses of 3 to 12 ms on random valves of eight muscles, to 5 us."""
    r = np.random.default_rng(seed)
    on = np.zeros((ticks, 8, 2))
    for muscle in range(8):
        at = 0
        while True:
            at += int(r.integers(10, 40))
            width = round(r.uniform(3e-3, 12e-3) / 5e-6) * 5e-6
            whole = int(width / TICK_S)
            if at + whole + 1 >= ticks:
                break
            valve = int(r.integers(0, 2))
            on[at : at + whole, muscle, valve] = TICK_S
            on[at + whole, muscle, valve] = width - whole * TICK_S
            at += whole
    return on


def rest(
    finger: Finger, c: PlantConstants, degrees: tuple[float, ...], **more: Any
) -> tuple[FingerSim, np.ndarray[Any, np.dtype[np.float64]]]:
    """A finger in balance at a posture, all valves shut."""
    q = np.radians(degrees)
    pairs = Pairs(finger, c)
    delta = pairs.delta(q, gravity_torque(finger.arm, q))
    return FingerSim(finger, c, q_rad=q, pressure_kpa=pairs.pressures(delta), **more), q


def independent(
    finger: Finger,
    c: PlantConstants,
    q: np.ndarray[Any, np.dtype[np.float64]],
    pressure_pa: np.ndarray[Any, np.dtype[np.float64]],
    inlet: list[int],
    outlet: list[int],
    duration_s: float,
    rtol: float = 1e-9,
) -> tuple[Any, Any]:
    """The same equations from the plain functions of `plant`, by SciPy's implicit Radau."""
    n = len(q)
    rest_m, arm_m = finger.tendons[:, 1], finger.tendons[:, 2]

    def gas(z: Any) -> tuple[Any, Any, Any]:
        length = rest_m + arm_m * np.repeat(z[:n], 2)
        volume = braid_volume(length, c.braid_length_m, c.turns) + c.dead_volume_m3
        return length, volume, z[2 * n :] / volume

    def rate(_: float, z: Any) -> Any:
        length, _volume, absolute = gas(z)
        gauge = absolute - c.atmosphere_pa
        pull = np.maximum(braid_force(gauge, length, c.braid_length_m, c.turns), 0.0)
        torque = -(pull * arm_m).reshape(n, 2).sum(axis=1)
        supply = c.supply_pa + c.atmosphere_pa
        change = np.zeros(2 * n)
        for i in inlet:
            change[i] += mass_flow_kg_s(
                supply, absolute[i], c.inlet_conductance_m3_s_pa, c.critical_ratio
            )
        for i in outlet:  # it passes air both ways
            ways = (absolute[i], c.atmosphere_pa), (c.atmosphere_pa, absolute[i])
            out, back = (
                mass_flow_kg_s(*way, c.outlet_conductance_m3_s_pa, c.critical_ratio) for way in ways
            )
            change[i] -= out - back
        push = forward_dynamics(finger.arm, z[:n], z[n : 2 * n], torque)
        return np.concatenate([z[n : 2 * n], push, change * 287.05 * c.gas_temperature_k])

    length = rest_m + arm_m * np.repeat(q, 2)
    volume = braid_volume(length, c.braid_length_m, c.turns) + c.dead_volume_m3
    start = np.concatenate([q, np.zeros(n), (pressure_pa + c.atmosphere_pa) * volume])
    found = solve_ivp(rate, (0.0, duration_s), start, method="Radau", rtol=rtol, atol=rtol / 100)
    end = found.y[:, -1]
    return end[:n], gas(end)[2] - c.atmosphere_pa


class TestAgainstSciPy:
    """An independent writing of the equations, solved by another method to 1e-9."""

    @pytest.mark.parametrize("payload", [0.0, 0.020])
    def test_open_valves_and_a_falling_payload(self, finger: Finger, payload: float) -> None:
        c = load_valve("cured").with_overrides({"inlet_on_ms": 0.0, "outlet_on_ms": 0.0})
        sim, q = rest(finger, c, (5.0, 10.0, 30.0, 20.0), payload_kg=payload)
        before = sim.pressure_kpa * 1e3
        on = np.zeros((60, 8, 2))
        inlet, outlet = [2, 5, 7], [1, 3, 4]
        on[:, inlet, 0] = on[:, outlet, 1] = TICK_S
        trace = sim.replay(TICK_S, on)
        laden = finger.with_payload(payload)
        angles, pressure = independent(laden, c, q, before, inlet, outlet, 0.060)
        assert np.degrees(np.ptp(trace[:, :4], axis=0)).max() > 3.0
        assert np.degrees(np.abs(trace[-1, :4] - angles)).max() < 1e-3
        assert np.abs(trace[-1, 8:] - pressure).max() < 1.0


class TestSteps:
    def test_the_method_is_of_third_order(self, finger: Finger) -> None:
        sims = [
            rest(finger, load_valve("cured"), (0.0, 10.0, 30.0, 30.0), payload_kg=0.02,
                 step_max_s=step)[0]
            for step in (1e-3, 5e-4, 2.5e-4, 2e-5)
        ]  # fmt: skip
        still = np.zeros((40, 8, 2))
        ends = [sim.replay(TICK_S, still)[-1, :4] for sim in sims]
        errors = [float(np.abs(end - ends[-1]).max()) for end in ends[:-1]]
        assert errors[0] / errors[1] > 5.0
        assert errors[1] / errors[2] > 5.0

    @pytest.mark.parametrize("valve", ["cured", "thesis"])
    def test_halving_the_step_changes_less_than_a_thousandth(
        self, finger: Finger, valve: str
    ) -> None:
        on = pulses(1000, 3)
        traces = [
            FingerSim(finger, load_valve(valve), pressure_kpa=250.0, step_max_s=step).replay(
                TICK_S, on
            )
            for step in (1e-3, 5e-4)
        ]
        for part in (slice(0, 4), slice(8, 16)):
            size = np.ptp(traces[1][:, part], axis=0)
            assert (np.abs(traces[0] - traces[1])[:, part].max(axis=0) / size).max() < 1e-3

    def test_edges_are_located_not_smeared_over_ticks(self, finger: Finger) -> None:
        """The same commands in ticks of 1 ms and of 0.25 ms."""
        coarse = pulses(300, 4)
        fine = np.zeros((1200, 8, 2))
        for k in range(4):
            fine[k::4] = np.clip(coarse - k * 2.5e-4, 0.0, 2.5e-4)
        ends = []
        for tick, on in ((1e-3, coarse), (2.5e-4, fine)):
            sim = FingerSim(finger, load_valve("cured"), pressure_kpa=250.0, step_max_s=1e-4)
            ends.append(sim.replay(tick, on)[-1])
        assert np.abs(ends[0][8:] - ends[1][8:]).max() < 0.1  # Pa
        assert np.degrees(np.abs(ends[0][:4] - ends[1][:4]).max()) < 1e-5


class TestEnergy:
    def test_shut_valves_and_frictionless_joints_keep_it(self, finger: Finger) -> None:
        free = dataclasses.replace(finger, arm=finger.arm.without_damping())
        sim, _ = rest(free, nominal(), (2.0, 10.0, 30.0, 20.0), payload_kg=0.02, step_max_s=2e-5)
        begin = sim.energy_j
        most = drift = 0.0
        for _ in range(20):
            sim.replay(TICK_S, np.zeros((25, 8, 2)))
            kinetic = kinetic_energy(sim.finger.arm, sim.q_rad, sim.qd_rad_s)
            most = max(most, float(kinetic))
            drift = max(drift, abs(sim.energy_j - begin))
        assert most > 3e-4  # J: it swings
        assert drift < 1e-8 * most

    def test_damping_only_takes(self, finger: Finger) -> None:
        sim, _ = rest(finger, nominal(), (2.0, 10.0, 30.0, 20.0), payload_kg=0.02)
        energies = []
        for _ in range(40):
            energies.append(sim.energy_j)
            sim.replay(TICK_S, np.zeros((5, 8, 2)))
        assert np.all(np.diff(energies) < 0.0)
        assert energies[0] - energies[-1] > 2e-4  # of 3e-4 J that a payload let go sets free

    def test_shut_valves_keep_the_air(self, finger: Finger) -> None:
        c = nominal()
        sim, _ = rest(finger, c, (2.0, 10.0, 30.0, 20.0), payload_kg=0.02)

        def content() -> Any:
            length = sim.muscles[:, layout.LENGTH]
            volume = braid_volume(length, c.braid_length_m, c.turns) + c.dead_volume_m3
            return (sim.pressure_kpa * 1e3 + c.atmosphere_pa) * volume

        before = content()
        sim.replay(TICK_S, np.zeros((2000, 8, 2)))
        assert np.abs(content() / before - 1.0).max() < 1e-9


class TestFinger:
    def test_pressures_of_the_muscles_law_hold_any_posture(self, finger: Finger) -> None:
        sim, q = rest(finger, nominal(), (10.0, -15.0, 65.0, 40.0))
        sim.replay(TICK_S, np.zeros((3000, 8, 2)))
        assert np.degrees(np.abs(sim.q_rad - q)).max() < 1e-6

    def test_stops_end_the_range(self, finger: Finger) -> None:
        sim = FingerSim(finger, nominal(), pressure_kpa=0.0, payload_kg=0.02)
        vented = np.zeros((1500, 8, 2))
        vented[:, :, 1] = TICK_S
        angles = np.degrees(sim.replay(TICK_S, vented)[:, :4])
        assert angles[-1, 1] > 70.0  # it fell on its stop, which gives
        # 45 mJ of fall against 1.28 N m/rad of stop: 15 degrees at the very most.
        assert np.all(angles < 85.0)
        assert np.all(np.abs(angles[:, 0]) < 1e-9)

    def test_tendons_never_push(self, finger: Finger) -> None:
        sim = FingerSim(finger, nominal(), pressure_kpa=0.0)
        for _ in range(100):
            sim.replay(TICK_S, np.zeros((10, 8, 2)))
            assert np.all(sim.muscles[:, layout.FORCE] >= 0.0)
        assert np.any(sim.pressure_kpa < 0.0)  # some muscle was drawn out to a slight vacuum

    def test_the_agonist_turns_forwards(self, finger: Finger) -> None:
        sim, q = rest(finger, load_valve("cured"), (0.0, 10.0, 20.0, 20.0))
        on = np.zeros((50, 8, 2))
        on[:, 2, 0] = TICK_S
        assert sim.replay(TICK_S, on)[-1, 1] > q[1] + np.radians(2.0)

    def test_friction_of_the_braid_widens_where_it_rests(self, finger: Finger) -> None:
        rough = Effects.from_config({"braid_friction": {"friction_n": 3.0}})
        ends = []
        for effects in (None, rough):
            sim = FingerSim(finger, load_valve("cured"), effects or Effects(), pressure_kpa=250.0)
            on = np.zeros((400, 8, 2))
            on[:60, 2, 0] = on[120:180, 3, 0] = TICK_S
            ends.append(np.degrees(sim.replay(TICK_S, on)[-1, 1]))
        assert abs(ends[0] - ends[1]) > 0.2


class TestRefused:
    def test_unknown_joint(self) -> None:
        table = {"name": "f", "arm": "planar2", "pair": [{"joint": "elbow", **PAIR}]}
        with pytest.raises(PlantError, match=r"unknown joint 'elbow'.*it has first, second"):
            load_finger(table)

    def test_a_joint_without_muscles(self) -> None:
        table = {"name": "f", "arm": "finger", "pair": [{"joint": "flexion", **PAIR}]}
        with pytest.raises(PlantError, match="joint 'abduction' has 0 pairs"):
            load_finger(table)

    def test_negative_payload(self, finger: Finger) -> None:
        with pytest.raises(PlantError, match=r"payload -0.01 kg; expected 0 or more"):
            FingerSim(finger, nominal(), payload_kg=-0.01)

    def test_a_range_outside_the_braid(self, finger: Finger) -> None:
        wide = tuple(dataclasses.replace(p, pulley_radius_m=0.012) for p in finger.pairs)
        with pytest.raises(PlantError, match=r"70 degrees joint 'flexion'.*47\.3 mm long"):
            FingerSim(dataclasses.replace(finger, pairs=wide), nominal())

    def test_an_angle_outside_the_range(self, finger: Finger) -> None:
        with pytest.raises(PlantError, match="joint 'abduction' at 40 degrees"):
            FingerSim(finger, nominal(), q_rad=np.radians([40.0, 0.0, 0.0, 0.0]))

    def test_an_effect_the_equations_do_not_hold(self, finger: Finger) -> None:
        creeping = Effects.from_config({"creep": {"relaxation_percent": 5.0}})
        with pytest.raises(PlantError, match="'creep': not in the finger's equations"):
            FingerSim(finger, nominal(), creeping)

    @pytest.mark.parametrize(
        ("change", "said"),
        [
            ({"pulley_radius_mm": "8"}, "pulley_radius_mm = '8' is a str; expected a number"),
            ({"pulley_radius_mm": 0.0}, "out of range"),
            ({"pulley_mm": 8.0}, "unknown key 'pulley_mm'; did you mean pulley_radius_mm"),
        ],
    )
    def test_a_pair_that_is_none(self, change: dict[str, Any], said: str) -> None:
        row = {"joint": "flexion", **PAIR, **change}
        with pytest.raises(PlantError, match=said):
            load_finger({"name": "f", "arm": "finger", "pair": [row]})

    def test_a_file_that_is_not_there(self) -> None:
        with pytest.raises(PlantError, match=r"finger file nowhere\.toml: cannot be read"):
            load_finger("nowhere.toml")

    def test_a_name_that_is_nearly_one(self) -> None:
        with pytest.raises(PlantError, match="did you mean cured"):
            load_valve("curd")


PAIR = {"pulley_radius_mm": 8.0, "length_mm": 62.0}
