"""What the switching tests share: each valve by itself, at each pressure of its upstream side."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rigs.rigfile.config import RigConfig
from rigs.rigfile.toml_reader import Table
from rigs.steps.custom_step import Steps
from rigs.steps.schedule import arrange
from rigs.steps.steps import EndTrial, State, Trial
from rigs.steps.valve import ValvePoint, has_supply_axis

VALVES = ("inlet", "outlet")


def each_valve(test: Any, protocol: str, point: Callable[..., ValvePoint]) -> Steps:
    """One trial with one point for each valve, pressure and replicate."""
    trial = 0
    for valve in test.valves:
        for place, pressure in arrange(
            test.pressures_kpa, test.order, test.repeats, test.mountings, test.seed
        ):
            trial += 1
            slot = f"{valve} {pressure:g}"
            yield State(f"{valve} at {pressure:g} kPa, replicate {place.replicate}")
            yield Trial(
                trial, slot, place.replicate, trial, place.mounting, protocol,
                (("held_pressure_kpa", pressure),),
            )  # fmt: skip
            yield point(trial, slot, place.replicate, trial, place.mounting, valve, pressure, test)
            yield EndTrial(trial)
    yield State("done")


def need_supply_axis(t: Table, valves: tuple[str, ...], config: RigConfig) -> None:
    """The inlet's test needs a supply whose pressure can be set.

    Raises:
        ConfigError: the rig has none.
    """
    if "inlet" in valves and not has_supply_axis(config):
        raise t.fail(
            "valves",
            f"the inlet's pressure is the supply's, and {config.source} has no [manual.supply]",
            'add that table to the rig, or set valves = ["outlet"]',
        )
