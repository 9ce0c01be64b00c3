"""A holder whose scale is off by another amount at each length: still the labels, nothing else.

Found on withheld bench 1034: `contraction_limit` and `camera_distortion` were named beside it.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gap.data.reader import read_dataset
from gap.decision.diagnose import diagnose_with_search
from plant.constants import nominal
from plant.effects.effects import Effects
from plant.errors import PlantError
from plant.simulator.simulate import held_offset_mm
from rigs.virtual.emulators.sensor_error import refuse_changing_scales
from tests.gap_bench import write_set

C = nominal()
RATIOS = st.floats(0.1, 10.0)


def offset_at(length_m: float, **values: float) -> float:
    stated = Effects.from_config({"length_label": {"offset_mm": 0.4, **values}})
    return float(held_offset_mm(1e3 * length_m, C, stated))


@given(RATIOS, RATIOS)
def test_the_offset_is_what_is_stated_in_mid_range_and_at_both_ends(
    short: float, long: float
) -> None:
    middle = 0.5 * (C.length_min_m + C.length_max_m)
    assert offset_at(middle, short=short, long=long) == pytest.approx(0.4)
    assert offset_at(C.length_min_m, short=short, long=long) == pytest.approx(0.4 * short)
    assert offset_at(C.length_max_m, short=short, long=long) == pytest.approx(0.4 * long)


def test_one_offset_is_the_same_at_every_length() -> None:
    lengths = np.linspace(1e3 * C.length_min_m, 1e3 * C.length_max_m, 5)
    stated = Effects.from_config({"length_label": {"offset_mm": 0.4}})
    assert held_offset_mm(lengths, C, stated) == pytest.approx(np.full(5, 0.4))


def test_the_virtual_stage_has_one_offset() -> None:
    with pytest.raises(PlantError, match="length_label: the virtual instruments have straight"):
        refuse_changing_scales(
            Effects.from_config({"length_label": {"offset_mm": 0.4, "short": 2.0}})
        )


def test_labels_that_a_bowed_slide_bends_are_labels_alone(tmp_path: Path) -> None:
    """Of the plant's own form: what is shown is that the search takes it for no second effect."""
    folder = tmp_path / "set"
    write_set(folder, {"length_label": {"offset_mm": -0.5, "short": 1.9, "long": 2.3}}, seed=3)
    verdict, _, search = diagnose_with_search(read_dataset(folder))
    assert [effect.ids for effect in verdict.effects] == [("length_label",)]
    assert search is not None
    (label,) = search.best.fit.candidates
    assert label.shape["short"] == pytest.approx(1.9, abs=0.4)
    assert label.shape["long"] == pytest.approx(2.3, abs=0.4)
    (note,) = (one for one in verdict.notes if one.startswith("length_label changes"))
    stated = Effects.from_config({"length_label": {"offset_mm": -0.5, "short": 1.9, "long": 2.3}})
    told = re.findall(r"(-?[\d.]+) mm at ([\d.]+) mm", note)
    assert len(told) == 3
    for off, at in told:
        assert float(off) == pytest.approx(float(held_offset_mm(float(at), C, stated)), abs=0.1)
