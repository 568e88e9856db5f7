# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Areas that a logger held: it wrote the camera's last value again in each row until the next one
came, as programs do that have one rate for all channels."""

from __future__ import annotations

import numpy as np

from finger_common.stamps import seconds

FEWEST_RUNS = 10
"""Runs of equal areas of which it can be told that they were held."""

ALIKE = 0.8
"""Share of the runs that have about the same length where areas were held."""

LEAST_INNER = 0.25
"""Change of the force within the runs over that from run to run, where areas were held; that within
runs of n rows is (n - 1)/n of it under a steady ramp, and next to nothing where areas stand still
because the force does."""


def held_text(number: int) -> str:
    """What is said of a number of rows as of `held_rows`."""
    return (
        f"{number} rows hold the area of the row before, as loggers write it until the next frame; "
        "left out, the first of each counts"
    )


def held_rows(
    stamp_ns: np.ndarray, area: np.ndarray, force_ns: np.ndarray, force: np.ndarray
) -> np.ndarray:
    """Mask (k,) of the rows that hold the area of a row before; none where areas are equal for
    another reason.

    stamp_ns (k,) in ns, area (k,) in m², force_ns (n,) in ns, force (n,) in N: in the order of
    time.
    """
    held = np.zeros(len(area), bool)
    if not len(area):
        return held
    starts = np.flatnonzero(np.diff(area, prepend=np.nan) != 0)
    ends = np.append(starts[1:], len(area))
    positive = area[starts] > 0
    # Runs that another area follows; the last one of a press may have any length.
    followed = np.flatnonzero(positive[:-1] & positive[1:])
    if len(followed) < FEWEST_RUNS:
        return held
    lengths = (ends - starts)[followed]
    usual = float(np.median(lengths))
    if usual < 2 or np.mean(np.abs(lengths - usual) <= max(1.0, usual / 4)) < ALIKE:
        return held
    rows = np.array([starts[followed], ends[followed] - 1, starts[followed + 1]])
    times = seconds(stamp_ns[rows] - force_ns[0])
    first, last, following = np.interp(times, seconds(force_ns - force_ns[0]), force)
    if np.abs(last - first).sum() < LEAST_INNER * np.abs(following - first).sum():
        return held
    for start, end in zip(starts, ends):
        # A longer run is several measurements that came out equal, as those without contact.
        count = max(round((end - start) / usual), 1)
        held[start:end] = True
        held[start + np.round(usual * np.arange(count)).astype(int)] = False
    return held
