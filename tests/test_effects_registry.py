"""Every effect of the catalogue: a new one is tested by being registered."""

from __future__ import annotations

import ast
import re
from collections import Counter
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from conftest import HOUSE
from gap.data.dataset import DataSet
from gap.data.trial import Channel, Trial
from gap.effects.recording import RECORDING
from gap.effects.terms import Active
from gap.model.grid import make_grid
from gap.model.residuals import Model
from plant.constants import KEYS, nominal
from plant.effects.catalogue import CATALOGUE
from plant.effects.effect import Effect, InPlant
from plant.effects.effects import NONE, Effects
from plant.physics import layout
from plant.simulator.readings import readings
from plant.simulator.simulate import commands, run_commands

C = nominal()
EFFECTS = list(CATALOGUE.values())
ROOMS = Path(__file__).parent.parent / "plant" / "effects"
FILL_AND_VENT = [
    (0.2, "inlet", 1.0), (0.24, "inlet", 0.0), (0.8, "inlet", 1.0), (0.809, "inlet", 0.0),
    (1.2, "inlet", 1.0), (1.7, "inlet", 0.0), (2.5, "outlet", 1.0), (2.53, "outlet", 0.0),
    (3.2, "outlet", 1.0), (3.209, "outlet", 0.0), (3.6, "outlet", 1.0), (4.2, "outlet", 0.0),
]  # fmt: skip
SETTINGS = (
    *(("held", length, 0.0, "valve", FILL_AND_VENT, 4.6) for length in (51.5, 56.0, 62.0, 67.0)),
    *(("hung", 66.0, mass, "valve", FILL_AND_VENT, 4.6) for mass in (1.0, 2.0)),
    (
        "loop", 60.0, 0.0, "regulator",
        [(0.0, "inlet", 1.0), *((0.2 + 8.0 * k, "regulator_kpa", p)
                                for k, p in enumerate((300.0, 550.0, 300.0, 0.0)))], 33.0,
    ),
)  # fmt: skip


def values_of(effect: Effect, amount: float) -> dict[str, float | str]:
    """Parameters of so much of an effect, everything else as it is by default."""
    values: dict[str, float | str] = {p.name: p.choices[0] for p in effect.parameters if p.choices}
    if effect.headline is not None:
        values[effect.headline] = effect.neutral_in(C) + amount
    return values


def amount_of(effect: Effect) -> float:
    """Enough of an effect to stand out of what the diagnosis's model leaves anyway."""
    return effect.search.step * (1.0 if effect.headline is None else 10.0)


def channels(effects: Effects, order: int, setting: tuple) -> dict[str, np.ndarray]:  # type: ignore[type-arg]
    """What the sensors show of one trial every millisecond, without noise."""
    kind, length, mass, source, events, duration = setting
    traces = run_commands(
        C, commands(events), duration, 1000.0, effects, source=source,
        load="isotonic" if kind == "hung" else "isometric", length_m=length * 1e-3,
        mass_kg=mass or 1.0, temperature_c=15.0 + 3.0 * order, trials=20.0 * order,
    )  # fmt: skip
    return vars(readings(traces, C, effects))


@cache
def model_of(name: str | None) -> Model:
    """The diagnosis's model of a data set from the plant with one effect, or with none."""
    effects = NONE
    if name is not None:
        effect = CATALOGUE[name]
        effects = Effects.from_config({name: values_of(effect, amount_of(effect))})
    trials = []
    for order, setting in enumerate(SETTINGS):
        kind, length, mass, source, events, _ = setting
        shown = channels(effects, order, setting)
        t = shown["time_s"]
        made = {k: Channel(t, shown[k]) for k in ("pressure_kpa", "force_n", "length_mm")}
        if source == "valve":
            for valve in ("inlet", "outlet"):
                own = [(at, to) for at, which, to in events if which == valve]
                times, to = zip((0.0, 0.0), *own, strict=True)
                made[f"{valve}_cmd"] = Channel(np.array(times), np.array(to))
        trials.append(
            Trial(
                f"t{order}", f"s{order}", "0", kind, "m0", 20.0 * order,
                np.nan if kind == "hung" else length, mass or np.nan, 15.0 + 3.0 * order, 0.0,
                False, made, np.zeros(0, dtype=np.int64),
            )
        )  # fmt: skip
    return Model(make_grid(DataSet("the plant", tuple(trials), C)))


def active(effect: Effect, amount: float) -> Active:
    shape = effect.search.plant_shape
    shape = effect.search.shapes[0] if shape is None else shape
    return [(effect.id, effect.options[0], amount, shape)]


@pytest.mark.parametrize("effect", EFFECTS, ids=lambda e: e.id)
def test_nothing_of_an_effect_is_the_nominal_plant_to_the_bit(effect: Effect) -> None:
    if effect.headline is None:
        pytest.skip("it is there or not")
    nothing = Effects.from_config({effect.id: values_of(effect, 0.0)})
    for order, setting in ((1, SETTINGS[1]), (2, SETTINGS[4])):
        plain, same = (channels(effects, order, setting) for effects in (NONE, nothing))
        for name in plain:
            assert np.array_equal(plain[name], same[name]), (setting[0], name)


