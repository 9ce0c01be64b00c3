"""The queue between acquisition and the viewer: bounded, never blocking, oldest dropped first."""

from __future__ import annotations

import threading
from collections import deque
from typing import Any

Item = tuple[Any, ...]


class DropQueue:
    """Two lanes under one lock: bulk (curves, pictures) and facts (points, states, messages).

    Bulk is bounded in bytes and facts in number, each dropping its own oldest, so that a
    flood of samples cannot push out the few reduced points. ``put`` takes a lock that is
    only ever held for a few instructions, and copies nothing.

    Args:
        bulk_bytes: most bytes of bulk held.
        bulk_items: most bulk items held (each has overhead beyond its bytes).
        fact_items: most facts held.
    """

    def __init__(
        self, bulk_bytes: int = 16_000_000, bulk_items: int = 20_000, fact_items: int = 5_000
    ) -> None:
        self._bulk: deque[tuple[int, Item]] = deque()
        self._facts: deque[Item] = deque()
        self._bulk_bytes = bulk_bytes
        self._bulk_items = bulk_items
        self._fact_items = fact_items
        self._held = 0
        self._lock = threading.Lock()
        self.dropped = 0

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
            self.dropped += len(self._bulk) + len(self._facts)
            self._bulk.clear()
            self._facts.clear()
            self._held = 0

    def drain(self) -> tuple[list[Item], list[Item]]:
        """Everything held, oldest first: (bulk, facts)."""
        with self._lock:
            bulk, self._bulk = self._bulk, deque()
            facts, self._facts = self._facts, deque()
            self._held = 0
        return [item for _, item in bulk], list(facts)

    @property
    def held_bytes(self) -> int:
        """Bytes of bulk waiting."""
        return self._held
