# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""A force sensor in the air: its zero is told by means over blocks of samples, how these scatter
is what is not known of it."""

BLOCK, BLOCKS, LEAST_BLOCKS = 0.1, 10.0, 3.0
"""s of a block in the air, also of the first one, which is left out; how many are remembered, and
how many tell the zero."""
SILENCE = 1.0
"""s without a sample after which the sensor may have been started again, with another zero."""
