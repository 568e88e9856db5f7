# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""One estimate of slip: the only declaration of its fields.

The compiled core's rows and the messages derive from it. To add a field, add it here, to
src/finger_msgs/msg/ContactSlip.msg and to the copy in src/finger_bag/finger_bag/data/finger_msgs,
all in the same order, and fill it in `kernels`.
"""

from __future__ import annotations

from typing import NamedTuple, get_type_hints

import numpy as np


class SlipEstimate(NamedTuple):
    """Tangential state of the contact at one instant (SI).

    stamp_ns; normal_force P (N); tangential_force Q (2,) in N: the wrench's components along the
    two sensor axes that follow the normal one (x, y, z in a circle); stick_ratio: share of the
    contact's area that sticks; slip_margin: 1 − |Q|/(μP); each with its standard deviation;
    slip_probability: that the whole contact slips now or within the horizon; friction μ and its
    standard deviation; tangential_displacement (2,) in m: of the bone over the plate since the
    contact began, as far as the skin sticks; tangential_stiffness (N/m); slips: slips seen so far;
    flags: bits of SlipFlag. Without contact all but forces and friction are NaN and the
    probability is 0; while a force is not finite it is NaN too.
    """

    stamp_ns: int
    normal_force: float
    tangential_force: tuple[float, float]
    stick_ratio: float
    stick_ratio_stddev: float
    slip_margin: float
    slip_margin_stddev: float
    slip_probability: float
    friction: float
    friction_stddev: float
    tangential_displacement: tuple[float, float]
    tangential_stiffness: float
    slips: int
    flags: int


_NUMPY_TYPES = {int: "i8", float: "f8", tuple[float, float]: "2f8"}

OUTPUT = np.dtype(
    [(name, _NUMPY_TYPES[kind]) for name, kind in get_type_hints(SlipEstimate).items()]
)
"""Row of the compiled core."""


def slip_estimates(rows: np.ndarray) -> list[SlipEstimate]:
    """Rows (n,) of OUTPUT as SlipEstimates."""
    # A vector comes as an array.
    return [
        SlipEstimate._make(tuple(v) if isinstance(v, np.ndarray) else v for v in row)
        for row in rows.tolist()
    ]
