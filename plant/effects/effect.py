"""What a file of the catalogue says of one effect, and the functions by which it acts.

One file defines one effect for all who use it: the compiled plant and its form for arrays
(`InPlant`), the readings of the sensors (`InSensors`), the diagnosis (`InDiagnosis`, `Search`) and
the page of the catalogue (the other fields of `Effect`).

Order of application. Effects of the same step follow each other in the order of the catalogue.

    muscle   push, threads, inner       what the formula of the braid gets for p, b and L
             scale                      change of the braid's force
             add                        force beside the braid
             transient                  force that depends on speed or on the past
    gas      upstream, outward          pressure before the inlet, conductance to the atmosphere
    load     mass, drag                 what hangs, and what rubs
    sensors  camera, camera_delay, pressure, force, supply

Functions are plain Python. Those of `InPlant` are compiled into the kernel as they stand and are
called with arrays as well: no branch on anything but `params`, `np.maximum` instead of `max`.
`params` and `state` are the arrays of `plant.physics.layout`; pressures are gauge Pa, lengths m,
forces N, temperatures K, times s, unless a name says otherwise.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from plant.constants import PlantConstants
from plant.effects.arguments import Array, Context, Params, Points, Shape, Values
from plant.effects.standards import Standard


@dataclass(frozen=True)
class Parameter:
    """One parameter of an effect: a number within bounds, or a word out of `choices`.

    `name`, `unit` and `meaning` are shown to users; `low` and `high` are the bounds of a number.
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
class InPlant:
    """What an effect adds to the plant. All functions may be left out.

    The first argument of a function is the value so far, which it returns changed.

    Attributes:
        slots: (values, constants) -> slots of the parameter array that differ from the nominal
            ones. Raises `PlantError` where the effect cannot be.
        push: (push, params, p) -> pressure that reaches the braid.
        threads: (b, params, p) -> length of the braid's threads.
        inner: (inner, params, length) -> length that counts for the force.
        scale: (pull, params, p, length, temperature, trials, braid) -> force of the braid;
            `braid(params, p, length)` is that without any scale.
        add: (pull, params, p, length) -> force that stays while nothing moves.
        transient: (pull, state, params, p, length, rate) -> force in all. `state` is that at the
            beginning of the step which ends at `p` and `length`.
        stiffness: (bound, params, p, length) -> bound on |dF/dL| in N/m, for the step size.
        damping: (bound, params, p, rate) -> bound on |dF/dv| in N s/m, for the step size.
        slide: (state, params, dp, dlength) updates `state` after a change of pressure and length.
        follow: (state, params, p0, pull0, pull, duration) updates `state` after a step in which
            pressure and lasting force ran straight. Needs the slot REMEMBERS.
        upstream: (supply, params, absolute) -> absolute pressure before the open inlet;
            `absolute` is that in the muscle.
        outward: (conductance, params) -> conductance in m3/(s Pa) to the atmosphere.
        mass: (mass, params) -> kg that hang.
        drag: (drag, state, params, length) -> friction against a lengthening load.
        drag_stiffness: (bound, params) -> bound on its slope in N/m, for the step size.
    """

    slots: Callable[[Values, PlantConstants], Mapping[int, float]] | None = None
    push: Callable[[Array, Params, Array], Array] | None = None
    threads: Callable[[Array, Params, Array], Array] | None = None
    inner: Callable[[Array, Params, Array], Array] | None = None
    scale: Callable[[Array, Params, Array, Array, Array, Array, Any], Array] | None = None
    add: Callable[[Array, Params, Array, Array], Array] | None = None
    transient: Callable[[Array, Params, Params, Array, Array, Array], Array] | None = None
    stiffness: Callable[[float, Params, float, float], float] | None = None
    damping: Callable[[float, Params, float, float], float] | None = None
    slide: Callable[[Params, Params, float, float], None] | None = None
    follow: Callable[[Params, Params, float, float, float, float], None] | None = None
    upstream: Callable[[float, Params, float], float] | None = None
    outward: Callable[[float, Params], float] | None = None
    mass: Callable[[float, Params], float] | None = None
    drag: Callable[[float, Params, Params, float], float] | None = None
    drag_stiffness: Callable[[float, Params], float] | None = None

    @property
    def on_force(self) -> bool:
        """Whether it changes the force of the muscle."""
        hooks = (self.push, self.threads, self.inner, self.scale, self.add, self.transient)
        return any(hook is not None for hook in hooks)


