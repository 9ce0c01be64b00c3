"""Every form of every effect: its equation, whence it comes, and whether it is held out.

Form 0 is the plainest; 1 and 2 are drawn for practice, reserved and live sets; from 3 on they are
held out: the campaign's stream of held-out forms alone draws them, so that neither the diagnosis
nor its tests nor its learnt reliability has met them. The equations run in `laws`, `kernel`,
`readings` and, from 3 on, `alternatives`. Where two numbers run the same equation the table says
so (`same_as`), and the effect has one more that is held out. Where the diagnosis has learnt the
kind of a held-out form since, the effect has newer ones.
"""

from __future__ import annotations

from dataclasses import dataclass

SEEN = (0, 1, 2)


class HeldOutError(ValueError):
    """A form was asked for that is kept from all but the campaign."""

    def __init__(self, effect: str, form: int) -> None:
        """Keep which effect and form it was."""
        super().__init__(
            f"form {form} of {effect} is held out: only the campaign of the blind check makes it"
        )
        self.effect, self.form = effect, form


@dataclass(frozen=True)
class Form:
    """One form of an effect: its number, equation and source; `same_as` an earlier number."""

    effect: str
    number: int
    equation: str
    source: str
    same_as: int | None = None

    @property
    def held_out(self) -> bool:
        """Whether it is kept from all but the campaign."""
        return self.number not in SEEN


_ISO6358 = "ISO 6358-1:2013"
_VIM = "JCGM 200:2012 (VIM)"
_DOEBELIN = "Doebelin, Measurement Systems, 5th ed., 2004"
_FRADEN = "Fraden, Handbook of Modern Sensors, 5th ed., 2016"
_BRAUER = "Brauer, Magnetic Actuators and Sensors, 2006"
_IEC61298 = "IEC 61298-2:2008 (conformity and linearity)"
_OIML = "OIML R 60:2000 (load cells)"
_IDELCHIK = "Idelchik, Handbook of Hydraulic Resistance, 3rd ed., 1994"

