"""A slot that keeps the newest item: the worker is never behind by more than one."""

from __future__ import annotations

import threading
from typing import Generic, TypeVar

Item = TypeVar("Item")


class LatestSlot(Generic[Item]):
    """Thread-safe slot of one item. `put` replaces an item not yet taken and counts it in `dropped`."""

    def __init__(self) -> None:
        self._condition = threading.Condition()
        self._item: Item | None = None
        self._closed = False
        self.dropped = 0

    def put(self, item: Item) -> bool:
        """Offer an item; true when an older one was dropped for it."""
        with self._condition:
            dropped = self._item is not None
            self.dropped += dropped
            self._item = item
            self._condition.notify()
            return dropped

    def take(self, timeout: float | None = None) -> Item | None:
        """The newest item, waiting for it; None after `timeout` seconds or when closed."""
        with self._condition:
            self._condition.wait_for(lambda: self._item is not None or self._closed, timeout)
            item, self._item = self._item, None
            return item

    def close(self) -> None:
        """Wake the worker for good."""
        with self._condition:
            self._closed = True
            self._condition.notify_all()

    @property
    def closed(self) -> bool:
        """Whether no further item will come."""
        return self._closed
