"""The mapping file: what each column of somebody's files is in the dataset format.

`docs/use/import-data.md` describes every key. Reading is strict: a key that is not known, or of
another type, stops with the file and the key.
"""

from __future__ import annotations

import math
import re
import tomllib
from collections.abc import Mapping as MappingOf
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from gap.data.dataset import CALIBRATION
from gap.data.trial import CHANNELS, COMMANDS
from gap.errors import GapError
from gap.mapping.formats.opened import FORMATS
from gap.mapping.formats.text import DELIMITERS, TextLayout
from gap.mapping.join import Join, read_join
from gap.mapping.section import Section
from gap.mapping.units import (
    DIMENSION,
    ISO,
    RELATIVE,
    SIGNALS,
    conversion,
    spelled,
    time_factor_ns,
)
from plant import tomlfile

CUTS = ("file", "column", "gaps", "edges", "cycles")
LABELS = ("slot", "replicate", "protocol", "mounting", "note", "muscle")
FACTS = ("held_length_mm", "load_kg", "temperature_c", "tare_length_mm")
_PLACE = re.compile(r"\{([a-z][a-z0-9_]*)\}")
_STEM = "stem"
LONGEST_S = 3.0e9
"""Largest time, in s: 64 bits hold three times as many nanoseconds. 1970 is half as far away."""
LARGEST_BIT = 52
SHORTEST_PERIOD_MS, LONGEST_PERIOD_MS = 0.1, 60e3
"""Periods of a pulsed valve."""


@dataclass(frozen=True)
class TimeBase:
    """Where the times of a column come from: one of column, rate, or the file itself.

    Attributes:
        column: name of the column of times, in `unit`; "" for none.
        rate_hz: samples a second, from the first row; None where not stated.
        own: times that the file stores with its values (TDMS waveform, MCAP log time).
        settled: there is no time: rows are settled points.
        offset_s: added to all times.
    """

    column: str = ""
    unit: str = "s"
    rate_hz: float | None = None
    own: bool = False
    settled: bool = False
    offset_s: float = 0.0


@dataclass(frozen=True)
class Stream:
    """One column of the main file, or of another `file`, with a time base of its own if stated."""

    column: str
    file: str = ""
    time: TimeBase | None = None


@dataclass(frozen=True)
class State:
    """A column that says on or off: 0 or 1, a bit of a number, certain values, or a threshold.

    Attributes:
        span: or how far: the values at which a valve is told to be shut and wholly open.
        pwm_period_ms: the share of that way is the duty of pulses of this period.
    """

    stream: Stream
    bit: int | None = None
    on: tuple[str | float, ...] | None = None
    above: float | None = None
    span: tuple[float, float] | None = None
    pwm_period_ms: float | None = None


@dataclass(frozen=True)
class Measured:
    """A measured channel: value = sign x scale x cell + offset, in `unit`.

    Attributes:
        name: of the dataset format.
        signal: unit of the cell where that is a signal (V); for the summary.
        gauge: False for absolute pressures, from which `ambient_kpa` is taken.
        absent: cells that stand for no measurement.
        gaps: whether a cell may be empty (no sample at that time).
    """

    name: str
    stream: Stream
    unit: str
    signal: str = ""
    factor: float = 1.0
    addend: float = 0.0
    gauge: bool = True
    ambient_kpa: float = 0.0
    rest_length_mm: float | None = None
    absent: tuple[float, ...] = ()
    gaps: bool = False


@dataclass(frozen=True)
class Direction:
    """The way settled points were gone: cells that stand for up and for down."""

    stream: Stream
    up: tuple[str | float, ...]
    down: tuple[str | float, ...]


@dataclass(frozen=True)
class Fact:
    """A number of a trial: fixed, of a column, or of a name in the file's name."""

    value: float | None = None
    column: str = ""
    name: str = ""
    unit: str = ""


@dataclass(frozen=True)
class Label:
    """A text of a trial: with {names} of the file's name, or of a column."""

    text: str = ""
    column: str = ""


