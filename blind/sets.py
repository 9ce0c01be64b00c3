"""Blind sets by stream and number: what is hidden in each, and how large it is made.

Streams: `practice` may be looked at freely; `reserved` keeps its answers until a verdict is
stored; `smoke` is a small one for the tests. `held_out` draws the forms that are held out, for the
campaign of `gap.check` alone; `beside` is the same benches, protocols and noise with forms that are
seen. Numbers run from 0; every block of sixty holds the same mixture of kinds.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from blind.design import Design, draw_design, other_trials
from blind.mimic import measure
from blind.noise import Noise, draw_noise
from blind.physics import numbers as n
from blind.physics.bench import no_effect, run_trial
from blind.physics.entries import CATALOGUE, ENTRIES, OUTSIDE, Hidden, draw, scaled
from blind.physics.stepping import OUT_FALL
from blind.recalibrate import Recalibration

Rng = np.random.Generator
STREAMS = {
    "practice": 101, "reserved": 202, "smoke": 303, "live": 404, "held_out": 505, "beside": 505,
    "several": 606,
}  # fmt: skip
HELD_OUT, BESIDE, SEVERAL = "held_out", "beside", "several"
MOST_AT_ONCE, LEAST_AT_ONCE = 5, 3
"""Effects of a set of the stream `several`, each of a family of its own."""
BLOCK = (
    ["nominal"] * 10 + ["single"] * 25 + ["pair"] * 5 + ["outside"] * 5
    + ["degenerate"] * 3 + ["unfit"] * 2 + ["left_out"] * 10
)  # fmt: skip
# Sizes are met from above, within a few percent (in the logarithm).
ABOVE = 0.05
MAGNITUDES = (0.5, 1.0, 2.0, 4.0, 8.0)
# Effects that muscle data alone seldom tell apart.
DEGENERATE = (
    "liner_threshold", "pressure_zero", "end_cap", "camera_distortion", "pressure_gain",
    "force_gain", "camera_scale", "fibre_stretch",
)  # fmt: skip
DEFECTS = (
    "force_shift", "pressure_shift", "force_smoothed", "pressure_smoothed", "length_smoothed",
    "force_saturated", "pressure_frozen", "gaps",
)  # fmt: skip
TABLE_NEEDS = ("", "short", "cycle", "warm", "load", "held")


@dataclass(frozen=True)
class BlindSet:
    """A set as hidden: everything needed to record it, and the answer."""

    stream: str
    number: int
    kind: str
    design: Design
    noise: Noise
    hidden: tuple[Hidden, ...]
    defect: str | None
    aim: float | None
    without: tuple[str, ...]
    measured: dict[str, object]

    def effects(self) -> np.ndarray:
        """The effect matrix of the bench that is recorded."""
        e = no_effect()
        for one in self.hidden:
            one.put(e)
        return e


@cache
def mixture() -> tuple[str, ...]:
    """Kinds of a block of sixty, in a mixed order."""
    return tuple(np.random.default_rng(60).permutation(BLOCK).tolist())


def kind_and_count(number: int) -> tuple[str, int]:
    """Kind of a set, and how many of that kind come before it."""
    block, place = divmod(number, len(BLOCK))
    kind = mixture()[place]
    return kind, block * BLOCK.count(kind) + mixture()[:place].count(kind)


def sized_droop(hidden: Hidden, design: Design) -> Hidden:
    """A supply droop whose largest fall in the data is its headline."""
    one = hidden
    for _ in range(4):
        e = no_effect()
        one.put(e)
        fall = 0.0
        for trial in {t.slot: t for t in design.trials if t.valved}.values():
            times = np.arange(0.0, trial.duration_s, 2e-3)
            fall = max(fall, float(run_trial(trial, design.true, e, times)[:, OUT_FALL].max()))
        if fall <= 0.0:
            break
        gain = one.shape[0] * hidden.strength / fall
        one = replace(one, shape=(gain, *one.shape[1:]))
    return one


def sized(hidden: Hidden, aim: float, recalibration: Recalibration, design: Design) -> Hidden:
    """The effect made so large that its recalibrated gap is `aim` floors, within its limit.

    The gap need not grow evenly (a constant may take the first part), so the nearest of a bisection
    in the logarithm is kept.
    """
    if hidden.entry.parameter is None:
        return hidden

    most = hidden.entry.limit
    if hidden.id == "payload" and hidden.strength < 0.0:  # something must be left to hang
        most = min([most, *(0.8 * t.load_kg for t in design.trials if t.load_kg > 0.0)])
    low, high = 1e-3, most / abs(hidden.strength)
    factor, best, miss = min(1.0, high), hidden, np.inf
    for _ in range(12):
        one = scaled(hidden, factor)
        left = recalibration.left_of([one])
        ratio = max(recalibration.ratio(left)["gap_over_floor"], 1e-9)
        off = float(np.log(ratio / aim)) - ABOVE
        if abs(off) < miss:
            best, miss = one, abs(off)
        if miss < 0.045 or (off < 0.0 and factor >= high):
            break
        if off < 0.0:
            low = factor
        else:
            high = factor
        guess = factor * float(np.clip(aim / ratio, 0.05, 20.0))
        inside = low * 1.02 < guess < high * 0.98
        factor = guess if inside else min(float(np.sqrt(low * high)), high)
        if off < 0.0 and guess >= high and high == most / abs(hidden.strength):
            factor = high
    return sized_droop(best, design) if best.id == "supply_droop" else best


def choose(kind: str, count: int, rng: Rng) -> tuple[list[str], float | None]:
    """Ids hidden in the count-th set of a kind, and the size aimed at in floors."""
    aim = MAGNITUDES[(count + count // len(CATALOGUE)) % len(MAGNITUDES)]
    if kind in ("single", "left_out"):
        return [CATALOGUE[count % len(CATALOGUE)].id], max(aim, 2.0) if kind == "left_out" else aim
    if kind == "pair":
        two = rng.choice(len(CATALOGUE), 2, replace=False)
        while CATALOGUE[two[0]].family == CATALOGUE[two[1]].family:
            two = rng.choice(len(CATALOGUE), 2, replace=False)
        return [CATALOGUE[i].id for i in two], max(aim, 2.0)
    if kind == "outside":
        return [OUTSIDE[count % len(OUTSIDE)].id], max(aim, 2.0)
    if kind == "degenerate":
        return [DEGENERATE[count % len(DEGENERATE)]], max(aim, 2.0)
    return [], None


def choose_several(rng: Rng) -> tuple[list[str], list[float]]:
    """Ids of several effects of as many families, and the size of each in floors."""
    wanted = int(rng.integers(LEAST_AT_ONCE, MOST_AT_ONCE + 1))
    ids: list[str] = []
    families: set[str] = set()
    for at in rng.permutation(len(CATALOGUE)).tolist():
        entry = CATALOGUE[at]
        if len(ids) < wanted and entry.family not in families:
            ids.append(entry.id)
            families.add(entry.family)
    return ids, [float(x) for x in rng.choice(MAGNITUDES[1:], wanted)]


class HeldOutStreamError(ValueError):
    """A set of the stream of held-out forms was asked for, and not by the campaign."""


def blind_set(stream: str, number: int, small: bool = False, held_out: bool = False) -> BlindSet:
    """Draw a set; the same stream and number always give the same one.

    `held_out` admits the stream of held-out forms: for the campaign alone.

    Raises:
        HeldOutStreamError: `stream` is that of held-out forms and `held_out` is not given.
    """
    if stream == HELD_OUT and not held_out:
        raise HeldOutStreamError(
            f"stream {HELD_OUT!r} is kept from practice, learning and tests: "
            "only `pamrig gap check --held-out` makes it"
        )
    rng = np.random.default_rng(np.random.SeedSequence([STREAMS[stream], number]))
    kind, count = kind_and_count(number)
    if stream == SEVERAL:
        kind = "several"
        ids, aims = choose_several(rng)
        aim = None
    else:
        ids, aim = choose(kind, count, rng)
        aims = [] if aim is None else [aim] * len(ids)
    changed = stream == SEVERAL or (stream in ("reserved", "live") and number % 3 == 2)
    # Plain sets are designed for some effect too, so that the design gives nothing away.
    decoy = [CATALOGUE[int(rng.integers(len(CATALOGUE)))].id]
    needs = [ENTRIES[i].needs for i in (ids or decoy)]
    if kind == "unfit":
        needs = ["stage", "valve"]
    table = all(x in TABLE_NEEDS for x in needs) and rng.random() < 0.2 and kind != "unfit"
    if "creep" in ids:
        table = False
    design = draw_design(rng, needs, changed, table, small or stream == "smoke")
    noise = draw_noise(rng, changed)
    hidden: list[Hidden] = []
    measured: dict[str, object] = {}
    if ids:
        recalibration = Recalibration(design, noise)
        for place, name in enumerate(ids):
            one = draw(ENTRIES[name], rng, design.stated, held_out=stream == HELD_OUT)
            if aims:
                one = sized(one, aims[place], recalibration, design)
            hidden.append(one)
        measured = measure(recalibration, hidden)
    defect = DEFECTS[count % len(DEFECTS)] if kind == "unfit" else None
    without = tuple(ids) if kind == "left_out" else ()
    return BlindSet(
        stream, number, kind, design, noise, tuple(hidden), defect, aim, without, measured
    )


def other_data(one: BlindSet, seed: int) -> BlindSet:
    """The same bench with the same hidden effects and other trials: to judge what was learnt."""
    rng = np.random.default_rng(np.random.SeedSequence([STREAMS[one.stream], one.number, 2, seed]))
    needs = [hidden.entry.needs for hidden in one.hidden] or ["stage"]
    return replace(one, design=other_trials(rng, one.design, needs))


def answer(one: BlindSet) -> dict[str, object]:
    """What a set hides, as plain JSON values."""
    stages = {h.entry.stage for h in one.hidden}
    return {
        "schema": 1,
        "stream": one.stream,
        "number": one.number,
        "kind": one.kind,
        "changed": one.design.changed,
        "table": one.design.table,
        "trials": len(one.design.trials),
        "effects": [{**h.as_dict(), "shape": list(h.shape)} for h in one.hidden],
        "stage": stages.pop() if len(stages) == 1 else None,
        "defect": one.defect,
        "aim": one.aim,
        "without": list(one.without),
        "measured": one.measured,
        "constants": {
            "supply_kpa": float(one.design.true[n.SUPPLY] - one.design.true[n.ATMOSPHERE]),
            "braid_length_mm": float(one.design.true[n.BRAID]),
            "turns": float(one.design.true[n.TURNS]),
        },
    }
