"""All controllers on both valves, with and without payload, and on plants unknown to them."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

from plant.constants import PlantConstants
from plant.effects.effects import NONE, Effects
from plant.errors import PlantError
from plant.finger import Finger
from plant.finger.reader import load_valve
from studies.comparison.figures import PathFigures, StepFigures, path_figures, step_figures
from studies.controllers.laws import LAWS, build_law
from studies.controllers.loop import FINE_STEP_S, Trial, run_law
from studies.controllers.reference import Reference, circle, step

PAYLOAD_KG = 0.020
STEP_JOINT = "flexion"
MOST_PATH_RMS_MM = 1.0
MOST_STEADY_DEG = 1.0


@dataclass(frozen=True)
class Case:
    """One plant: differences from the plant that law and firmware assume.

    `heavier` scales masses and inertias of all links, `plant` sets constants of
    `configs/plant/thesis.toml`, `scaled` has factors of such constants.
    """

    title: str
    payload_kg: float = 0.0
    plant: tuple[tuple[str, float], ...] = ()
    effects: tuple[tuple[str, tuple[tuple[str, float | str], ...]], ...] = ()
    scaled: tuple[tuple[str, float], ...] = ()
    heavier: float = 1.0

    def constants(self, known: PlantConstants) -> PlantConstants:
        """The constants of the plant."""
        changes = dict(self.plant)
        changes |= {key: known.value(key) * factor for key, factor in self.scaled}
        return known.with_overrides(changes, f"case {self.title!r}")

    def built(self, finger: Finger) -> Finger:
        """The finger of the plant, without payload."""
        if self.heavier == 1.0:
            return finger
        links = []
        for link in finger.arm.links:
            xx, yy, zz, xy, xz, yz = (value * self.heavier for value in link.inertia_kg_m2)
            tensor = (xx, yy, zz, xy, xz, yz)
            mass = link.mass_kg * self.heavier
            links.append(dataclasses.replace(link, mass_kg=mass, inertia_kg_m2=tensor))
        return dataclasses.replace(finger, arm=dataclasses.replace(finger.arm, links=tuple(links)))

    def additions(self) -> Effects:
        """The active effects."""
        if not self.effects:
            return NONE
        return Effects.from_config({name: dict(given) for name, given in self.effects})


FRICTION_2_N = ("braid_friction", (("friction_n", 2.0),))

BARE = Case("no payload")
LADEN = Case("20 g", PAYLOAD_KG)
PERTURBED = (
    Case("braid friction 2 N", effects=(FRICTION_2_N,)),
    Case("braid friction 2 N, 20 g", PAYLOAD_KG, effects=(FRICTION_2_N,)),
    Case("liner takes 30 kPa", effects=(("liner_threshold", (("threshold_kpa", 30.0),)),)),
    Case("supply 500 for 550 kPa", plant=(("supply_kpa", 500.0),)),
    Case("outlets 20 % wider", effects=(("flow_area", (("ratio", 1.2), ("side", "outlet"))),)),
    Case(
        "inlets shut 0.5 ms later",
        effects=(("valve_delay", (("edge", "inlet_off"), ("delay_ms", 0.5))),),
    ),
    Case("dead volume 1 for 0.5 ml", plant=(("dead_volume_ml", 1.0),)),
    Case("links 20 % heavier", heavier=1.2),
    Case("links 20 % lighter", heavier=0.8),
    Case("braid threads 5 % longer", scaled=(("braid_length_mm", 1.05),)),
    Case("braid threads 5 % shorter", scaled=(("braid_length_mm", 0.95),)),
    Case("5 % more turns", scaled=(("turns", 1.05),)),
    Case("5 % fewer turns", scaled=(("turns", 0.95),)),
    Case(
        "braid friction 4 N, fibres slide twice as far",
        effects=(
            (
                "braid_friction",
                (("friction_n", 4.0), ("travel_kpa", 80.0), ("travel_mm", 0.8)),
            ),
        ),
    ),
)
"""Plants that no law was tuned for. Kinds and sizes were chosen before they were run: the first
seven before the adaptive law learned friction, the others after."""


@dataclass(frozen=True)
class Row:
    """One controller on one valve and plant under one noise realization.

    `learned_g` is the payload estimated by the adaptive law.
    """

    law: str
    valve: str
    case: str
    seed: int
    step: StepFigures
    path: PathFigures
    learned_g: float | None = None

    @property
    def accepted(self) -> bool:
        """Fingertip within 1 mm rms of the circle, joint within 1 degree of the step."""
        return (
            self.path.rms_mm <= MOST_PATH_RMS_MM
            and self.step.steady_error_deg <= MOST_STEADY_DEG
            and not self.step.faults
            and not self.path.faults
        )

    def as_dict(self) -> dict[str, object]:
        """Plain values for JSON."""
        return {**dataclasses.asdict(self), "accepted": self.accepted}


def run_trial(
    finger: Finger, law: str, valve: str, case: Case, reference: Reference, **options: object
) -> Trial:
    """One controller on one plant. Raises `PlantError` for an unknown law or valve."""
    known = load_valve(valve)
    controller, scheme = build_law(law, finger, known)
    return run_law(
        finger,
        known,
        controller,
        reference,
        scheme=scheme,
        built=case.built(finger),
        plant=case.constants(known),
        payload_kg=case.payload_kg,
        effects=case.additions(),
        **options,  # type: ignore[arg-type]
    )


def run_case(
    finger: Finger, law: str, valve: str, case: Case, seed: int = 1, step_max_s: float = FINE_STEP_S
) -> Row:
    """Step and circle of one controller on one plant, under one noise realization."""
    joint = finger.arm.joint(STEP_JOINT)
    stepped, turned = (
        run_trial(finger, law, valve, case, reference, seed=seed, step_max_s=step_max_s)
        for reference in (step(finger, STEP_JOINT), circle(finger))
    )
    learned = None
    if law == "adaptive":
        learned = float(turned.estimates[-1, 0] * 1e3)
    figures = step_figures(stepped, joint), path_figures(turned)
    return Row(law, valve, case.title, seed, *figures, learned)


def table(
    finger: Finger,
    laws: Iterable[str] = LAWS,
    valves: Iterable[str] = ("thesis", "cured"),
    cases: Iterable[Case] = (BARE, LADEN),
    seeds: Iterable[int] = (1,),
    progress: Callable[[str], None] | None = None,
) -> Iterator[Row]:
    """One row per combination, in the order valve, law, case, seed.

    A seed selects the noise and the errors of the sensors. `progress` is called before each row.
    """
    chosen, draws = list(laws), list(seeds)
    for law in chosen:
        if law not in LAWS:
            raise PlantError(f"controller {law!r}: choose one of {', '.join(LAWS)}")
    for valve in valves:
        for law in chosen:
            for case in cases:
                for seed in draws:
                    if progress is not None:
                        progress(f"{valve} valve, {law}, {case.title}, seed {seed}")
                    yield run_case(finger, law, valve, case, seed)
