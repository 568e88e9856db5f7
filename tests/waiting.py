# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""One way for tests to wait for something to happen."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TypeVar

T = TypeVar("T")


def wait_until(
    condition: Callable[[], T],
    what: str | Callable[[], object],
    *,
    spin: Callable[[], object] = lambda: time.sleep(0.01),
    seconds: float = 60.0,
) -> T:
    """What the condition gives, once it is true; AssertionError when it is not within `seconds`.

    what: what is awaited, or a function that gives it and what is known of the failure. spin: what
    happens between two looks.
    """
    end = time.monotonic() + seconds
    while not (found := condition()):
        if time.monotonic() > end:
            told = what if isinstance(what, str) else what()
            raise AssertionError(f"not within {seconds:g} s: {told}")
        spin()
    return found
