"""Canaries: what must not fool the diagnosis."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lfilter

from gap.data.dataset import DataSet
from gap.data.reader import read_dataset
from gap.data.trial import Channel, Trial
from gap.decision.diagnose import diagnose
from gap.estimation.fit_problem import FitProblem
from gap.model.features import BLOCKS
from gap_bench import write_set
from plant.arrays import Array


@pytest.fixture(scope="module")
def nominal(tmp_path_factory: pytest.TempPathFactory) -> DataSet:
    return read_dataset(write_set(tmp_path_factory.mktemp("nominal"), seed=21))


@pytest.fixture(scope="module")
def friction(tmp_path_factory: pytest.TempPathFactory) -> DataSet:
    folder = tmp_path_factory.mktemp("friction")
    effect = {"braid_friction": {"friction_n": 1.0}}
    return read_dataset(write_set(folder, effect, seed=22))


def changed(data: DataSet, name: str, change: Callable[[Trial, Channel], Channel]) -> DataSet:
    """The data set with one channel of every trial changed."""
    trials = []
    for trial in data.trials:
        channels = dict(trial.channels)
        if name in channels:
            channels[name] = change(trial, channels[name])
        trials.append(dataclasses.replace(trial, channels=channels))
    return dataclasses.replace(data, trials=tuple(trials))


def test_an_effect_of_size_zero_is_not_named(nominal: DataSet) -> None:
    assert diagnose(nominal).status == "no_gap_above_floor"


def test_friction_is_named(friction: DataSet) -> None:
    verdict = diagnose(friction)
    assert verdict.status in ("named", "named_form_inadequate")
    assert verdict.effects[0].ids == ("braid_friction",)


def test_friction_of_the_wrong_sign_is_not_called_friction(
    nominal: DataSet, friction: DataSet
) -> None:
    """Twice the nominal force less the force with friction: loops the wrong way round."""
    plain = {trial.name: trial["force_n"] for trial in nominal.trials if "force_n" in trial}

    def flip(trial: Trial, channel: Channel) -> Channel:
        other = plain[trial.name]
        base = np.interp(channel.time_s, other.time_s, other.value)
        return Channel(channel.time_s, 2.0 * base - channel.value)

    verdict = diagnose(changed(friction, "force_n", flip))
    assert not (
        verdict.status in ("named", "named_form_inadequate")
        and verdict.effects[0].ids == ("braid_friction",)
    )


def test_the_same_trials_twice_do_not_raise_an_alarm(nominal: DataSet) -> None:
    """Copies under other names and slots: more rows, no more evidence of a gap."""
    copies = tuple(
        dataclasses.replace(trial, name=f"{trial.name}-copy") for trial in nominal.trials
    )
    twice = dataclasses.replace(nominal, trials=(*nominal.trials, *copies))
    assert diagnose(twice).status == "no_gap_above_floor"


def test_a_slow_gauge_behind_a_tube_is_not_taken_for_a_wrong_clock(nominal: DataSet) -> None:
    """Sound takes 7 ms through 2.4 m of tube; the gauge itself takes 6 ms."""

    def late(trial: Trial, channel: Channel) -> Channel:
        arrives = np.interp(channel.time_s - 0.007, channel.time_s, channel.value)
        step = float(np.median(np.diff(channel.time_s)))
        share = 1.0 - np.exp(-step / 0.006)
        seen = lfilter([share], [1.0, share - 1.0], arrives, zi=[(1.0 - share) * arrives[0]])[0]
        return dataclasses.replace(channel, value=seen)

    verdict = diagnose(changed(nominal, "pressure_kpa", late))
    assert verdict.status != "data_unfit"
    (explanation,) = verdict.effects
    assert explanation.ids == ("pressure_lag",)
    time = explanation.parameters["time_ms"]
    assert time.low is not None
    assert time.high is not None
    assert time.low < 13.0 < time.high


def test_readings_at_the_end_of_a_gauge_count_for_nothing(nominal: DataSet) -> None:
    """A zero 0.5 kPa low, which its converter shows as zero, moved supply and gain to the ends of
    their tolerances: benches without any effect got the name of one."""

    def clipped(trial: Trial, channel: Channel) -> Channel:
        return dataclasses.replace(channel, value=np.maximum(channel.value - 0.488, 0.0))

    def floors(data: DataSet) -> tuple[Array, Array]:
        rows = FitProblem.of(data).rows
        pressure, vented = rows.block == BLOCKS.index("pressure"), rows.pressure < 0.2e3
        return rows.floor[pressure & vented], rows.floor[pressure & (rows.pressure > 10e3)]

    vented, pressurised = floors(changed(nominal, "pressure_kpa", clipped))
    assert len(vented)
    assert float(np.median(vented)) > 1.0
    assert pressurised.max() < 1.0
    assert floors(nominal)[0].max(initial=0.0) < 1.0


@pytest.mark.parametrize(("name", "late_s"), [("force_n", 0.06), ("pressure_kpa", 0.06)])
def test_a_channel_out_of_time_is_unfit(nominal: DataSet, name: str, late_s: float) -> None:
    def shift(trial: Trial, channel: Channel) -> Channel:
        keep: Array = channel.time_s + late_s
        return Channel(keep, channel.value)

    verdict = diagnose(changed(nominal, name, shift))
    assert verdict.status == "data_unfit"
    assert name in str(verdict.reason)


def test_a_channel_out_of_time_does_not_hide_that_the_muscle_is_another(nominal: DataSet) -> None:
    late = changed(nominal, "pressure_kpa", lambda _, c: Channel(c.time_s + 0.06, c.value))
    strong = changed(late, "force_n", lambda _, c: Channel(c.time_s, 3.0 * c.value))
    verdict = diagnose(strong)
    assert verdict.status == "nominal_unfit"
    assert "turns would have to be off by" in str(verdict.reason)


def test_a_force_read_far_outside_its_trial_is_no_crash(nominal: DataSet, tmp_path: Path) -> None:
    """Only one sample of a channel, or none in common with the others, is legal data."""

    def single(trial: Trial, channel: Channel) -> Channel:
        return Channel(channel.time_s[:1], channel.value[:1])

    few = dataclasses.replace(nominal, trials=nominal.trials[: len(nominal.trials) // 3])
    verdict = diagnose(changed(few, "force_n", single))
    assert verdict.status
