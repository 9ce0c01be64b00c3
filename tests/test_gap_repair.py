"""Data put right before anything is compared: spikes of a length, and parts of a motion."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gap.data.dataset import DataSet
from gap.data.repair import repaired, spikes_of, without_parts, without_spikes
from gap.data.trial import Channel, Trial
from gap.estimation.fit_problem import FitProblem
from plant.constants import nominal

Array = npt.NDArray[np.float64]


def noisy(value: npt.ArrayLike, sd: float, seed: int = 0) -> Array:
    noise = np.random.default_rng(seed).standard_normal(np.shape(value))
    return np.asarray(np.asarray(value) + sd * noise)


@given(
    st.floats(0.001, 0.05),
    st.floats(0.0, 30.0),
    st.floats(-0.5, 0.5).filter(lambda height: abs(height) > 0.05),
    st.integers(0, 1000),
)
def test_a_reading_that_leaves_a_steady_course_and_is_back_is_a_spike(
    sd: float, speed: float, height: float, seed: int
) -> None:
    """As a laser's on the cylinder of E. Zillen: 0.2 to 0.45 mm, one reading in forty."""
    t = np.arange(400) * 0.01
    value = noisy(speed * t, sd, seed)
    clean = spikes_of(value)
    value[[100, 180, 300]] += height * sd / 0.01 * 2.0
    found = spikes_of(value)
    # Chance makes one in two million readings.
    assert len(clean) <= 1
    assert len(set(found.tolist()) - {100, 180, 300}) <= 1
    if abs(height) > 0.2:
        assert set(found.tolist()) >= {100, 180, 300}


def swing(frames_hz: float, own_hz: float) -> Array:
    """A load that bounces on its muscle, calm before."""
    t = np.arange(200) / frames_hz
    since = np.maximum(t - t[50], 0.0)
    bounce = 4.0 * np.exp(-since) * np.sin(2.0 * np.pi * own_hz * since)
    return np.asarray(60.0 - bounce - 3.0 * since.clip(0, 1))


@pytest.mark.parametrize("own_hz", [1.0, 3.1, 4.4, 7.3])
def test_a_swing_that_few_frames_follow_is_no_spike(own_hz: float) -> None:
    assert not len(spikes_of(noisy(swing(10.0, own_hz), 0.01)))


@pytest.mark.parametrize(
    "course",
    [
        np.r_[np.full(100, 60.0), np.full(100, 55.0)],
        np.r_[np.full(100, 60.0), [54.0], np.full(100, 55.0)],
        np.r_[np.linspace(60.0, 50.0, 100), np.linspace(50.0, 60.0, 100)],
        np.r_[np.linspace(60.0, 50.0, 30), np.full(100, 50.0)],
    ],
    ids=["step", "overshoot", "turn", "stop"],
)
def test_what_a_mass_can_do_is_no_spike(course: Array) -> None:
    assert not len(spikes_of(noisy(course, 0.01)))


def test_a_channel_that_jumps_all_the_time_is_left_as_it_is() -> None:
    value = noisy(np.full(400, 60.0), 0.01)
    value[::20] += 0.5
    assert not len(spikes_of(value))


def trial(name: str, slot: str, seconds: float, length: Array, settled: bool = False) -> Trial:
    t = np.linspace(0.0, seconds, len(length))
    channels = {
        "length_mm": Channel(t, length),
        "pressure_kpa": Channel(t, noisy(np.full(len(t), 300.0), 0.3)),
        "force_n": Channel(t, noisy(np.full(len(t), 40.0), 0.1, 1)),
    }
    nan = float("nan")
    return Trial(
        name, slot, name, "triangle", "", nan, nan, nan, 21.0, nan, settled, channels,
        np.zeros(len(t), dtype=np.int64),
    )  # fmt: skip


def stroke(seed: int = 0) -> Array:
    return noisy(np.r_[np.linspace(60, 70, 200), np.linspace(70, 60, 200)], 0.005, seed)


def data_of(*trials: Trial) -> DataSet:
    return DataSet("there", trials, nominal())


def test_half_a_stroke_is_left_out_where_the_others_are_whole() -> None:
    """A recording cut into cycles begins with part of one."""
    whole = [trial(str(k), "slow", 8.0, stroke(k)) for k in range(2, 5)]
    part = trial("1", "slow", 4.0, stroke()[200:])
    made = without_parts(data_of(part, *whole))
    assert [t.name for t in made.trials] == ["2", "3", "4"]
    assert made.notes == ("left out, only a part of the motion that their slot repeats: 1",)


def test_a_stroke_and_a_half_is_a_slot_of_its_own() -> None:
    whole = [trial(str(k), "slow", 8.0, stroke(k)) for k in range(2, 5)]
    longer = trial("5", "slow", 12.0, np.r_[stroke(), stroke(1)[:200]])
    made = without_parts(data_of(*whole, longer))
    assert [t.slot for t in made.trials] == ["slow", "slow", "slow", "slow (5)"]
    assert made.notes == ("slots of their own, longer than what their slot repeats: 5",)


def test_the_bins_of_whole_strokes_are_not_those_of_a_part() -> None:
    whole = [trial(str(k), "slow", 8.0, stroke(k)) for k in range(2, 5)]
    part = trial("1", "slow", 4.0, stroke()[200:])
    rows = FitProblem.of(data_of(part, *whole)).rows
    assert rows.span_s.max() < 0.5


@pytest.mark.parametrize("seconds", [7.0, 9.0, 12.0])
def test_a_stroke_driven_by_hand_stays_a_replicate(seconds: float) -> None:
    trials = [trial(str(k), "slow", 8.0, stroke(k)) for k in range(3)]
    data = data_of(*trials, trial("x", "slow", seconds, stroke()))
    assert without_parts(data) is data


def test_of_two_trials_neither_is_a_part() -> None:
    data = data_of(trial("a", "s", 8.0, stroke()), trial("b", "s", 4.0, stroke()[200:]))
    assert without_parts(data) is data


def test_settled_points_have_no_parts_and_no_spikes() -> None:
    tables = [trial(str(k), "map", 8.0, stroke(), settled=True) for k in range(3)]
    data = data_of(trial("x", "map", 2.0, stroke()[200:], settled=True), *tables)
    assert without_parts(data) is data
    assert without_spikes(data) is data


def test_spikes_are_replaced_and_said_to_be() -> None:
    length = stroke()
    spiked = length.copy()
    spiked[[50, 120]] += 0.4
    data = data_of(trial("a", "s", 8.0, spiked), trial("b", "s", 8.0, length))
    made = repaired(data)
    assert np.abs(made.trials[0]["length_mm"].value - length).max() < 0.05
    assert made.trials[1] is data.trials[1]
    assert made.notes == (
        "spikes of length_mm, one reading each, replaced by the mean of their neighbours: "
        "2, in trials such as a",
    )
    assert without_spikes(made) is made
