# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Contact on and off by two force thresholds (hysteresis)."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from .errors import InputError

ONSET_FORCE = 0.05
"""N, default normal force from which the finger counts as in contact."""

LIFTOFF_FORCE = 0.03
"""N, default normal force below which a contact ends; below ONSET_FORCE, so that noise does not
chatter.
"""


def check_thresholds(onset_force: float, liftoff_force: float) -> None:
    """Raise InputError unless 0 ≤ liftoff_force < onset_force (N)."""
    if not 0.0 <= liftoff_force < onset_force:
        raise InputError(
            f"liftoff_force is {liftoff_force:g} N, not below onset_force ({onset_force:g} N); "
            "lower one or raise the other"
        )


def in_contact(
    touching: bool,
    force: float,
    onset_force: float = ONSET_FORCE,
    liftoff_force: float = LIFTOFF_FORCE,
) -> bool:
    """Whether the finger is in contact at normal force `force` (N), `touching` at the sample
    before.

    Plain arithmetic, so that compiled kernels wrap it: ``numba.njit(in_contact)``.
    """
    if touching:
        return force >= liftoff_force
    return force >= onset_force


def contacts(
    force: np.ndarray, onset_force: float = ONSET_FORCE, liftoff_force: float = LIFTOFF_FORCE
) -> Iterator[tuple[int, int]]:
    """Contacts in normal forces (n,) in N: first sample and first sample after it (n when it does
    not end).
    """
    force = np.asarray(force, dtype=float)
    ups = np.flatnonzero(force >= onset_force)
    downs = np.flatnonzero(~(force >= liftoff_force))
    begin = 0
    while True:
        next_up = np.searchsorted(ups, begin)
        if next_up == len(ups):
            return
        onset = int(ups[next_up])
        next_down = np.searchsorted(downs, onset)
        end = int(downs[next_down]) if next_down < len(downs) else len(force)
        yield onset, end
        begin = end
