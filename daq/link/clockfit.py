"""Conversion of device time to host time from pings, with a stated error bound.

The host sends a ping at ``sent_ns``, the device notes ``device_us``, the host receives the reply
at ``received_ns``. The device's time stamp lies between the two. The fit uses the pings of the
last minute, the fastest of each half second, and models their midpoint as

    midpoint_ns = a + b * device_us + c * excess_ns,      -1/2 <= c <= 1/2.

``excess_ns`` is the round trip time beyond the shortest one. A delay in one direction only (such
as the latency timer of an adapter) shifts the midpoint by half of the delay; ``c`` estimates this
share. The host cannot observe the asymmetry of the fastest ping itself. The error bound therefore
always includes half of its round trip time.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]

_WRAP = 1 << 32
_HALF = 1 << 31
BUCKET_NS = 500_000_000
WINDOW = 120
DRIFT_PRIOR = 100e-6
KNOT_US = 30_000_000
SPAN_US = 60_000_000
RESOLUTION_NS = 2_000.0


class DeviceTime:
    """Extends a 32-bit microsecond counter beyond its overflow (every 71.6 min).

    The number of overflows is the one closest to the time passed on the host's clock. Long gaps
    and late samples therefore cause no error.
    """

    def __init__(self) -> None:
        self._last_us: int | None = None
        self._last_ns = 0

    def unwrap(self, raw_us: int, host_ns: int) -> int:
        """Device time without overflow, us; zero is that of the device's counter."""
        if self._last_us is None:
            self._last_us = raw_us
        else:
            passed_us = (host_ns - self._last_ns) // 1000
            step = (raw_us - self._last_us - passed_us + _HALF) % _WRAP - _HALF
            self._last_us += step + passed_us
        self._last_ns = host_ns
        return self._last_us

    def reset(self) -> None:
        """Start again after a restart of the device."""
        self._last_us = None


@dataclass(frozen=True)
class ClockMap:
    """Piecewise linear map from device time to host time, extrapolated beyond the outer knots.

    Attributes:
        device_us, host_ns: knots, at least two, ascending.
        error_ns: error bound between the knots.
        drift_ppm: mean rate of the device's clock relative to the host's, ppm.
        fastest_round_trip_ns: of all pings used.
        pings: number of pings.
    """

    device_us: tuple[int, ...]
    host_ns: tuple[int, ...]
    error_ns: float
    drift_ppm: float
    fastest_round_trip_ns: int
    pings: int

    def to_host_ns(self, device_us: npt.ArrayLike) -> npt.NDArray[np.int64]:
        """Host monotonic time, ns, of device times without overflow, same shape."""
        x = np.asarray(device_us, dtype=np.int64)
        knots = np.asarray(self.device_us, dtype=np.int64)
        values = np.asarray(self.host_ns, dtype=np.int64)
        at = np.clip(np.searchsorted(knots, x, side="right") - 1, 0, len(knots) - 2)
        slope = (np.diff(values) / np.diff(knots))[at]
        return np.asarray(values[at] + np.rint((x - knots[at]) * slope).astype(np.int64))

    def as_dict(self) -> dict[str, Any]:
        """The attributes for events and final.json."""
        return {
            "knots": [[d, h] for d, h in zip(self.device_us, self.host_ns, strict=True)],
            "error_ns": round(self.error_ns),
            "drift_ppm": round(self.drift_ppm, 4),
            "fastest_round_trip_ns": self.fastest_round_trip_ns,
            "pings": self.pings,
        }

    @staticmethod
    def from_dict(fields: dict[str, Any]) -> ClockMap:
        """The inverse of :meth:`as_dict`."""
        knots = fields["knots"]
        return ClockMap(
            tuple(int(k[0]) for k in knots),
            tuple(int(k[1]) for k in knots),
            float(fields["error_ns"]),
            float(fields["drift_ppm"]),
            int(fields["fastest_round_trip_ns"]),
            int(fields["pings"]),
        )


