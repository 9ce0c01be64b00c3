"""The queue between acquisition and the viewer: bounded, never blocking, oldest dropped first."""

from __future__ import annotations

import threading
from collections import deque
from typing import Any

Item = tuple[Any, ...]


class DropQueue:
    """Three lanes under one lock: curves, pictures, and facts (points, states, messages).

    Curves are bounded in bytes and facts in number, each dropping its own oldest; of the
    pictures under one path only the newest is held. So a flood in one lane cannot push out
    what waits in another. ``put`` takes a lock that is only ever held for a few
    instructions, and copies nothing.

    Args:
        bulk_bytes: most bytes of curves held.
        bulk_items: most pieces of curves held (each has overhead beyond its bytes).
        fact_items: most facts held.
        picture_paths: most paths of which a picture is held.

    Attributes:
        dropped: items that were pushed out or refused.
        replaced: pictures that a newer one took the place of before they were drawn.
    """

    def __init__(
        self,
        bulk_bytes: int = 16_000_000,
        bulk_items: int = 20_000,
        fact_items: int = 5_000,
        picture_paths: int = 8,
    ) -> None:
        self._bulk: deque[tuple[int, Item]] = deque()
        self._facts: deque[Item] = deque()
        self._bulk_bytes = bulk_bytes
        self._bulk_items = bulk_items
        self._fact_items = fact_items
        self._pictures: dict[str, Item] = {}
        self._picture_paths = picture_paths
        self._held = 0
        self._lock = threading.Lock()
        self.dropped = 0
        self.replaced = 0

    def put_bulk(self, size: int, item: Item) -> None:
        """Add an item of ``size`` bytes, dropping the oldest bulk until it fits."""
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
        """Add a picture in place of an older one of the same path."""
        with self._lock:
            if self._pictures.pop(path, None) is not None:
                self.replaced += 1
            self._pictures[path] = item
            if len(self._pictures) > self._picture_paths:
                del self._pictures[next(iter(self._pictures))]
                self.dropped += 1

    def put_fact(self, item: Item) -> None:
        """Add a small item, dropping the oldest fact if there are too many."""
        with self._lock:
            self._facts.append(item)
            if len(self._facts) > self._fact_items:
                self._facts.popleft()
                self.dropped += 1

    def drop(self) -> None:
        """Count an item that never came in."""
        with self._lock:
            self.dropped += 1

    def abandon(self) -> None:
        """Empty the queue, counting what was in it as dropped."""
        with self._lock:
            self.dropped += len(self._bulk) + len(self._facts) + len(self._pictures)
            self._bulk.clear()
            self._pictures.clear()
            self._facts.clear()
            self._held = 0

    def drain(self) -> tuple[list[Item], list[Item], list[Item]]:
        """Everything held, oldest first: (curves, pictures, facts)."""
        with self._lock:
            bulk, self._bulk = self._bulk, deque()
            facts, self._facts = self._facts, deque()
            pictures, self._pictures = self._pictures, {}
            self._held = 0
        return [item for _, item in bulk], list(pictures.values()), list(facts)

    @property
    def held_bytes(self) -> int:
        """Bytes of curves waiting."""
        return self._held
