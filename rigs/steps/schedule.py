"""In which order a test goes through its settings and points, and how long it will take."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from rigs.steps.custom_step import CustomStep, Step, Steps
from rigs.steps.steps import Dwell, Measure, SetLength, SetPressure, Settle, Tare, Vent, Zero

ORDERS = ("up-down", "random", "abba")
"""Settings as listed and points up, then down; both shuffled by the seed; settings as listed in
odd replicates and backwards in even ones, so that a drift cancels, points up, then down."""
MOVE_MM = 8.0
VENT_S = 1.0
TARE_S = 2.0
SETTLE_S = 0.8
PICTURE_S = 0.02

T = TypeVar("T")


@dataclass(frozen=True)
class Place:
    """Where a trial stands in a test."""

    mounting: str
    replicate: int
    first_of_mounting: bool


def arrange(
    settings: Sequence[T], order: str, repeats: int, mountings: Sequence[str], seed: int
) -> Iterator[tuple[Place, T]]:
    """Every trial of a test: each setting ``repeats`` times in each mounting.

    Replicates are counted on through the mountings: the third replicate of a setting that is
    repeated twice is the first one after the muscle was mounted anew.
    """
    rng = np.random.default_rng([seed, 1])
    for m, mounting in enumerate(mountings):
        for k in range(repeats):
            replicate = m * repeats + k + 1
            trials = list(settings)
            if order == "random":
                trials = [trials[i] for i in rng.permutation(len(trials))]
            elif order == "abba" and replicate % 2 == 0:
                trials.reverse()
            for at, setting in enumerate(trials):
                yield Place(mounting, replicate, k == 0 and at == 0), setting


def path(values: Sequence[float], order: str, rng: np.random.Generator) -> list[tuple[str, float]]:
    """The points of a trial: (direction, value); up and down, or shuffled."""
    if order == "random":
        return [("single", float(v)) for v in rng.permutation(list(values))]
    up = sorted(values)
    return [("up", v) for v in up] + [("down", v) for v in reversed(up)]


def cost_s(step: Step, speed_mm_s: float = 10.0) -> float:
    """About how long a step takes on the bench, in s."""
    match step:
        case Dwell(seconds):
            return seconds
        case SetLength():
            return MOVE_MM / speed_mm_s if speed_mm_s else 10.0
        case Tare():
            return TARE_S
        case Vent():
            return VENT_S
        case Zero():
            return step.seconds
        case SetPressure():
            return 0.02
        case Settle():
            return step.criterion.window_s + SETTLE_S
        case Measure():
            return step.seconds + step.frames * PICTURE_S
        case CustomStep():
            return step.seconds
    return 0.0


def outline(steps: Steps, speed_mm_s: float = 10.0) -> tuple[int, float]:
    """A method walked through without a bench: (points, seconds)."""
    points, seconds = 0, 0.0
    answer = None
    try:
        while True:
            step = steps.send(answer)
            seconds += cost_s(step, speed_mm_s)
            points += isinstance(step, Measure) or (
                step.points if isinstance(step, CustomStep) else 0
            )
            answer = (True, SETTLE_S) if isinstance(step, Settle) else None
    except StopIteration:
        return points, seconds
