"""Where gains come from: rules and searches against what can be worked out by hand."""

from __future__ import annotations

import json
import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import expm

from plant.errors import PlantError
from plant.finger import load_finger
from plant.finger.reader import load_valve
from plant.links.dynamics import forward_dynamics, gravity_torque
from studies.comparison.figures import PathFigures, StepFigures
from studies.comparison.pressure import PulsePid, pressure_case
from studies.comparison.provenance import Provenance, provenance
from studies.controllers.feedforward import critical_integral_rate
from studies.controllers.laws import Tuning, tuning
from studies.controllers.model import linear_model
from studies.controllers.muscles import Pairs
from studies.controllers.pid import Gains, ziegler_nichols
from studies.controllers.placement import PolePlacement, feedback_rates
from studies.controllers.reference import STEP_POSTURE_DEG
from studies.controllers.tuning import (
    Critical,
    PressureResponse,
    critical_gain,
    oscillation_period,
    pressure_response,
)

FINGER = load_finger()
CURED = load_valve("cured")
POSTURE = np.radians(STEP_POSTURE_DEG)


def third_order(gain: float) -> tuple[Any, Any]:
    """1/(s + 1)^3 under proportional control, let go from a displacement; exact in time."""
    a = np.array([[-1.0, 1.0, 0.0], [0.0, -1.0, 1.0], [-gain, 0.0, -1.0]])
    step_s, x = 0.01, np.array([1.0, 0.0, 0.0])
    turn = expm(a * step_s)
    rows = []
    for _ in range(24_000):
        rows.append(x[0])
        x = turn @ x
    return np.arange(len(rows)) * step_s, np.array(rows)


class TestCriticalGain:
    def test_a_plant_of_third_order_has_its_analytic_one(self) -> None:
        """1/(s+1)^3: phase -180 degrees at sqrt(3) rad/s, where the plant's gain is 1/8."""
        found = critical_gain(third_order, 1.0, 40.0, rounds=20)
        # Sustained means to lose less than a tenth in 80 s: 0.4 % below the true one.
        assert 0.995 * 8.0 < found.gain < 8.0
        # The poles are -1 + K^(1/3) exp(+-j 60 degrees); at K = 8 the period is 2 pi / sqrt(3).
        swing = found.gain ** (1 / 3) * math.sin(math.pi / 3)
        assert found.period_s == pytest.approx(2.0 * math.pi / swing, rel=1e-4)

    @pytest.mark.parametrize(("low", "high"), [(9.0, 40.0), (1.0, 7.0)])
    def test_a_search_that_does_not_hold_it_is_refused(self, low: float, high: float) -> None:
        with pytest.raises(PlantError, match="widen the search"):
            critical_gain(third_order, low, high)

    def test_period_of_a_sine_between_samples(self) -> None:
        time = np.arange(0.0, 3.0, 0.01)
        assert oscillation_period(time, np.sin(2 * np.pi * time / 0.137)) == pytest.approx(
            0.137, rel=1e-3
        )

    def test_ziegler_and_nichols_table(self) -> None:
        pid = ziegler_nichols(10.0, 0.8)
        assert (pid.kp, pid.ti_s, pid.td_s) == (6.0, 0.4, 0.1)
        assert ziegler_nichols(10.0, 0.8, "pi").ti_s == pytest.approx(0.8 / 1.2)
        assert ziegler_nichols(10.0, 0.8, "p").kp == 5.0


class TestMuscleMap:
    @given(
        st.lists(st.floats(-0.3, 1.2), min_size=4, max_size=4),
        st.lists(st.floats(-0.05, 0.05), min_size=4, max_size=4),
    )
    def test_torque_and_delta_are_inverse(self, q: list[float], torque: list[float]) -> None:
        pairs = Pairs(FINGER, CURED)
        angles, wanted = np.array(q), np.array(torque)
        back = pairs.torque(angles, pairs.delta(angles, wanted))
        np.testing.assert_allclose(back, wanted, atol=1e-12)

    def test_pressures_stay_between_nothing_and_twice_the_mean(self) -> None:
        kpa = Pairs(FINGER, CURED).pressures(np.array([-400.0, 0.0, 100.0, 400.0]))
        np.testing.assert_allclose(kpa, [0, 500, 250, 250, 350, 150, 500, 0])


