"""One recording: a main file with its companions, its columns as channels on one clock."""

from __future__ import annotations

import re
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pandas as pd

from gap.errors import GapError
from gap.mapping.formats.opened import open_source
from gap.mapping.formats.source import Column, Source, Whole
from gap.mapping.join import Offset, clock_keys, offset_of
from gap.mapping.mapping import (
    LONGEST_S,
    Fact,
    Mapping,
    Measured,
    State,
    Stream,
    TimeBase,
)
from gap.mapping.units import DIMENSION, ISO, conversion, spelled, time_factor_ns
from plant.arrays import Array

_PLACE = re.compile(r"\{([a-z][a-z0-9_]*)\}")
Mask = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class Found:
    """A main file and what the names in its pattern stand for.

    Attributes:
        other: what they could stand for as well, where the pattern fits in another way.
    """

    path: Path
    names: dict[str, str]
    other: dict[str, str] = field(default_factory=dict)

    @property
    def doubt(self) -> str:
        """That the pattern fits in another way too, in words; empty where it does not."""
        if not self.other:
            return ""
        read, other = (
            ", ".join(f"{name} = {names[name]}" for name in self.other)
            for names in (self.names, self.other)
        )
        return f"{self.path.name}: read as {read}, but its pattern fits {other} too; rename it"

    def filled(self, text: str) -> str:
        """A text with the names put in."""
        return _PLACE.sub(lambda place: self.names[place[1]], text)


def find_files(mapping: Mapping, folder: Path) -> list[Found]:
    """Main files of a mapping, in order of their names.

    Raises:
        GapError: a pattern that no file matches, or a file that two patterns match.
    """
    found: dict[Path, Found] = {}
    for pattern in mapping.files:
        rule, longest = re.compile(_rule(pattern)), re.compile(_rule(pattern, longest=True))
        matched = []
        for path in sorted(folder.glob(_PLACE.sub("*", pattern))):
            fits = rule.fullmatch(path.relative_to(folder).as_posix())
            if fits and path.is_file():
                names = {**fits.groupdict(), "stem": path.stem}
                again = longest.fullmatch(path.relative_to(folder).as_posix())
                other = again.groupdict() if again else {}
                matched.append(Found(path, names, other if other != fits.groupdict() else {}))
        if not matched:
            raise GapError(
                f"{mapping.path}: source.files", f"no file {pattern!r} in {folder}",
                "check the pattern, or state the folder with --from",
            )  # fmt: skip
        for one in matched:
            if one.path in found:
                raise GapError(f"{mapping.path}: source.files", f"{one.path} matches two patterns")
            found[one.path] = one
    return [found[path] for path in sorted(found)]


def _rule(pattern: str, longest: bool = False) -> str:
    """The pattern as a regular expression, each name as short as can be, or as long."""
    parts: list[str] = []
    seen: set[str] = set()
    least = "" if longest else "?"
    for part in re.split(r"(\{[a-z][a-z0-9_]*\}|\*|\?)", pattern):
        name = part[1:-1]
        if part == "*":
            parts.append("[^/]*")
        elif part == "?":
            parts.append("[^/]")
        elif _PLACE.fullmatch(part):
            parts.append(f"(?P={name})" if name in seen else f"(?P<{name}>[^/]+{least})")
            seen.add(name)
        else:
            parts.append(re.escape(part))
    return "".join(parts)


@dataclass(frozen=True)
class Series:
    """Values of one column with their times in ns (None for settled points), all shape (n,)."""

    column: Column
    values: npt.NDArray[np.generic]
    ns: Whole | None
    dropped: int = 0


