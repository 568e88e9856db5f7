# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Searches for the minimum of J: global ones over the whole box, and local least squares."""

from .coordinates import Coordinates, all_free, held
from .local import LocalFit, carrying, refine
from .population import Search, Stopped, best_points, search, search_grid