@dataclass(frozen=True)
class Cut:
    """How a recording is cut into trials, one way after the other.

    Attributes:
        by: of `CUTS`.
        columns: a new value in any of these begins a trial (by "column").
        ignore: values of these columns that belong to no trial.
        gap_s: a longer pause of all channels ends a trial (by "gaps").
        edges: a command or another column (by "edges").
        edge: rise, fall, both or change.
        before_s: part of the trial before its edge.
        cycles: channel whose turning points are looked for (by "cycles").
        hysteresis: smallest swing that counts, in the unit of that channel.
        start: "low" or "high": the turning points at which a cycle begins.
        ends: "drop" or "keep" of what is no whole cycle at either end.
        replicates: whether the parts of one recording are replicates of one setting.
    """

    by: tuple[str, ...] = ("file",)
    columns: tuple[str, ...] = ()
    ignore: tuple[str, ...] = ()
    gap_s: float = 0.0
    edges: State | None = None
    edge: str = "rise"
    before_s: float = 0.0
    cycles: str = ""
    hysteresis: float = 0.0
    start: str = "low"
    ends: str = "drop"
    replicates: bool = False


@dataclass(frozen=True)
class Muscle:
    """What is stated of one muscle: constants of its bench, calibrations, rest length."""

    bench: MappingOf[str, Any] = field(default_factory=dict)
    calibration: MappingOf[str, Any] = field(default_factory=dict)
    rest_length_mm: float | None = None


@dataclass(frozen=True)
class Mapping:
    """A mapping file.

    Attributes:
        path: of the mapping file.
        files: patterns of the main files, with {names} and `*`.
        kind: format of all files; "" to go by their names.
        layout: of text files.
        time: time base of all channels that state none.
        channels, commands, direction: what is measured and commanded.
        cut: how recordings become trials.
        order: "files", "rows", "time" or "unknown".
        labels, facts: columns of trials.csv.
        common: what holds for all muscles.
        muscles: what holds for one, by its name.
        companion: format and layout of the files that only channels name; None for those above.
        join: how the clock of a companion file is joined to that of the main file.
    """

    path: Path
    text: str
    files: tuple[str, ...]
    kind: str
    layout: TextLayout
    time: TimeBase
    channels: tuple[Measured, ...]
    commands: MappingOf[str, State]
    direction: Direction | None
    cut: Cut
    order: str
    labels: MappingOf[str, Label]
    facts: MappingOf[str, Fact]
    common: Muscle
    muscles: MappingOf[str, Muscle]
    join: Join | None = None
    companion: tuple[str, TextLayout] | None = None

    def rest_length_mm(self, channel: Measured, muscle: str) -> float | None:
        """Rest length that a contraction in this channel refers to."""
        own = self.muscles.get(muscle, Muscle()).rest_length_mm
        return next(
            (r for r in (own, channel.rest_length_mm, self.common.rest_length_mm) if r is not None),
            None,
        )