@pytest.mark.parametrize("effect", EFFECTS, ids=lambda e: e.id)
def test_nothing_of_an_effect_is_the_nominal_prediction_to_the_bit(effect: Effect) -> None:
    model = model_of(None)
    plain, same = model.residual(C, []), model.residual(C, active(effect, 0.0))
    for block in plain:
        assert np.array_equal(plain[block], same[block]), block


@pytest.mark.parametrize("effect", EFFECTS, ids=lambda e: e.id)
def test_plant_and_diagnosis_agree_on_an_effect(effect: Effect) -> None:
    """The prediction with the effect leaves of it no more than its file says."""
    misfit, share = misfit_of(effect)
    assert share > 3.0, "the settings of this test do not show the effect"
    assert misfit <= effect.search.plant_misfit


def misfit_of(effect: Effect) -> tuple[float, float]:
    """Share of the effect that its prediction leaves, and its size over what is left anyway.

    Both rms, in the block of features in which the diagnosis sees the effect best.
    """
    model = model_of(effect.id)
    usual = model_of(None).residual(C, [])
    without = model.residual(C, [])
    with_it = model.residual(C, active(effect, amount_of(effect)))

    def rms(x: np.ndarray) -> float:
        return float(np.sqrt(np.mean(np.square(x))))

    blocks = [block for block in effect.search.blocks if block in usual]
    best = max(blocks, key=lambda block: rms(with_it[block] - without[block]) / rms(usual[block]))
    floor = rms(usual[best])
    left = np.sqrt(max(rms(with_it[best]) ** 2 - floor**2, 0.0))
    return float(left / rms(without[best])), rms(without[best]) / floor


def test_no_two_effects_write_the_same_slot_of_their_own() -> None:
    taken: Counter[int] = Counter()
    for effect in EFFECTS:
        if effect.plant.slots is not None:
            values = Effects.from_config({effect.id: values_of(effect, amount_of(effect))})
            slots = effect.plant.slots(values.values[effect.id], C)
            taken.update(slot for slot in slots if layout.EFFECTS <= slot != layout.REMEMBERS)
            assert all(slot < layout.PARAMS_SIZE for slot in slots)
            assert layout.FORCE_EFFECTS not in slots
    assert max(taken.values()) == 1


@pytest.mark.parametrize("effect", EFFECTS, ids=lambda e: e.id)
def test_the_file_of_an_effect_is_whole(effect: Effect) -> None:
    assert len(list(ROOMS.glob(f"*/{effect.id}.py"))) == 1
    assert all(key in KEYS for key in effect.constants)
    assert not isinstance(effect.neutral, str) or effect.neutral in KEYS
    assert effect.standard
    assert effect.search.shapes
    acts = effect.plant != InPlant() or any(vars(effect.sensors).values())
    assert acts, "it does nothing in the plant"


def test_the_docs_have_one_line_for_every_effect() -> None:
    text = (ROOMS.parent.parent / "docs" / "reference" / "effects.md").read_text(encoding="utf-8")
    for effect in EFFECTS:
        found = re.search(rf"^\| `{effect.id}` \| (\w+) \| (\w+) \| .* \| (.+)$", text, re.M)
        assert found, effect.id
        told = (found[1], found[2], found[3].removesuffix(" |").replace("\\|", "|"))
        assert told == (effect.family, effect.stage, effect.equation)
        assert effect.headline is None or f"`{effect.headline}`" in found[0]


def test_no_code_beside_the_effects_asks_which_effect_it_is() -> None:
    names = "|".join([*CATALOGUE, *(error.id for error in RECORDING)])
    asked = re.compile(rf"(==|!=|\bin) *\(?[\"']({names})[\"']|[\"']({names})[\"'] +(not +)?in ")
    for room in ("plant/simulator", "gap/model", "gap/effects"):
        for file in (ROOMS.parent.parent / room).glob("*.py"):
            assert not asked.search(file.read_text(encoding="utf-8")), file.name


SCORING = "gap/check/scoring/inputs.py"
"""What each effect depends on, written down by hand for a score: the diagnosis must not know it."""


def test_no_other_file_of_the_diagnosis_names_an_effect() -> None:
    """What is particular to an effect stands in its file; the study of the thesis's tables may."""
    # A constant of the plant file, a key of run.json and a test have the names of effects.
    ids = set(CATALOGUE) - {"critical_ratio", "leak", "creep"}
    found = [
        f"{path.relative_to(HOUSE)}:{node.lineno}: {node.value}"
        for package in ("gap", "cli", "analysis")
        for path in sorted((HOUSE / package).rglob("*.py"))
        if "thesis" not in path.parts and path.relative_to(HOUSE).as_posix() != SCORING
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Constant) and node.value in ids
    ]
    assert not found, found
