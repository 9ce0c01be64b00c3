"""Bounded queue between acquisition and the viewer; never blocks, drops the oldest items."""

from __future__ import annotations

import threading
from collections import deque
from typing import Any

Item = tuple[Any, ...]


class DropQueue:
    """Three lanes under one lock: curves, pictures, and events (points, states, messages).

    Each lane has its own limit, so a full lane does not displace items of another lane. Curves
    are limited in bytes and number, events in number; each drops its oldest items. Of the
    pictures of one path only the newest is kept. The lock is held for a few instructions only.

    Args:
        bulk_bytes: maximum bytes of curves.
        bulk_items: maximum number of curve pieces.
        event_items: maximum number of events.
        picture_paths: maximum number of paths with a picture.

    Attributes:
        dropped: number of dropped or rejected items.
        replaced: number of pictures replaced by a newer one before they were drawn.
    """

    def __init__(
        self,
        bulk_bytes: int = 16_000_000,
        bulk_items: int = 20_000,
        event_items: int = 5_000,
        picture_paths: int = 8,
    ) -> None:
        self._bulk: deque[tuple[int, Item]] = deque()
        self._events: deque[Item] = deque()
        self._bulk_bytes = bulk_bytes
        self._bulk_items = bulk_items
        self._event_items = event_items
        self._pictures: dict[str, Item] = {}
        self._picture_paths = picture_paths
        self._held = 0
        self._lock = threading.Lock()
        self.dropped = 0
        self.replaced = 0

    def put_bulk(self, size: int, item: Item) -> None:
        """Add an item of ``size`` bytes; drop the oldest ones until it fits."""
        with self._lock:
            self._bulk.append((size, item))
            self._held += size
            while self._bulk and (
                self._held > self._bulk_bytes or len(self._bulk) > self._bulk_items
            ):
                old, _ = self._bulk.popleft()
                self._held -= old
                self.dropped += 1

    def put_picture(self, path: str, item: Item) -> None:
        """Add a picture; it replaces an older one of the same path."""
        with self._lock:
            if self._pictures.pop(path, None) is not None:
                self.replaced += 1
            self._pictures[path] = item
            if len(self._pictures) > self._picture_paths:
                del self._pictures[next(iter(self._pictures))]
                self.dropped += 1

    def put_event(self, item: Item) -> None:
        """Add an event; drop the oldest one if there are too many."""
        with self._lock:
            self._events.append(item)
            if len(self._events) > self._event_items:
                self._events.popleft()
                self.dropped += 1

    def drop(self) -> None:
        """Count a rejected item."""
        with self._lock:
            self.dropped += 1

    def discard_all(self) -> None:
        """Empty the queue and count its items as dropped."""
        with self._lock:
            self.dropped += len(self._bulk) + len(self._events) + len(self._pictures)
            self._bulk.clear()
            self._pictures.clear()
            self._events.clear()
            self._held = 0

    def drain(self) -> tuple[list[Item], list[Item], list[Item]]:
        """Remove and return all items, oldest first: (curves, pictures, events)."""
        with self._lock:
            bulk, self._bulk = self._bulk, deque()
            events, self._events = self._events, deque()
            pictures, self._pictures = self._pictures, {}
            self._held = 0
        return [item for _, item in bulk], list(pictures.values()), list(events)

    @property
    def held_bytes(self) -> int:
        """Bytes of the waiting curves."""
        return self._held
