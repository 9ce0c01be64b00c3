"""The tests that an investigation may run, each for what it shows, with settings for the rig."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from cli.investigate.config import INVESTIGATION
from gap.design.config import DESIGN
from rigs.rigfile.config import RigConfig


@dataclass(frozen=True)
class Test:
    """A protocol with settings, and in words what it shows.

    `also` names what in an advised experiment of another protocol this one stands for.
    """

    protocol: str
    what: str
    settings: Mapping[str, Any]
    also: tuple[str, ...] = field(default=())

    __test__ = False  # not a test of pytest's

    @property
    def kind(self) -> tuple[str, bool]:
        """The protocol, and whether it holds each setting for long."""
        return self.protocol, _held_long(self.settings)

    def answers(self, protocol: str, settings: Mapping[str, Any]) -> bool:
        """Whether an advised experiment is this one."""
        held = _held_long(settings)
        return (protocol, held) == self.kind or (protocol in self.also and not held)


def _held_long(settings: Mapping[str, Any]) -> bool:
    """Whether each setting is held for long, so that what is slow shows: creep, a leak."""
    return "measure" in settings or settings.get("step_s", 0.0) >= DESIGN.shut_s


@dataclass(frozen=True)
class _Settings:
    """Where a battery measures: shares of the range of pressures, lengths, loads and speeds."""

    pressures: tuple[float, ...]
    lengths: tuple[float, ...]
    moved: tuple[float, ...]
    masses: tuple[float, ...]
    speeds: tuple[float, ...]
    stepped: tuple[float, ...]
    warmer_k: float


_FIRST = _Settings(
    (0.1, 0.3, 0.5, 0.75, 1.0), (0.12, 0.45, 0.75), (0.15, 0.35, 0.55, 0.75), (0.4, 1.0),
    (0.2, 1.0), (0.45,), 15.0,
)  # fmt: skip
_AGAIN = _Settings(
    (0.15, 0.4, 0.6, 0.85, 0.95), (0.2, 0.6, 0.8), (0.2, 0.4, 0.6, 0.8), (0.6, 0.8), (0.5, 1.0),
    (0.1, 0.8), 10.0,
)  # fmt: skip


def battery(config: RigConfig, again: bool = False) -> list[Test]:
    """All tests that this rig can run, in the order in which they are run unless advised.

    Muscle and sensors at rest; valves and gas; a length that moves; loads; a hold; warmth; and a
    chamber that is shut, as a loop that holds its pressure hides a leak.
    `again` gives the same tests at other pressures, lengths, loads and speeds; that of the valves
    twice, with a short and with a long muscle.
    """
    at, repeats = _AGAIN if again else _FIRST, INVESTIGATION.repeats
    low, high = config.limits.length_min_mm, config.limits.length_max_mm
    top = 0.9 * config.limits.pressure_kpa
    pressures = [round(share * top, -1) for share in at.pressures]
    lengths = [round(low + share * (high - low), 1) for share in at.lengths]
    more = [round(low + share * (high - low), 1) for share in at.moved]
    heaviest = 0.15 * config.limits.force_n / config.conditions.gravity_m_s2
    masses = [round(share * heaviest, 2) for share in at.masses]
    manual = config.stage.kind == "manual"
    regulated = config.virtual is not None and config.virtual.source == "regulator"
    moved = [pressures[1], pressures[3]]
    sweeps = {"from_mm": more[0], "to_mm": more[2],
              "speeds_mm_s": [share * config.stage.speed_mm_s for share in at.speeds]}  # fmt: skip
    made = [
        Test(
            "isometric", "pressures at three lengths",
            {"lengths_mm": lengths, "pressures_kpa": pressures, "repeats": repeats},
            also=("hysteresis",),
        )
    ]  # fmt: skip
    with_valves = not regulated and config.valve.static_scheme != "reg"
    if with_valves:
        steps = [pressures[2], pressures[4], pressures[1], pressures[3], pressures[0]]
        # Short and long, as the muscle's own volume tells gas that flows from gas that is stored.
        made += [
            Test(
                "step", "the valves fully open, and in bursts",
                {"schemes": ["two", "burst"], "pressures_kpa": steps, "step_s": 1.5,
                 "supply_kpa": config.limits.pressure_kpa,
                 "length_mm": round(low + share * (high - low), 1), "repeats": repeats},
            )
            for share in at.stepped
        ]  # fmt: skip
    made += [
        Test(
            "isobaric", "a length that moves",
            {"pressures_kpa": moved, "lengths_mm": more, "repeats": repeats}
            | ({} if manual else {"sweeps": sweeps}),
        ),
        Test(
            "isotonic", "pressures under two loads",
            {"masses_kg": masses, "pressures_kpa": pressures[1:], "repeats": repeats},
        ),
        Test(
            "isometric", "a minute at each of two pressures",
            {"lengths_mm": lengths[1:2], "pressures_kpa": moved, "repeats": repeats,
             "measure": {"seconds": INVESTIGATION.hold_s}},
        ),
    ]  # fmt: skip
    if with_valves:
        made.append(Test(
            "step", "a chamber that is shut, at two pressures",
            {"schemes": ["two"], "pressures_kpa": moved, "step_s": DESIGN.shut_s,
             "supply_kpa": config.limits.pressure_kpa, "length_mm": lengths[1],
             "repeats": repeats},
        ))  # fmt: skip
    if "thermometer" in config.instruments.text:
        room = round(config.conditions.temperature_c, 0)
        made.append(Test(
            "isothermal", "the same pressures cold and warm",
            {"temperatures_c": [room, room + at.warmer_k], "lengths_mm": lengths[1:2],
             "pressures_kpa": pressures[1:], "repeats": repeats,
             "soak": {"soak_s": 30.0, "timeout_s": 3600.0}},
        ))  # fmt: skip
    return made


def protocol_text(test: Test, config: RigConfig) -> str:
    """A protocol file of a test for this rig."""
    name = test.protocol
    values = dict(test.settings)
    table: dict[str, Any] = {"protocol": name, "name": f"investigate-{name}", **values}
    if name != "step":
        top = 0.6 * config.limits.pressure_kpa
        force = {"drift_mm": 0.03} if name == "isotonic" else {"drift_n": 0.05}
        table |= {"order": "abba", "mountings": ["m1"]}
        if name != "isotonic":
            table["slack_length_mm"] = round(config.limits.length_min_mm + 3.0, 1)
        table["precondition"] = {"cycles": 2, "pressure_kpa": round(top), "dwell_s": 0.5}
        table["settle"] = {"window_s": 0.5, "pressure_kpa": 1.5, "drift_kpa": 0.5, **force,
                           "timeout_s": 6.0}  # fmt: skip
        usual = {"seconds": 0.5, "frames": 1, "zero_s": 0.4}
        table["measure"] = usual | dict(values.get("measure", {}))
    plain = [f"{k} = {json.dumps(v)}" for k, v in table.items() if not isinstance(v, dict)]
    for key, value in table.items():
        if isinstance(value, dict):
            plain += ["", f"[{key}]", *(f"{k} = {json.dumps(v)}" for k, v in value.items())]
    return "\n".join(plain) + "\n"
