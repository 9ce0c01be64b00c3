"""Commands of valves that open part of the way, and of valves that are pulsed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from gap.data.reader import read_dataset
from gap.errors import GapError
from import_sets import imported, understood

HEAD = """
[source]
files = "*.csv"

[time]
column = "t"
unit = "s"

[channels.pressure_kpa]
column = "p"
unit = "kPa"
reference = "gauge"
"""
SPOOL = (
    HEAD
    + """
[channels.inlet_cmd]
column = "u"
shut = 5.0
open = 10.0

[channels.outlet_cmd]
column = "u"
shut = 5.0
open = 0.0

[bench]
valve = "proportional"
"""
)
PULSED = (
    HEAD
    + """
[channels.inlet_cmd]
column = "duty"
shut = 0
open = 100
pwm_period_ms = 20
"""
)


def test_a_period_that_makes_millions_of_pulses_is_a_slip(tmp_path: Path) -> None:
    pd.DataFrame({"t": [0.0, 500.0, 1000.0], "p": 10.0, "duty": [0, 50, 0]}).to_csv(
        tmp_path / "run.csv", index=False
    )
    with pytest.raises(GapError, match=r"makes more than 2e\+06 pulses \(check pwm_period_ms\)"):
        imported(tmp_path, PULSED.replace("= 20", "= 0.1"))


def logged(folder: Path, **columns: object) -> None:
    """A recording at 100 Hz."""
    length = max(len(np.atleast_1d(np.asarray(one))) for one in columns.values())
    time_s = np.arange(length) / 100.0
    table = pd.DataFrame({"t": time_s, "p": 10.0 + 0.1 * np.arange(length), **columns})
    table.to_csv(folder / "run.csv", index=False)


def test_one_voltage_drives_both_sides_of_a_spool(tmp_path: Path) -> None:
    volts = [5.0, 5.0, 6.0, 7.5, 10.0, 10.4, 5.0, 4.0, 2.5, 0.0, 5.0]
    logged(tmp_path, u=volts)
    imported(tmp_path, SPOOL)
    trial = read_dataset(tmp_path / "out").trials[0]
    inlet, outlet = trial["inlet_cmd"], trial["outlet_cmd"]
    at = np.arange(len(volts)) / 100.0

    def held(channel: object) -> list[float]:
        value, time_s = channel.value, channel.time_s  # type: ignore[attr-defined]
        return [float(value[np.searchsorted(time_s, t + 1e-9) - 1]) for t in at]

    assert held(inlet) == pytest.approx([0, 0, 0.2, 0.5, 1, 1, 0, 0, 0, 0, 0])
    assert held(outlet) == pytest.approx([0, 0, 0, 0, 0, 0, 0, 0.2, 0.5, 1, 0])


def test_a_duty_becomes_the_pulses_that_the_valve_is_given(tmp_path: Path) -> None:
    duty = np.repeat([0.0, 25.0, 100.0, 50.0, 0.0], 4)  # per cent; each for 40 ms
    logged(tmp_path, duty=duty)
    imported(tmp_path, PULSED)
    inlet = read_dataset(tmp_path / "out").trials[0]["inlet_cmd"]
    # Two periods of a duty each: 5 ms of 20, all of 20, 10 ms of 20.
    changes = [(0.04, 1), (0.045, 0), (0.06, 1), (0.065, 0), (0.08, 1), (0.13, 0), (0.14, 1),
               (0.15, 0)]  # fmt: skip
    first = int(inlet.value[0] == 0.0)
    assert list(zip(inlet.time_s[first:], inlet.value[first:], strict=True)) == [
        (pytest.approx(t), v) for t, v in changes
    ]


def test_the_dry_run_says_how_a_command_was_read(tmp_path: Path) -> None:
    logged(tmp_path, u=[5.0, 7.0, 3.0], duty=[0.0, 50.0, 0.0])
    sets = [imported(tmp_path, text, dry=True)[0] for text in (SPOOL, PULSED)]
    units = [{one.name: one.unit for one in own.channels}["inlet_cmd"] for own in sets]
    assert units == ["shut 5, open 10", "shut 0, open 100, pulses of 20 ms"]


@pytest.mark.parametrize(
    ("text", "told"),
    [
        (SPOOL.replace('valve = "proportional"', "supply_kpa = 500"),
         r"channels\.inlet_cmd\.open: is for a proportional valve"),
        (SPOOL.replace("shut = 5.0\nopen = 10.0", "open = 10.0"), r"inlet_cmd\.shut: is missing"),
        (SPOOL.replace("open = 10.0", "open = 5.0"), r"inlet_cmd\.open: is 5, as shut is"),
        (SPOOL.replace("shut = 5.0\nopen = 10.0", "shut = 5.0\nopen = 10.0\nabove = 6"),
         r"inlet_cmd\.open: expected at most one"),
        (PULSED.replace("= 20", "= 0"), r"pwm_period_ms: expected a number above 0"),
        (PULSED.replace("= 20", "= 1e-9"), r"pwm_period_ms: 1e-09 ms; allowed 0\.1 to 60000"),
    ],
)  # fmt: skip
def test_commands_that_say_too_little_or_too_much_are_refused(
    tmp_path: Path, text: str, told: str
) -> None:
    with pytest.raises(GapError, match=told):
        understood(tmp_path, text)


@pytest.mark.parametrize(
    ("text", "column", "told"),
    [
        (SPOOL, {"u": [5.0, 3.0, 2.0]}, r"column u: goes from 2 to 5 and never opens the valve"),
        (SPOOL, {"u": [5.0, np.nan, 6.0]}, r"row 3.* is empty"),
    ],
)
def test_columns_that_cannot_be_such_a_command_are_refused(
    tmp_path: Path, text: str, column: dict[str, list[float]], told: str
) -> None:
    logged(tmp_path, **column)
    with pytest.raises(GapError, match=told):
        imported(tmp_path, text)
