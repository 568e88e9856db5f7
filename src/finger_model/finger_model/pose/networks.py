# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Coefficients of the correction for finger and pose, by small networks.

How they depend on ten numbers cannot be told from the few fingers that were solved in three
dimensions at large strain. Many were solved by linear elasticity. So the networks learn both at
once: their hidden layers are shared, and only the last layer tells large from small strain
(`scripts/pose_correction.py`). What several say that began at other random weights is averaged.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ..geometry import Geometry
from .pose import Pose
from .touch import Touch

SKIN_RATIOS = (12.0, 120.0)
"""Moduli of the epidermis over that of the tissue, E₂/E, of the fingers learned from; a ratio
outside is held at the end."""
MIDDLE_SKIN_RATIO = 60.0
"""By which the inputs are scaled."""


def inputs(geometry: Geometry, skin_ratio: float, pose: Pose, touch: Touch) -> np.ndarray:
    """Finger and pose (12,), about −1 to 1 for those learned from.

    Of the finger: depth of the pad, the length over which the skin bends, t (E₂/E)^⅓, width and
    depth of the bone, width of the nail, which holds the pad's sides, and E₂/E. Of the pose: aspect
    and tilt, and what they make of the first touch.
    """
    a, c = geometry.pad_semi_axis_radial, geometry.pad_semi_axis_axial
    ratio = min(max(skin_ratio, SKIN_RATIOS[0]), SKIN_RATIOS[1]) / MIDDLE_SKIN_RATIO
    bending = geometry.epidermis_thickness * ratio ** (1 / 3)
    x, y = (2.0 * pose.axes[2, :2]) ** 2
    return np.array(
        [
            2.0 * math.log(c / (0.7 * a)),
            0.7 * math.log(bending / (0.06 * a)),
            4.0 * (geometry.bone_semi_axis_radial / a - 0.4),
            4.0 * (geometry.bone_semi_axis_axial / c - 0.4),
            5.0 * (geometry.nail_reach / a - 0.78),
            0.8 * math.log(1.6 * ratio),
            4.3 * math.log(pose.aspect) - 1.0,
            2.0 * x - 1.0,
            2.0 * y - 1.0,
            2.0 * math.sqrt(math.hypot(*touch.aside)) - 1.0,
            2.0 * touch.bluntness,
            2.0 * touch.thickness,
        ]
    )


def outputs(layers: Sequence[np.ndarray], x: np.ndarray) -> np.ndarray:
    """Mean outputs (m,) of networks at inputs x (k,). layers: arrays (networks, k + 1, n) of the
    weights; the last row of each is the bias."""
    first, *others = layers
    values = x @ first[:, :-1] + first[:, -1]
    for layer in others:
        values = (np.tanh(values)[:, None] @ layer[:, :-1])[:, 0] + layer[:, -1]
    return values.mean(axis=0)
