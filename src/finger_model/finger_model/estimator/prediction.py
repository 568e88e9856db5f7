# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Contact under a force not applied yet; the state of the estimator stays as it is."""

from __future__ import annotations

import math

import numpy as np

from finger_common.errors import InputError, ModelError

from ..history import ContactHistory, check_force_history
from ..reduced.model import history_of
from .filter_state import FilterState

LONGEST_HORIZON = 3600.0
"""s"""

MOST_POINTS = 5000
"""Of a history to predict: samples wait meanwhile, 0.1 s, or 0.4 s where the force falls often."""

_BISECTIONS = 40


def predict(state: FilterState, time: np.ndarray, force: np.ndarray) -> ContactHistory:
    """Contact under a future force: time (n,) in s from now, increasing, > 0; force (n,) in N.

    The area is the fused one: the model's with the error known so far. Raises InputError for a bad
    history, one of more than MOST_POINTS or beyond LONGEST_HORIZON, or a force beyond the model's
    limit, and ModelError for a force that it cannot follow.
    """
    time, force = check_force_history(time, force, "force to predict")
    if len(time) > MOST_POINTS:
        raise InputError(f"force to predict: {len(time)} points; give {MOST_POINTS} at most")
    if time[-1] > LONGEST_HORIZON:
        raise InputError(
            f"force to predict: time ends at {time[-1]:g} s; give {LONGEST_HORIZON:g} s at most"
        )
    if time[0] <= 0:
        raise InputError(
            f"force to predict: time begins at {time[0]:g} s; give times from now, above 0"
        )
    limit = float(state.records.constants["force_limit"][0])
    if force.max() > limit:
        raise InputError(
            f"force {force.max():.2f} N is beyond the model's limit of {limit:.2f} N for these "
            "parameters; ask for less"
        )
    table = state.predicted(time, force)
    if not np.isfinite(table).all():
        row = int(np.argmin(np.isfinite(table).all(axis=1)))
        raise ModelError(
            f"the model cannot follow the force of {force[row]:.3g} N in {time[row]:.3g} s: these "
            "parameters hardly carry it; ask for less"
        )
    return history_of(time, force, table)


def force_for_area(state: FilterState, area: float, horizon: float) -> float:
    """Normal force (N) that, applied now and held for `horizon` (s), gives this area (m²).

    By bisection. Raises InputError for an area that is not positive or beyond what the force limit
    gives, or the largest force that the model can follow.
    """
    if not (math.isfinite(area) and area > 0):
        raise InputError(f"area is {area} m², a positive area is needed")
    if not (math.isfinite(horizon) and 0 <= horizon <= LONGEST_HORIZON):
        raise InputError(f"horizon is {horizon} s, 0 to {LONGEST_HORIZON:g} s is needed")
    time = np.unique([0.0, horizon])

    def area_at(force: float) -> float:
        return float(state.predicted(time, np.full(len(time), force))[-1, 0])

    low, high = 0.0, float(state.records.constants["force_limit"][0])
    if not math.isfinite(area_at(low)):
        raise InputError("the model could not follow the contact; lift the finger, then ask again")
    for _ in range(_BISECTIONS):
        if math.isfinite(largest := area_at(high)):
            break
        high *= 0.9
    if not largest >= area:
        raise InputError(
            f"area {area * 1e6:.1f} mm² is beyond the {largest * 1e6:.1f} mm² that the "
            f"largest force of the model ({high:.2f} N) gives; ask for less"
        )
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        if area_at(middle) < area:
            low = middle
        else:
            high = middle
    return 0.5 * (low + high)
