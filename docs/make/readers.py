"""Which files are read for the reference, and where each question of a reader belongs."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from cli.protocols.plan import load_plan
from docs.make.asked import HOUSE, Recorder
from gap.mapping.mapping import read_mapping
from plant import tomlfile
from rigs.bench.rig import open_rig
from rigs.protocols.names import default_rig
from rigs.protocols.own import OwnTest, procedure_of
from rigs.protocols.registry import procedure
from rigs.rigfile.columns import QUANTITIES, load_columns
from rigs.rigfile.command_form import load_command_form
from rigs.rigfile.config import RigConfig, load_rig
from rigs.rigfile.form import load_form
from rigs.steps.custom_step import Steps
from rigs.virtual.board.joint_load import read_joint_constants
from studies.simulation.scenario import load_scenario

EXAMPLES = Path(__file__).with_name("examples")
SHIPPED = HOUSE / "configs"
NAMES = (
    # What a user names; the page shows one table for all names.
    (r"^(instruments|manual|set|get|muscles|marks)\.[^.]+", r"\1.NAME"),
    (r"^card\.channels\.[^.]+", "card.channels.NAME"),
    (r"^channels\.(inlet|outlet)_cmd", "channels.COMMAND"),
    (r"^channels\.(?!COMMAND|direction)[^.]+", "channels.NAME"),
    (r"^trials\.(slot|replicate|protocol|mounting|note|muscle)$", "trials.LABEL"),
    (r"^trials\.[a-z_]+$", "trials.NUMBER"),
    (r"\[\d+\]", "[]"),
)
FOLDERS = {"rigs": "rig", "calibrations": "calibration", "instruments": "commands",
           "plans": "plan", "own": "own", "scenarios": "scenario",
           "mappings": "mapping", "recorders": "recorder", "regulators": "regulator",
           "marks": "marks"}  # fmt: skip
"""Kind of file by the name of the folder in which it lies."""
NAMES_OF = {"recorder": (rf"^({'|'.join(QUANTITIES)})$", "QUANTITY")}
"""What a user names in one kind of file alone."""


@dataclass(frozen=True)
class Bare(OwnTest):
    """A protocol of a user's own without keys of its own."""

    def steps(self) -> Steps:
        """No step."""
        yield from ()


@dataclass(frozen=True)
class Plain(Bare):
    """Another one, so that what depends on the class shows."""


@dataclass
class Reading:
    """The recording of all readers: what is read at the moment, and what was asked."""

    protocol: str = ""
    recorder: Recorder = field(init=False)

    def __post_init__(self) -> None:
        self.recorder = Recorder(self.place)

    def place(self, source: str, code: str, table: str) -> tuple[str, str] | None:
        """Kind and table of a question."""
        if Path(code).name == "form.py":
            return "instrument", ""  # also where a rig file holds the description
        folder = Path(source).parent.name
        kind = self.protocol if folder == "protocols" else FOLDERS.get(folder, "")
        return (kind, named(kind, table)) if kind else None


def named(kind: str, table: str) -> str:
    """A table of a kind of file, with NAME for what a user names."""
    for pattern, name in (*NAMES, *((NAMES_OF[kind],) if kind in NAMES_OF else ())):
        table = re.sub(pattern, name, table)
    return table


def recorded() -> Recorder:
    """Everything that the readers ask for in the shipped files and in the examples."""
    reading = Reading()
    with reading.recorder.recording():
        for path in _files("rigs"):
            _rig(path)
        for path in _files("instruments"):
            _instrument(path)
        _protocols(reading)
        for folder, read in (("plans", load_plan), ("mappings", read_mapping)):
            for path in _files(folder):
                read(path)
        for path in _files("scenarios"):
            load_scenario(str(path))
        for path in _files("recorders"):
            load_columns(str(path))
    return reading.recorder


def _files(folder: str) -> list[Path]:
    return sorted([*(SHIPPED / folder).glob("*.toml"), *(EXAMPLES / folder).glob("*.toml")])


def _table(path: Path) -> dict[str, Any]:
    return tomlfile.loads(tomlfile.read_text(path))


def _rig(path: Path) -> None:
    config = load_rig(str(path))
    if config.virtual is not None and config.joint is not None:
        read_joint_constants(config.virtual.joint, config.source)
    if config.pressure_source.own and config.is_virtual:
        with open_rig(config):  # its driver alone knows the keys
            pass


def _instrument(path: Path) -> None:
    read: Callable[[str], object] = load_form if "quantity" in _table(path) else load_command_form
    read(str(path))


def _protocols(reading: Reading) -> None:
    """Each protocol file on two rigs of different limits, so that a bound of the rig shows."""
    for path in _files("protocols"):
        reading.protocol = str(_table(path)["protocol"])
        config = load_rig(default_rig(reading.protocol))
        for rig in (config, _wider(config)):
            procedure(reading.protocol).read(str(path), rig)
    reading.protocol = ""
    for test in (Bare, Plain):
        for rig in (load_rig("virtual"), _wider(load_rig("virtual"))):
            path = EXAMPLES / "own" / f"{test.protocol_name()}.toml"
            procedure_of(test, test.__name__).read(str(path), rig)


def _wider(config: RigConfig) -> RigConfig:
    """The rig with other limits."""
    old = config.limits
    limits = replace(
        old, pressure_kpa=old.pressure_kpa + 3.0, length_min_mm=old.length_min_mm - 0.5,
        length_max_mm=old.length_max_mm + 0.5, force_n=old.force_n + 7.0,
    )  # fmt: skip
    stage = replace(config.stage, speed_mm_s=config.stage.speed_mm_s + 1.0)
    joint = config.joint
    if joint is not None:
        joint = replace(joint, low_deg=joint.low_deg - 1.0, high_deg=joint.high_deg + 1.0)
    return replace(config, limits=limits, stage=stage, joint=joint)
