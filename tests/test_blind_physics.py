"""The blind bench's own physics against the checks of docs/reference/plant.md and closed forms."""

from __future__ import annotations

import ast
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import blind
from blind.physics import numbers as n
from blind.physics.bench import NoSuchBenchError, Trial, no_effect, nominal, run_trial
from blind.physics.entries import CATALOGUE, ENTRIES, Hidden, draw
from blind.physics.laws import static_force, volume
from blind.physics.readings import read_settled, read_trial
from blind.physics.stepping import OUT_F, OUT_FALL, OUT_L, OUT_P, OUT_TAP
from blind.protocols import stairs

C = nominal()


def plain(protocol: str = "free", **fields: object) -> Trial:
    return Trial("t", "s", protocol, 1, 1, 1, 10.0, **fields)  # type: ignore[arg-type]


def pulses(width: float, count: int, side: int = 0, first: float = 0.1, every: float = 0.3):
    edges = []
    for i in range(count):
        edges += [(first + every * i, side, 1), (first + every * i + width, side, 0)]
    return np.array(edges, dtype=float)


def with_effect(name: str, strength: float, form: int = 1, variant: str | None = None):
    drawn = draw(ENTRIES[name], np.random.default_rng(5), C, form)
    e = no_effect()
    Hidden(name, form, strength, drawn.shape, variant or drawn.variant).put(e)
    return e


def constant(value: float, end: float = 1e4):
    return np.array([0.0, end]), np.array([value, value])


def test_it_imports_nothing_of_the_other_packages() -> None:
    ours = {"valvefw", "plant", "vision", "daq", "rigs", "gap", "pamrig", "configs"}
    for path in Path(blind.__file__).parent.glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
            if isinstance(node, ast.ImportFrom):
                names = [node.module or ""]
            assert not {name.split(".")[0] for name in names} & ours, path.name


def test_check_1_short_pulses_fill_the_muscle_in_steps() -> None:
    trial = plain(held_mm=60.0, edges=pulses(11.2e-3, 7))
    p = run_trial(trial, C, no_effect(), 0.09 + 0.3 * np.arange(8))[:, OUT_P]
    assert np.abs(100.0 * p / 550.0 - [0, 21, 41, 61, 79, 92, 99, 100]).max() < 1.0


def test_check_2_force_and_volume() -> None:
    lengths = (52.0, 55.0, 60.0, 65.0, 67.0)
    force = [static_force(600.0, x, C, no_effect()) for x in lengths]
    assert np.allclose(force, [4.13, 17.49, 41.42, 67.44, 78.43], atol=0.006)
    assert np.allclose(
        [volume(x, C) - 0.5 for x in lengths], [6.146, 6.092, 5.848, 5.396, 5.153], atol=6e-4
    )


def test_check_3_shut_in_air_keeps_p_times_v() -> None:
    t = np.linspace(0.0, 40.0, 81)
    trial = plain(
        length=(np.array([0.0, 10.0, 20.0, 30.0, 40.0]), np.array([55.0, 70.0, 52.0, 68.0, 55.0])),
        edges=np.zeros((0, 3)),
    )
    out = run_trial(trial, C, no_effect(), t, 1e-7)
    product = (out[:, OUT_P] + C[n.ATMOSPHERE]) * [volume(x, C) for x in out[:, OUT_L]]
    assert np.ptp(product) / product[0] < 1e-9


def test_check_4_finer_steps_change_nothing() -> None:
    trial = plain(held_mm=60.0, edges=pulses(11.2e-3, 7))
    t = np.linspace(0.0, 3.0, 3001)
    coarse = run_trial(trial, C, no_effect(), t)[:, OUT_P]
    fine = run_trial(trial, C, no_effect(), t, 0.01)[:, OUT_P]
    assert np.abs(coarse - fine).max() < 0.1


def test_a_hanging_mass_comes_to_rest_where_the_braid_carries_it() -> None:
    trial = plain(load_kg=2.0, regulator=constant(300.0))
    out = run_trial(trial, C, no_effect(), np.array([80.0]))[0]
    carried = (3.0 * out[OUT_L] ** 2 - 88.4**2) * 0.3 / (4.0 * math.pi * 1.855**2)
    assert carried == pytest.approx(2.0 * 9.80665, rel=1e-3)


def test_a_load_that_weighs_less_than_none_is_refused_and_not_integrated() -> None:
    """It ran away in ever smaller steps; the measure of mimics tried it (reserved set 5684)."""
    trial = plain(load_kg=0.6, regulator=constant(300.0))
    with pytest.raises(NoSuchBenchError, match=r"0\.6 kg with -1\.5 kg"):
        run_trial(trial, C, with_effect("payload", -1.5), np.array([8.0]))
    lighter = run_trial(trial, C, with_effect("payload", -0.4, form=0), np.array([80.0]))[0]
    light = run_trial(replace(trial, load_kg=0.2), C, no_effect(), np.array([80.0]))[0]
    assert lighter[OUT_L] == pytest.approx(light[OUT_L], rel=1e-3)


