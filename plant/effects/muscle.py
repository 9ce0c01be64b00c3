"""Effects of the muscle itself and of its temperature."""

from __future__ import annotations

from plant.effects.entry import Entry, Parameter

MUSCLE: tuple[Entry, ...] = (
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
        equation="p -> w ln(1 + exp(-p_t / w) (exp(p / w) - 1)), which tends to p - p_t",
        source="Chou and Hannaford 1996; Klute and Hannaford 2000 (threshold pressure)",
    ),
    Entry(
        "bladder_elasticity",
        "elasticity",
        "muscle",
        "the rubber tube is a spring along the muscle, whatever the pressure",
        (
            Parameter("stiffness_n_mm", "N/mm", "spring rate at 60 mm", 0, 50),
            Parameter("rest_mm", "mm", "length at which the tube pulls nothing", 10, 2000, 72.5),
            Parameter("hardening_per_mm2", "1/mm2", "cubic over linear term", 0, 0.1, 0.0),
        ),
        "force against pressure at one length, but for its intercept; gas and valve traces",
        ("force_zero", "contraction_limit"),
        "pull the vented muscle over its lengths: a spring follows length, a force zero does not",
        equation="F + k (x + h x^3) / (1 + 3 h x_60^2), x = L - rest",
        source="Chou and Hannaford 1996 (spring); Klute and Hannaford 2000 (hardening rubber)",
    ),
    Entry(
        "contraction_limit",
        "elasticity",
        "muscle",
        "force falls away near the shortest length beyond what the braid angle gives",
        (
            Parameter("force_n", "N", "force lost at length_min + 1 mm", 0, 200),
            Parameter("scale_mm", "mm", "distance over which the loss falls to 1/e", 0.1, 10, 1.0),
        ),
        "all lengths more than a few millimetres from the shortest; gas and valve traces",
        ("bladder_elasticity", "end_cap", "camera_distortion"),
        "isometric points close together in length near the shortest: this loss is local",
        equation="F - f exp(-(L - length_min - 1 mm) / scale)",
        source="Tondu 2012 (force near the greatest contraction)",
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
                -5,
                15,
            ),
            Parameter("rest_mm", "mm", "length without contraction", 60.5, 2000, 72.5),
        ),
        "proportionality of force to pressure at each length; up against down; timing",
        (
            "camera_distortion",
            "camera_scale",
            "length_label",
            "contraction_limit",
            "fibre_stretch",
        ),
        "a gauge block before the camera at several places; then the length is known and what "
        "remains belongs to the muscle",
        equation="L -> L - shortening (rest - L) / (rest - 60 mm) in the force, not in the volume",
        source="Tondu and Lopez 2000 (factor k on the contraction)",
    ),
    Entry(
        "fibre_stretch",
        "geometry",
        "muscle",
        "the braid threads lengthen under load",
        (Parameter("stretch_percent", "%", "of braid length at 500 kPa", 0, 10),),
        "low pressures; up against down; valve timing",
        ("pressure_gain", "force_gain", "end_cap", "camera_scale"),
        "force against pressure at fixed length curves with stretch and stays straight with a "
        "gain; dead weight on the force sensor",
        equation="b -> b (1 + stretch p / 500 kPa) in the force, not in the volume",
        source="Davis, Tsagarakis, Canderle and Caldwell 2003",
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
        equation="F - friction p / 300 kPa mean(z_i), four Maxwell-slip elements driven by p and L",
        source="Iwan 1966; Davis and Caldwell 2006; Vo-Minh et al. 2010",
    ),
    Entry(
        "viscosity",
        "rate",
        "muscle",
        "force depends on the speed of contraction",
        (
            Parameter("damping_n_s_mm", "N s/mm", "force per speed at 10 mm/s", 0, 10),
            Parameter(
                "exponent", "", "of force over speed: 1 linear, below 1 saturating", 0.2, 2, 1.0
            ),
            Parameter(
                "pressure_share", "", "part that goes with pressure, as at 300 kPa", 0, 1, 0.0
            ),
        ),
        "all settled points; isometric tests altogether",
        ("braid_friction", "link_friction", "pressure_lag", "camera_delay"),
        "moving-length tests at several speeds: force of friction is the same at all of them",
        equation="F + c v (|v| / 10 mm/s)^(q - 1) (1 - s + s p / 300 kPa), v = dL/dt",
        source="Reynolds et al. 2003 (dashpot); Klute, Czerniecki and Hannaford 2002 (Hill's law)",
    ),
    Entry(
        "creep",
        "rate",
        "muscle",
        "force or length drifts for seconds to minutes after a step",
        (
            Parameter("relaxation_percent", "%", "of the step after 60 s", -50, 50),
            Parameter("fast_s", "s", "shortest time constant", 0.5, 60, 3.0),
            Parameter("slow_s", "s", "longest time constant", 5, 3600, 200.0),
        ),
        "the first second after a step; valve timing",
        ("braid_friction", "temperature_stiffening", "wear"),
        "hold one point for minutes, step away and back: creep starts anew at each step",
        equation="F - g sum m_i, tau_i dm_i/dt = F_e - m_i, four tau_i from fast_s to slow_s",
        source="Fung 1993 (quasi-linear viscoelasticity); Vo-Minh et al. 2011",
    ),
    Entry(
        "temperature_stiffening",
        "temperature",
        "muscle",
        "force at the same pressure and length changes with temperature",
        (
            Parameter("percent_per_k", "%/K", "change of force at 500 kPa", -5, 5),
            Parameter("reference_c", "degC", "temperature of no change", -20, 80, 21.0),
            Parameter("flat_share", "", "part that does not grow with pressure", 0, 1, 0.0),
        ),
        "everything at one temperature; valve timing",
        ("creep", "wear", "force_gain"),
        "the same points hot, cold and hot again: it comes back with the temperature",
        equation="F + k (T - T_ref) ((1 - s) F + s F(500 kPa)), F the braid's",
        source="Equations 4-47 to 4-50 of the thesis: constants of the force linear in temperature",
    ),
)
"""In the order of the specification."""
