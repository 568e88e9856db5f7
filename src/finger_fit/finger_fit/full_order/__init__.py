# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""The full-order model beside a fit: correction of the areas, and check of the candidates."""

from .areas import BetterModel, FullOrder
from .check import FullOrderCheck, check
from .correction import Correction, correct, correction_around
