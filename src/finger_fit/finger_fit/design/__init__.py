# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Before a study: how well planned presses tell the parameters, and how many people it takes."""

from .expected import Expected, expected, presses_for
from .plan import Plan, plans_of
from .power import power, subjects_for

__all__ = ["Expected", "Plan", "expected", "plans_of", "power", "presses_for", "subjects_for"]