@dataclass(frozen=True)
class InSensors:
    """What an effect adds to readings. `amount` is the value of the headline parameter.

    Attributes:
        pressure: (amount) -> gain and zero in kPa: read = true (1 + gain) + zero.
        pressure_bent: (true Pa, values) -> Pa that a scale which changes over the range reads
            beyond a straight one.
        scale_changes: (values) -> whether there is any.
        force: (amount) -> gain and zero in N.
        force_bent: as `pressure_bent`, N.
        camera: (true length, values, constants) -> read minus true length. Raises `PlantError`.
        camera_delay: (amount) -> s by which the time stamps of frames are late.
        held: (written length, values, constants) -> true minus written length of a muscle that is
            held, m.
        supply: (supply, inside, params, values) -> Pa by which the supply channel shows less,
            for absolute pressures of supply and muscle while the inlet is open.
    """

    pressure: Callable[[float], tuple[float, float]] | None = None
    pressure_bent: Callable[[Array, Values], Array] | None = None
    scale_changes: Callable[[Values], bool] | None = None
    force: Callable[[float], tuple[float, float]] | None = None
    force_bent: Callable[[Array, Values], Array] | None = None
    camera: Callable[[Array, Values, PlantConstants], Array] | None = None
    camera_delay: Callable[[float], float] | None = None
    held: Callable[[Array, Values, PlantConstants], Array] | None = None
    supply: Callable[[float, float, Params, Values], float] | None = None


@dataclass(frozen=True)
class InDiagnosis:
    """What an effect adds to the diagnosis's prediction from measured inputs.

    `amount` is that of the headline parameter beyond `Effect.neutral`, in the headline's unit, or
    1 for an effect that is there or not. All functions may be left out.

    Attributes:
        length: (points, amount, shape, constants) -> m, true minus read or written length.
        camera: (true length, amount, shape, constants) -> m, read minus true, at all times alike.
        camera_bends: whether `camera` is no straight line of the length.
        pressure: (p, points, amount, shape) -> true pressure before gain and zero of the gauge.
        lost: (p, amount, shape) -> pressure that does not reach the braid.
        shortened: (p, length, amount, shape, constants) -> m that the inner length is shorter.
        stretch: (p, length, amount, shape, constants) -> relative lengthening of the threads.
        force: (points, p, length, base, shape, context) -> force for an amount of one; `base` is
            the force of the braid.
        at_rest: whether `force` needs neither pressure nor a past, so that a tare takes it away.
        force_linearity: (force, amount, shape, context) -> N by which a reading is off because the
            scale changes over the range. A shape without numbers is a straight scale.
        pressure_linearity: the same for a gauge, Pa.
        force_shown: (force, points, amount) -> force after what the record does to it.
        pressure_shown: (pressure, points, amount) -> pressure after what the record does to it.
        mass: (points, amount, shape, constants) -> kg beside the stated load.
        drag: (points, shape) -> friction of the load for an amount of one.
        drag_range: (points, shape) -> the least and the most that it may be: a load that sticks is
            held by what it takes. It counts where the force above the load is read. None: `drag`.
        gas: (params, amount, option, shape) writes slots of `plant.effects.pressure_stage`.
        gas_in_trial: (params, amount, trial) adds to what one trial alone has of it; for effects
            that may differ between replicates.
        late: (amount, constants) -> s by which each stroke of the effect's edge is late.
        stated: (shape, parameters, constants) -> the shape in which a plant file states the effect;
            None: the first.
        largest_fall: whether the headline parameter is the largest fall of the supply in the
            data, which the prediction gives, and not the amount.
    """

    length: Callable[[Points, float, Shape, PlantConstants], Array] | None = None
    camera: Callable[[Array, float, Shape, PlantConstants], Array] | None = None
    camera_bends: bool = False
    pressure: Callable[[Array, Points, float, Shape], Array] | None = None
    lost: Callable[[Array, float, Shape], Array] | None = None
    shortened: Callable[[Array, Array, float, Shape, PlantConstants], Array] | None = None
    stretch: Callable[[Array, Array, float, Shape, PlantConstants], Array] | None = None
    force: Callable[[Points, Array, Array, Array, Shape, Context], Array] | None = None
    stated: Callable[[Shape, Values, PlantConstants], Shape] | None = None
    at_rest: bool = False
    force_linearity: Callable[[Array, float, Shape, Context], Array] | None = None
    pressure_linearity: Callable[[Array, float, Shape, Context], Array] | None = None
    force_shown: Callable[[Array, Points, float], Array] | None = None
    pressure_shown: Callable[[Array, Points, float], Array] | None = None
    mass: Callable[[Points, float, Shape, PlantConstants], Array] | None = None
    drag: Callable[[Points, Shape], Array] | None = None
    drag_range: Callable[[Points, Shape], tuple[Array, Array] | None] | None = None
    gas: Callable[[Params, float, str, Shape], None] | None = None
    gas_in_trial: Callable[[Params, float, int], None] | None = None
    late: Callable[[float, PlantConstants], float] | None = None
    largest_fall: bool = False


