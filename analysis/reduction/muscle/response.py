"""Frequency responses of a dynamic test, with coherence.

H1 estimator (Welch): input and output are cut into segments that are whole periods of the
excitation, without overlap or window. At each frequency, with X and Y the Fourier coefficients of
a segment and n segments,

    H = sum(conj(X) Y) / sum(|X|^2),   coherence = |sum(conj(X) Y)|^2 / (sum|X|^2 sum|Y|^2).

Gain and phase have the random error sqrt((1 - c) / (2 n c)) of a frequency response (Bendat and
Piersol, Random Data, 4th ed. 2010, chapter 9: of the gain relative, of the phase in rad), here with
n - 1 in place of n and Student's t for 2 (n - 1) degrees of freedom, because the noise is estimated
from the same segments. Of a sine, a segment is one period or more; of a chirp, one sweep, and the
neighbouring frequencies of a band are joined: n counts both.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from analysis.reduction.columns import valve_test_frame
from analysis.reduction.points import Reduction, length_source, point_events, without_excluded
from analysis.reduction.uncertainty import student_ratio
from daq.errors import RecordError
from daq.store.derive import sample_host_ns
from plant.arrays import Array

if TYPE_CHECKING:
    from daq.store.run import Run

LABELS = ("trial", "slot", "repeat", "mounting", "order", "settled", "shape", "pair", "follows")
FIGURES = (
    "frequency_hz", "gain", "u_gain", "phase_deg", "u_phase_deg", "coherence", "segments",
    "input_amplitude", "harmonics_percent",
)  # fmt: skip
STROKE = (
    "stroke_mm", "u_stroke_mm", "work_j", "u_work_j", "pressure_high_kpa", "pressure_low_kpa",
    "length_high_mm", "length_low_mm",
)  # fmt: skip
"""Of a sine under a load; NaN elsewhere."""
COLUMNS = (*LABELS, *FIGURES, *STROKE)
HARMONICS = 5
"""A mean period is the sum of so many harmonics, or of fewer where the readings are too slow."""
READINGS_A_SEGMENT = 8
"""A segment holds so many readings of the slower signal or more."""
HIGHEST_SHARE = 0.4
"""Up to this share of the rate of its readings a signal has a response."""
LEAST_INPUT = 0.5
"""With less than this share of the amplitude that was asked for, a sine was not applied."""
BANDS_PER_DECADE = 8
ACROSS_S = 3e-3
"""Standard uncertainty of the time between streams: of the clock fit, and of lines that arrive."""
SET_PRESSURE, PRESSURE_FORCE, PRESSURE_LENGTH = (
    "set-point to pressure", "pressure to force", "pressure to length",
)  # fmt: skip
GAIN_UNITS = {SET_PRESSURE: "kPa/kPa", PRESSURE_FORCE: "N/kPa", PRESSURE_LENGTH: "mm/kPa"}
"""Unit of the gain of each pair of signals."""


@dataclass(frozen=True)
class Signal:
    """Values over time: seconds since the start of the excitation, and values, shapes (n,)."""

    time_s: Array
    values: Array

    @property
    def rate_hz(self) -> float:
        """Median rate."""
        if len(self.time_s) < 3:
            return 0.0
        return 1.0 / max(float(np.median(np.diff(self.time_s))), 1e-9)


@dataclass(frozen=True)
class Response:
    """A frequency response at one frequency.

    Attributes:
        gain, u_gain, phase_deg, u_phase_deg: with random errors only.
        coherence: 0 to 1.
        segments: independent estimates it is the mean of.
    """

    frequency_hz: float
    gain: float
    u_gain: float
    phase_deg: float
    u_phase_deg: float
    coherence: float
    segments: int
    input_amplitude: float


@dataclass(frozen=True)
class Period:
    """The mean period of a signal: its values at equal phases, without a trend, shape (n,).

    Attributes:
        u: standard uncertainty of each value by noise.
    """

    values: Array
    u: float


def mean_period(
    signal: Signal, frequency_hz: float, begin_s: float, periods: int, count: int = 360
) -> Period | None:
    """The mean of whole periods as a sum of harmonics; None where the readings are too few."""
    harmonics = min(HARMONICS, int(HIGHEST_SHARE * signal.rate_hz / frequency_hz))
    use = (signal.time_s >= begin_s) & (signal.time_s < begin_s + periods / frequency_hz)
    t, y = signal.time_s[use], signal.values[use]
    unknown = 2 + 2 * harmonics
    if harmonics < 1 or len(t) < 2 * unknown:
        return None

    def columns(time_s: Array) -> list[Array]:
        angles = [2.0 * math.pi * (k + 1) * frequency_hz * time_s for k in range(harmonics)]
        return [wave(angle) for angle in angles for wave in (np.cos, np.sin)]

    middle = float(t.mean())
    matrix = np.column_stack([np.ones(len(t)), t - middle, *columns(t)])
    found = np.linalg.lstsq(matrix, y, rcond=None)[0]
    free = len(t) - unknown
    noise = math.sqrt(float(np.sum((y - matrix @ found) ** 2)) / free)
    phases_s = begin_s + np.arange(count) / (count * frequency_hz)
    values = found[0] + np.column_stack(columns(phases_s)) @ found[2:]
    u = noise * math.sqrt((unknown - 1) / len(t)) * student_ratio(free)
    return Period(np.asarray(values), u)


def sine_coefficients(signal: Signal, frequency_hz: float, edges_s: Array) -> npt.NDArray[Any]:
    """Complex amplitude of each segment, by least squares with level and trend.

    NaN for a segment with fewer than five readings.
    """
    out = np.full(len(edges_s) - 1, np.nan + 0j)
    at = np.searchsorted(signal.time_s, edges_s)
    for k, (first, end) in enumerate(pairwise(at)):
        if end - first < 5:
            continue
        t, y = signal.time_s[first:end], signal.values[first:end]
        angle = 2.0 * math.pi * frequency_hz * t
        columns = np.column_stack([np.ones(len(t)), t - t.mean(), np.cos(angle), np.sin(angle)])
        found = np.linalg.lstsq(columns, y, rcond=None)[0]
        out[k] = found[2] - 1j * found[3]
    return out


def sweep_coefficients(signal: Signal, frequencies_hz: Array, edges_s: Array) -> npt.NDArray[Any]:
    """Fourier coefficients of each segment at multiples of 1/segment, shape (segments, n).

    Readings need not be equally spaced: each counts for the time to its neighbours.
    """
    out = np.full((len(edges_s) - 1, len(frequencies_hz)), np.nan + 0j)
    at = np.searchsorted(signal.time_s, edges_s)
    for k, (first, end) in enumerate(pairwise(at)):
        if end - first < 5:
            continue
        t, y = signal.time_s[first:end], signal.values[first:end]
        width = np.gradient(t)
        width = width / width.sum()
        centred = (y - float(width @ y)) * width
        out[k] = 2.0 * np.exp(-2j * math.pi * np.outer(frequencies_hz, t)) @ centred
    return out


def estimate(frequency_hz: float, x: npt.NDArray[Any], y: npt.NDArray[Any]) -> Response | None:
    """H1 of the coefficients of all segments, each shape (n,); None with fewer than two."""
    good = np.isfinite(x) & np.isfinite(y)
    x, y = x[good], y[good]
    n = len(x)
    sxx, syy = float(np.sum(np.abs(x) ** 2)), float(np.sum(np.abs(y) ** 2))
    if n < 2 or sxx <= 0.0 or syy <= 0.0:
        return None
    sxy = complex(np.sum(np.conj(x) * y))
    h = sxy / sxx
    coherence = min(abs(sxy) ** 2 / (sxx * syy), 1.0)
    u = math.sqrt(max(1.0 - coherence, 0.0) / (2.0 * (n - 1) * max(coherence, 1e-12)))
    u *= student_ratio(2.0 * (n - 1))
    return Response(
        frequency_hz, abs(h), abs(h) * u, math.degrees(math.atan2(h.imag, h.real)),
        min(math.degrees(u), 180.0), coherence, n, math.sqrt(sxx / n),
    )  # fmt: skip


def sine_response(x: Signal, y: Signal, frequency_hz: float, begin_s: float, periods: int) -> (
    Response | None
):  # fmt: skip
    """Response to a sine whose counted periods begin at ``begin_s``; None where it has none."""
    rate = min(x.rate_hz, y.rate_hz)
    if frequency_hz > HIGHEST_SHARE * rate:
        return None
    each = max(1, math.ceil(READINGS_A_SEGMENT * frequency_hz / rate))
    segments = periods // each
    if segments < 2:
        return None
    edges = begin_s + np.arange(segments + 1) * each / frequency_hz
    return estimate(
        frequency_hz, sine_coefficients(x, frequency_hz, edges),
        sine_coefficients(y, frequency_hz, edges),
    )  # fmt: skip


def chirp_responses(
    x: Signal, y: Signal, ends_hz: tuple[float, float], sweep_s: float, sweeps: int
) -> list[Response]:
    """Responses to sweeps, the first of which is not counted, in bands of equal ratios."""
    rate = min(x.rate_hz, y.rate_hz)
    low, high = ends_hz[0], min(ends_hz[1], HIGHEST_SHARE * rate)
    first, last = math.ceil(low * sweep_s), math.floor(high * sweep_s)
    frequencies = np.arange(float(first), last + 1.0) / sweep_s
    if len(frequencies) < 2:
        return []
    edges = sweep_s * np.arange(1.0, sweeps + 2.0)
    x_all = sweep_coefficients(x, frequencies, edges)
    y_all = sweep_coefficients(y, frequencies, edges)
    bands = np.floor(np.log10(frequencies / low) * BANDS_PER_DECADE + 1e-9).astype(int)
    out = []
    for band in sorted(set(bands.tolist())):
        use = bands == band
        middle = float(np.exp(np.log(frequencies[use]).mean()))
        found = estimate(middle, x_all[:, use].ravel(), y_all[:, use].ravel())
        if found is not None:
            out.append(found)
    return out


class DynamicRecord:
    """The signals of a dynamic test, in their units.

    Args:
        run: an opened run.

    Attributes:
        notes: defects, for the reader.
    """

    def __init__(self, run: Run) -> None:
        self.run = run
        self.notes: list[str] = []
        self.calibrations = {
            name: run.calibration(name) for name in ("pressure_kpa", "force_n", "length_mm")
        }
        self._valve = self._stream("valve")
        self._time_ns = (
            sample_host_ns(run, "valve", self._valve) if len(self._valve) else np.zeros(0)
        )
        self._length = length_source(run)
        self._start_ns = int(run.manifest["started"]["monotonic_ns"])

    def _stream(self, name: str) -> dict[str, npt.NDArray[Any]]:
        try:
            return dict(self.run.samples(name))
        except RecordError as error:
            self.notes.append(str(error))
            return {}

    def _between(
        self, name: str, span: list[int] | None, column: str
    ) -> tuple[npt.NDArray[Any], npt.NDArray[Any]]:
        columns = self._stream(name)
        if span is None or "row" not in columns:
            return np.zeros(0, np.int64), np.zeros(0)
        use = (columns["row"] >= span[0]) & (columns["row"] < span[1])
        return columns["host_ns"][use], columns[column][use].astype(np.float64)

    def signals(self, event: Mapping[str, Any]) -> dict[str, Signal]:
        """Set-point, pressure, and force or length over an excitation, by name."""
        start_ns = self._start_ns + int(event["start_t_ns"])
        end_ns = start_ns + (float(event["period_s"]) * (int(event["periods"]) + 60)) * 1e9

        def signal(host_ns: npt.NDArray[Any], values: Array) -> Signal:
            return Signal(np.asarray((host_ns.astype(np.int64) - start_ns) * 1e-9), values)

        out: dict[str, Signal] = {}
        end = event["valve_seq"][1]
        counted_ns = self._start_ns + int(event["counted_t_ns"])
        use = (self._time_ns >= counted_ns) & (self._valve["seq"] < end)
        use &= self._time_ns < end_ns
        pressure = self.calibrations["pressure_kpa"].apply(
            self._valve["counts"][use].astype(np.float64)
        )
        out["pressure"] = signal(self._time_ns[use], np.asarray(pressure))
        at_ns, kpa = self._between("setpoint", event.get("setpoint_rows"), "kpa")
        if len(kpa):
            out["set"] = Signal(out["pressure"].time_s, self._staircase(event, use, at_ns, kpa))
        if event.get("mass_kg") is None:
            at_ns, grams = self._between("balance", event.get("balance_rows"), "grams")
            force = np.asarray(self.calibrations["force_n"].apply(grams))
            out["force"] = signal(at_ns, force)
        if self._length:
            at_ns, reading = self._between(self._length, event.get("length_rows"), "reading")
            length = np.asarray(self.calibrations["length_mm"].apply(reading))
            out["length"] = signal(at_ns, length)
        return out

    def _staircase(
        self, event: Mapping[str, Any], use: npt.NDArray[np.bool_], at_ns: Any, kpa: Array
    ) -> Array:
        """The set-point at each sample, in kPa.

        The controller reports its set-point with each sample: it is there at that time. Its scale
        is that of the set-points that were sent. A regulator with a port of its own does not, and
        the time is that of sending.
        """
        held = np.clip(np.searchsorted(at_ns, self._time_ns[use], side="right") - 1, 0, None)
        sent = kpa[held]
        told = self._valve["setpoint_x16"][use].astype(np.float64)
        if event.get("device") != "valve" or len(told) < 8 or not np.ptp(told):
            return np.asarray(sent)
        scale = float(sent.std() / told.std())
        return np.asarray(sent.mean() + scale * (told - told.mean()))


def pairs_of(signals: Mapping[str, Signal]) -> list[tuple[str, str, str]]:
    """(name of the pair, input, output) of all that were recorded."""
    out = []
    for name, x, y in (
        (SET_PRESSURE, "set", "pressure"),
        (PRESSURE_FORCE, "pressure", "force"),
        (PRESSURE_LENGTH, "pressure", "length"),
    ):
        if len(signals.get(x, Signal(np.zeros(0), np.zeros(0))).values) > 8 and (
            len(signals.get(y, Signal(np.zeros(0), np.zeros(0))).values) > 8
        ):
            out.append((name, x, y))
    return out


def reduce_dynamic(run: Run) -> Reduction:
    """One row for each frequency and pair of signals.

    ``u_gain`` holds the random error and the gains of both calibrations, which are common to all
    frequencies (none for set-point to pressure, which is in the transducer's own scale).
    ``u_phase_deg`` holds the random error and, between streams, 3 ms. Of a sine under a load the
    row of pressure to length has the stroke and its work, see :func:`_stroke`.
    """
    record = DynamicRecord(run)
    rows: list[dict[str, Any]] = []
    for event in point_events(run):
        signals = record.signals(event)
        if len(signals["pressure"].values) < 16:
            record.notes.append(f"point {event['order']}: too few samples were received")
            continue
        for name, x, y in pairs_of(signals):
            for found in _responses(event, signals[x], signals[y]):
                if x == "set" and found.input_amplitude < LEAST_INPUT * _asked(event):
                    record.notes.append(
                        f"point {event['order']}: the set-point hardly moved at"
                        f" {found.frequency_hz:.3g} Hz, no response is given"
                    )
                    continue
                rows.append(_row(record, event, name, found, signals))
    if not rows and not record.notes:
        record.notes.append("the run holds no excitation")
    table = valve_test_frame(rows, COLUMNS)
    made = Reduction(table, tuple(dict.fromkeys(record.notes)), record.calibrations)
    return without_excluded(run, made)


def _asked(event: Mapping[str, Any]) -> float:
    """Amplitude of a sine in kPa; 0 for a chirp, which shares it out over frequencies."""
    return float(event["amplitude_kpa"]) if event["shape"] == "sine" else 0.0


def _responses(event: Mapping[str, Any], x: Signal, y: Signal) -> list[Response]:
    period_s, periods = float(event["period_s"]), int(event["periods"])
    if event["shape"] == "chirp":
        return chirp_responses(
            x, y, (float(event["low_hz"]), float(event["high_hz"])), period_s, periods
        )
    begin_s = (int(event["counted_t_ns"]) - int(event["start_t_ns"])) * 1e-9
    found = sine_response(x, y, float(event["low_hz"]), begin_s, periods)
    return [] if found is None else [found]


def _row(
    record: DynamicRecord, event: Mapping[str, Any], name: str, r: Response,
    signals: Mapping[str, Signal],
) -> dict[str, Any]:  # fmt: skip
    common = 0.0
    across = 0.0
    if name != SET_PRESSURE:
        out = "force_n" if name == PRESSURE_FORCE else "length_mm"
        cal = record.calibrations
        common = math.hypot(cal["pressure_kpa"].u_gain, cal[out].u_gain)
        across = 360.0 * r.frequency_hz * ACROSS_S
    harmonics = math.nan
    if name == SET_PRESSURE and event["shape"] == "sine":
        harmonics = 100.0 * distortion(signals["pressure"], r.frequency_hz)
    return {
        **{key: event.get(key) for key in ("trial", "slot", "mounting", "order", "shape")},
        "repeat": event["replicate"], "settled": bool(event["settled"]),
        "follows": float(bool(event["follows"])), "pair": name, "frequency_hz": r.frequency_hz,
        "gain": r.gain, "u_gain": math.hypot(r.u_gain, common * r.gain),
        "phase_deg": r.phase_deg, "u_phase_deg": math.hypot(r.u_phase_deg, across),
        "coherence": r.coherence, "segments": r.segments, "input_amplitude": r.input_amplitude,
        "harmonics_percent": harmonics,
        **(_stroke(record, event, signals) if name == PRESSURE_LENGTH else {}),
    }  # fmt: skip


def _stroke(
    record: DynamicRecord, event: Mapping[str, Any], signals: Mapping[str, Signal]
) -> dict[str, float]:
    """Stroke and work of a sine under a load, and pressure and length at both ends of the pressure.

    The stroke is that of the mean period; its uncertainty is noise and the gain of the calibration,
    since the zero cancels. The work is weight times stroke.
    """
    mass_kg = event.get("mass_kg")
    if event["shape"] != "sine" or not mass_kg:
        return {}
    f, periods = float(event["low_hz"]), int(event["periods"])
    begin_s = (int(event["counted_t_ns"]) - int(event["start_t_ns"])) * 1e-9
    pressure, length = (
        mean_period(signals[name], f, begin_s, periods) for name in ("pressure", "length")
    )
    if pressure is None or length is None:
        return {}
    manifest = record.run.manifest
    weight = float(mass_kg) * float(manifest["conditions"]["gravity_m_s2"])
    u_mass = float((manifest.get("load") or {}).get("u_mass", math.nan))
    stroke = float(np.ptp(length.values))
    u_gain = record.calibrations["length_mm"].u_gain
    # At opposite phases the odd harmonics err against each other: the ends are not independent.
    u_stroke = math.hypot(2.0 * length.u, u_gain * stroke)
    work = weight * stroke * 1e-3
    high, low = int(np.argmax(pressure.values)), int(np.argmin(pressure.values))
    return {
        "stroke_mm": stroke, "u_stroke_mm": u_stroke, "work_j": work,
        "u_work_j": math.hypot(weight * u_stroke * 1e-3, u_mass * work),
        "pressure_high_kpa": float(pressure.values[high]),
        "pressure_low_kpa": float(pressure.values[low]),
        "length_high_mm": float(length.values[high]), "length_low_mm": float(length.values[low]),
    }  # fmt: skip


def distortion(signal: Signal, frequency_hz: float) -> float:
    """Root of the power of harmonics 2 to 5 over that of the first, by least squares."""
    t, y = signal.time_s, signal.values
    if len(t) < 40:
        return math.nan
    columns = [np.ones(len(t)), t - t.mean()]
    for harmonic in range(1, 6):
        angle = 2.0 * math.pi * harmonic * frequency_hz * t
        columns += [np.cos(angle), np.sin(angle)]
    found = np.linalg.lstsq(np.column_stack(columns), y, rcond=None)[0][2:]
    sizes = np.hypot(found[0::2], found[1::2])
    return float(np.sqrt(np.sum(sizes[1:] ** 2)) / sizes[0]) if sizes[0] > 0.0 else math.nan
