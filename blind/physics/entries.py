"""What can be hidden: every catalogue effect and ten that no catalogue lists, with their draws."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from blind.physics import numbers as n
from blind.physics.forms import SEEN, HeldOutError, held_out_of

Rng = np.random.Generator
Shape = Callable[[Rng, int, "np.ndarray"], tuple[float, float, float]]
EDGES = ("inlet_on", "inlet_off", "outlet_on", "outlet_off")
SIDES = ("inlet", "outlet")


@dataclass(frozen=True)
class Entry:
    """One effect: its place, its headline parameter, and how far it may go.

    `usual` is a plainly visible value; `limit` the largest a bench would meet. A flow ratio and
    a critical ratio are stored as their distance from `neutral`.
    """

    id: str
    family: str
    stage: str
    parameter: str | None
    usual: float
    limit: float
    needs: str = ""
    variants: tuple[str, ...] = ()
    either_sign: bool = True
    neutral: float = 0.0
    shape: Shape | None = None

    @property
    def row(self) -> int:
        """Its row of the effect matrix."""
        return ROW[self.id]

    @property
    def variant_key(self) -> str | None:
        """Name of the parameter that says which edge or side."""
        return None if not self.variants else ("side" if len(self.variants) == 2 else "edge")


ROW = {name: i for i, name in enumerate((*n.EFFECT_IDS, *n.OUTSIDE_IDS))}


def _bladder(rng: Rng, form: int, c: np.ndarray) -> tuple[float, float, float]:
    rest = float(rng.uniform(61.0, 69.0))
    if form >= 3:  # Gent's limit of the first invariant, beyond all lengths of these muscles
        return rest, float(rng.uniform(0.9, 2.5)), 0.0
    return rest, 0.01 if form == 1 else float(rng.uniform(8.0, 15.0)), 0.0


def _limit(rng: Rng, form: int, c: np.ndarray) -> tuple[float, float, float]:
    return float(rng.uniform(1.5, 3.5)) if form else 4.0, 0.0, 0.0


def _friction(rng: Rng, form: int, c: np.ndarray) -> tuple[float, float, float]:
    return float(rng.uniform(0.3, 0.9)), float(rng.uniform(8.0, 25.0)), 0.0


def _viscosity(rng: Rng, form: int, c: np.ndarray) -> tuple[float, float, float]:
    low, high = {1: (8.0, 20.0), 3: (5.0, 16.0), 4: (0.45, 2.6)}.get(form, (0.55, 0.8))
    return float(rng.uniform(low, high)), 0.0, 0.0


def _creep(rng: Rng, form: int, c: np.ndarray) -> tuple[float, float, float]:
    low, high = ((10.0, 30.0), (10.0, 30.0), (1.0, 5.0), (0.18, 0.42), (4.0, 18.0))[form]
    return float(rng.uniform(low, high)), 0.0, 0.0


def _volume(rng: Rng, form: int, c: np.ndarray) -> tuple[float, float, float]:
    return float(rng.uniform(0.002, 0.008)), 0.0, 0.0


def _gas(rng: Rng, form: int, c: np.ndarray) -> tuple[float, float, float]:
    return float(rng.uniform(0.5, 3.0)), 0.0, 0.0


def _droop(rng: Rng, form: int, c: np.ndarray) -> tuple[float, float, float]:
    tau = float(rng.uniform(0.05, 0.4))
    # For a fall of 40 kPa at a full flow of 960 mg/s; scaled to the headline on the design.
    filling = 960.0 * tau * (1.0 - np.exp(-0.06 / tau))
    gain = {2: 40.0 / 960.0**0.8, 4: 40.0 / 960.0**2, 5: 40.0 / 8.87, 6: 40.0 / 650.0}.get(
        form, 40.0 / filling
    )
    return gain, tau, 0.0


def _slide(rng: Rng, form: int, c: np.ndarray) -> tuple[float, float, float]:
    return float(rng.uniform(0.05, 0.2)), 0.0, 0.0


def _place(rng: Rng, form: int, c: np.ndarray) -> tuple[float, float, float]:
    low, high = c[n.L_MIN], c[n.L_MAX]
    length = float(rng.uniform(0.6 * low + 0.4 * high, 0.3 * low + 0.7 * high))
    return length, float(rng.uniform(200.0, 450.0)), 0.0


def _surge(rng: Rng, form: int, c: np.ndarray) -> tuple[float, float, float]:
    return float(rng.uniform(0.25, 0.6)), 0.0, 0.0


def _backlash(rng: Rng, form: int, c: np.ndarray) -> tuple[float, float, float]:
    return float(rng.uniform(60.0, 160.0)), 0.0, 0.0


def _weep(rng: Rng, form: int, c: np.ndarray) -> tuple[float, float, float]:
    return float(rng.uniform(250.0, 400.0)), 0.0, 0.0


def _ripple(rng: Rng, form: int, c: np.ndarray) -> tuple[float, float, float]:
    return float(rng.uniform(3.0, 9.0)), float(rng.uniform(0.0, 6.28)), 0.0


def _gradient(rng: Rng, form: int, c: np.ndarray) -> tuple[float, float, float]:
    return float(rng.uniform(10.0, 40.0)), 0.0, 0.0


def _pixels(rng: Rng, form: int, c: np.ndarray) -> tuple[float, float, float]:
    return float(rng.uniform(1.5, 3.5)), float(rng.uniform(0.0, 6.28)), 0.0


CATALOGUE: tuple[Entry, ...] = (
    Entry("liner_threshold", "dead_space", "muscle", "threshold_kpa", 40.0, 180.0, "", (), False),
    Entry("bladder_elasticity", "elasticity", "muscle", "stiffness_n_mm", 0.3, 3.0, "", (),
          False, shape=_bladder),
    Entry("contraction_limit", "elasticity", "muscle", "force_n", 5.0, 60.0, "short", (), False,
          shape=_limit),
    Entry("end_cap", "geometry", "muscle", "shortening_mm", 1.0, 6.0, "", (), False),
    Entry("fibre_stretch", "geometry", "muscle", "stretch_percent", 1.0, 6.0, "", (), False),
    Entry("braid_friction", "friction", "muscle", "friction_n", 2.0, 25.0, "cycle", (), False,
          shape=_friction),
    Entry("viscosity", "rate", "muscle", "damping_n_s_mm", 0.1, 2.5, "stage", (), False,
          shape=_viscosity),
    Entry("creep", "rate", "muscle", "relaxation_percent", 4.0, 25.0, "hold", (), False,
          shape=_creep),
    Entry("temperature_stiffening", "temperature", "muscle", "percent_per_k", 0.3, 3.0, "warm"),
    Entry("dead_volume", "gas", "chamber", "volume_ml", 1.0, 12.0, "valve", (), False,
          shape=_volume),
    Entry("polytropic", "gas", "chamber", "exponent", 0.2, 0.4, "valve", (), False, neutral=1.0,
          shape=_gas),
    Entry("leak", "flow", "valve", "conductance_m3_s_pa", 2e-12, 4e-11, "decay", (), False),
    Entry("flow_area", "flow", "valve", "ratio", 0.3, 0.7, "valve", SIDES, neutral=1.0),
    Entry("critical_ratio", "flow", "valve", "critical_ratio", 0.2, 0.4, "valve", neutral=0.5),
    Entry("supply_droop", "flow", "valve", "droop_kpa", 40.0, 200.0, "valve", (), False,
          shape=_droop),
    Entry("valve_delay", "valve_timing", "valve", "delay_ms", 3.0, 25.0, "valve", EDGES),
    Entry("valve_delay_pressure", "valve_timing", "valve", "slope_ms_per_kpa", 0.01, 0.06,
          "valve", EDGES),
    Entry("transport_delay", "valve_timing", "valve", None, 1.0, 1.0, "pulses", (), False),
    Entry("link_friction", "load", "load", "friction_n", 2.0, 20.0, "load", (), False,
          shape=_slide),
    Entry("payload", "load", "load", "mass_kg", 0.2, 1.5, "load"),
    Entry("pressure_zero", "pressure_sensor", "sensor", "offset_kpa", 5.0, 60.0),
    Entry("pressure_gain", "pressure_sensor", "sensor", "percent", 4.0, 25.0),
    Entry("pressure_lag", "pressure_sensor", "sensor", "time_ms", 5.0, 60.0, "valve", (), False),
    Entry("force_zero", "force_sensor", "sensor", "offset_n", 2.0, 25.0),
    Entry("force_gain", "force_sensor", "sensor", "percent", 4.0, 25.0),
    Entry("length_label", "length_sensor", "sensor", "offset_mm", 0.7, 4.0, "held"),
    Entry("camera_scale", "length_sensor", "sensor", "percent", 1.5, 8.0, "camera"),
    Entry("camera_distortion", "length_sensor", "sensor", "distortion_mm", 0.5, 4.0, "camera"),
    Entry("camera_delay", "length_sensor", "sensor", "delay_ms", 20.0, 150.0, "stage"),
    Entry("wear", "drift", "any", "percent_per_100_trials", 5.0, 40.0),
)  # fmt: skip
OUTSIDE: tuple[Entry, ...] = (
    Entry("pressure_ripple", "outside", "sensor", "amplitude_kpa", 5.0, 40.0, "", shape=_ripple),
    Entry("local_buckle", "outside", "muscle", "force_n", 5.0, 40.0, "", (), False, shape=_place),
    Entry("slide_stick", "outside", "load", "force_n", 4.0, 40.0, "load", (), False,
          shape=_place),
    Entry("supply_surge", "outside", "valve", "surge_kpa", 60.0, 150.0, "valve", shape=_surge),
    Entry("mains_pickup", "outside", "sensor", "amplitude_n", 2.0, 20.0, ""),
    Entry("cell_gradient", "outside", "sensor", "drift_n", 2.0, 20.0, "", shape=_gradient),
    Entry("mount_backlash", "outside", "muscle", "play_mm", 1.0, 6.0, "", (), False,
          shape=_backlash),
    Entry("weeping_valve", "outside", "valve", "conductance_mg_s_kpa", 0.02, 2.0, "decay", (),
          False, shape=_weep),
    Entry("pixel_locking", "outside", "sensor", "amplitude_mm", 0.2, 1.5, "camera",
          shape=_pixels),
    Entry("coil_heating", "outside", "valve", "delay_ms", 3.0, 20.0, "pulses", (), False),
)  # fmt: skip
ENTRIES = {entry.id: entry for entry in (*CATALOGUE, *OUTSIDE)}


@dataclass(frozen=True)
class Hidden:
    """One effect as drawn: entry, form (0 plainest, 1 and 2 the alternatives), strength, shape.

    `strength` is the headline parameter's distance from neutral. Forms from 3 on are held out: an
    effect in one of them is made for the campaign alone, which says so by `held_out`.

    Raises:
        HeldOutError: A form is held out, or does not exist, and the caller is not the campaign.
    """

    id: str
    form: int
    strength: float
    shape: tuple[float, float, float] = (0.0, 0.0, 0.0)
    variant: str | None = None
    held_out: bool = False

    def __post_init__(self) -> None:
        allowed = (*SEEN, *held_out_of(self.id)) if self.held_out else SEEN
        if self.form not in allowed:
            raise HeldOutError(self.id, self.form)

    @property
    def entry(self) -> Entry:
        """Its entry."""
        return ENTRIES[self.id]

    @property
    def parameters(self) -> dict[str, float | str]:
        """Headline parameter by EFFECTS's name, with side or edge."""
        out: dict[str, float | str] = {}
        if self.entry.parameter:
            out[self.entry.parameter] = self.strength + self.entry.neutral
        if self.variant and self.entry.variant_key:
            out[self.entry.variant_key] = self.variant
        return out

    def as_dict(self) -> dict[str, object]:
        """The effect as plain JSON values."""
        plain: dict[str, object] = {
            "id": self.id,
            "family": self.entry.family,
            "stage": self.entry.stage,
            "form": self.form,
            "parameters": self.parameters,
        }
        # Sets of the other streams keep the answers that they were sealed with.
        return {**plain, "held_out": True} if self.held_out else plain

    def put(self, e: np.ndarray) -> None:
        """Switch it on in an effect matrix."""
        row = ROW[self.id]
        value = self.strength + (0.0 if self.id == "polytropic" else self.entry.neutral)
        e[row] = (self.form, value, *self.shape)
        if self.variant:
            e[row, 2] = self.entry.variants.index(self.variant)


