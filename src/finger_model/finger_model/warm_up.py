# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Compile what the live estimate uses, so that no first sample waits for it.

`python -m finger_model.warm_up` does it once, about a minute; numba keeps the result beside the
sources.
"""

from __future__ import annotations

import numpy as np

from .estimator import ContactEstimator
from .reduced.model import ReducedModel
from .slip import SlipEstimator


def warm_up(estimator: ContactEstimator) -> None:
    """Run everything that streams and services use once; spoils the estimator's state."""
    for estimate in estimator.add_wrench(1, (0.0, 0.0, 0.0)):
        SlipEstimator().add(estimate, (0.0, 0.0, 0.0))
    estimator.predict(np.array([0.1]), np.array([0.01]))
    estimator.force_for_area(1e-6)
    estimator.mismatch()


if __name__ == "__main__":
    warm_up(ContactEstimator(ReducedModel.load()))
