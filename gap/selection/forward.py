"""Which effects explain the gap: forward over effects, forms left free, rivals kept.

An effect enters when it takes away more than chance could and a fair share of the gap; shapes of
the same effect may share its place, so that one effect of another form does not take two. Every
effect that was nearly as good stays on the list of rivals.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from gap.effects.candidates import Suspect
from gap.estimation.agreement import inflation
from gap.estimation.fit_problem import Inquiry, State
from gap.estimation.information import SLACK
from gap.estimation.non_identical import controlled
from gap.estimation.null_distribution import carried, simulated_null
from gap.estimation.shape_fit import shaped
from gap.selection.inclusion import akin, apart, counts, excess, plea
from gap.selection.refine import (
    BENT,
    MOUNTINGS,
    NEAR,
    SHAPED,
    STANDS_FOR,
    Choice,
    flexed_by_second,
    gains_by_key,
    in_best_form,
    linear_gains,
    refine,
    with_free_shapes,
)
from gap.selection.swap import exchanged, spared
from plant.effects.catalogue import CATALOGUE

Array = npt.NDArray[np.float64]

ALARM = 28.0
"""Least gain (drop of the whitened sum of squares) of a first effect; see docs/use/gap.md."""
CHANCE = 0.002
BEYOND_CHANCE = 1.7
"""How far beyond the simulated null a first effect must reach: real noise has other forms too."""
PLAIN = 100.0
"""Gain from which a first effect needs no proof on slots it was not fitted to."""
CARRIED = 0.3
"""Least share of its gain that a first effect must carry over to such slots."""
BETTER = 4.0
"""How much less another effect must leave to take the place of one, in whitened squares."""
MOST = 3
_REFINED = 7
_ELSEWHERE = 4
_DELAYS_MS = (3.0, 8.0, 15.0, 25.0)
_CLOCKS_MS = (8.0, 20.0, 45.0, 80.0, 120.0, 170.0, 230.0, 300.0, 380.0, 480.0)


@dataclass
class Naming:
    """What the search found.

    Attributes:
        chosen: the explanation kept; no keys at all when nothing alarmed.
        rivals: other explanations with as many effects, best first.
        first_gain: gain of the best single effect, by key, linearised at the base.
        excess: whitened gap beyond noise at the base.
        left: the same after the explanation.
        alarm: gain that a first effect needed on these data.
        chance: share of simulated data sets without a gap whose best gain is as large.
        steps: (key, gain) of each effect in order of entry.
        tried: for each step beyond the first the best further effect and what spoke for it.
        last_gain: gain of each key on top of the explanation, linearised.
        uneven: the explanation with its valve delays free to differ at each stroke, if it has any.
    """

    chosen: Choice
    rivals: list[Choice]
    first_gain: dict[str, float]
    excess: float
    left: float
    alarm: float = ALARM
    chance: float = 1.0
    steps: list[tuple[str, float]] = field(default_factory=list)
    tried: list[dict[str, float | str]] = field(default_factory=list)
    last_gain: dict[str, float] = field(default_factory=dict)
    uneven: State | None = None

    @property
    def remaining(self) -> State:
        """The state whose residual speaks for or against the explanation."""
        return self.uneven or self.chosen.state


def name_effects(q: Inquiry) -> Naming:  # noqa: C901 - one step of the search a branch
    """Search for up to three effects that explain the gap of `q`."""
    state = q.base
    gains, amounts = linear_gains(q, state)
    fresh: Array | None = None
    if np.abs(state.shift).max(initial=0.0) > BENT:
        # Constants at their limits: the suspects are also asked at the plant as stated.
        fresh_gains, fresh = linear_gains(q, q.stated())
        fresh_gains = fresh_gains * max(naming_scale(q, gains, fresh_gains), 0.0)
        gains = np.maximum(gains, np.minimum(fresh_gains, excess(q, state)))
    for key, (gain, amount) in (_scan_clocks(q) | _scan_delays(q)).items():
        for j, suspect in enumerate(q.suspects):
            if suspect.key == key and gain > gains[j]:
                gains[j], amounts[j] = gain, amount
    null = simulated_null(q)
    alarm = max(ALARM, BEYOND_CHANCE * null.threshold(CHANCE))
    naming = Naming(
        Choice((), state), [], gains_by_key(q, gains), excess(q, state), excess(q, state), alarm,
        null.chance(float(gains.max(initial=0.0))),
    )  # fmt: skip
    keys: tuple[str, ...] = ()
    for step in range(MOST):
        best = gains_by_key(q, gains)
        top = sorted((k for k in best if k not in keys), key=lambda k: -best[k])
        bent = [key for key in bent_keys(q, state) if key not in keys]
        if not top or (best[top[0]] < alarm and not bent):
            break
        gain = best[top[0]]
        if step == 0 and not bent and gain / inflation(q, top[0]) < alarm:
            break
        small = step == 0 and gain < PLAIN and not bent
        if small and carried(q, top[0])[0] < CARRIED * gain:
            break
        tried = [
            refine(q, state, keys, key, gains, amounts, fresh if step == 0 else None)
            for key in dict.fromkeys([*_candidates(q, state, top, best), *bent])
        ]
        tried = with_free_shapes(q, state, tried, gains, amounts)
        relative = min((c.cost for c in tried if akin(state, c.state)), default=np.inf)
        fit = [choice for choice in tried if _counts(q, naming, state, choice, relative)]
        if step:
            key, after = (fit or tried)[0].keys[-1], (fit or tried)[0].state
            naming.tried.append(plea(q, naming.excess, alarm, state, key, after, bool(fit)))
        if not fit:
            break
        tried.remove(fit[0])
        tried.insert(0, fit[0])
        naming.steps.append((tried[0].keys[-1], state.cost - tried[0].cost))
        naming.chosen = tried[0]
        naming.rivals = [choice for choice in tried[1:] if not step or choice in fit]
        state = q.polish(shaped(q, q.polish(tried[0].state)))
        naming.chosen = Choice(tried[0].keys, state)
        keys = tried[0].keys
        gains, amounts = linear_gains(q, state)
        flexed = flexed_by_second(q, naming.chosen, gains, amounts, naming.excess)
        if flexed is not None:
            state = shaped(q, flexed.state)
            naming.chosen = Choice(keys, state)
            gains, amounts = linear_gains(q, state)
        one = _one_for_two(q, naming)
        if one is not None:
            naming.steps[-2:] = [(one.keys[-1], naming.steps[-2][1] + naming.steps[-1][1])]
            naming.chosen, naming.rivals = one, [c for c in naming.rivals if c.keys != one.keys]
        before = naming.chosen
        _set_right(q, naming)
        if one is not None or naming.chosen is not before:
            keys, state = naming.chosen.keys, naming.chosen.state
            gains, amounts = linear_gains(q, state)
    naming.rivals = _polished(q, naming)
    naming.left = excess(q, state)
    naming.last_gain = gains_by_key(q, gains)
    return naming


def _set_right(q: Inquiry, naming: Naming) -> None:
    """Leave out what the last effect made needless, and put better ones in the place of others."""
    if len(naming.chosen.keys) < 2:
        return
    less = spared(q, naming.chosen, naming.alarm)
    if less is not None:
        gone = next(k for k, (key, _) in enumerate(naming.steps) if key not in less.keys)
        naming.steps[gone : gone + 2] = [
            (naming.steps[gone + 1][0], naming.steps[gone][1] + naming.steps[gone + 1][1])
        ]
        naming.chosen, naming.rivals = less, []
    if len(naming.chosen.keys) < 2:
        return
    others = exchanged(q, naming.chosen)
    if others and others[0].cost < naming.chosen.cost - BETTER:
        naming.steps = [
            (key, gain) for key, (_, gain) in zip(others[0].keys, naming.steps, strict=True)
        ]
        others.append(naming.chosen)
        naming.chosen = others.pop(0)
    known = {choice.state.ids for choice in naming.rivals} | {naming.chosen.state.ids}
    naming.rivals += [choice for choice in others if choice.state.ids not in known]


def _polished(q: Inquiry, naming: Naming) -> list[Choice]:
    """Rivals, those near the explanation fitted to the end as it was: a descent that stopped early
    would look like a worse fit.
    """
    least = naming.chosen.cost
    near = least + NEAR * max(least - len(q.rows), float(np.sqrt(2.0 * len(q.rows))))
    made = [
        Choice(choice.keys, q.polish(choice.state)) if at < SHAPED and choice.cost < near
        else choice
        for at, choice in enumerate(sorted(naming.rivals, key=lambda choice: choice.cost))
    ]  # fmt: skip
    return sorted(made, key=lambda choice: choice.cost)


def _candidates(q: Inquiry, state: State, top: list[str], best: dict[str, float]) -> list[str]:
    """Keys worth a nonlinear fit: the best, and the best that show in other channels.

    What is left of a large effect whose form is not exact outweighs a second effect elsewhere.
    """
    made = [key for key in top[:_REFINED] if best[key] > 0.3 * best[top[0]]]
    elsewhere = [key for key in top if apart(q, state, key)] if state.suspects else []
    made += [
        key for key in elsewhere[:_ELSEWHERE]
        if key not in made and best[key] > 0.3 * best[elsewhere[0]]
    ]  # fmt: skip
    return made


def bent_keys(q: Inquiry, state: State, beyond: float = SLACK) -> list[str]:
    """Keys of effects in whose place a constant has left its tolerance, or gone `beyond` (sd).

    Next to strong data a signature must match the constant's to the last digit to show that it
    could take over, so these are always fitted.
    """
    known = {suspect.key for suspect in q.suspects}
    far = [
        (abs(shift), name)
        for name, shift in zip(q.names, state.shift.tolist(), strict=True)
        if abs(shift) > beyond and name in STANDS_FOR
    ]
    # Each mounting's offset is drawn about zero: what all share is a label's or the camera's.
    own = state.shift[len(q.names) - q.unnamed :][: q.mountings]
    common = abs(float(own.sum())) / np.sqrt(max(len(own), 1))
    if common > beyond:
        far.append((common, MOUNTINGS))
    return [k for _, name in sorted(far, reverse=True) for k in STANDS_FOR[name] if k in known][:4]


def _counts(q: Inquiry, naming: Naming, before: State, choice: Choice, relative: float) -> bool:
    """Whether an effect that was fitted takes away enough to count."""
    if not before.suspects:
        return before.cost - choice.cost >= naming.alarm
    key = choice.keys[-1]
    return counts(q, naming.excess, naming.alarm, before, key, choice.state, relative)


def _scan_clocks(q: Inquiry) -> dict[str, tuple[float, float]]:
    """Gain and amount of whole clock offsets, too large for a signature to point at."""
    found: dict[str, tuple[float, float]] = {}
    if excess(q, q.base) < 0.3 * len(q.rows):
        return found
    for suspect in q.suspects:
        if suspect.id not in ("force_clock", "pressure_clock", "camera_delay"):
            continue
        best = (0.0, 0.0)
        for start in (q.base.shift, np.zeros(len(q.names))):

            def gain(
                amount: float, at: Array = start, of: Suspect = suspect
            ) -> tuple[float, float]:
                return q.base.cost - q.cost_at(at, (of,), np.array([amount])), amount

            for size in _CLOCKS_MS:
                best = max(best, gain(size), gain(-size))
            step = 0.2 * abs(best[1])
            while best[0] > 0.0 and step > 1.0:
                best = max(best, gain(best[1] + step), gain(best[1] - step))
                step *= 0.6
        if best[0] > 0.0:
            found[suspect.key] = best
    return found


def _scan_delays(q: Inquiry) -> dict[str, tuple[float, float]]:
    """Gain and amount of valve delays in tests that a controller made.

    Its pulses may be shorter than the delay, and then do nothing at all: a signature of a
    millisecond does not point at twenty. Commands that are alike in all replicates are long ones.
    """
    found: dict[str, tuple[float, float]] = {}
    if not controlled(q.data) or excess(q, q.base) < 0.3 * len(q.rows):
        return found
    for suspect in q.suspects:
        if suspect.id != "valve_delay":
            continue
        tried = [
            (q.base.cost - q.cost_at(q.base.shift, (suspect,), np.array([size])), size)
            for size in _DELAYS_MS
        ]
        found[suspect.key] = max(tried)
    return {key: best for key, best in found.items() if best[0] > 0.0}


def naming_scale(q: Inquiry, gains: Array, fresh: Array) -> float:
    """Factor that brings gains at the stated plant to those at the recalibrated one."""
    return float(gains.max(initial=0.0) / max(fresh.max(initial=0.0), 1e-9))


def _one_for_two(q: Inquiry, naming: Naming) -> Choice | None:
    """The last effect alone where it does without the one before it, of its own family.

    An effect in a form of its own may be begun by a relative, and only then be seen itself.
    """
    keys = naming.chosen.keys
    if len(keys) < 2 or _family(keys[-1]) != _family(keys[-2]) or keys[-1] == keys[-2]:
        return None
    state = naming.chosen.state
    others = [(s, a) for s, a in zip(state.suspects, state.amounts, strict=True)
              if s.key not in keys[-2:]]  # fmt: skip
    below = q.base if not others else q.fit([s for s, _ in others], [float(a) for _, a in others])
    gains, amounts = linear_gains(q, below)
    alone = refine(q, below, keys[:-2], keys[-1], gains, amounts)
    alone = in_best_form(q, below, alone, gains, amounts)
    gains, amounts = linear_gains(q, alone.state)
    flexed = flexed_by_second(q, alone, gains, amounts, naming.excess)
    if flexed is not None:
        alone = Choice(alone.keys, q.polish(shaped(q, flexed.state)))
    needed = counts(q, naming.excess, naming.alarm, alone.state, keys[-2], state)
    return None if needed else alone


def _family(key: str) -> str:
    name = key.partition(":")[0]
    return CATALOGUE[name].family if name in CATALOGUE else name


def why_not(q: Inquiry, naming: Naming, named: set[str]) -> dict[str, str]:
    """For each entry not in the set: what share of the gap it closes alone."""
    made: dict[str, str] = {}
    rivals = {c.state.ids[-1]: c for c in reversed(naming.rivals)}
    for suspect in q.suspects:
        name = suspect.id
        if suspect.defect or name in named or name in made:
            continue
        gain = max(
            (g for k, g in naming.first_gain.items() if k.split(":")[0] == name), default=0.0
        )
        if not any(block in q.grid.points for block in suspect.blocks):
            made[name] = "no channel in these data would show it"
        elif name in rivals and naming.chosen.keys:
            worse = rivals[name].cost - naming.chosen.cost
            made[name] = f"fits worse than the set by {worse:.0f} in chi-square"
        elif naming.excess > 1.0:
            made[name] = f"closes {100 * min(gain / naming.excess, 1.0):.0f} % of the gap"
        else:
            made[name] = f"chi-square falls by {gain:.0f} only"
    return made
