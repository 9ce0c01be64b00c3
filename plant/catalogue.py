"""The catalogue of effects: what a real bench may do that the nominal plant does not.

Verdicts, rig files (`[effects.<id>]`), docs and blind checks all use these ids. Every entry says
what the effect leaves untouched, which others it can be taken for, and what tells them apart.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Parameter:
    """One parameter of an effect: a number within bounds, or a word out of `choices`.

    `default` None means that it must be given.
    """

    name: str
    unit: str
    meaning: str
    low: float = 0.0
    high: float = 0.0
    default: float | str | None = None
    choices: tuple[str, ...] = ()


@dataclass(frozen=True)
class Entry:
    """One effect: where it acts, its parameters (the headline first) and how to recognise it."""

    id: str
    family: str
    stage: str
    summary: str
    parameters: tuple[Parameter, ...]
    untouched: str
    mistaken_for: tuple[str, ...]
    told_apart_by: str
    in_plant: bool = False

    @property
    def headline(self) -> str | None:
        """Name of the headline parameter; None for an effect that is there or not."""
        return self.parameters[0].name if self.parameters else None

    @property
    def unit(self) -> str:
        """Unit of the headline parameter."""
        return self.parameters[0].unit if self.parameters else ""


_EDGE = Parameter(
    "edge",
    "",
    "which of the four delays",
    choices=("inlet_on", "inlet_off", "outlet_on", "outlet_off"),
)

_ENTRIES = (
    Entry(
        "liner_threshold",
        "dead_space",
        "muscle",
        "the liner must swell before it meets the braid: little force below a threshold",
        (
            Parameter("threshold_kpa", "kPa", "gauge pressure lost at high pressure", 0, 500),
            Parameter("width_kpa", "kPa", "softness of the knee (softplus width)", 1, 200, 25.0),
        ),
        "force per pressure well above the threshold; gas and valve traces; up against down",
        ("pressure_zero",),
        "vent and read the pressure: a zero shows there, a liner does not; and a liner bends the "
        "force line below the threshold where a zero shifts it whole",
        True,
    ),
    Entry(
        "bladder_elasticity",
        "elasticity",
        "muscle",
        "the rubber tube is a spring along the muscle, whatever the pressure",
        (Parameter("stiffness_n_mm", "N/mm", "spring rate at 60 mm", 0, 50),),
        "force against pressure at one length, but for its intercept; gas and valve traces",
        ("force_zero", "contraction_limit"),
        "pull the vented muscle over its lengths: a spring follows length, a force zero does not",
    ),
    Entry(
        "contraction_limit",
        "elasticity",
        "muscle",
        "force falls away near the shortest length beyond what the braid angle gives",
        (Parameter("force_n", "N", "force lost at length_min + 1 mm", 0, 200),),
        "all lengths more than a few millimetres from the shortest; gas and valve traces",
        ("bladder_elasticity", "end_cap"),
        "isometric points close together in length near the shortest: this loss is local",
    ),
    Entry(
        "end_cap",
        "geometry",
        "muscle",
        "the ends are not cylindrical: effective contraction is larger than the measured one",
        (
            Parameter(
                "shortening_mm",
                "mm",
                "effective minus measured length at 60 mm, as positive",
                0,
                15,
            ),
        ),
        "proportionality of force to pressure at each length; up against down; timing",
        ("camera_distortion", "camera_scale", "length_label", "contraction_limit"),
        "a gauge block before the camera at several places; then the length is known and what "
        "remains belongs to the muscle",
    ),
    Entry(
        "fibre_stretch",
        "geometry",
        "muscle",
        "the braid threads lengthen under load",
        (Parameter("stretch_percent", "%", "of braid length at 500 kPa", 0, 10),),
        "low pressures; up against down; valve timing",
        ("pressure_gain", "force_gain"),
        "force against pressure at fixed length curves with stretch and stays straight with a "
        "gain; dead weight on the force sensor",
    ),
    Entry(
        "braid_friction",
        "friction",
        "muscle",
        "rate-independent friction between fibres: up and down differ",
        (
            Parameter("friction_n", "N", "half the loop height at 300 kPa", 0, 100),
            Parameter(
                "travel_kpa", "kPa", "rise of pressure after which all fibres slip", 1, 150, 40.0
            ),
            Parameter("travel_mm", "mm", "shortening after which all fibres slip", 0.01, 5, 0.4),
        ),
        "the mean of up and down; gas and valve traces; anything measured at zero pressure",
        ("viscosity", "creep", "link_friction"),
        "the same loop at two speeds, and with a wait at each point: friction keeps its height",
        True,
    ),
    Entry(
        "viscosity",
        "rate",
        "muscle",
        "force depends on the speed of contraction",
        (Parameter("damping_n_s_mm", "N s/mm", "force per speed at 10 mm/s", 0, 10),),
        "all settled points; isometric tests altogether",
        ("braid_friction", "link_friction", "pressure_lag", "camera_delay"),
        "moving-length tests at several speeds: force of friction is the same at all of them",
    ),
    Entry(
        "creep",
        "rate",
        "muscle",
        "force or length drifts for seconds to minutes after a step",
        (Parameter("relaxation_percent", "%", "of the step after 60 s", 0, 50),),
        "the first second after a step; valve timing",
        ("braid_friction", "temperature_stiffening", "wear"),
        "hold one point for minutes, step away and back: creep starts anew at each step",
    ),
    Entry(
        "temperature_stiffening",
        "temperature",
        "muscle",
        "force at the same pressure and length changes with temperature",
        (Parameter("percent_per_k", "%/K", "change of force at 500 kPa", -5, 5),),
        "everything at one temperature; valve timing",
        ("creep", "wear", "force_gain"),
        "the same points hot, cold and hot again: it comes back with the temperature",
    ),
    Entry(
        "dead_volume",
        "gas",
        "chamber",
        "more volume in line and fittings than assumed",
        (Parameter("volume_ml", "ml", "extra volume", 0, 100),),
        "all settled points; the pressure finally reached",
        ("flow_area", "polytropic"),
        "fill at a short and a long length: extra volume weighs less when the muscle is large; "
        "seal the muscle and move the length",
    ),
    Entry(
        "polytropic",
        "gas",
        "chamber",
        "the gas does not stay isothermal",
        (Parameter("exponent", "", "polytropic exponent above 1", 1, 1.4),),
        "all settled points; closed valves at constant length",
        ("dead_volume", "flow_area"),
        "seal the muscle and move it fast and slowly: the pressure swing shows the exponent",
    ),
    Entry(
        "leak",
        "flow",
        "valve",
        "air escapes whatever the command",
        (Parameter("conductance_m3_s_pa", "m3/(s Pa)", "of the leak", 0, 1e-8),),
        "force at a measured pressure; the vented state",
        ("flow_area", "supply_droop"),
        "shut both valves on a pressurised muscle and watch",
    ),
    Entry(
        "flow_area",
        "flow",
        "valve",
        "inlet or outlet conductance differs from the assumed one",
        (
            Parameter("ratio", "", "conductance over nominal", 0.1, 10),
            Parameter("side", "", "which valve", choices=("inlet", "outlet")),
        ),
        "all settled points; the other side's traces; pulses too short to open",
        ("dead_volume", "polytropic", "critical_ratio", "supply_droop", "leak", "valve_delay"),
        "fill against vent: an area concerns one of them, a volume both; pulses of several "
        "widths: an area scales each, a delay takes the same from each",
    ),
    Entry(
        "critical_ratio",
        "flow",
        "valve",
        "the flow chokes at another pressure ratio",
        (Parameter("critical_ratio", "", "ISO 6358 b", 0.0, 0.9),),
        "choked flow (filling from low pressure, venting from high); all settled points",
        ("flow_area", "supply_droop"),
        "the last third of a fill and of a vent against the first, supply recorded",
    ),
    Entry(
        "supply_droop",
        "flow",
        "valve",
        "supply pressure falls while filling",
        (Parameter("droop_kpa", "kPa", "largest fall in the data", 0, 300),),
        "venting; all settled points",
        ("flow_area", "critical_ratio", "leak"),
        "a pressure sensor right at the inlet, or fills at half the supply pressure",
    ),
    Entry(
        "valve_delay",
        "valve_timing",
        "valve",
        "on or off delays differ by a constant",
        (Parameter("delay_ms", "ms", "extra delay", -10, 50), _EDGE),
        "all settled points; the rate of change while a valve is open",
        ("valve_delay_pressure", "transport_delay", "flow_area", "pressure_lag"),
        "pulse widths from below to well above the delay, at one pressure",
    ),
    Entry(
        "valve_delay_pressure",
        "valve_timing",
        "valve",
        "the delays depend on pressure differently",
        (Parameter("slope_ms_per_kpa", "ms/kPa", "extra slope", -0.05, 0.05), _EDGE),
        "pulses at one pressure, but for a constant; all settled points",
        ("valve_delay",),
        "the same pulse at low and at high pressure",
    ),
    Entry(
        "transport_delay",
        "valve_timing",
        "valve",
        "commands shorter than the on-delay do open the valve, later",
        (),
        "commands longer than the delays",
        ("valve_delay",),
        "pulses shorter than the on-delay: an inertial valve ignores them",
    ),
    Entry(
        "link_friction",
        "load",
        "load",
        "friction in the joint or slide that carries the load",
        (Parameter("friction_n", "N", "friction force of the slide", 0, 100),),
        "isometric tests altogether; gas traces at constant length",
        ("braid_friction", "viscosity", "payload"),
        "isometric against isotonic loops: friction of the slide is only in the latter",
    ),
    Entry(
        "payload",
        "load",
        "load",
        "the load is not the mass it is said to be",
        (Parameter("mass_kg", "kg", "extra mass", -10, 10),),
        "isometric tests altogether",
        ("link_friction", "force_zero"),
        "weigh the load; or two added masses that are known",
    ),
    Entry(
        "pressure_zero",
        "pressure_sensor",
        "sensor",
        "offset of the pressure reading",
        (Parameter("offset_kpa", "kPa", "read minus true", -100, 100),),
        "differences of pressure; timing",
        ("liner_threshold", "force_zero"),
        "vent to the atmosphere and read",
    ),
    Entry(
        "pressure_gain",
        "pressure_sensor",
        "sensor",
        "scale of the pressure reading",
        (Parameter("percent", "%", "read over true", -20, 20),),
        "the vented reading; timing",
        ("force_gain", "fibre_stretch"),
        "a reference gauge on the same line at one high pressure",
    ),
    Entry(
        "pressure_lag",
        "pressure_sensor",
        "sensor",
        "first-order lag of the pressure reading",
        (Parameter("time_ms", "ms", "time constant", 0, 1000),),
        "all settled points",
        ("viscosity", "valve_delay", "camera_delay"),
        "pressure against force at constant length: both must start together and do not",
    ),
    Entry(
        "force_zero",
        "force_sensor",
        "sensor",
        "offset of the force reading, the same in all trials",
        (Parameter("offset_n", "N", "read minus true", -50, 50),),
        "differences of force; pressure and length; timing",
        ("pressure_zero", "bladder_elasticity", "payload"),
        "slacken the muscle and read; one dead weight",
    ),
    Entry(
        "force_gain",
        "force_sensor",
        "sensor",
        "scale of the force reading",
        (Parameter("percent", "%", "read over true", -20, 20),),
        "the unloaded reading; pressure and length; timing",
        ("pressure_gain", "fibre_stretch", "temperature_stiffening"),
        "dead weights over the range",
    ),
    Entry(
        "length_label",
        "length_sensor",
        "sensor",
        "the length at which trials were held is not the one written down",
        (Parameter("offset_mm", "mm", "true minus written", -10, 10),),
        "differences of length; everything within one length",
        ("end_cap",),
        "a gauge block between the holders",
    ),
    Entry(
        "camera_scale",
        "length_sensor",
        "sensor",
        "millimetres per pixel are off",
        (Parameter("percent", "%", "read over true", -20, 20),),
        "isometric tests by label; the length at which the scale was set",
        ("end_cap", "camera_distortion"),
        "two gauge blocks of different length before the camera",
    ),
    Entry(
        "camera_distortion",
        "length_sensor",
        "sensor",
        "lens distortion is not taken out",
        (Parameter("distortion_mm", "mm", "at the end of the range", -5, 5),),
        "the middle of the picture; isometric tests by label",
        ("end_cap", "camera_scale"),
        "one gauge block moved across the picture",
    ),
    Entry(
        "camera_delay",
        "length_sensor",
        "sensor",
        "frame times are late against the other clocks",
        (Parameter("delay_ms", "ms", "frame time minus true", -200, 200),),
        "everything at rest",
        ("viscosity", "pressure_lag"),
        "the blinking light in the picture against the device clock",
    ),
    Entry(
        "wear",
        "drift",
        "any",
        "a slow change with trial order, cycles or days, not tied to temperature",
        (Parameter("percent_per_100_trials", "%", "change of force", -50, 50),),
        "comparisons within one trial, and of trials close together",
        ("creep", "temperature_stiffening"),
        "repeat the first trial last, at the same temperature and after the same rest",
    ),
)

CATALOGUE: dict[str, Entry] = {entry.id: entry for entry in _ENTRIES}
"""All thirty effects by id, in the order of the specification."""

FAMILIES: tuple[str, ...] = tuple(dict.fromkeys(entry.family for entry in _ENTRIES))
"""The families, in order of first appearance; "none" and "unknown" are verdicts beside them."""
