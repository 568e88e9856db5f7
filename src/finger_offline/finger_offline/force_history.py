# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""The force of a recording before a trial: tissue that was pressed a moment ago is not at rest."""

from __future__ import annotations

import numpy as np

from finger_common.stamps import nanoseconds

LONGEST = 60.0
"""s before a trial that are kept. A fit says where its search box allows tissue that recovers
later."""

STEP = 0.05
"""s over which the force before a trial is averaged: what creep keeps of it changes slower."""


def force_before(
    stamp_ns: np.ndarray, force: np.ndarray, first: int, since: int = 0
) -> tuple[np.ndarray, np.ndarray]:
    """Stamps (h,) in ns and forces (h,) in N, means over `STEP`, of the samples since … first − 1
    of a recording; nothing where there are none.

    stamp_ns (n,) in ns, force (n,) in N.
    """
    start = int(stamp_ns[first])
    low = max(int(np.searchsorted(stamp_ns, start - nanoseconds(LONGEST))), since)
    stamps, values = stamp_ns[low:first], force[low:first]
    if not len(stamps):
        return np.empty(0, np.int64), np.empty(0)
    away = stamps - start
    begins = np.flatnonzero(np.diff(away // nanoseconds(STEP), prepend=np.iinfo(np.int64).min // 2))
    number = np.diff(begins, append=len(stamps))
    middle = np.add.reduceat(away, begins) // number
    return start + middle, np.add.reduceat(values, begins) / number
