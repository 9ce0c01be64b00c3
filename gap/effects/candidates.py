"""The suspects: every catalogue entry in several shapes, and the defects of a recording.

The catalogue fixes one headline parameter for an effect, not its exact form, and a real bench
never has the form one wrote down. So each effect is tried in a few shapes (where its knee is, how
soon it saturates, whether it scales with pressure), and an effect may use two of them at once.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from plant.effects.catalogue import CATALOGUE

Shape = Mapping[str, float]


@dataclass(frozen=True)
class Suspect:
    """One effect in one shape.

    Attributes:
        id: catalogue id, or the name of a defect of the recording.
        step: amount of the headline parameter at which its signature is taken.
        sign: +1 where only positive amounts make sense, 0 where both do.
        blocks: which blocks of features it can touch.
        option: the word that goes with the headline parameter (side, edge), if any.
    """

    id: str
    step: float
    sign: int
    blocks: tuple[str, ...]
    shape: Shape = field(default_factory=dict)
    option: str = ""

    @property
    def free(self) -> Mapping[str, tuple[float, float]]:
        """Numbers of its shape that a fit may move, with the range of each."""
        table = _FREE.get(self.id, {})
        return {key: table[key] for key in self.shape if key in table and "even" not in self.shape}

    @property
    def defect(self) -> bool:
        """Whether it is a defect of the recording, not an effect of the catalogue."""
        return self.id not in CATALOGUE

    @property
    def bounds(self) -> tuple[float, float]:
        """Least and greatest amount: the catalogue's range where the amount is the headline."""
        least = 0.0 if self.sign else -np.inf
        if self.id == "transport_delay":
            return least, 1.0
        if self.defect or self.id == "supply_droop":
            return least, np.inf
        headline = CATALOGUE[self.id].parameters[0]
        # Ratios and exponents are amounts beyond one; the critical ratio beyond some half.
        neutral = {"flow_area": 1.0, "polytropic": 1.0, "critical_ratio": 0.45}.get(self.id, 0.0)
        return max(headline.low - neutral, least), headline.high - neutral

    @property
    def family(self) -> str:
        """Family of the catalogue, or the defect itself."""
        return CATALOGUE[self.id].family if self.id in CATALOGUE else self.id

    @property
    def key(self) -> str:
        """Id with side or edge: suspects of one key are shapes of one thing."""
        return f"{self.id}:{self.option}" if self.option else self.id


_FREE: dict[str, dict[str, tuple[float, float]]] = {
    "liner_threshold": {"width_kpa": (3.0, 150.0)},
    "bladder_elasticity": {"rest": (0.45, 0.95)},
    "contraction_limit": {"decay_mm": (0.3, 4.0), "knee_mm": (1.5, 10.0)},
    "fibre_stretch": {"power": (0.3, 2.0)},
    "braid_friction": {"kpa": (3.0, 300.0), "mm": (0.03, 5.0)},
    "viscosity": {"knee_mm_s": (3.0, 150.0), "power": (0.3, 1.0)},
    "creep": {"tau_s": (0.5, 400.0)},
    "dead_volume": {"line_s": (0.001, 0.3)},
    # Air in a tube 10 mm wide takes the wall's temperature within seconds (r^2 / 5.8 of its thermal
    # diffusivity, 1 s at 5 bar); what falls for longer leaks.
    "polytropic": {"heat_s": (0.05, 6.0)},
    "supply_droop": {"tau_s": (0.005, 6.0), "back_s": (0.005, 6.0)},
    "link_friction": {
        "knee_mm_s": (0.05, 30.0),
        "travel_mm": (0.02, 3.0),
        "fall_mm_s": (1.0, 30.0),
        "step_mm": (0.2, 10.0),
    },
    "pressure_lag": {"before": (0.02, 0.5)},
    "camera_distortion": {"power": (1.5, 6.0)},
    "wear": {"power": (0.3, 3.0)},
}
"""Numbers of shapes that are fitted, with what a bench could have."""
_MUSCLE = ("force", "load")
_GAS = ("pressure",)
_ALL = ("pressure", "force", "load", "camera")


# Pressure and length over which all fibres come to slip.
_TRAVELS = ((40.0, 0.4), (10.0, 0.1), (120.0, 1.2), (40.0, 0.1), (10.0, 0.5), (60.0, 2.5))


def _shapes(
    name: str, step: float, sign: int, blocks: tuple[str, ...], *shapes: Shape
) -> list[Suspect]:
    return [Suspect(name, step, sign, blocks, shape) for shape in shapes or ({},)]


