"""Ways to spoil recorded channels so that no diagnosis should rest on them."""

from __future__ import annotations

import numpy as np

Rng = np.random.Generator
Floats = np.ndarray
Channels = dict[str, tuple[Floats, Floats]]


def smoothed(values: Floats, width: int) -> Floats:
    """Centred running mean over `width` samples, ends repeated."""
    width += 1 - width % 2
    padded = np.pad(values, width // 2, mode="edge")
    return np.asarray(np.convolve(padded, np.full(width, 1.0 / width), mode="valid"))


def spoil(channels: Channels, defect: str, strength: float, trial: int, rng: Rng) -> Channels:
    """Channels (name to times and values) with one defect; strength 0..1 is drawn per set."""
    out = dict(channels)
    name = {"force": "force_n", "pressure": "pressure_kpa", "length": "length_mm"}.get(
        defect.split("_")[0], ""
    )
    if defect == "gaps":
        if trial % 3 == 0:
            start = 0.15 + 0.5 * float(rng.random())
            for key, (t, v) in channels.items():
                end = float(t[-1]) if len(t) else 0.0
                keep = (t < start * end) | (t > (start + 0.3) * end)
                out[key] = (t[keep], v[keep])
        return out
    if name not in channels or len(channels[name][0]) < 8:
        return out
    t, v = channels[name]
    period = float(np.median(np.diff(t)))
    if defect.endswith("shift"):
        shift = (0.12 + 0.25 * strength) * (1.0 if strength < 0.5 else -1.0)
        out[name] = (t, np.interp(t - shift, t, v))
    elif defect.endswith("smoothed"):
        out[name] = (t, smoothed(v, max(int((0.15 + 0.3 * strength) / period), 3)))
    elif defect.endswith("saturated"):
        out[name] = (t, np.minimum(v, (4.0 + 12.0 * strength)))
    elif defect.endswith("frozen") and trial % 3 == 0:
        start = int(0.2 * len(v))
        frozen = v.copy()
        frozen[start:] = v[start]
        out[name] = (t, frozen)
    return out
