"""A kept prediction is the one that a model would make: effects left out change nothing."""

from __future__ import annotations

import numpy as np
import pytest

from gap.data.reader import read_dataset
from gap.effects.candidates import CANDIDATES
from gap.effects.terms import Active, acting_in
from gap.model.grid import make_grid
from gap.model.residuals import Model
from gap_bench import write_set


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> Model:
    """All blocks, with a mounting and a calibration of the camera in force."""
    return Model(make_grid(read_dataset(write_set(tmp_path_factory.mktemp("set"), replicates=1))))


def test_an_effect_that_is_left_out_of_a_block_does_nothing_there(model: Model) -> None:
    c = model.grid.data.constants
    moved: Active = [("mounting", "", 0.1, {"number": 0.0})]
    left_out = set()
    for one in CANDIDATES:
        active = [*moved, (one.id, one.option, one.step, one.shape)]
        for block, points in model.grid.points.items():
            if acting_in(block, active) == moved:
                left_out.add((block, one.id))
                predicted = [getattr(model, f"_{block}")(points, c, on) for on in (active, moved)]
                np.testing.assert_array_equal(*predicted, err_msg=f"{one.id} in {block}")
    assert {("force", "leak"), ("pressure", "bladder_elasticity")} <= left_out
    assert not {("force", "bladder_elasticity"), ("pressure", "leak")} & left_out


def test_rows_are_kept_for_equal_arguments_and_not_for_others(model: Model) -> None:
    c = model.grid.data.constants
    one = model.residual(c, [], ("force",))["force"]
    assert model.residual(c, [], ("force",))["force"] is one
    valve: Active = [("valve_delay", "outlet_on", 5.0, {})]
    assert model.residual(c, valve, ("force",))["force"] is one
    shape = next(s.shape for s in CANDIDATES if s.id == "bladder_elasticity")
    stiff: Active = [("bladder_elasticity", "", 0.5, shape)]
    assert not np.array_equal(model.residual(c, stiff, ("force",))["force"], one)