def test_a_settled_point_of_a_swinging_load_is_where_it_comes_to_rest() -> None:
    """It may swing on for minutes: at an instant it is some tenths of a millimetre off."""
    slack = C.copy()
    slack[n.LOAD_C] = 0.0  # two standard deviations of its tolerance below what is stated
    levels = np.array([0.0, 91.0, 183.0, 275.0])

    def trial(dwell_s: float) -> Trial:
        ends = np.arange(len(levels)) * (dwell_s + 0.02) + dwell_s - 0.2
        return plain(load_kg=2.2, regulator=stairs(levels, dwell_s, 0.02), settled_s=ends)

    rest = read_settled(trial(300.0), slack, no_effect()).length
    settled = read_settled(trial(8.0), slack, no_effect()).length
    ends = trial(8.0).settled_s
    at_once = read_trial(trial(8.0), slack, no_effect(), ends, ends, ends).length
    assert np.abs(at_once - rest).max() > 0.1
    assert np.abs(settled - rest).max() < 0.03


@pytest.mark.parametrize("form", [0, 1, 2])
class TestHeadlineParametersMeanWhatTheCatalogueSays:
    """Each measured back from a run by a formula of its own."""

    def force(self, e, p: float, length: float) -> float:
        return static_force(p, length, C, e)

    def test_liner_threshold(self, form: int) -> None:
        e = with_effect("liner_threshold", 60.0, form)
        slope = (3.0 * 60.0**2 - 88.4**2) * 1e-3 / (4.0 * math.pi * 1.855**2)
        lost = (self.force(no_effect(), 600.0, 60.0) - self.force(e, 600.0, 60.0)) / slope
        assert lost == pytest.approx(60.0, rel=0.01)

    def test_bladder_elasticity(self, form: int) -> None:
        e = with_effect("bladder_elasticity", 0.4, form)
        for p in (0.0, 400.0):
            here = [self.force(e, p, x) - self.force(no_effect(), p, x) for x in (59.99, 60.01)]
            assert (here[1] - here[0]) / 0.02 == pytest.approx(0.4, rel=1e-3)

    def test_contraction_limit(self, form: int) -> None:
        e = with_effect("contraction_limit", 6.0, form)
        lost = self.force(no_effect(), 500.0, 52.0) - self.force(e, 500.0, 52.0)
        assert lost == pytest.approx(6.0)

    def test_end_cap(self, form: int) -> None:
        e = with_effect("end_cap", 1.2, form)
        assert self.force(e, 500.0, 60.0) == pytest.approx(self.force(no_effect(), 500.0, 58.8))

    def test_fibre_stretch(self, form: int) -> None:
        e = with_effect("fibre_stretch", 2.0, form)
        longer = C.copy()
        longer[n.BRAID] *= 1.02
        assert self.force(e, 500.0, 60.0) == pytest.approx(
            static_force(500.0, 60.0, longer, no_effect())
        )

    def test_temperature_stiffening(self, form: int) -> None:
        e = with_effect("temperature_stiffening", 0.5, form)
        forces = []
        for celsius in (20.9, 21.1):
            c = C.copy()
            c[n.MUSCLE_C] = celsius
            forces.append(static_force(500.0, 60.0, c, e))
        gain = 100.0 * (forces[1] - forces[0]) / 0.2 / static_force(500.0, 60.0, C, no_effect())
        assert gain == pytest.approx(0.5, rel=0.01)

    def test_braid_friction(self, form: int) -> None:
        e = with_effect("braid_friction", 3.0, form)
        t = np.array([0.0, 20.0, 40.0])
        trial = plain(held_mm=60.0, regulator=(t, np.array([0.0, 600.0, 0.0])), regulator_s=0.01)
        out = run_trial(trial, C, e, np.linspace(0.0, 40.0, 8001))
        up, down = out[:4000], out[4001:]
        at_up = np.interp(300.0, up[:, OUT_P], up[:, OUT_F])
        at_down = np.interp(-300.0, -down[:, OUT_P], down[:, OUT_F])
        assert 0.5 * (at_down - at_up) == pytest.approx(3.0, rel=0.02)

    def test_viscosity(self, form: int) -> None:
        e = with_effect("viscosity", 0.2, form)
        trial = plain(
            length=(np.array([0.0, 1.0]), np.array([55.0, 65.0])), regulator=constant(300.0)
        )
        moving = run_trial(trial, C, e, np.array([0.5]))[0, OUT_F]
        still = static_force(300.0, 60.0, C, no_effect())
        assert moving - still == pytest.approx(0.2 * 10.0, rel=1e-3)

    def test_creep(self, form: int) -> None:
        e = with_effect("creep", 6.0, form)
        t = np.array([0.0, 1.0, 1.001, 100.0])
        trial = plain(
            held_mm=60.0, regulator=(t, np.array([0.0, 0.0, 500.0, 500.0])), regulator_s=1e-3
        )
        out = run_trial(trial, C, e, np.array([61.0]))[0, OUT_F]
        step = static_force(500.0, 60.0, C, no_effect())
        assert 100.0 * (1.0 - out / step) == pytest.approx(6.0, rel=0.01)

    def test_wear(self, form: int) -> None:
        e = with_effect("wear", -8.0, form)
        trial = Trial("t", "s", "free", 1, 1, 100, 1.0, held_mm=60.0, regulator=constant(400.0))
        out = run_trial(trial, C, e, np.array([0.5]))[0, OUT_F]
        assert out / static_force(400.0, 60.0, C, no_effect()) == pytest.approx(0.92)

    def test_leak(self, form: int) -> None:
        e = with_effect("leak", 2e-12, form)
        trial = plain(held_mm=60.0, edges=np.array([[0.0, 0, 1], [0.5, 0, 0]]))
        t = np.arange(0.6, 120.0, 0.01)
        p = run_trial(trial, C, e, t)[:, OUT_P]
        i = int(np.argmin(np.abs(p - 300.0)))
        rate = (p[i + 10] - p[i - 10]) / 0.2  # kPa/s
        mass = -rate * volume(60.0, C) / (287.05 * 293.15) * 1e-3  # kg/s
        assert mass / (1.185 * 401325.0) == pytest.approx(2e-12, rel=0.03)

    def test_valve_delay(self, form: int) -> None:
        pulse = np.array([[0.1, 0, 1], [0.2, 0, 0]])
        t = np.arange(0.1, 0.15, 1e-5)
        starts = []
        for e in (no_effect(), with_effect("valve_delay", 4.0, form, "inlet_on")):
            p = run_trial(plain(held_mm=60.0, edges=pulse), C, e, t)[:, OUT_P]
            starts.append(t[np.argmax(p > 1.0)])
        assert 1e3 * (starts[1] - starts[0]) == pytest.approx(4.0, rel=0.15)

    def test_supply_droop_is_the_largest_fall(self, form: int) -> None:
        from blind.design import draw_design
        from blind.sets import sized_droop

        design = draw_design(np.random.default_rng(3), ["valve"], False, False, True)
        drawn = draw(ENTRIES["supply_droop"], np.random.default_rng(2), C, form)
        hidden = sized_droop(drawn, design)
        e = no_effect()
        hidden.put(e)
        falls = [
            run_trial(t, design.true, e, np.arange(0.0, t.duration_s, 1e-3))[:, OUT_FALL].max()
            for t in design.trials
            if t.valved
        ]
        assert max(falls) == pytest.approx(hidden.strength, rel=0.02)

    def test_pressure_lag(self, form: int) -> None:
        e = with_effect("pressure_lag", 20.0, form)
        t = np.arange(0.0, 10.0, 0.01)
        course = (np.array([0.0, 1.0, 9.0]), np.array([0.0, 0.0, 400.0]))
        out = run_trial(plain(held_mm=60.0, regulator=course, regulator_s=1e-3), C, e, t)
        behind = (out[:, OUT_P] - out[:, OUT_TAP])[500] / 50.0  # ramp of 50 kPa/s
        assert 1e3 * behind == pytest.approx(20.0, rel=0.15)


def test_every_entry_of_the_catalogue_is_there_once() -> None:
    assert [entry.id for entry in CATALOGUE] == list(n.EFFECT_IDS)
    assert len(CATALOGUE) == 30
    assert len({entry.family for entry in CATALOGUE}) == 14  # those of the table


@pytest.mark.parametrize("ms", [6.0, 9.0])
def test_a_command_shorter_than_the_on_delay_opens_only_in_transport(ms: float) -> None:
    trial = plain(held_mm=60.0, edges=pulses(1e-3 * ms, 2))
    t = np.array([0.0, 0.6])
    assert run_trial(trial, C, no_effect(), t)[1, OUT_P] == 0.0
    for form in (0, 1, 2):
        e = with_effect("transport_delay", 1.0, form)
        assert run_trial(trial, C, e, t)[1, OUT_P] > 10.0
