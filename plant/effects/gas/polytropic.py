"""The gas does not stay isothermal."""

from __future__ import annotations

from plant.constants import PlantConstants
from plant.effects import pressure_stage as stage
from plant.effects.arguments import Params, Shape, Values
from plant.effects.effect import Effect, InDiagnosis, InPlant, Parameter, Search
from plant.physics import layout


def _slots(values: Values, c: PlantConstants) -> dict[int, float]:
    return {layout.EXPONENT: float(values["exponent"])}


def _gas(params: Params, amount: float, option: str, shape: Shape) -> None:
    params[layout.EXPONENT] += amount
    params[stage.HEAT_RATE] = 1.0 / shape["heat_s"] if "heat_s" in shape else 0.0
    params[stage.HEAT_BY_MASS] = shape.get("mass", 0.0)
    params[stage.FADING] = shape.get("fades_s", 0.0)


POLYTROPIC = Effect(
    "polytropic",
    "gas",
    "chamber",
    "the gas does not stay isothermal",
    (Parameter("exponent", "", "polytropic exponent above 1", 1, 1.4),),
    "all settled points; closed valves at constant length",
    ("dead_volume", "flow_area", "leak"),
    "seal the muscle and move it fast and slowly: the pressure swing shows the exponent",
    equation="P V^k constant when sealed, dP/dt = k (...) / V with k the exponent",
    source="Richer and Hurmuzlu 2000 (between isothermal and adiabatic)",
    standard="none needed: the sealed muscle moved at two speeds",
    constants=("polytropic_exponent", "dead_volume_ml"),
    neutral=1.0,
    stands_for=("gas_temperature_k",),
    # Gas that filling warms needs less mass, as if more had come in.
    shows_as=("flow_area",),
    plant=InPlant(slots=_slots),
    diagnosis=InDiagnosis(gas=_gas),
    search=Search(
        step=0.02,
        sign=1,
        blocks=("pressure",),
        # With `mass`, the energy balance of the gas in the muscle (Carneiro and Almeida 2006): the
        # more of it there is, the longer the wall takes to cool it, and it leaves as warm as it is.
        # With `fades_s` the exponent falls after each opening of a valve, towards half of what it
        # has above one (Al-Ibrahim and Otis 1992: chambers that are filled and vented).
        shapes=(
            {},
            {"heat_s": 0.2},
            {"heat_s": 1.0},
            {"heat_s": 5.0},
            {"heat_s": 0.1, "mass": 1.0},
            {"fades_s": 0.1},
        ),
        # Air in a tube 10 mm wide takes the wall's temperature within seconds (r^2 / 5.8 of its
        # thermal diffusivity, 1 s at 5 bar), and within some hundredths where a jet stirs it; what
        # falls for longer leaks.
        free={"heat_s": (0.02, 6.0), "fades_s": (0.01, 2.0)},
        one_shape=True,
    ),
)