class TestLinearModel:
    def test_it_is_the_slope_of_the_finger(self) -> None:
        pairs = Pairs(FINGER, CURED)
        model = linear_model(pairs, POSTURE, 0.01)
        held = model.delta0
        small = 1e-5

        def push(q: Any, qd: Any, delta: Any) -> Any:
            return forward_dynamics(FINGER.arm, q, qd, pairs.torque(q, delta))

        still = np.zeros(4)
        assert np.abs(push(POSTURE, still, held)).max() < 1e-9
        for k, unit in enumerate(np.eye(4) * small):
            for column, ends in (
                (k, [push(POSTURE + s * unit, still, held) for s in (1, -1)]),
                (4 + k, [push(POSTURE, s * unit, held) for s in (1, -1)]),
                (8 + k, [push(POSTURE, still, held + s * unit) for s in (1, -1)]),
            ):
                slope = (ends[0] - ends[1]) / (2 * small)
                np.testing.assert_allclose(slope, model.a[4:8, column], rtol=1e-5, atol=1e-3)

    def test_the_integral_oscillates_at_its_critical_rate(self) -> None:
        """Simulated sample by sample: it dies out 5 % below and grows 5 % above."""
        model = linear_model(Pairs(FINGER, CURED), POSTURE, 0.006)
        rate = critical_integral_rate(model, 0.009)
        a, b = model.sampled(0.01)
        turn = np.linalg.solve(model.gain, model.stiffness)
        sizes = []
        for share in (0.95, 1.05):
            x, integral, sent = np.zeros(12), np.zeros(4), np.zeros(4)
            x[:4] = 0.1
            rows = []
            for _ in range(3000):
                integral = integral - share * rate * 0.01 * x[:4]
                x, sent = a @ x + b @ sent, turn @ integral
                rows.append(np.abs(x[:4]).max())
            sizes.append(np.max(rows[-200:]) / np.max(rows[:200]))
        assert sizes[0] < 0.2
        assert sizes[1] > 5.0


class TestPolePlacement:
    def design(self) -> PolePlacement:
        t = tuning(FINGER, CURED)
        return PolePlacement(t.model, t.dead_s)

    def test_feedback_poles_are_where_they_were_placed(self) -> None:
        law = self.design()
        got = np.sort_complex(np.linalg.eigvals(law.a - law.b @ law.k))
        np.testing.assert_allclose(
            np.sort(np.abs(got)), np.sort(np.abs(law.feedback_poles)), atol=2e-3
        )
        step = 0.01
        waves = [np.log(z) / step for z in got if z.imag > 1e-3 and abs(np.log(z)) / step < 60.0]
        assert len(waves) == 2
        for pole in waves:
            assert -pole.real / abs(pole) == pytest.approx(0.7, abs=0.01)

    def test_observer_poles_are_where_they_were_placed(self) -> None:
        law = self.design()
        got = np.linalg.eigvals(law.a_wide - law.gain @ law.c_wide)
        slow = np.sort(np.abs(got))[-8:]
        want = np.sort(np.abs(law.observer_poles))[-8:]
        np.testing.assert_allclose(slow, want, atol=1e-3)
        assert np.abs(got).max() < np.exp(-0.39)

    def test_only_badly_damped_poles_are_moved(self) -> None:
        poles = np.array([-100.0, -5 + 40j, -5 - 40j, -80 + 10j, -80 - 10j])
        moved = feedback_rates(poles)
        np.testing.assert_allclose(moved[[0, 3, 4]], poles[[0, 3, 4]])
        np.testing.assert_allclose(np.abs(moved), np.abs(poles))
        assert -moved[1].real / abs(moved[1]) == pytest.approx(0.7)

    def test_the_observer_finds_a_constant_disturbance(self) -> None:
        """On its own model with 8 kPa too much on one joint: angle kept, disturbance found."""
        from studies.controllers.reference import Reference

        law = self.design()
        model = law.model
        still = np.zeros((2, 4))
        law.start(Reference(np.tile(model.q0, (2, 1)), still, still, 0.0), model.q0)
        x, sent = np.zeros(12), [np.zeros(4)] * law._ahead
        extra = np.array([0.0, 8.0, 0.0, 0.0])
        for k in range(300):
            u = law.delta(k * 0.01, model.q0 + x[:4]) - model.delta0
            sent.append(u)
            x = law.a @ x + law.b @ (sent.pop(0) + extra)
        np.testing.assert_allclose(law._estimate[12:], extra, atol=1e-3)
        assert np.abs(x[:4]).max() < 1e-6