def _make() -> tuple[Suspect, ...]:
    made: list[Suspect] = []
    made += _shapes(
        "liner_threshold", 10.0, 1, _MUSCLE,
        {"width_kpa": 6.0}, {"width_kpa": 25.0}, {"width_kpa": 60.0}, {"saturating": 1.0},
    )  # fmt: skip
    made += _shapes(
        "bladder_elasticity", 0.1, 1, _MUSCLE,
        {"rest": 0.57}, {"rest": 0.68}, {"rest": 0.82}, {"rest": 0.68, "cubic": 1.0},
    )  # fmt: skip
    made += _shapes(
        "contraction_limit", 1.0, 1, _MUSCLE,
        {"decay_mm": 0.7}, {"decay_mm": 1.6}, {"decay_mm": 3.5},
        {"decay_mm": 0.7, "pressure": 1.0}, {"decay_mm": 1.6, "pressure": 1.0},
        {"decay_mm": 3.5, "pressure": 1.0}, {"knee_mm": 5.0}, {"knee_mm": 5.0, "pressure": 1.0},
    )  # fmt: skip
    made += _shapes(
        "end_cap", 0.2, 1, _MUSCLE, {"grow": 0.0}, {"grow": 1.0}, {"grow": 2.0}, {"grow": -1.0}
    )
    made += _shapes(
        "fibre_stretch", 0.1, 1, _MUSCLE, {"power": 1.0}, {"power": 0.5}, {"tension": 1.0}
    )
    made += _shapes(
        "braid_friction", 0.5, 1, _MUSCLE,
        *({"kpa": k, "mm": m, "pressure": p} for k, m in _TRAVELS for p in (1.0, 0.0)),
    )  # fmt: skip
    made += _shapes(
        "viscosity", 0.02, 1, _MUSCLE,
        {}, {"knee_mm_s": 10.0}, {"knee_mm_s": 40.0}, {"power": 0.5}, {"pressure": 1.0},
        {"pressure": 1.0, "knee_mm_s": 20.0},
    )  # fmt: skip
    made += _shapes(
        "creep", 0.5, 1, _MUSCLE,
        *({"tau_s": t} for t in (1.5, 6.0, 25.0, 100.0)),
        *({"tau_s": t, "settled": 1.0} for t in (3.0, 12.0, 50.0)),
    )  # fmt: skip
    made += _shapes(
        "temperature_stiffening", 0.1, 0, _MUSCLE,
        {}, {"pressure": 1.0}, {"pressure": -0.5}, {"additive": 1.0},
    )  # fmt: skip
    made += _shapes(
        "dead_volume", 0.1, 1, _GAS, {}, {"elastic": 1.0}, {"line_s": 0.01}, {"line_s": 0.06},
    )  # fmt: skip
    made += _shapes(
        "polytropic", 0.02, 1, _GAS, {}, {"heat_s": 0.2}, {"heat_s": 1.0}, {"heat_s": 5.0}
    )
    made += _shapes("leak", 1e-12, 1, _GAS, {}, {"laminar": 1.0})
    made += [
        Suspect("flow_area", 0.03, 0, _GAS, shape, side)
        for side in ("inlet", "outlet")
        for shape in ({}, {"drop": 1.0})  # a seat that lifts, or a filter that throttles, with it
    ]
    made += _shapes("critical_ratio", 0.03, 0, _GAS, {}, {"inlet": 1.0}, {"outlet": 1.0})
    made += _shapes(
        "supply_droop",
        5.0,
        1,
        _GAS,
        {},
        {"tau_s": 0.03},
        {"tau_s": 0.15},
        {"tau_s": 0.6},
        {"tau_s": 2.5},
        {"tau_s": 0.03, "back_s": 0.3},  # a regulator that gives way at once and recovers slowly
    )
    edges = ("inlet_on", "inlet_off", "outlet_on", "outlet_off")
    made += [Suspect("valve_delay", 0.3, 0, _GAS, {}, edge) for edge in edges]
    made += [Suspect("valve_delay_pressure", 0.001, 0, _GAS, {}, edge) for edge in edges]
    made += _shapes("transport_delay", 1.0, 1, _GAS)
    made += _shapes(
        "link_friction", 0.5, 1, ("load",),
        {"knee_mm_s": 0.3}, {"knee_mm_s": 2.0}, {"knee_mm_s": 10.0}, {"travel_mm": 0.1},
        {"travel_mm": 0.5}, {"knee_mm_s": 0.3, "fall_mm_s": 4.0},
        {"knee_mm_s": 1.0, "step_mm": 1.5},
    )  # fmt: skip
    made += _shapes("payload", 0.02, 0, ("load",), {}, {"lifted_mm": 20.0})
    made += _shapes("pressure_zero", 1.0, 0, ("pressure", *_MUSCLE))
    made += _shapes("pressure_gain", 0.5, 0, ("pressure", *_MUSCLE))
    made += _shapes("pressure_lag", 2.0, 1, ("pressure", *_MUSCLE), {}, {"before": 0.3})
    made += _shapes("force_zero", 0.2, 0, _MUSCLE)
    made += _shapes("force_gain", 0.5, 0, _MUSCLE)
    made += _shapes("length_label", 0.1, 0, _ALL)
    made += _shapes("camera_scale", 0.2, 0, _ALL, {}, {"middle": 1.0})
    made += _shapes(
        "camera_distortion",
        0.1,
        0,
        _ALL,
        {"power": 3.0},
        {"power": 2.0, "even": 1.0},
        {"power": 3.0, "edge": 1.0},
    )
    made += _shapes("camera_delay", 4.0, 0, ("pressure", *_MUSCLE))
    made += _shapes("wear", 1.0, 0, _MUSCLE, {}, {"power": 0.5}, {"additive": 1.0}, {"power": 2.0})
    made += _shapes("force_clock", 4.0, 0, _MUSCLE)
    made += _shapes("pressure_clock", 2.0, 0, ("pressure", *_MUSCLE))
    made += _shapes("force_smoothed", 1.0, 1, ("force",))
    made += _shapes("pressure_smoothed", 1.0, 1, ("pressure",))
    return tuple(made)


SUSPECTS = _make()
"""All suspects: shapes of one id follow each other, defects of the recording come last."""

DEFECTS: dict[str, str] = {
    "force_clock": "force_n is out of time with the other channels",
    "pressure_clock": "pressure_kpa is out of time with the other channels",
    "force_smoothed": "force_n is smoothed both ways in time, the other channels are not",
    "pressure_smoothed": "pressure_kpa is smoothed both ways in time, the other channels are not",
}
"""What each defect means to a person."""