@dataclass(frozen=True)
class _Fit:
    """``host_ns = host0 + offset + (1000 + rate) * (device_us - device0)``."""

    device0: int
    host0: int
    offset_ns: float
    rate: float
    covariance: Floats
    bias_ns: float

    def host_ns(self, device_us: int) -> int:
        x = device_us - self.device0
        return self.host0 + 1000 * x + round(self.offset_ns + self.rate * x)

    def error_ns(self, device_us: int) -> float:
        x = np.array([1.0, (device_us - self.device0) * 1e-6])
        spread = float(np.sqrt(max(0.0, x @ self.covariance @ x)))
        return self.bias_ns + 3.0 * spread + RESOLUTION_NS


_Ping = tuple[int, int, int]  # device_us, midpoint_ns, round_trip_ns
_Knot = tuple[int, int, float]  # device_us, host_ns, error_ns


class ClockFit:
    """Running fit of one device's clock, from past pings only.

    For the map of the whole run, the fit creates knots as time passes and then drops old pings. A
    run of any length therefore keeps pings of some minutes only.

    Attributes:
        pings: number of pings added.
    """

    def __init__(self) -> None:
        self._near: deque[_Ping] = deque()
        self._knots: list[_Knot] = []
        self._fastest_ns = 0
        self._window: deque[_Ping] = deque(maxlen=WINDOW)
        self._bucket: int | None = None
        self._fit: _Fit | None = None
        self.pings = 0

    def add(self, sent_ns: int, received_ns: int, device_us: int) -> None:
        """Add one ping; ``device_us`` without overflow (see :class:`DeviceTime`).

        Raises:
            ValueError: the reply is older than the request.
        """
        round_trip = received_ns - sent_ns
        if round_trip < 0:
            raise ValueError(f"reply received {-round_trip} ns before its request was sent")
        ping = (device_us, sent_ns + round_trip // 2, round_trip)
        self._fastest_ns = min(self._fastest_ns, round_trip) if self.pings else round_trip
        self.pings += 1
        self._fit = None
        bucket = sent_ns // BUCKET_NS
        if bucket == self._bucket:
            if round_trip < self._window[-1][2]:
                self._window[-1] = self._near[-1] = ping
            return
        self._bucket = bucket
        self._window.append(ping)
        self._near.append(ping)
        while device_us - self._next_knot > SPAN_US:
            self._knots.append(self._knot(self._next_knot))
            while self._near[0][0] < self._next_knot - SPAN_US:
                self._near.popleft()

    @property
    def ready(self) -> bool:
        """True after the first ping."""
        return self.pings > 0

    @property
    def error_ns(self) -> float:
        """Error bound at the newest ping, ns."""
        return self._current().error_ns(self._window[-1][0])

    def error_at_ns(self, device_us: int) -> float:
        """Error bound at ``device_us``, ns; grows with the distance from the pings."""
        return self._current().error_ns(device_us)

    @property
    def drift_ppm(self) -> float:
        """Rate of the device's clock relative to the host's, parts per million."""
        return -self._current().rate * 1e3

    def to_host_ns(self, device_us: int) -> int:
        """Host monotonic time, ns, of a device time without overflow.

        Raises:
            ValueError: there is no ping yet.
        """
        return self._current().host_ns(device_us)

    def as_dict(self) -> dict[str, Any]:
        """The current fit line as a plain :class:`ClockMap`."""
        fit = self._current()
        newest = self._window[-1][0]
        knots = (newest - 1_000_000, newest)
        return ClockMap(
            knots,
            tuple(fit.host_ns(k) for k in knots),
            self.error_ns,
            self.drift_ppm,
            min(p[2] for p in self._window),
            self.pings,
        ).as_dict()

    def final(self) -> ClockMap:
        """Map of the whole run: a local two-sided fit every 30 s.

        Raises:
            ValueError: there was no ping.
        """
        if not self._near:
            raise ValueError("no ping has been answered, so there is no clock fit")
        at, last = self._next_knot, self._near[-1][0]
        knots = [*self._knots]
        while not knots or last - at >= KNOT_US // 2:
            knots.append(self._knot(at))
            at += KNOT_US
        knots.append(self._knot(max(last, knots[0][0] + 1_000_000)))
        device, host, errors = zip(*knots, strict=True)
        rate = (host[-1] - host[0]) / float(device[-1] - device[0]) - 1000.0
        return ClockMap(device, host, max(errors), -rate * 1e3, self._fastest_ns, self.pings)

    @property
    def _next_knot(self) -> int:
        """Device time of the next knot, us."""
        return self._knots[-1][0] + KNOT_US if self._knots else self._near[0][0]

    def _knot(self, at_us: int) -> _Knot:
        near = [p for p in self._near if abs(p[0] - at_us) <= SPAN_US]
        fit = _regress(near or list(self._near))
        return at_us, fit.host_ns(at_us), fit.error_ns(at_us)

    def _current(self) -> _Fit:
        if self._fit is None:
            if not self._window:
                raise ValueError("no ping has been answered, so there is no clock fit yet")
            self._fit = _regress(list(self._window))
        return self._fit


def _regress(pings: list[_Ping]) -> _Fit:
    """Weighted regression with bounded asymmetry and down-weighted outliers (Huber)."""
    device0, host0, _ = pings[-1]
    x = np.array([(d - device0) * 1e-6 for d, _, _ in pings])
    y = np.array([float(h - host0 - 1000 * (d - device0)) for d, h, _ in pings])
    trips = np.array([float(r) for _, _, r in pings])
    fastest = float(trips.min())
    excess = trips - fastest
    # A longer round trip has less weight; the floor stops one fast ping from dominating.
    sigma = 20e3 + 0.25 * excess
    offset, rate, c, covariance = 0.0, 0.0, 0.0, np.zeros((2, 2))
    weight = 1.0 / sigma**2
    for _ in range(4):
        c = _asymmetry(x, y, excess, weight)
        offset, rate, covariance = _line(x, y - c * excess, weight)
        residual = np.abs(y - c * excess - offset - rate * x) / sigma
        scale = max(1.0, 1.4826 * float(np.median(residual)))
        weight = np.minimum(1.0, 2.0 * scale / np.maximum(residual, 1e-9)) / sigma**2
    left = (y - c * excess - offset - rate * x) ** 2 * weight
    spread = max(1.0, float(left.sum()) / max(1, len(pings) - 3))
    return _Fit(device0, host0, offset, rate / 1e6, covariance * spread, fastest / 2)


def _asymmetry(x: Floats, y: Floats, excess: Floats, weight: Floats) -> float:
    """Share of the excess round trip that shifts the midpoint, within its physical bounds."""
    total = weight.sum()

    def centred(v: Floats) -> Floats:
        return np.asarray(v - (weight * v).sum() / total)

    xc, yc, ec = centred(x), centred(y), centred(excess)
    sxx, sxe, see = (weight * xc * xc).sum(), (weight * xc * ec).sum(), (weight * ec * ec).sum()
    # With few pings, the prior on the drift separates it from the asymmetry.
    sxx += 1.0 / (DRIFT_PRIOR * 1e9) ** 2
    see += 1e-3
    det = sxx * see - sxe * sxe
    if det <= 0 or len(x) < 4:
        return 0.0
    c = (sxx * (weight * ec * yc).sum() - sxe * (weight * xc * yc).sum()) / det
    return float(min(0.5, max(-0.5, c)))


def _line(x: Floats, y: Floats, weight: Floats) -> tuple[float, float, Floats]:
    """Offset and rate (ns/s); the prior limits the drift to about 100 ppm."""
    sw, sx, sy = weight.sum(), (weight * x).sum(), (weight * y).sum()
    sxx = (weight * x * x).sum() + 1.0 / (DRIFT_PRIOR * 1e9) ** 2
    sxy = (weight * x * y).sum()
    normal = np.array([[sw, sx], [sx, sxx]])
    covariance = np.linalg.inv(normal)
    offset, rate = covariance @ np.array([sy, sxy])
    return float(offset), float(rate), covariance
