# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""A force sensor in the air: its zero is told by means over blocks of samples, how these scatter
is what is not known of it."""

import math

BLOCK, BLOCKS, LEAST_BLOCKS = 0.1, 10.0, 3.0
"""s of a block in the air, also of the first one, which is left out; how many are remembered, and
how many tell the zero."""
TARED_SCATTERS = 6.0
"""Scatters of the blocks by which one lies beside the mean of those before, at least, where the
sensor was tared."""
SILENCE = 1.0
"""s without a sample after which the sensor may have been started again, with another zero."""


def is_tared(blocks: float, jump: float, variance: float, least: float) -> bool:
    """Whether a block that lies beside the mean of the `blocks` before it, of this variance, is of
    another zero: the sensor was tared, or moved at once. least: jump that may be one.

    A gripper that goes on to move makes the blocks after it scatter; one that swings has scattered
    before.
    """
    return blocks >= BLOCKS and jump > max(least, TARED_SCATTERS * math.sqrt(variance))
