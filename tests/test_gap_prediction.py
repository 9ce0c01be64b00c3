"""Whether an explanation found on some protocols foretells another, and a wrong one does not."""

from __future__ import annotations

import dataclasses

import pytest

from gap.inquiry import Inquiry, State
from gap.naming import name_effects
from gap.prediction import FORETOLD, SHOWN, foretell, gains
from gap.reader import read_dataset
from gap.suspects import SUSPECTS
from gap_bench import write_set

NEW = "hysteresis"


@pytest.fixture(scope="module")
def earlier_and_all(tmp_path_factory: pytest.TempPathFactory) -> tuple[Inquiry, Inquiry]:
    folder = tmp_path_factory.mktemp("liner")
    write_set(folder, {"liner_threshold": {"threshold_kpa": 25.0}}, seed=12, replicates=2)
    data = read_dataset(folder)
    known = tuple(trial for trial in data.trials if trial.protocol != NEW)
    return Inquiry(dataclasses.replace(data, trials=known)), Inquiry(data)


def fitted(q: Inquiry, name: str) -> State:
    suspect = next(s for s in SUSPECTS if s.id == name)
    return q.polish(q.fit([suspect], [suspect.step]))


def test_what_is_there_is_foretold_and_what_merely_fitted_is_not(
    earlier_and_all: tuple[Inquiry, Inquiry],
) -> None:
    earlier, everything = earlier_and_all
    new = [k for k, t in enumerate(everything.data.trials) if t.protocol == NEW]
    right, wrong = name_effects(earlier).chosen.state, fitted(earlier, "creep")
    assert right.ids == ("liner_threshold",)
    found = foretell(everything, new, right, [wrong])
    assert found.shown
    assert found.confirmed
    assert found.share > FORETOLD
    assert found.left < 1.3 * found.rows
    assert found.rivals[("creep",)] > found.left + SHOWN
    turned = foretell(everything, new, wrong, [right])
    assert not turned.confirmed
    # Beside one that foretells as much nothing is confirmed.
    assert not foretell(everything, new, right, [right]).confirmed


def test_gains_are_where_the_effect_is(earlier_and_all: tuple[Inquiry, Inquiry]) -> None:
    earlier, _ = earlier_and_all
    state = fitted(earlier, "liner_threshold")
    taken = gains(earlier, state)
    assert taken.shape == (len(earlier.data.trials),)
    by = {
        protocol: sum(g for g, t in zip(taken, earlier.data.trials, strict=True)
                      if t.protocol == protocol)
        for protocol in ("isometric", "step")
    }  # fmt: skip
    assert by["isometric"] > by["step"]
    assert by["isometric"] > SHOWN
