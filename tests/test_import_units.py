"""Units of a mapping file against their definitions, over all values that a sensor gives."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gap.data.reader import read_dataset
from gap.errors import GapError
from gap.mapping.units import RELATIVE, TIME_NS, UNITS, accepted, conversion, time_factor_ns
from import_sets import imported

VALUE = st.floats(-1e5, 1e5, allow_nan=False)
# One of each unit in SI, from the definitions: pascal, newton, metre, kilogram.
SI = {
    "pressure": (1e3, {
        "kPa": 1e3, "Pa": 1.0, "MPa": 1e6, "bar": 1e5, "mbar": 100.0, "hPa": 100.0,
        "psi": 4.4482216152605 / 6.4516e-4, "mmHg": 13595.1 * 9.80665 * 1e-3,
    }),
    "force": (1.0, {
        "N": 1.0, "mN": 1e-3, "kN": 1e3, "gf": 9.80665e-3, "kgf": 9.80665, "g": 9.80665e-3,
        "kg": 9.80665, "lbf": 4.4482216152605,
    }),
    "length": (1e-3, {"mm": 1e-3, "m": 1.0, "cm": 1e-2, "um": 1e-6, "in": 0.0254}),
    "mass": (1.0, {"kg": 1.0, "g": 1e-3, "lb": 0.45359237, "N": 1.0 / 9.80665}),
}  # fmt: skip


def convert(value: float, unit: str, dimension: str, rest: float | None = None) -> float:
    return float(conversion(unit, dimension, "here", rest)(np.array([value]))[0])


@pytest.mark.parametrize("dimension", SI)
@given(value=VALUE)
def test_every_unit_is_its_definition(dimension: str, value: float) -> None:
    ours, units = SI[dimension]
    assert set(units) == set(UNITS[dimension])
    for unit, si in units.items():
        made = convert(value, unit, dimension)
        assert made * ours == pytest.approx(value * si, rel=1e-8, abs=1e-12)


@given(value=VALUE)
def test_a_conversion_keeps_ratios_and_goes_back(value: float) -> None:
    for dimension, units in UNITS.items():
        for unit in units:
            there = conversion(unit, dimension, "here", None)
            assert there.factor > 0.0
            back = (convert(value, unit, dimension) - there.addend) / there.factor
            assert back == pytest.approx(value, rel=1e-9, abs=1e-6)


@pytest.mark.parametrize(
    ("value", "unit", "celsius"),
    [(0.0, "K", -273.15), (32.0, "F", 0.0), (212.0, "°F", 100.0), (21.0, "°C", 21.0)],
)
def test_temperatures_have_a_zero_of_their_own(value: float, unit: str, celsius: float) -> None:
    assert convert(value, unit, "temperature") == pytest.approx(celsius, abs=1e-9)


@given(rest=st.floats(1.0, 1e3), share=st.floats(-0.5, 0.5))
def test_contraction_shortens_and_strain_lengthens(rest: float, share: float) -> None:
    assert convert(share, "contraction", "length", rest) == pytest.approx(rest * (1 - share))
    assert convert(share, "strain", "length", rest) == pytest.approx(rest * (1 + share))
    for unit in ("contraction", "strain"):
        percent = convert(100 * share, f"{unit} %", "length", rest)
        assert percent == pytest.approx(convert(share, unit, "length", rest), abs=1e-9)


def test_a_contraction_needs_a_rest_length() -> None:
    for unit in RELATIVE:
        with pytest.raises(GapError, match="needs rest_length_mm"):
            conversion(unit, "length", "here", None)


@pytest.mark.parametrize("dimension", ["pressure", "force", "length", "temperature", "mass"])
def test_a_unit_of_another_dimension_is_called_so(dimension: str) -> None:
    for other, units in UNITS.items():
        for unit in set(units) - set(UNITS[dimension]):
            with pytest.raises(GapError, match=rf"here: '{unit}' is a unit of \w+, not of"):
                conversion(unit, dimension, "here", 60.0)
        assert other
    for unit in TIME_NS:
        if unit not in accepted(dimension):
            with pytest.raises(GapError, match=r"unit of time, not of"):
                conversion(unit, dimension, "here", 60.0)


def test_an_unknown_unit_gets_the_nearest_known() -> None:
    with pytest.raises(GapError, match=r"unknown unit 'kpa' \(did you mean 'kPa'"):
        conversion("kpa", "pressure", "here", None)
    with pytest.raises(GapError, match="'bar' is a unit of pressure, not of time"):
        time_factor_ns("bar", "here")


@settings(deadline=None, max_examples=15)  # writes and reads files
@given(
    volts=st.lists(st.floats(-10, 10), min_size=2, max_size=6),
    scale=st.floats(0.1, 50),
    offset=st.floats(-2, 2),
    sign=st.sampled_from([1, -1]),
)
def test_a_signal_becomes_its_quantity(
    volts: list[float],
    scale: float,
    offset: float,
    sign: int,
    tmp_path_factory: pytest.TempPathFactory,
) -> None:
    folder = tmp_path_factory.mktemp("signal")
    (folder / "a.csv").write_text("v\n" + "".join(f"{v!r}\n" for v in volts))
    imported(
        folder,
        '[source]\nfiles = "a.csv"\n[time]\nrate_hz = 100\n[channels.force_n]\ncolumn = "v"\n'
        f'unit = "V"\nscale = {scale!r}\noffset = {offset!r}\ngives = "N"\nsign = {sign}\n',
    )
    (trial,) = read_dataset(folder / "out").trials
    np.testing.assert_allclose(
        trial["force_n"].value, sign * scale * np.array(volts) + offset, rtol=1e-9, atol=1e-9
    )


def test_absolute_pressure_loses_the_stated_ambient_pressure(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("p\n1013.25\n3013.25\n")
    imported(
        tmp_path,
        '[source]\nfiles = "a.csv"\n[time]\nrate_hz = 10\n[channels.pressure_kpa]\ncolumn = "p"\n'
        'unit = "mbar"\nreference = "absolute"\nambient_kpa = 101.325\n',
    )
    (trial,) = read_dataset(tmp_path / "out").trials
    np.testing.assert_allclose(trial["pressure_kpa"].value, [0.0, 200.0], atol=1e-9)