@dataclass(eq=False)
class Recording:
    """The channels of one main file.

    Attributes:
        found: the main file.
        channels: measured, in the units of the dataset, NaN removed unless the points are settled.
        commands: 0 or 1, or between for a proportional valve.
        direction: +1 up, -1 down, 0 unknown; settled points only.
        dated: whether its times count from 1970, so that files share one clock.
        offset: by how much the clock of a companion file was shifted.
        clocks: keys of `calibration.toml` that state how uncertain that is.
    """

    found: Found
    mapping: Mapping
    folder: Path
    channels: dict[str, Series] = field(default_factory=dict)
    commands: dict[str, Series] = field(default_factory=dict)
    direction: npt.NDArray[np.int64] | None = None
    dated: bool = False
    offset: Offset | None = None
    clocks: tuple[str, ...] = ()
    _sources: dict[Path, Source] = field(default_factory=dict)
    _columns: dict[tuple[Path, str], Column] = field(default_factory=dict)
    _words: dict[tuple[Path, str], list[str]] = field(default_factory=dict)
    _times: dict[tuple[Path, TimeBase, int], Whole] = field(default_factory=dict)
    _dated: dict[bool, str] = field(default_factory=dict)

    @property
    def files(self) -> list[Path]:
        """All files that were opened."""
        return list(self._sources)

    def series(self, stream: Stream) -> Series:
        """A column with its times. Raises `GapError`."""
        path = self.folder / self.found.filled(stream.file) if stream.file else self.found.path
        column = self._column(path, stream.column)
        base = stream.time or self.mapping.time
        return Series(column, column.values, self._ns(path, base, column))

    def _column(self, path: Path, name: str) -> Column:
        if path not in self._sources:
            how = (self.mapping.kind, self.mapping.layout)
            if path != self.found.path and self.mapping.companion is not None:
                how = self.mapping.companion
            self._sources[path] = open_source(path, *how)
        if (path, name) not in self._columns:
            self._columns[path, name] = self._sources[path].column(name)
        return self._columns[path, name]

    def texts(self, name: str) -> tuple[Series, list[str]]:
        """A column of the main file, and its values as texts. Raises `GapError`."""
        series = self.series(Stream(name))
        key = (self.found.path, name)
        if key not in self._words:
            self._words[key] = words(series.column)
        return series, self._words[key]

    def _ns(self, path: Path, base: TimeBase, column: Column) -> Whole | None:
        """Times of a column in ns, ascending; None for settled points."""
        if base.settled:
            return None
        key = (path, base, len(column) if not base.own else id(column))
        if key not in self._times:
            self._times[key] = self._read_times(path, base, column)
        return self._times[key]

    def _read_times(self, path: Path, base: TimeBase, column: Column) -> Whole:
        named = f"{self.mapping.path}: time"
        at = column
        if base.own:
            if column.own_ns is None:
                raise GapError(
                    named, f"{column.where} has no times of its own", "state column or rate_hz"
                )
            ns, dated = column.own_ns, column.dated
        elif base.rate_hz is not None:
            count = np.arange(len(column), dtype=np.float64)
            if len(column) / base.rate_hz > LONGEST_S:
                raise GapError(
                    f"{named}.rate_hz", f"{base.rate_hz:g} Hz is not a plausible sampling rate"
                )
            ns, dated = np.round(count * (1e9 / base.rate_hz)).astype(np.int64), False
        else:
            at = self._column(path, base.column)
            if base.unit != ISO:
                _check_unit(at, base.unit, f"{named}.unit")
            ns, dated = _nanoseconds(at, base.unit)
        if len(ns) != len(column):
            raise GapError(
                column.where, f"has {len(column)} values, its time column {len(ns)}",
                "state the time column of this channel: [channels.NAME.time]",
            )  # fmt: skip
        step = np.diff(ns)
        wrong = np.flatnonzero(step <= 0)
        if len(wrong):
            k = int(wrong[0]) + 1
            twice = "appears twice" if step[k - 1] == 0 else "runs backwards"
            raise at.error(k, f"time {twice} ({(ns[k] - ns[0]) * 1e-9:.9g} s after the first)")
        self._dated[dated] = at.where
        if len(self._dated) == 2:
            raise GapError(
                self._dated[False], f"has no date, and {self._dated[True]} has one",
                "their clocks cannot be joined",
            )  # fmt: skip
        self.dated = dated
        return ns + round(base.offset_s * 1e9)


