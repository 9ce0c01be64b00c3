"""The kinds of files in the order of the page, with a title and a paragraph each."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Kind:
    """A kind of file.

    Attributes:
        id: as in keys.toml.
        title: heading.
        what: one line for the list of contents.
        text: paragraph below the heading.
        group: kind whose lines hold where there is no line of its own.
        tables: order of the tables on the page; others follow as they were read.
    """

    id: str
    title: str
    what: str
    text: str
    group: str = ""
    tables: tuple[str, ...] = ()

    def order(self, table: str) -> int:
        """Position of a table on the page."""
        return self.tables.index(table) if table in self.tables else len(self.tables)


_METHOD = ("precondition", "leak_check", "settle", "measure")


def _protocol(name: str, what: str, page: str) -> Kind:
    text = (
        f"Read by `pamrig {name} --protocol FILE`; see [{page}](../use/{page}.md). The shipped "
        f"file is `{name}` (`configs/protocols/{name}.toml`)."
    )
    return Kind(name, f"Protocol: {name}", what, text, "protocol", _METHOD)


KINDS: tuple[Kind, ...] = (
    Kind(
        "rig", "Rig file", "the devices of a bench, their ports, calibrations and limits",
        "Named with `--rig FILE`. `configs/rigs` holds the shipped files; "
        "`virtual-instruments.toml` has every optional instrument. The protocol that each device "
        "speaks is in [instruments](instruments.md). `[effects.NAME]` and `[virtual.plant]` have "
        "the keys of [effects](#effects) and of a [plant file](#plant-file).",
        "",
        ("limits", "conditions", "joint", "valve", "valve_b", "pressure_source", "balance",
         "load_cell", "stage", "camera", "camera.sync", "camera.settings", "calibrations",
         "calibrations.pressure_kpa", "calibrations.pressure_b_kpa", "calibrations.force_n",
         "calibrations.length_mm", "thermometer", "flow", "pressure_transmitter", "supply",
         "instruments.NAME", "channels.NAME", "card", "card.channels.NAME", "card.output",
         "manual.NAME", "load",
         "operator", "virtual", "virtual.joint", "virtual.regulator", "virtual.sensors"),
    ),
    Kind(
        "firmware", "Firmware parameters", "settings of the valve controller",
        "In `[valve.parameters]` and `[valve_b.parameters]` of a rig file, and in "
        "`[controller.parameters]` and `parameters` of a scenario. Counts are those of the 12-bit "
        "converter; `_x16` means sixteenths of a count. See the [wire format](wire-format.md).",
    ),
    Kind(
        "calibration", "Calibration file", "offset, scale and uncertainty of one sensor",
        "Written by `pamrig calibrate`, named by `calibration = \"FILE\"` in a rig file. "
        "value = offset + scale · reading; uncertainties are standard uncertainties (k = 1).",
    ),
    Kind(
        "camera-calibration", "Camera calibration file", "scale, lens and depth of a camera",
        "Written by `pamrig calibrate camera`, named by `camera.calibration` in a rig file; TOML "
        "or JSON. See [length](../use/length.md).",
    ),
    Kind(
        "gauges", "Gauge-block table", "pictures of known lengths, for a camera's calibration",
        "Read by `pamrig calibrate camera`; a CSV file with the same columns serves as well.",
    ),
    Kind(
        "regulator", "Regulator calibration file", "dynamics of a proportional regulator",
        "Written by `pamrig calibrate regulator`, named by `pressure_source.dynamics` in a rig "
        "file. It holds for regulator, line and muscle as mounted. See "
        "[regulators](../use/regulators.md#dynamics).",
        "", ("values", "standard_uncertainties"),
    ),
    Kind(
        "marks", "Marks file", "printed markers whose pose is measured",
        "Read by `pamrig pose --marks FILE`, named by `camera.marks` in a rig file. NAME is the "
        "name of a marker. See [pose](../use/pose.md#marks).",
    ),
    Kind(
        "pose-camera", "Pose camera file", "focal length, lens and plane of a camera",
        "Written by `pamrig calibrate pose`, named by `camera` in a [marks file](#marks-file).",
    ),
    Kind(
        "instrument", "Instrument description", "lines of an instrument that gives readings",
        "Named by `form` in a rig file, or written into the instrument's table there. The shipped "
        "files are in `configs/instruments`. See [instruments](instruments.md).",
    ),
    Kind(
        "commands", "Command description", "lines of an instrument that is set",
        "Named by `form` in the table of the device, such as `[supply]`. See "
        "[extending](extending.md#an-instrument-by-description).",
        "", ("set.NAME", "get.NAME"),
    ),
    Kind(
        "recorder", "Recorder file", "a controller of your own that prints columns",
        "Read by `pamrig record FILE`; the shipped file is `own-controller` "
        "(`configs/recorders/own-controller.toml`). QUANTITY is pressure_kpa, force_n, length_mm "
        "or temperature_c. See [own controller](../use/own-controller.md).",
        "", ("QUANTITY", "setpoint"),
    ),
    _protocol("isometric", "length held, pressure stepped, force read", "isometric"),
    _protocol("isobaric", "pressure held, length stepped, force read", "isobaric"),
    _protocol("isotonic", "load hung, pressure stepped, length read", "isotonic"),
    _protocol("isothermal", "isometric and isobaric trials over temperatures", "isothermal"),
    _protocol("hysteresis", "cycles up and down", "hysteresis"),
    _protocol("blocked-force", "slack length held, pressure stepped", "blocked-force"),
    _protocol("free-contraction", "almost no load, pressure stepped", "blocked-force"),
    _protocol("creep", "pressure and load held, length read over time", "creep"),
    _protocol("relaxation", "length and pressure held, force read over time", "creep"),
    _protocol("dynamic", "sines and sweeps of the pressure", "dynamic"),
    _protocol("fatigue", "many cycles between two pressures", "fatigue"),
    _protocol("switching-time", "switching times of a valve", "valve-tests"),
    _protocol("switching-voltage", "switching voltages of a valve", "valve-tests"),
    _protocol("flow", "air velocity against pressure", "valve-tests"),
    _protocol("step", "steps of pressure by several schemes", "valve-tests"),
    _protocol("ram", "moves of a ram between proximity switches", "valve-tests"),
    _protocol("joint-static", "angle, torque and stiffness of a joint", "joint"),
    _protocol("joint-step", "steps of the pressures of both muscles of a joint", "joint"),
    Kind(
        "own", "Protocol of your own", "keys that every protocol written in Python has",
        "In addition to these, the fields of the class are keys; see "
        "[own protocols](../use/own-protocols.md).",
        "protocol", _METHOD,
    ),
    Kind(
        "plan", "Plan file", "a sequence of tests",
        "Run with `pamrig plan FILE`; see [records](../use/records.md).",
    ),
    Kind(
        "scenario", "Scenario", "plant, load, muscles and commands of a simulation",
        "Run with `pamrig simulate FILE`; the shipped files are in `configs/scenarios`. See "
        "[simulation](../use/simulation.md). `[plant]` and `plant` have the keys of a "
        "[plant file](#plant-file), `[effects.NAME]` and `effects` those of [effects](#effects), "
        "`load.arm` those of an [arm](#arm).",
        "", ("load", "load.joint[]", "controller", "muscle[]", "command[]", "measure[]", "sensors"),
    ),
    Kind(
        "plant", "Plant file", "constants of a bench",
        "The nominal constants are `configs/plant/thesis.toml`, which states every key. "
        "`bench.toml` of a dataset, `--plant FILE`, a valve block (`configs/plant/valves`) and the "
        "tables `plant` of rig files and scenarios state those that differ. `bench.toml` and "
        "`--plant FILE` may also hold [effects](#effects), and `bench.toml` "
        "[empirical corrections](#empirical-correction). See [nominal plant](plant.md).",
    ),
    Kind(
        "effects", "Effects", "effects that are added to the nominal plant",
        "In rig files, scenarios, plant files and simulator descriptions. See "
        "[effects](effects.md).",
    ),
    Kind(
        "empirical", "Empirical correction", "a correction without a physical cause",
        "Written by `pamrig gap shrink` into a plant file; NAME is the corrected reading: force, "
        "load, pressure or camera. See [gap](../use/gap.md).",
    ),
    Kind(
        "arm", "Arm", "links and joints",
        "The shipped files are in `configs/plant/links`. See [links](../use/links.md).",
    ),
    Kind(
        "finger", "Finger", "an arm with pairs of muscles",
        "The shipped file is `configs/plant/fingers/finger.toml`. "
        "See [control](../use/control.md).",
    ),
    Kind(
        "model", "Model file", "a force law with fitted values",
        "Written by `pamrig fit`; the shipped files are in `configs/plant/models`. "
        "See [models](../use/models.md).",
    ),
    Kind(
        "mapping", "Mapping file", "columns of data files of other programs",
        "Read by `pamrig import data`; see [import data](../use/import-data.md). NAME below "
        "`[channels]` is supply_kpa, pressure_kpa, length_mm, force_n or temperature_c; COMMAND is "
        "inlet_cmd or outlet_cmd; LABEL is slot, replicate, protocol, mounting, note or muscle; "
        "NUMBER is one of the other keys of `[trials]`.",
        "", ("source", "companion", "time", "join", "channels.NAME", "channels.NAME.time",
             "channels.COMMAND", "channels.COMMAND.time", "channels.direction", "cut", "cut.edges",
             "cut.cycles",
             "trials", "trials.LABEL", "trials.NUMBER", "muscles.NAME"),
    ),
    Kind(
        "uncertainty", "Calibration uncertainties", "`calibration.toml` of a dataset",
        "Standard uncertainties (k = 1) of what all trials share; see "
        "[dataset format](dataset-format.md).",
    ),
    Kind(
        "simulator", "Simulator description", "a simulator of your own for the diagnosis",
        "Named with `--simulator FILE`; see [your simulator](../use/your-simulator.md). The keys "
        "of another kind than that of the file are refused.",
        "", ("parameters.NAME", "covariance", "inputs", "variables.NAME"),
    ),
)  # fmt: skip