def scaled(hidden: Hidden, factor: float) -> Hidden:
    """The same effect `factor` times as strong."""
    shape = hidden.shape
    if hidden.id == "supply_droop":  # its flow gain carries it
        shape = (shape[0] * factor, *shape[1:])
    return replace(hidden, strength=hidden.strength * factor, shape=shape)


def draw(
    entry: Entry, rng: Rng, c: np.ndarray, form: int | None = None, held_out: bool = False
) -> Hidden:
    """An effect of usual strength with its form, shape, sign and edge or side drawn.

    `held_out` draws from the forms that are held out, where the entry has any (an effect from
    outside the catalogue has none): for the campaign alone.

    Raises:
        HeldOutError: `form` is held out and `held_out` is not given.
    """
    kept = held_out_of(entry.id) if held_out else ()
    if form is not None:
        chosen = form
    elif kept:
        chosen = int(rng.choice(kept))
    else:
        chosen = int(rng.integers(1, 3))
    shape = entry.shape(rng, chosen, c) if entry.shape else (0.0, 0.0, 0.0)
    variant = str(rng.choice(entry.variants)) if entry.variants else None
    sign = -1.0 if entry.either_sign and rng.random() < 0.5 else 1.0
    if entry.id in ("valve_delay", "valve_delay_pressure"):
        sign = 1.0 if rng.random() < 0.8 else -1.0
    if entry.id == "wear":
        sign = -1.0 if rng.random() < 0.7 else 1.0
    return Hidden(entry.id, chosen, sign * entry.usual, shape, variant, bool(kept))