def read_mapping(path: Path) -> Mapping:
    """Read a mapping file.

    Raises:
        GapError: names the file and the key, what came and what was expected.
    """
    try:
        text = tomlfile.read_text(path)
        table = tomlfile.loads(text)
    except OSError as error:
        raise GapError(str(path), f"cannot be read: {error.strerror}") from None
    except (UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise GapError(str(path), f"cannot be read as TOML ({error})") from None
    root = Section(table, str(path))
    source = _required(root, "source")
    files = source.texts("files")
    if not files:
        raise source.error("files", "is missing", "the data files, for example '*.csv'")
    names = _names_of(source, files)
    kind, layout = _kind(source), _layout(source)
    source.close()
    companion = _companion(root.table("companion"))
    common = _muscle(root)
    muscles = _muscles(root)
    base = root.table("time")
    time = _time(base) if base is not None else TimeBase(own=True)
    channels, commands, direction = _channels(_required(root, "channels"), time, names)
    labels, facts, order = _trials(root.table("trials"), names)
    cut = _cut(root.table("cut"), time, channels, names)
    join = _join(root, time, channels)
    root.close()
    mapping = Mapping(
        path, text, files, kind, layout, time, channels, commands, direction, cut, order,
        labels, facts, common, muscles, join, companion,
    )  # fmt: skip
    _check_rest_lengths(mapping, root)
    _check_valves(mapping)
    return mapping


def _check_valves(mapping: Mapping) -> None:
    """A command that opens a valve part of the way is that of a proportional valve."""
    known = [one.bench.get("valve") for one in (mapping.common, *mapping.muscles.values())]
    for name, state in mapping.commands.items():
        if state.span and not state.pwm_period_ms and "proportional" not in known:
            raise GapError(
                f"{mapping.path}: channels.{name}.open", "is for a proportional valve",
                'state valve = "proportional" in [bench]; of an on/off valve, pwm_period_ms',
            )  # fmt: skip


def _join(root: Section, time: TimeBase, channels: tuple[Measured, ...]) -> Join | None:
    """The join of two clocks; both channels must be there, one of them in another file."""
    join = read_join(root.table("join"))
    if join is None:
        return None
    files = {channel.name: channel.stream.file for channel in channels}
    for key, name in (("channel", join.channel), ("to", join.to)):
        if name not in files:
            raise GapError(root.where(f"join.{key}"), f"{name!r} is not a channel of this mapping")
    if time.settled:
        raise GapError(root.where("join"), "settled points have no time")
    if not files[join.channel] or files[join.to]:
        raise GapError(
            root.where("join.channel"), f"{join.channel} must be of another file, {join.to} not",
            "state channels.NAME.file",
        )  # fmt: skip
    return join


def _required(root: Section, key: str) -> Section:
    found = root.table(key)
    if found is None:
        raise root.missing(key, f"a table [{key}]")
    return found


def _names_of(source: Section, files: tuple[str, ...]) -> set[str]:
    """Names that every pattern of files has."""
    for pattern in files:
        if Path(pattern).is_absolute() or ".." in Path(pattern).parts or "\\" in pattern:
            what = f"{pattern!r} leads out of the folder of the data"
            raise source.error("files", what, "state the folder with --from")
        if re.search(r"[{}]", _PLACE.sub("", pattern)):
            raise source.error("files", f"{pattern!r}: expected names like {{muscle}}")
    each = [set(_PLACE.findall(pattern)) for pattern in files]
    if any(_STEM in names for names in each):
        raise source.error("files", "{stem} is the file's own name", "choose another name")
    return set.intersection(*each) | {_STEM}


def _kind(source: Section) -> str:
    kind = source.text("type")
    if kind and kind not in FORMATS:
        raise source.error("type", f"{kind!r} is not one of {', '.join(FORMATS)}")
    return kind


def _companion(table: Section | None) -> tuple[str, TextLayout] | None:
    """Format and layout of companion files, where they are not those of the main files."""
    if table is None:
        return None
    made = _kind(table), _layout(table)
    table.close()
    return made


def _layout(source: Section) -> TextLayout:
    usual = TextLayout()
    layout = TextLayout(
        delimiter=source.choice("delimiter", (*DELIMITERS, "auto"), "auto").replace("auto", ""),
        decimal=source.choice("decimal", ("point", "comma"), usual.decimal),
        header=source.flag("header", usual.header),
        header_begins=source.text("header_begins"),
        units=source.flag("units"),
        comment=source.text("comment"),
        skip_lines=source.count("skip_lines", 0) or 0,
        skip_after_header=source.count("skip_after_header", 0) or 0,
        encoding=source.choice("encoding", ("utf-8", "latin-1", "cp1252", "utf-16"), "utf-8"),
        missing=source.texts("missing", usual.missing),
    )
    if not layout.header and (layout.units or layout.header_begins):
        key = "units" if layout.units else "header_begins"
        raise source.error(key, "there is no header", "remove header = false")
    if layout.header_begins and layout.skip_lines:
        raise source.error("header_begins", "skip_lines says where the table begins", "keep one")
    return layout


def _time(table: Section, within: bool = False) -> TimeBase:
    """A time base; `within` a channel it may not say that there is no time."""
    column = table.column()
    rate = table.positive("rate_hz")
    own = table.flag("own")
    settled = False if within else table.flag("settled")
    given = [bool(column), rate is not None, own, settled]
    if sum(given) != 1:
        words = "column, rate_hz or own" + ("" if within else ", or settled")
        raise table.error("", f"expected one of {words}, got {sum(given)} of them")
    unit = table.text("unit", "" if column else "s", required=bool(column))
    if unit != ISO:
        time_factor_ns(unit, table.where("unit"))
    offset = table.number("offset_s", 0.0) or 0.0
    if settled and offset:
        raise table.error("offset_s", "settled points have no time")
    if abs(offset) > LONGEST_S:
        raise table.error("offset_s", f"{offset:g} s is not a plausible time")
    table.close()
    return TimeBase(column, unit, rate, own, settled, offset)


def _stream(table: Section, names: set[str]) -> Stream:
    file = table.text("file")
    _check_places(table, "file", file, names)
    if file and (Path(file).is_absolute() or ".." in Path(file).parts or "*" in file):
        raise table.error("file", f"{file!r} is not the name of one file within the data's folder")
    own = table.table("time")
    return Stream(
        table.column(required=True), file, _time(own, within=True) if own is not None else None
    )


def _check_places(table: Section, key: str, text: str, names: set[str]) -> None:
    for name in _PLACE.findall(text):
        if name not in names:
            known = ", ".join(f"{{{n}}}" for n in sorted(names))
            raise table.error(key, f"{{{name}}} is not a name in source.files", f"known: {known}")


def _channels(
    table: Section, time: TimeBase, names: set[str]
) -> tuple[tuple[Measured, ...], dict[str, State], Direction | None]:
    channels: list[Measured] = []
    commands: dict[str, State] = {}
    direction: Direction | None = None
    for name in table.keys:
        if name not in (*CHANNELS, *COMMANDS, "direction"):
            continue  # `close` refuses it, with the nearest name
        one = _required(table, name)
        if name in COMMANDS:
            commands[name] = _command(one, names)
        elif name == "direction":
            if not time.settled:
                raise one.error("", "is for settled points; here the times show it")
            up, down = one.scalars("up") or ("up",), one.scalars("down") or ("down",)
            direction = Direction(_stream(one, names), up, down)
        else:
            channels.append(_measured(name, one, names))
        one.close()
    for name in (*CHANNELS, *COMMANDS, "direction"):
        _ = name in table
    table.close()
    if not channels:
        raise table.error("", "has no measured channel", f"expected some of {', '.join(CHANNELS)}")
    if commands and time.settled:
        raise table.error(next(iter(commands)), "settled points have no commands in time")
    seen: dict[tuple[str, str], str] = {}
    for channel in channels:
        key = (channel.stream.file, channel.stream.column)
        if key in seen:
            what = f"is the column of {seen[key]} as well"
            raise table.error(f"{channel.name}.column", what, "each channel has its own column")
        seen[key] = channel.name
        if time.settled and channel.stream.time is not None:
            raise table.error(f"{channel.name}.time", "settled points have no time")
    return tuple(channels), commands, direction


def _command(table: Section, names: set[str]) -> State:
    """A command of a valve: a state, or how far it is to open."""
    state = _state(table, names)
    shut, wide = table.number("shut"), table.number("open")
    period = table.positive("pwm_period_ms")
    if shut is None and wide is None and period is None:
        return state
    if shut is None or wide is None:
        key = "shut" if shut is None else "open"
        raise table.error(key, "is missing", "state the values of shut and of wholly open")
    if period is not None and not SHORTEST_PERIOD_MS <= period <= LONGEST_PERIOD_MS:
        raise table.error(
            "pwm_period_ms",
            f"{period:g} ms; allowed {SHORTEST_PERIOD_MS:g} to {LONGEST_PERIOD_MS:g}",
            "pulses that a valve cannot follow are the command of a proportional valve",
        )
    if shut == wide:
        raise table.error("open", f"is {wide:g}, as shut is")
    if any(given is not None for given in (state.bit, state.on, state.above)):
        raise table.error("open", "expected at most one of bit, on, above, and shut with open")
    return replace(state, span=(shut, wide), pwm_period_ms=period)


def _state(table: Section, names: set[str]) -> State:
    bit, on, above = table.count("bit"), table.scalars("on"), table.number("above")
    if sum(given is not None for given in (bit, on, above)) > 1:
        raise table.error("", "expected at most one of bit, on and above")
    if bit is not None and bit > LARGEST_BIT:
        raise table.error("bit", f"expected 0 to {LARGEST_BIT}, got {bit}")
    return State(_stream(table, names), bit, on, above)


def _measured(name: str, table: Section, names: set[str]) -> Measured:
    unit = table.text("unit", required=True)
    signal, given = "", unit
    scale, offset = table.number("scale"), table.number("offset")
    sign = table.number("sign", 1.0)
    if sign not in (1.0, -1.0):
        raise table.error("sign", f"expected 1 or -1, got {sign:g}")
    gives = table.text("gives")
    if spelled(unit) in SIGNALS:
        if scale is None or not gives:
            key = "scale" if scale is None else "gives"
            raise table.error(key, f"is missing: {unit} needs scale, offset and gives (a unit)")
        signal, given = unit, gives
    elif gives:
        raise table.error("gives", f"is for signals ({', '.join(SIGNALS)}); {unit} is a unit")
    if scale == 0.0:
        raise table.error("scale", "is 0")
    dimension = DIMENSION[name]
    key = table.where("gives" if signal else "unit")
    rest = table.positive("rest_length_mm")
    conversion(given, dimension, key, rest or 1.0)  # refuses units; the rest length comes later
    gauge, ambient = True, 0.0
    if dimension == "pressure":
        gauge = table.choice("reference", ("gauge", "absolute")) == "gauge"
        if not gauge:
            ambient = table.positive("ambient_kpa", required=True) or 0.0
    absent = table.scalars("missing_values") or ()
    for value in absent:
        if isinstance(value, str):
            raise table.error("missing_values", f"expected numbers, got {value!r}")
    gaps = table.choice("empty_cells", ("refuse", "no sample"), "refuse") == "no sample"
    return Measured(
        name, _stream(table, names), given, signal, sign * (1.0 if scale is None else scale),
        offset or 0.0, gauge, ambient, rest,
        tuple(float(value) for value in absent), gaps,
    )  # fmt: skip


def _cut(
    table: Section | None, time: TimeBase, channels: tuple[Measured, ...], names: set[str]
) -> Cut:
    if table is None:
        return Cut()
    by = table.texts("by", ("file",))
    for word in by:
        if word not in CUTS:
            raise table.error("by", f"{word!r} is not one of {', '.join(CUTS)}")
        if time.settled and word in ("gaps", "edges", "cycles"):
            raise table.error("by", f"{word!r} needs times, and these are settled points")
    columns = table.columns("columns") if "column" in by else ()
    if "column" in by and not columns:
        raise table.error("columns", "is missing: which columns number the trials?")
    edges: State | None = None
    edge, before = "rise", 0.0
    if "edges" in by:
        one = _required(table, "edges")
        edge = one.choice("edge", ("rise", "fall", "both", "change"), "rise")
        before = one.number("before_s", 0.0) or 0.0
        if not 0.0 <= before <= LONGEST_S:
            raise one.error("before_s", f"expected 0 or more, got {before:g}")
        edges = _state(one, names)
        one.close()
    cycles, hysteresis, start, ends = "", 0.0, "low", "drop"
    if "cycles" in by:
        one = _required(table, "cycles")
        cycles = one.choice("channel", [channel.name for channel in channels])
        hysteresis = one.positive("hysteresis", required=True) or 0.0
        start = one.choice("start", ("low", "high"), "low")
        ends = one.choice("ends", ("drop", "keep"), "drop")
        one.close()
    parts = table.choice(
        "parts", ("replicates", "settings"), "replicates" if "cycles" in by else "settings"
    )
    gap_s = table.positive("gap_s", required=True) if "gaps" in by else 0.0
    cut = Cut(
        by, columns, table.texts("ignore", (), empty=True) if "column" in by else (),
        gap_s or 0.0, edges, edge, before, cycles, hysteresis, start, ends, parts == "replicates",
    )  # fmt: skip
    table.close()
    return cut


def _trials(
    table: Section | None, names: set[str]
) -> tuple[dict[str, Label], dict[str, Fact], str]:
    if table is None:
        return {}, {}, "auto"
    labels: dict[str, Label] = {}
    facts: dict[str, Fact] = {}
    for name in LABELS:
        value = table.value(name)
        if isinstance(value, dict):
            one = _required(table, name)
            labels[name] = Label(column=one.column(required=True))
            one.close()
        elif value is not None:
            text = table.text(name)
            _check_places(table, name, text, names)
            labels[name] = Label(text=text)
    for name in FACTS:
        value = table.value(name)
        if isinstance(value, dict):
            facts[name] = _fact(name, _required(table, name), names)
        elif value is not None:
            facts[name] = Fact(value=table.number(name))
    order = table.choice("order", ("files", "rows", "time", "unknown", "auto"), "auto")
    table.close()
    return labels, facts, order


def _fact(name: str, table: Section, names: set[str]) -> Fact:
    column, place = table.column(), table.text("name")
    if bool(column) == bool(place):
        raise table.error("", "expected either column or name")
    if place:
        _check_places(table, "name", f"{{{place}}}", names)
    unit = table.text("unit", required=True)
    conversion(unit, DIMENSION[name], table.where("unit"), None)
    if spelled(unit) in RELATIVE:
        raise table.error("unit", f"{unit!r}: state a length")
    table.close()
    return Fact(column=column, name=place, unit=unit)


def _muscle(table: Section) -> Muscle:
    calibration = table.raw("calibration")
    for key, value in calibration.items():
        where = table.where(f"calibration.{key}")
        if key not in CALIBRATION:
            raise GapError(where, "unknown key", f"known: {', '.join(CALIBRATION)}")
        if not _is_number(value):
            raise GapError(where, f"expected a number, got {value!r}")
    bench = table.raw("bench")
    _check_bench(bench, table.where("bench"))
    return Muscle(bench, calibration, table.positive("rest_length_mm"))


def _is_number(value: object) -> bool:
    number = isinstance(value, (int, float)) and not isinstance(value, bool)
    return number and math.isfinite(value)  # type: ignore[arg-type]


def _check_bench(table: MappingOf[str, Any], where: str) -> None:
    """Refuse what no bench.toml holds; the plant checks names and ranges when it is read back."""
    for key, value in table.items():
        if isinstance(value, dict):
            _check_bench(value, f"{where}.{key}")
        elif not _is_number(value) and not isinstance(value, (str, bool)):
            raise GapError(f"{where}.{key}", f"expected a number or a text, got {value!r}")


def _muscles(root: Section) -> dict[str, Muscle]:
    table = root.table("muscles")
    if table is None:
        return {}
    made = {}
    for name in table.keys:
        one = _required(table, name)
        made[name] = _muscle(one)
        one.close()
    return made


def _check_rest_lengths(mapping: Mapping, root: Section) -> None:
    """A contraction needs a rest length: of the channel, of all muscles, or of each."""
    for channel in mapping.channels:
        if spelled(channel.unit) not in RELATIVE:
            continue
        if mapping.muscles and all(m.rest_length_mm for m in mapping.muscles.values()):
            continue
        where = root.where(f"channels.{channel.name}.rest_length_mm")
        conversion(channel.unit, "length", where, mapping.rest_length_mm(channel, ""))