_TABLE: dict[str, tuple[tuple[str, str], ...]] = {
    "liner_threshold": (
        ("min(p, P)", "Chou and Hannaford 1996"),
        ("P (1 - exp(-p/P))", "Klute and Hannaford 2000 (rubber takes up its share gradually)"),
        ("P p^2/(p^2 + (0.7 P)^2)", "Hill 1910 (sigmoid with exponent 2)"),
        ("min(p, P (1 + 0.5 x exp(1-x))), x = p/80",
         "Mueller and Strehlow, Rubber and Rubber Balloons, 2004 (limit point)"),
        ("min(p, P p/(p + 130)), P at 500 kPa",
         "Greenwood and Williamson, Proc. R. Soc. A 295 (1966) 300 (contact by and by)"),
    ),
    "bladder_elasticity": (
        ("k x", "Chou and Hannaford 1996"),
        ("k (x + b x^3)", "Klute and Hannaford 2000 (hardening rubber)"),
        ("k s (exp(x/s) - 1)", "Fung, Biomechanics, 1993"),
        ("u - 1/u^2, u = L/rest", "Treloar, The Physics of Rubber Elasticity, 1975 (neo-Hooke)"),
        ("(u - 1/u^2)/(J - u^2 - 2/u + 3)", "Gent, Rubber Chem. Technol. 69 (1996) 59"),
    ),
    "contraction_limit": (
        ("linear over a reach", "linear stop"),
        ("exp(-x/r)", "Tondu 2012 (wall term)"),
        ("((R - x)/R)^2", "Davis and Caldwell 2006 (locking braid)"),
        ("((R - x)/R)^1.5", "Johnson, Contact Mechanics, 1985 (Hertz)"),
        ("s/(1 - (s/S)^2), s = R - x", "Warner, Ind. Eng. Chem. Fundam. 11 (1972) 379 (FENE)"),
    ),
    "end_cap": (
        ("s", "Tondu and Lopez 2000 (constant)"),
        ("s D/D_60, D^2 = b^2 - L^2", "Chou and Hannaford 1996 (diameter of the braid)"),
        ("s (L_0 - L)/(L_0 - 60)", "Tondu and Lopez 2000 (factor on the contraction)"),
        ("s (D - D_f)/(D_60 - D_f)", "Tsagarakis and Caldwell, ICRA 2000 (truncated cones)"),
        ("s (0.35 + 0.65 (1 - exp(-p/170)))",
         "Kothera, Jangid, Sirohi and Wereley, J. Mech. Des. 131 (2009) 091010"),
        ("s (1 + 0.7 exp(-p/130)), s at 500 kPa",
         "Kerscher, Albiez, Zollner and Dillmann, BioRob 2006 (a factor that falls with p)"),
    ),
    "fibre_stretch": (
        ("p", "Davis, Tsagarakis, Canderle and Caldwell 2003"),
        ("p D/D_60", "Davis et al. 2003 with the hoop's radius"),
        ("1 - exp(-p/300)", "slack of a weave taken up, Grosberg and Kedia 1966"),
        ("1.25 p/(p + 90) - 0.25 p", "Comninou and Yannas, J. Biomech. 9 (1976) 427 (crimp)"),
        ("x + 0.8 x^4", "Ramberg and Osgood, NACA TN 902, 1943"),
    ),
    "braid_friction": (
        ("dz = 3 r (1 - s z)", "Dahl, Aerospace TOR-0158, 1968, stiff"),
        ("dz = r (1 - s z)", "Dahl 1968"),
        ("four elements, dz = r/c_i (1 - s z |z|^2)", "Iwan 1966; Dahl 1976, exponent 3"),
        ("dz = r (1 - s z/g(r)), Stribeck's g",
         "Canudas de Wit, Olsson, Astrom and Lischinsky, IEEE TAC 40 (1995) 419 (LuGre)"),
        ("dz = r (1 - |z|^1.6 (0.7 sgn + 0.3)), level p^(2/3)",
         "Wen, J. Eng. Mech. 102 (1976) 249 (Bouc-Wen); Johnson 1985 (p^(2/3))"),
    ),
    "viscosity": (
        ("d v", "Reynolds, Repperger, Phillips and Bandry 2003"),
        ("tanh(v/v_s)", "smoothed Coulomb friction; Andersson, Soderberg and Bjorklund 2007"),
        ("|v|^m", "Ostwald 1925; de Waele 1923 (power law)"),
        ("v/(|v| + a)", "Hill, Proc. R. Soc. B 126 (1938) 136 (hyperbola)"),
        ("asinh(v/v_0)", "Eyring, J. Chem. Phys. 4 (1936) 283"),
    ),
    "creep": (
        ("1 - exp(-t/T)", "Kelvin-Voigt; Ferry, Viscoelastic Properties of Polymers, 1980"),
        ("two Kelvin elements", "Burgers 1935; Findley, Lai and Onaran 1976"),
        ("log t", "Fung 1993 (quasi-linear viscoelasticity)"),
        ("t^n", "Nutting, J. Franklin Inst. 191 (1921) 679; Findley 1976"),
        ("1 - exp(-(t/T)^0.45)", "Kohlrausch 1854; Struik 1978 (stretched exponential)"),
    ),
    "temperature_stiffening": (
        ("k dT p", "thesis, equations 4-47 to 4-50"),
        ("k dT p/(p + 100)", "linear in temperature, saturating in pressure"),
        ("exp(k dT sqrt(p))", "Ferry 1980 (exponential in temperature)"),
        ("exp(k T_0 dT/T (2/(1 + p/500)))", "Arrhenius 1889; Ward and Sweeney 2012"),
        ("exp(k C dT/(C + dT)), C = 51.6 K",
         "Williams, Landel and Ferry, J. Am. Chem. Soc. 77 (1955) 3701"),
    ),
    "dead_volume": (
        ("V", "ideal gas in one more vessel"),
        ("V behind a linear throttle", "Blackburn, Reethof and Shearer 1960"),
        ("V (0.75 + 0.25 p/300)", "linear hose; Wylie and Streeter 1993"),
        ("V (0.45 + 0.55 atan(p/110))",
         "Langewouters, Wesseling and Goedhard, J. Biomech. 17 (1984) 425"),
        ("V behind an orifice, flow as sqrt(dp)", _IDELCHIK),
        ("V (0.35 + 0.65 y/300), dy = (p - y)/0.23 s",
         "Westerhof and Noordergraaf, J. Biomech. 3 (1970) 357 (viscoelastic tube)"),
        ("V behind a check valve, emptied through a throttle",
         "Andersen, Analysis of Pneumatic Systems, 1967 (one-way flow control)"),
        ("V (p - 72)/228 above 72 kPa, else none",
         "Hunt and Vaughan, Hydraulic Handbook, 9th ed., 1996 (spring-loaded accumulator)"),
        ("V y/p, dy = (510 p/(p + 210) - y)/tau",
         "Glueckauf, Trans. Faraday Soc. 51 (1955) 1540 (Langmuir sorption in a drier)"),
    ),
    "polytropic": (
        ("n", "ideal gas, constant exponent"),
        ("n with linear heat loss", "Chou and Hannaford 1996; Otis and Pourmovahed 1985"),
        ("1.15 (n - 1) filling, 0.85 (n - 1) venting",
         "Richer and Hurmuzlu, J. Dyn. Syst. Meas. Control 122 (2000) 416"),
        ("heat loss as dT^(4/3)", "Churchill and Chu, Int. J. Heat Mass Transf. 18 (1975) 1323"),
        ("n falls after each stroke", "Al-Ibrahim and Otis, Proc. 45th NCFP, 1992"),
        ("heat loss as flow^0.78", "Eichelberg, Engineering 148 (1939) 463 (gas in motion)"),
    ),
    "leak": (
        ("orifice, b = 0.5", _ISO6358),
        ("p^2 - p_a^2", "Poiseuille flow of a gas; Roth, Vacuum Technology, 1990"),
        ("orifice, b = 0.2", _ISO6358 + " (long passages)"),
        ("(p^2 - p_a^2)(1 + dp/170)^3",
         "Witherspoon, Wang, Iwai and Gale, Water Resour. Res. 16 (1980) 1016 (gaping crack)"),
        ("dp exp(-dp/260)", "Crank 1975 (permeation); Mueller and Nau 1998 (lip pressed down)"),
    ),
    "flow_area": (
        ("r", _ISO6358),
        ("r after a lift of 1.5 ms", "Topcu, Yuksel and Kamis, Mechatronics 16 (2006)"),
        ("1 + (r-1)(0.9 + 0.2 p2/p1)", "Beater, Pneumatic Drives, 2007"),
        ("1 + (r-1) C_d(p2/p1), polynomial of fifth order", "Perry, Trans. ASME 71 (1949) 757"),
        ("1 + (r-1)(1 + K (p1 - 400))", _ISO6358 + " (pressure dependence coefficient)"),
        ("1 + (r-1)(0.32 + 0.68 sqrt(dp/300))",
         "Blackburn, Reethof and Shearer 1960 (poppet that the flow lifts)"),
    ),
    "critical_ratio": (
        ("ellipse, m = 0.5", _ISO6358),
        ("m = 0.48", _ISO6358 + " (subsonic index)"),
        ("m = 0.53", _ISO6358 + " (subsonic index)"),
        ("sqrt(y^1.43 - y^1.71) C_d(y)", "de Saint-Venant and Wantzel 1839; Perry 1949"),
        ("m = 0.58 with 4 kPa to crack", _ISO6358 + " (cracking pressure); Beater 2007"),
        ("ellipse, b + 0.21 (p1/MPa - 0.385)", _ISO6358 + " (b that changes with the pressure)"),
    ),
    "supply_droop": (
        ("receiver behind a linear restriction", "Andersen, Analysis of Pneumatic Systems, 1967"),
        ("receiver behind a linear restriction", "Andersen 1967"),
        ("q^0.8", "ISO 6953-2 (flow characteristic)"),
        ("receiver behind an orifice, sqrt", _IDELCHIK),
        ("q^2", "Darcy 1857; Weisbach 1845 (line)"),
        ("q^(1/3)", "Beater 2007 (first opening of a regulator)"),
        ("max(q - q_0, 0)", "ISO 6953-2 (beyond the largest flow of a regulator)"),
    ),
    "valve_delay": (
        ("d", "Nominal plant, delay of the valve"),
        ("d (1 + 0.12 sin)", "scatter from stroke to stroke"),
        ("d (1 + 0.08 cos)", "the same, another course"),
        ("d (1 + 0.045 log(rest/0.4 s))",
         "Rabinowicz, Proc. Phys. Soc. 71 (1958) 668 (friction grows with rest)"),
        ("d (0.88 + 0.24 exp(-strokes/9))", _BRAUER + " (residual flux)"),
    ),
    "valve_delay_pressure": (
        ("s p", "Nominal plant, delay of the valve"),
        ("s (p/2 + p^2/1200)", "second-order term of the same"),
        ("s (1 - exp(-p/600))", _BRAUER + " (saturation)"),
        ("2 s sqrt(300 p)", _BRAUER + " (force as current squared)"),
        ("-log(1 - sqrt(p/1500))", "Kallenbach et al., Elektromagnete, 4th ed., 2012 (coil L/R)"),
    ),
    "transport_delay": (
        ("all edges act", "IEEE 1076-2008 (transport delay)"),
        ("all edges act", "IEEE 1076-2008"),
        ("0.5 ms between edges", "Kallenbach 2012 (armature in flight)"),
        ("width less 0.45 w exp(-w/5 ms)",
         "Bellido-Diaz, Juan-Chico and Valencia, Logic-Timing Simulation, 2006 (degradation)"),
        ("pulses below 2.6 ms rejected", "IEEE 1076-2008 (reject limit)"),
        ("6.5 ms between edges", _BRAUER + " (flux must decay first)"),
    ),
    "link_friction": (
        ("tanh(v/0.1)", "Coulomb 1785, smoothed"),
        ("dz = v/l (1 - s z)", "Dahl 1968"),
        ("tanh(v/0.4)(1 + 0.35 exp(-(v/4)^2))", "Stribeck 1902; Armstrong-Helouvry et al. 1994"),
        ("dz = v/l (1 - s z/g(v))", "Canudas de Wit et al. 1995 (LuGre)"),
        ("dz = v/l (1 - |z|^1.6 (0.7 sgn + 0.3))", "Wen 1976 (Bouc-Wen)"),
    ),
    "payload": (
        ("m", "Newton's second law"),
        ("m (1 + 0.15 tanh((60-L)/5))", "soft guide; Meriam and Kraige, Dynamics"),
        ("m (1 + 0.03 (60-L))", "hose lifted along: catenary's weight per length"),
        ("m (cos a + 0.35 sin a), a = (60-L)/35", "lever; Meriam and Kraige, Statics"),
        ("m (0.55 + 0.45 x^2), x = (L_max - L)/(L_max - 60)", "Cayley, Proc. R. Soc. 8 (1857) 506"),
    ),
    "pressure_zero": (
        ("z", _VIM + " 4.28"),
        ("z (1 + 0.06 sin(trial))", _VIM + " 4.21 (instrumental drift)"),
        ("z (1 +- 0.05) by mounting", _VIM + " 2.20 (repeatability conditions)"),
        ("z (1.12 - 0.55 exp(-session/40 min))", _FRADEN + " (warm-up)"),
        ("z (1.03 - 0.28 exp(-t/7 s))", _DOEBELIN + " (thermal transient of a diaphragm)"),
    ),
    "pressure_gain": (
        ("g", _VIM + " 4.12"),
        ("g (0.9 + 0.1 p/300)", _IEC61298),
        ("g", _VIM + " 4.12"),
        ("g (0.64 + 0.36 x (2 - x))", _IEC61298 + ", terminal-based"),
        ("g (1.13 - 0.13 x^2)",
         "Timoshenko and Woinowsky-Krieger, Plates and Shells, 1959 (large deflection)"),
        ("g (1 + 0.17 sin(pi x))", _IEC61298 + ", S-shaped"),
        ("g (1, from 371 kPa on 0.57)", _FRADEN + " (an amplifier that changes its range)"),
    ),
    "pressure_lag": (
        ("first order", _DOEBELIN),
        ("rate 1.15/(1 + 0.3 |d|/200)", "Blackburn, Reethof and Shearer 1960"),
        ("two first orders, 3 to 1", _DOEBELIN),
        ("second order, damping 0.6", "Bergh and Tijdeman, NLR-TR F.238, 1965"),
        ("rate as mean pressure", "Iberall, J. Res. NBS 45 (1950) 85 (compressible line)"),
        ("a quick and a slow first order side by side",
         "Hjelmgren, Dynamic Measurement of Pressure, SP Report 2002:34"),
        ("slower down than up", _DOEBELIN + " (unsymmetrical instruments)"),
    ),
    "force_zero": (
        ("z", _VIM + " 4.28"),
        ("z (1 + 0.06 sin(trial))", _VIM + " 4.21 (instrumental drift)"),
        ("z (1 +- 0.05) by mounting", _VIM + " 2.20 (repeatability conditions)"),
        ("z (1 + 0.22 cos(session/90 min))", _DOEBELIN + " (interfering input, room)"),
        ("z (1.1 - 0.32 exp(-t/9 s))", _OIML + " (creep, minimum dead load output return)"),
    ),
    "force_gain": (
        ("g", _VIM + " 4.12"),
        ("g (0.9 + 0.1 F/60)", _OIML + " (non-linearity)"),
        ("g", _VIM + " 4.12"),
        ("g/(0.87 + 0.13 x^2)", "Timoshenko and Gere, Mechanics of Materials, 1972 (bending beam)"),
        ("g (0.66 + 0.34 tanh x)", _FRADEN + " (saturation)"),
        ("g (0.88 + 0.36 (x - 2/3)+)", _DOEBELIN + " (two slopes, overload stop)"),
    ),
    "length_label": (
        ("o", "none needed"),
        ("o (1 + 0.02 (L-60))", "scale's own gain; ISO 230-2:2014"),
        ("o (1 +- 0.1) by mounting", "ISO 230-2:2014 (repeatability)"),
        ("o (1 + 0.12 sin(2 pi L/2.6))", "ISO 230-2:2014 (periodic error of a screw)"),
        ("o (1 + 0.37 ((L-60)/6.2)^2)", "Abbe 1890; Bryan, Precis. Eng. 1 (1979) 129"),
        ("o (0.73, from 59.3 mm on 1.31)", "ISO 230-2:2014 (joint of a scale in two sections)"),
    ),
    "camera_scale": (
        ("g", "Hartley and Zisserman, Multiple View Geometry, 2004"),
        ("g (1 + 0.012 (60-L))", "the muscle swells towards the camera; Hartley and Zisserman"),
        ("g (1 - 0.008 (60-L))", "the same, tilted the other way"),
        ("g/(1 - 0.017 (L-60))", "Faugeras, Three-Dimensional Computer Vision, 1993 (projective)"),
        ("g (1 + 0.0043 (L-60)^2)", "Fraser, ISPRS J. 52 (1997) 149 (unflat image plane)"),
    ),
    "camera_distortion": (
        ("x^3", "Brown 1966"),
        ("0.75 x^3 + 0.25 x^5", "Brown 1971 (fifth order)"),
        ("1.25 x^3/(1 + 0.25 x^2)", "Fitzgibbon, CVPR 2001 (division model)"),
        ("tan(a x) - a x", "Kannala and Brandt, IEEE PAMI 28 (2006) 1335"),
        ("0.45 x^2 + 0.55 x^3", "Conrady, MNRAS 79 (1919) 384 (decentred lens)"),
    ),
    "camera_delay": (
        ("d", "none needed"),
        ("d (1 + 0.12 sin(t/1.7))", "queue of frames; Kleinrock, Queueing Systems, 1975"),
        ("d (1 +- 0.1), period 0.9 s", "two paths of a frame"),
        ("d (0.86 + 0.28 saw(t/1.37))", "Mills, Computer Network Time Synchronization, 2006"),
        ("d (0.93 + 0.35 max(sin, 0.2)^3)", "Kleinrock 1975 (busy periods)"),
    ),
    "wear": (
        ("n", "linear trend"),
        ("log(1 + n/25)", "running in; Blau 1989"),
        ("0.6 n + 0.4 n^2", "second-order trend"),
        ("0.45 (1 - exp(-n/15)) + 0.55 n^3", "Weibull, J. Appl. Mech. 18 (1951) 293 (bathtub)"),
        ("1 - exp(-n/55)", "Mullins, Rubber Chem. Technol. 42 (1969) 339"),
    ),
}  # fmt: skip
_SAME = {
    ("supply_droop", 1): 0,
    ("transport_delay", 1): 0,
    ("pressure_gain", 2): 0,
    ("force_gain", 2): 0,
}
FORMS: tuple[Form, ...] = tuple(
    Form(effect, number, equation, source, _SAME.get((effect, number)))
    for effect, forms in _TABLE.items()
    for number, (equation, source) in enumerate(forms)
)
_HELD_OUT = {e: tuple(range(len(SEEN), len(forms))) for e, forms in _TABLE.items()}


def held_out_of(effect: str) -> tuple[int, ...]:
    """Numbers of the forms of an effect that are held out; none from outside the catalogue."""
    return _HELD_OUT.get(effect, ())
