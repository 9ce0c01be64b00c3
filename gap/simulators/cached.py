"""Predictions kept within a process, so that a simulation with memory runs once for each value."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Mapping

from gap.data.trial import Channel, Trial

Channels = dict[str, Channel]
_MOST_BYTES = 256 << 20


class Cached:
    """Predictions by trial and parameter values; the oldest are dropped beyond 256 MB.

    A trial is known by its identity: two trials of one name in two data sets are two.
    """

    def __init__(self, most_bytes: int = _MOST_BYTES) -> None:
        self._most = most_bytes
        self._bytes = 0
        # The trial is kept along with its predictions, so that its identity stays its own.
        self._kept: OrderedDict[tuple[object, ...], tuple[Trial, Channels]] = OrderedDict()

    def get(
        self, trial: Trial, values: Mapping[str, float], make: Callable[[], Channels]
    ) -> Channels:
        """The predictions, made by `make` if they are not known."""
        key = (id(trial), *sorted(values.items()))
        if key in self._kept:
            self._kept.move_to_end(key)
            return dict(self._kept[key][1])
        made = make()
        self._kept[key] = (trial, made)
        self._bytes += _size(made)
        while self._bytes > self._most and len(self._kept) > 1:
            _, (_, dropped) = self._kept.popitem(last=False)
            self._bytes -= _size(dropped)
        return dict(made)


def _size(channels: Channels) -> int:
    return sum(channel.value.nbytes for channel in channels.values())
