"""Blind sets: the same again by number, fit to be read, and sealed."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from blind.__main__ import main
from blind.design import draw_design
from blind.exchange import write
from blind.mimic import best_rivals
from blind.noise import draw_noise
from blind.physics.entries import CATALOGUE, Hidden
from blind.recalibrate import Recalibration
from blind.recording import record
from blind.seal import opened, seal
from blind.sets import BLOCK, MAGNITUDES, answer, blind_set, choose, kind_and_count, other_data
from blind.standin import stand_in

COLUMNS = {
    "trial", "time_s", "inlet_cmd", "outlet_cmd", "supply_kpa", "pressure_kpa", "length_mm",
    "force_n", "temperature_c", "direction",
}  # fmt: skip


def number_of(kind: str, which: int = 0) -> int:
    return [i for i in range(600) if kind_and_count(i)[0] == kind][which]


@pytest.fixture(scope="module")
def single():
    return blind_set("smoke", number_of("single", 1))


def test_the_same_number_gives_the_same_set_to_the_bit(single) -> None:
    again = blind_set("smoke", single.number)
    assert answer(again) == answer(single)
    pd.testing.assert_frame_equal(record(again).samples, record(single).samples)


def test_other_streams_hide_other_things_under_the_same_number(single) -> None:
    other = blind_set("practice", single.number, small=True)
    assert not record(other).samples.equals(record(single).samples)


def test_other_data_of_a_set_are_of_the_same_bench_with_other_slots(single) -> None:
    """What was learnt on the one can be judged on the other."""
    first, second = other_data(single, 0), other_data(single, 1)
    assert first.hidden == second.hidden == single.hidden
    for one in (first, second):
        np.testing.assert_array_equal(one.design.true, single.design.true)
        assert len({t.slot for t in one.design.trials}) == len(
            {t.slot for t in single.design.trials}
        )
    made = [record(one).samples for one in (single, first, second)]
    assert not any(made[i].equals(made[j]) for i, j in ((0, 1), (0, 2), (1, 2)))


@pytest.mark.parametrize("kind", ["nominal", "single", "unfit"])
def test_a_folder_is_valid_exchange_data(kind: str, tmp_path: Path) -> None:
    one = blind_set("smoke", number_of(kind))
    write(record(one), tmp_path / "a")
    write(record(one), tmp_path / "b", as_csv=True)
    trials = pd.read_csv(tmp_path / "a" / "trials.csv")
    samples = pd.read_parquet(tmp_path / "a" / "samples.parquet")
    plain = pd.read_csv(tmp_path / "b" / "samples.csv")
    assert list(plain.columns) == list(samples.columns)
    assert set(samples.columns) <= COLUMNS
    assert set(samples["trial"]) == set(trials["trial"])
    assert not samples.duplicated(["trial", "time_s"]).any()
    for _, rows in samples.groupby("trial"):
        assert (np.diff(rows["time_s"]) > 0).all()
    assert trials["order"].is_monotonic_increasing
    assert trials.groupby("slot").size().min() >= 2
    assert trials["mounting"].nunique() == 2


def test_what_is_hidden_never_stands_in_the_folder(single, tmp_path: Path) -> None:
    write(record(single), tmp_path / "set")
    text = "".join(
        p.read_text(encoding="utf-8")
        for p in (tmp_path / "set").iterdir()
        if p.suffix != ".parquet"
    )
    for entry in CATALOGUE:
        assert entry.id not in text
    assert single.kind not in text


def test_replicates_differ_by_noise_alone_and_by_about_the_floor() -> None:
    one = blind_set("smoke", number_of("nominal"))
    recorded = record(one)
    first = recorded.trials.groupby("slot")["trial"].apply(list).iloc[0]
    columns = [
        recorded.samples[recorded.samples["trial"] == name]["pressure_kpa"].dropna().to_numpy()
        for name in first
    ]
    assert not np.array_equal(columns[0], columns[1])
    assert abs(np.mean(columns[0] - columns[1])) < 5.0


def test_the_hidden_effect_has_the_size_aimed_at() -> None:
    """Within the limits of its parameter; the measure is the recalibrated gap over the floor."""
    one = blind_set("smoke", number_of("single", 3))
    hidden = one.hidden[0]
    assert one.aim is not None
    reached = float(one.measured["members"][0]["gap_over_floor"])  # type: ignore[index]
    assert reached == pytest.approx(one.aim, rel=0.3) or abs(hidden.strength) >= hidden.entry.limit


def test_a_block_holds_every_kind_and_singles_meet_every_effect_and_size() -> None:
    kinds = [kind_and_count(i)[0] for i in range(len(BLOCK))]
    assert sorted(kinds) == sorted(BLOCK)
    rng = np.random.default_rng(0)
    met = {(choose("single", i, rng)[0][0], choose("single", i, rng)[1]) for i in range(150)}
    assert met == {(e.id, m) for e in CATALOGUE for m in MAGNITUDES}


def test_a_seal_opens_for_its_own_answer_only(single) -> None:
    digest, envelope = seal(answer(single))
    assert opened(envelope, digest)["number"] == single.number
    other = json.loads(json.dumps(envelope))
    other["answer"]["kind"] = "nominal"
    with pytest.raises(ValueError, match="does not match its seal"):
        opened(other, digest)
    again, _ = seal(answer(single))
    assert again != digest  # another salt: answers cannot be guessed from digests


def test_practice_sets_are_made_on_the_command_line(tmp_path: Path, capsys) -> None:
    assert (
        main(["make", "--practice", "0", "--small", "--answer", "--out", str(tmp_path / "d")]) == 0
    )
    said = json.loads(capsys.readouterr().out)
    envelope = json.loads((tmp_path / "d.answer.json").read_text())
    assert opened(envelope, said["seal"])["stream"] == "practice"
    assert (tmp_path / "d" / "samples.parquet").exists()


def test_a_delay_and_its_slope_stand_in_for_each_other_where_the_supply_never_varies() -> None:
    """Their signatures at a usual size do not: what comes late turns with how late it comes."""
    rng = np.random.default_rng(5)
    recalibration = Recalibration(
        draw_design(rng, ["valve"], False, False, True), draw_noise(rng, False)
    )
    late = Hidden("valve_delay", 0, 2.0, (0.0, 0.0, 0.0), "inlet_off")
    slope = Hidden("valve_delay_pressure", 0, 0.01, (0.0, 0.0, 0.0), "inlet_off")
    leak = Hidden("leak", 0, 2e-12)
    assert stand_in(recalibration, [late], slope) > 0.95
    assert stand_in(recalibration, [late], leak) < 0.5


def test_a_load_that_is_lighter_than_it_is_said_to_be_still_weighs_something() -> None:
    """Less than nothing ran away in the integrator (sets 2498, 3359 and 3706)."""
    one = blind_set("reserved", 3359)
    lightest = min(t.load_kg for t in one.design.trials if t.load_kg > 0.0)
    assert [h.id for h in one.hidden] == ["payload"]
    assert -lightest < one.hidden[0].strength < 0.0
    assert np.isfinite(record(one).samples["length_mm"].dropna()).all()


def test_an_amount_that_no_bench_has_takes_nobodys_place() -> None:
    """A muscle cannot be longer than its ends say, nor slide with less than no friction."""
    target = np.array([1.0, 0.2])
    cap = Hidden("end_cap", 0, 0.5)
    zero = Hidden("force_zero", 0, 2.0)
    unit = np.array([[-1.0, 0.0], [0.0, 1.0]])
    found = best_rivals(target, [cap, zero], unit, set())
    assert found[0][1] == ("force_zero",)
    assert max(share for share, _ in found) == pytest.approx(0.04 / 1.04)
    turned = best_rivals(target, [cap, zero], -unit, set())
    assert turned[1] == (pytest.approx(1.0), ("end_cap", "force_zero"))