@dataclass(frozen=True)
class Growth:
    """A size that may grow with pressure: one shape is in proportion to it, another constant.

    Attributes:
        key: number of the shape that is 1 where the size is in proportion to the pressure, else 0.
        name: of the parameter that a diagnosis states, with its unit.
        unit: of the headline parameter by kPa.
        share: parameter of the plant that says which part is in proportion, as at 300 kPa.
    """

    key: str
    name: str
    unit: str
    share: str


@dataclass(frozen=True)
class Search:
    """How the diagnosis tries an effect.

    A real bench never has the form one wrote down, so each effect is tried in a few shapes (where
    its knee is, how soon it saturates, whether it scales with pressure).

    Attributes:
        step: amount at which its signature is taken.
        sign: +1 where only positive amounts make sense, 0 where both do.
        blocks: which blocks of features it can touch.
        shapes: the forms, the usual one first.
        free: numbers of a shape that a fit may move, with what a bench could have.
        fixed_by: keys of shapes none of whose numbers are moved.
        bounded: whether the range of the headline parameter bounds the amount.
        plant_shape: the shape nearest to the form of the plant, the first where None.
        plant_misfit: share of the effect that this shape leaves of the plant's form (rms).
        as_plant: (shape, context) -> parameters of the plant's form that the shape gives.
        one_shape: whether its shapes are states of the gas, of which two at once mean nothing.
        scan: "clock" or "delay" for an amount in time too large for a sensitivity to show, which
            is tried at whole values. A table of settled points shows no clock.
        settled: start and bounds of its parameters in a fit of settled points; empty where
            settled points do not show it.
        each_label: whether, in tables of settled points, each written length alone may have it:
            shapes with `only_mm`.
        growth: how its size may grow with pressure, where shapes with and without it exist.
        either: key that a shape may have as 1, if that leaves less: what was before the data.
        curve: a shape with more numbers than the others, from where its fit starts. It is tried
            where all others leave much.
    """

    step: float
    sign: int
    blocks: tuple[str, ...]
    shapes: tuple[Shape, ...] = ({},)
    free: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    fixed_by: tuple[str, ...] = ()
    bounded: bool = True
    plant_shape: Shape | None = None
    plant_misfit: float = 0.05
    as_plant: Callable[[Shape, Context], Mapping[str, float]] | None = None
    one_shape: bool = False
    scan: str = ""
    settled: Mapping[str, tuple[float, float, float]] = field(default_factory=dict)
    each_label: bool = False
    growth: Growth | None = None
    either: str = ""
    curve: Shape | None = None


def same_numbers(**parameters: str) -> Callable[[Shape, Context], Mapping[str, float]]:
    """`Search.as_plant` where the plant's form has numbers of the shape under other names."""
    return lambda shape, context: {parameters[k]: v for k, v in shape.items() if k in parameters}