def _nanoseconds(column: Column, unit: str) -> tuple[Whole, bool]:
    """Times of a time column in ns, and whether they have a date."""
    values = column.values
    if unit == ISO or values.dtype.kind == "M":
        if unit != ISO:
            raise GapError(column.where, f"holds dates, not {unit}", f"state time.unit {ISO!r}")
        if not column.is_text and values.dtype.kind != "M":
            raise GapError(column.where, "holds numbers, not ISO 8601 times", "state time.unit")
        made = pd.to_datetime(pd.Series(values), utc=True, format="ISO8601", errors="coerce")
        bad = np.flatnonzero(made.isna().to_numpy())
        if len(bad):
            k = int(bad[0])
            raise column.error(k, f"{str(values[k])[:40]!r} is not a date and time (ISO 8601)")
        return made.dt.tz_localize(None).to_numpy().astype("datetime64[ns]").astype(np.int64), True
    factor = time_factor_ns(unit, column.where)
    number = numbers(column)
    empty = np.flatnonzero(~np.isfinite(number))
    if len(empty):
        raise column.error(int(empty[0]), "has no time", "every row needs one")
    far = np.flatnonzero(np.abs(number) * (factor * 1e-9) > LONGEST_S)
    if len(far):
        raise column.error(int(far[0]), f"{number[far[0]]:g} {unit} is not a plausible time")
    if values.dtype.kind == "i":
        return values.astype(np.int64) * factor, False
    return np.round(number * factor).astype(np.int64), False


def numbers(column: Column) -> Array:
    """Values as floats, NaN where empty. Raises `GapError` for a text or an infinite value."""
    if column.is_text:
        for k, word in enumerate(column.values.tolist()):
            if word and not _is_number(word):
                raise column.error(k, f"{word[:40]!r} is not a number")
        return np.array([float(w) if w else np.nan for w in column.values.tolist()])
    if column.values.dtype.kind == "M":
        raise GapError(column.where, "holds dates, not numbers")
    value = np.asarray(column.values, dtype=np.float64)
    infinite = np.flatnonzero(np.isinf(value))
    if len(infinite):
        raise column.error(int(infinite[0]), "is infinite")
    return value


