# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Fits the finger model's parameters to recorded trials.

From Python: `Trial` and `fit` (`api`). The subpackages, in the order in which a fit uses them:
`problem` (trials and cost), `quality` (is the data fit to be fitted?), `search`, `full_order`
(correction and check), `uncertainty`, `results` (what was found, and files), `report` (figures and
page), `study` (the stages, from bags to files).
"""

from .api import Fit, Trial, fit
