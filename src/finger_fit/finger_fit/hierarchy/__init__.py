# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Many people: population mean, spread between subjects and moisture slope of a fitted quantity."""

from .model import Estimates, HierarchyPriors, Posterior, posterior

__all__ = ["Estimates", "HierarchyPriors", "Posterior", "posterior"]