def _is_number(word: str) -> bool:
    return re.fullmatch(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", word) is not None


def read_recording(mapping: Mapping, found: Found, folder: Path) -> Recording:
    """Read all channels of one main file and its companions.

    Raises:
        GapError: names file, column and row.
    """
    made = Recording(found, mapping, folder)
    muscle = mapping.labels["muscle"].text if "muscle" in mapping.labels else ""
    for channel in mapping.channels:
        rest = mapping.rest_length_mm(channel, found.filled(muscle))
        made.channels[channel.name] = _measured(made, channel, rest)
    for name, state in mapping.commands.items():
        made.commands[name] = on_off(made, state) if state.span is None else _opening(made, state)
    if mapping.direction is not None:
        series = made.series(mapping.direction.stream)
        up = is_one_of(series.column, mapping.direction.up)
        down = is_one_of(series.column, mapping.direction.down)
        neither = np.flatnonzero(~up & ~down & ~_empty(series.column))
        if len(neither) or (up & down).any():
            k = int(neither[0]) if len(neither) else int(np.argmax(up & down))
            what = f"{series.values[k]!r} is neither up nor down"
            raise series.column.error(k, what, "state channels.direction.up and .down")
        made.direction = up.astype(np.int64) - down.astype(np.int64)
    if mapping.time.settled:
        _check_lengths(made)
    _joined(made)
    return made


def _joined(recording: Recording) -> None:
    """Shift everything of the companion file to the main file's clock. Raises `GapError`."""
    join = recording.mapping.join
    if join is None:
        return
    both = []
    for name in (join.channel, join.to):
        series = recording.channels[name]
        assert series.ns is not None
        both.append((np.asarray(series.ns * 1e-9), np.asarray(series.values, dtype=np.float64)))
    where = f"{recording.found.path}: join"
    recording.offset = offset = offset_of(join, where, both[0], both[1])
    shift_ns = round(offset.offset_s * 1e9)
    streams = {c.name: c.stream for c in recording.mapping.channels}
    file = streams[join.channel].file
    streams |= {name: state.stream for name, state in recording.mapping.commands.items()}
    for named in (recording.channels, recording.commands):
        for name, series in named.items():
            if streams[name].file == file and series.ns is not None:
                named[name] = replace(series, ns=series.ns + shift_ns)
    shifted = {name for name, stream in streams.items() if stream.file == file}
    recording.clocks = clock_keys(shifted, streams.keys() - shifted)


def _check_unit(column: Column, unit: str, where: str) -> None:
    """The unit that the file states must be that of the mapping: kN for N is a factor of 1000."""
    if column.unit and spelled(column.unit) != spelled(unit):
        raise GapError(
            where, f"is {unit!r}, and {column.where} states {column.unit!r}", "state the file's"
        )


def _check_lengths(recording: Recording) -> None:
    """Settled points: every column has the same number of rows."""
    sizes = {name: len(series.values) for name, series in recording.channels.items()}
    if recording.direction is not None:
        sizes["direction"] = len(recording.direction)
    first = next(iter(sizes))
    for name, size in sizes.items():
        if size != sizes[first]:
            what = f"{name} has {size} values and {first} has {sizes[first]}"
            raise GapError(str(recording.found.path), what, "settled points are rows")


def _measured(recording: Recording, channel: Measured, rest_length_mm: float | None) -> Series:
    series = recording.series(channel.stream)
    column = series.column
    raw = numbers(column)
    empty = np.isnan(raw)
    absent = np.isin(raw, channel.absent) if channel.absent else np.zeros(len(raw), dtype=bool)
    if empty.any() and not channel.gaps:
        raise column.error(
            int(np.argmax(empty)), "is empty",
            f'where that means no sample: channels.{channel.name}.empty_cells = "no sample"',
        )  # fmt: skip
    where = f"{recording.mapping.path}: channels.{channel.name}.unit"
    _check_unit(column, channel.signal or channel.unit, where)
    convert = conversion(channel.unit, DIMENSION[channel.name], where, rest_length_mm)
    value = convert(channel.factor * raw + channel.addend) - channel.ambient_kpa
    value[absent] = np.nan
    if not np.isfinite(value).any():
        raise GapError(column.where, "has no value", f"channels.{channel.name} has nothing to read")
    dropped = int(absent.sum())
    if series.ns is None:
        return Series(column, value, None, dropped)
    here = np.isfinite(value)
    return Series(column, value[here], series.ns[here], dropped)


def on_off(recording: Recording, state: State) -> Series:
    """A column that says on or off as 0 and 1. Raises `GapError`."""
    series = recording.series(state.stream)
    column = series.column
    if state.on is not None:
        on = is_one_of(column, state.on)
        return Series(column, on.astype(np.float64), series.ns)
    raw = numbers(column)
    empty = np.flatnonzero(np.isnan(raw))
    if len(empty):
        raise column.error(int(empty[0]), "is empty", "a command is on or off")
    if state.above is not None:
        return Series(column, (raw > state.above).astype(np.float64), series.ns)
    if state.bit is not None:
        odd = np.flatnonzero((raw != np.floor(raw)) | (raw < 0) | (raw >= 2.0**53))
        if len(odd):
            raise column.error(int(odd[0]), f"{raw[odd[0]]:g} has no bits")
        return Series(
            column, ((raw.astype(np.int64) >> state.bit) & 1).astype(np.float64), series.ns
        )
    odd = np.flatnonzero((raw != 0.0) & (raw != 1.0))
    if len(odd):
        raise column.error(
            int(odd[0]), f"{raw[odd[0]]:g} is neither 0 nor 1", "state bit, on or above"
        )
    return Series(column, raw, series.ns)


def _opening(recording: Recording, state: State) -> Series:
    """A column that says how far a valve is to open as 0 to 1, or as pulses. Raises `GapError`."""
    series = recording.series(state.stream)
    column = series.column
    raw = numbers(column)
    empty = np.flatnonzero(np.isnan(raw))
    if len(empty):
        raise column.error(int(empty[0]), "is empty", "a command is never unknown")
    assert state.span is not None
    shut, wide = state.span
    share = np.clip((raw - shut) / (wide - shut), 0.0, 1.0)
    if not np.any(share > 0.0) and np.ptp(raw) > 0.0:
        raise GapError(
            column.where, f"goes from {raw.min():g} to {raw.max():g} and never opens the valve",
            f"check shut ({shut:g}) and open ({wide:g})",
        )  # fmt: skip
    if state.pwm_period_ms is None or series.ns is None:
        return Series(column, share, series.ns)
    return _pulses(Series(column, share, series.ns), round(state.pwm_period_ms * 1e6))


def _pulses(duty: Series, period_ns: int) -> Series:
    """The pulses of a duty: each period begins with one, the first period with the first sample."""
    ns = duty.ns
    assert ns is not None
    if (int(ns[-1]) - int(ns[0])) / period_ns > _MOST_PULSES:
        raise GapError(
            duty.column.where, f"makes more than {_MOST_PULSES:g} pulses", "check pwm_period_ms"
        )
    begin = np.arange(ns[0], ns[-1] + 1, period_ns, dtype=np.int64)
    share = np.asarray(duty.values)[np.searchsorted(ns, begin, side="right") - 1]
    end = begin + np.round(share * period_ns).astype(np.int64)
    times = np.stack([begin, end], axis=1)
    values = np.stack([np.ones(len(begin)), np.zeros(len(begin))], axis=1)
    # A duty of nothing has no pulse, and one of a whole period does not end before the next.
    values[end == begin] = 0.0
    keep = np.stack([np.ones(len(begin), dtype=bool), (end > begin) & (end < begin + period_ns)], 1)
    return Series(duty.column, values[keep], times[keep], duty.dropped)


_MOST_PULSES = 2e6
"""Pulses of a recording beyond which a period is a slip of the unit."""


def is_one_of(column: Column, among: tuple[str | float, ...]) -> Mask:
    """Which values are one of several numbers or texts."""
    words = {str(item) for item in among if isinstance(item, str)}
    values = [item for item in among if not isinstance(item, str)]
    if column.is_text:
        words |= {f"{value:g}" for value in values}
        return np.array([str(word) in words for word in column.values.tolist()], dtype=bool)
    made = np.isin(numbers(column), values) if values else np.zeros(len(column), dtype=bool)
    for word in words:
        if _is_number(word):
            made |= numbers(column) == float(word)
    return np.asarray(made)


def _empty(column: Column) -> Mask:
    if column.is_text:
        return np.array([not word for word in column.values.tolist()], dtype=bool)
    return np.isnan(numbers(column))


def words(column: Column) -> list[str]:
    """Values as texts: whole numbers without a point, "" where empty."""
    if column.is_text:
        return [str(word) for word in column.values.tolist()]
    if column.values.dtype.kind == "M":
        return [str(value) for value in column.values]
    return ["" if np.isnan(value) else f"{value:.12g}" for value in numbers(column).tolist()]


def fact_value(name: str, fact: Fact, text: str, where: str) -> float:
    """A number of a trial that stands in the file's name. Raises `GapError`."""
    if not _is_number(text.replace(",", ".")):
        raise GapError(where, f"{text!r} is not a number")
    value = np.array([float(text.replace(",", "."))])
    return float(conversion(fact.unit, DIMENSION[name], where, None)(value)[0])