def test_the_thesis_valve_answers_later_than_the_cured_one() -> None:
    cured = pressure_response(FINGER, CURED)
    thesis = pressure_response(FINGER, load_valve("thesis"))
    assert 0.004 < cured.dead_s < 0.012
    assert thesis.dead_s > 3.0 * cured.dead_s
    assert gravity_torque(FINGER.arm, POSTURE)[1] < 0.0  # down is forwards: gravity flexes


class TestProvenance:
    def test_it_says_what_the_rules_made(self) -> None:
        response = PressureResponse(0.007, 0.006)
        model = linear_model(Pairs(FINGER, CURED), POSTURE, response.lag_s)
        still = StepFigures(0.1, 0.2, 1.0, 0.3, 0.1, 0.54, 0.25, 90.0, ())
        turned = PathFigures(4.05, 5.0, 5.0, 180.0, ())
        found = Provenance(
            Tuning(response, model, 0.009, 0.018, 12.0),
            Critical(0.6, 0.134),
            {joint: Critical(1.8, 0.05) for joint in FINGER.joints},
            (still, turned),
            (still, turned),
        )
        text = found.text()
        assert "dead time 7 ms, lag 6 ms" in text
        assert "oscillations of 6.5 Hz (damping ratio 0.14), 7.2 Hz (damping ratio 0.16)" in text
        assert "4.0 1/s, a third of the critical 12.0 1/s" in text
        assert "critical gain of tip alone: 1.80, period 0.050 s" in text
        assert text.count("circle 4.05 mm rms") == 2
        assert json.loads(json.dumps(found.as_dict(), allow_nan=False))["lead_s"] == 0.018

    @pytest.mark.campaign
    def test_a_loop_alone_bears_no_less_than_all_together(self) -> None:
        told: list[str] = []
        found = provenance(FINGER, CURED, told.append)
        assert len(told) == 3 + len(FINGER.joints)
        assert all(one.gain > 0.95 * found.together.gain for one in found.apart.values())
        assert found.with_together[0].ripple_deg < found.with_apart[0].ripple_deg


class TestPressurePid:
    def test_it_holds_a_pressure_on_the_cured_valve_only(self) -> None:
        """Ziegler and Nichols's gains from the bench's own critical gain."""
        cured = pressure_case(CURED, "cured", "pid")
        thesis = pressure_case(load_valve("thesis"), "thesis", "pid")
        assert cured.fault == thesis.fault == ""
        assert cured.error_worst_kpa < 3.0
        assert cured.ripple_worst_kpa < 10.0
        assert thesis.ripple_worst_kpa > 50.0

    def test_a_pulse_is_longer_by_what_the_valve_opens_late(self) -> None:
        law = PulsePid(CURED, Gains(1.0, math.inf, 0.0))
        assert law.pulse(300.0, 294.0) == ("inlet", 6500)  # 6 ms net, opens 0.5 ms late
        assert law.pulse(300.0, 306.0) == ("vent", 6500)
        assert law.pulse(300.0, 300.5)[1] == 0  # less than half of the shortest opening
        assert law.pulse(300.0, 299.0)[1] == 2150  # the shortest