@dataclass(frozen=True)
class EachTrial:
    """A small change that is drawn anew for each trial: a random error of sensor, hand or clock.

    Attributes:
        kind: what the noise model calls it.
        sd: standard deviation of the headline parameter.
        blocks: of features that it moves.
        option: the word that goes with the headline parameter.
    """

    kind: str
    sd: float
    blocks: tuple[str, ...]
    option: str = ""


@dataclass(frozen=True)
class Effect:
    """One effect: where it acts, its parameters (the headline first), how to recognise it.

    Attributes:
        id: its name in files.
        family: group of the catalogue.
        stage: of the chain at which it acts.
        summary: one line.
        parameters: the headline first.
        search: what the diagnosis needs to look for it.
        plant, sensors, diagnosis: the functions by which it acts.
        equation: what it adds to the nominal plant, in the symbols of its parameters.
        source: where that form comes from.
        untouched: what stays as it is.
        mistaken_for: effects that it can be taken for.
        constants: plant-file keys that a fit may move instead of it.
        told_apart_by: the experiment that tells it from them.
        standard: the reference standard that settles it.
        neutral: value of the headline parameter that is no effect, or the plant-file key of the
            constant that the headline parameter replaces.
        own_constant: plant-file key of the constant that the headline parameter is added to, with
            `{option}` for the word that goes with it. A fit may shift that constant instead.
        ratio: whether the headline parameter is a factor of that constant, not an addend.
        stands_for: other constants that a fit may shift instead; "mountings" for what the
            lengths of all mountings are off by in common.
        shows_as: effects that this one looks like besides where its form is not quite that of the
            bench.
        calibration: key of `calibration.toml` that states how far the effect may go unnoticed.
        each_trial: how the effect varies from trial to trial on a sound bench.
        of_braid: whether it is of a braid round a tube: a cylinder does not have it.
        reference: the standard that gives the effect by itself, and how well it gives the
            headline parameter (one sd, in its unit).
    """

    id: str
    family: str
    stage: str
    summary: str
    parameters: tuple[Parameter, ...]
    untouched: str
    mistaken_for: tuple[str, ...]
    told_apart_by: str
    equation: str
    source: str
    standard: str
    search: Search
    constants: tuple[str, ...] = ()
    neutral: float | str = 0.0
    own_constant: str = ""
    ratio: bool = False
    stands_for: tuple[str, ...] = ()
    shows_as: tuple[str, ...] = ()
    calibration: str = ""
    each_trial: tuple[EachTrial, ...] = ()
    of_braid: bool = False
    reference: tuple[Standard, float] | None = None
    plant: InPlant = InPlant()
    sensors: InSensors = InSensors()
    diagnosis: InDiagnosis = InDiagnosis()

    @property
    def headline(self) -> str | None:
        """Name of the headline parameter; None for an effect that is there or not."""
        return self.parameters[0].name if self.parameters else None

    @property
    def unit(self) -> str:
        """Unit of the headline parameter."""
        return self.parameters[0].unit if self.parameters else ""

    @property
    def options(self) -> tuple[str, ...]:
        """Words that go with the headline parameter (a side, an edge); one empty word if none."""
        return next((p.choices for p in self.parameters if p.choices), ("",))

    @property
    def option_name(self) -> str:
        """Name of the parameter whose words these are ("side", "edge"); empty if none."""
        return next((p.name for p in self.parameters if p.choices), "")

    def keys(self) -> Mapping[str, str]:
        """Key of each candidate (id, or id:option) -> its own constant, "" where it has none."""
        return {
            f"{self.id}:{o}" if o else self.id: self.own_constant.format(option=o)
            for o in self.options
        }

    def neutral_in(self, constants: PlantConstants) -> float:
        """Value of the headline parameter that is no effect on a bench of these constants."""
        if isinstance(self.neutral, str):
            return constants.value(self.neutral)
        return self.neutral

    def amount(self, values: Values, constants: PlantConstants) -> float:
        """How much of the effect these parameters are, as the diagnosis counts it.

        Args:
            values: parameters of the effect, complete.
            constants: of the plant, for an effect that replaces one of them.
        """
        if self.headline is None:
            return 1.0
        return float(values[self.headline]) - self.neutral_in(constants)
