"""Every model of `plant.models` in a scene, and a joint between two muscles against SciPy."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from plant.constants import nominal
from plant.links.arm import Arm, Link
from plant.models import catalogue
from plant.models.law import History
from plant.scene.model_table import model_table
from plant.scene.scene import Coordinate, Scene, Unit

C = nominal()


@pytest.mark.parametrize("name", catalogue.names())
def test_a_table_repeats_its_model(name: str) -> None:
    """In points off its grid, over all pressures and lengths that a bench can reach."""
    table = model_table(catalogue.get(name), C)
    largest = np.abs(table.force[..., 0]).max()
    assert table.error_n < 2e-4 * max(largest, 1.0)


def test_a_model_with_memory_of_length_shows_its_loop() -> None:
    """Maxwell slip along a triangle of length at steady pressure: as the law itself says."""
    model = catalogue.get("maxwell-slip")
    model = model.with_values({f"slip_{t}_um": 4.0 for t in (100, 300, 1000)})
    up = np.linspace(0.058, 0.064, 300)
    length = np.concatenate([up, up[::-1]])
    p = np.full(length.size, 300e3)
    expected = model.law.force(model.q, p, length, np.full(p.size, 21.0), History())
    slide = Coordinate("slide", mass=1e9, low=0.04, high=0.08, start=float(length[0]))
    unit = Unit("muscle", C, model=model, reach={"slide": 1.0}, pressure_pa=300e3)
    scene = Scene([unit], [slide])
    found = [scene.forces_n[0]]
    for step in np.diff(length):
        scene.world.motion[1, 0] = step / 1e-3
        scene.world.units[0, 1] = 300e3
        scene.advance(1e-3, [0.0], [0.0])
        scene.world.units[0, 1] = 300e3
        scene.refresh()
        found.append(scene.forces_n[0])
    assert np.ptp(expected) > 5.0
    assert np.abs(np.array(found) - expected).max() < 0.02


def test_creep_relaxes_at_its_own_pace() -> None:
    """Held at 60 mm and filled once: what came at once and what comes late add up to the law."""
    late_2_s = {"late_2_s": 0.1, "late_20_s": 0.0, "late_200_s": 0.0}
    model = catalogue.get("creep").with_values(late_2_s)
    scene = Scene([Unit("muscle", C, model=model, rest_m=0.060, pressure_pa=300e3)])
    first = float(scene.forces_n[0])
    for _ in range(200):
        scene.advance(10e-3, [0.0], [0.0])
    base = float(
        model.law.base.force(  # type: ignore[attr-defined]
            model.q[: len(model.law.base.parameters)],  # type: ignore[attr-defined]
            np.array([300e3]), np.array([0.060]), np.array([21.0]),
        )[0]
    )  # fmt: skip
    assert first == pytest.approx(0.9 * base, rel=1e-6)
    late = base - 0.1 * base * math.exp(-2.0 / 2.0)
    assert float(scene.forces_n[0]) == pytest.approx(late, rel=2e-3)


def test_a_joint_between_two_muscles_agrees_with_scipy() -> None:
    """One link in gravity, both muscles filled and one vented; its own equations, its own edges."""
    link = Link.rod("elbow", 0.12, 0.2, 0.0, damping_n_m_s=0.02)
    arm = Arm("forearm", (link,), (0.0, -9.80665, 0.0))
    r, rest = 8e-3, 0.062
    units = [
        Unit("flexor", C, reach={"elbow": -r}, rest_m=rest, tendon=True, pressure_pa=200e3),
        Unit("extensor", C, reach={"elbow": r}, rest_m=rest, tendon=True, pressure_pa=200e3),
    ]
    scene = Scene(units, [Coordinate("elbow", low=-1.0, high=1.0)], arm)
    fill, vent = np.zeros((2, 2))
    angles = []
    for tick in range(600):
        fill[0] = 1e-3 if 50 <= tick < 65 else 0.0
        vent[1] = 1e-3 if 200 <= tick < 214 else 0.0
        scene.advance(1e-3, fill, vent)
        angles.append(float(scene.places[0]))
    b, n, atm = C.braid_length_m, C.turns, C.atmosphere_pa
    rt, rho, four_pi = 287.05 * C.gas_temperature_k, 1.185, 4.0 * math.pi * n * n
    supply, cond = C.supply_pa + atm, C.inlet_conductance_m3_s_pa
    inertia = 0.2 * 0.12**2 / 3.0

    def psi(ratio: float) -> float:
        return 1.0 if ratio <= 0.5 else math.sqrt(max(0.0, 1.0 - ((ratio - 0.5) / 0.5) ** 2))

    def rates(t: float, y: np.ndarray, inlet: bool, outlet: bool) -> list[float]:
        q, speed, p1, p2 = y
        out, torque = [], -0.02 * speed - 0.2 * 9.80665 * 0.06 * math.cos(q)
        for p, way, flows in (
            (p1, -1.0, cond * rho * supply * psi(p1 / supply) if inlet else 0.0),
            (p2, 1.0, -cond * rho * p2 * psi(atm / p2) if outlet else 0.0),
        ):
            length = rest + way * r * q
            volume = (b * b * length - length**3) / four_pi + C.dead_volume_m3
            swell = (b * b - 3.0 * length * length) / four_pi * way * r * speed
            out.append((rt * flows - p * swell) / volume)
            pull = max(0.0, (p - atm) * (3.0 * length * length - b * b) / four_pi)
            torque -= way * r * pull
        return [speed, torque / inertia, *out]

    y, now, wanted, found = np.array([0.0, 0.0, 200e3 + atm, 200e3 + atm]), 0.0, [], []
    on = 8.70e-3 + 0.00395e-3 * 550.0
    off = 8.94e-3 - 0.00080e-3 * 550.0
    marks = [(0.05 + on, True, False), (0.065 + off, False, False)]
    state = (False, False)
    for until, inlet, outlet in [*marks, (math.nan, False, True), (math.nan, False, False),
                                 (0.6, False, False)]:  # fmt: skip
        before = state
        if math.isnan(until):
            # The outlet's delay is taken from the pressure at the command: go there first.
            command = 0.2 if outlet else 0.214
            leg = solve_ivp(rates, (now, command), y, args=before, rtol=1e-9, atol=1e-9,
                            max_step=2e-3, dense_output=True)  # fmt: skip
            found.append(leg)
            y, now = leg.y[:, -1], command
            kpa = (y[3] - atm) / 1e3
            until = command + (9.28 + 0.00174 * kpa if outlet else 8.82 - 0.00058 * kpa) * 1e-3
        leg = solve_ivp(rates, (now, until), y, args=before, rtol=1e-9, atol=1e-9,
                        max_step=2e-3, dense_output=True)  # fmt: skip
        found.append(leg)
        y, now, state = leg.y[:, -1], until, (inlet, outlet)
    time = np.arange(1, 601) * 1e-3
    for t in time:
        leg = next(k for k in found if k.t[-1] >= t - 1e-12)
        wanted.append(float(leg.sol(t)[0]))
    assert np.ptp(angles) > 0.2
    assert np.abs(np.array(angles) - wanted).max() < 1e-3 * np.ptp(angles)
