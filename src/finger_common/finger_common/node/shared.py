# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Threads that all nodes of a context share."""

from __future__ import annotations

import threading
from typing import Any, ClassVar, TypeVar

from rclpy.context import Context

S = TypeVar("S", bound="SharedInContext")


class SharedInContext:
    """Base of what there is once for all nodes of a context, until the context ends."""

    _all: ClassVar[dict[tuple[type, Context], Any]] = {}
    _making = threading.Lock()

    @classmethod
    def of(cls: type[S], context: Context) -> S:
        """That of a context, which is made when it is first needed."""
        with SharedInContext._making:
            found: S | None = cls._all.get((cls, context))
            if found is None:
                for ended in [key for key in cls._all if not key[1].ok()]:
                    del cls._all[ended]
                found = cls._all[cls, context] = cls(context)
                context.on_shutdown(found.end)
            return found

    def __init__(self, context: Context) -> None:
        self.context = context

    def end(self) -> None:
        """End the thread, which must not outlive the interpreter; the context has ended."""
        raise NotImplementedError
