# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Compile what the live estimate uses, so that no first sample waits for it.

`python -m finger_model.warm_up` does it once, about a minute; numba keeps the result beside the
sources.
"""

from __future__ import annotations

import functools
from pathlib import Path

import numpy as np

from .estimator import ContactEstimator, sensitivities, stream
from .geometry import Geometry
from .reduced.model import ReducedModel, load_population
from .shape.estimate import NO_OUTLINE
from .shape.settings import PoseSettings
from .slip import SlipSettings
from .slip_and_shape import SlipAndShape


def is_compiled() -> bool:
    """Whether an earlier start has left the estimate's kernel, or there is none to keep."""
    kept = getattr(stream.process, "stats", None)  # of numba, where it is installed
    folder = None if kept is None else kept.cache_path
    return folder is None or any(Path(folder).glob("stream.process-*.nbi"))


def warm_up(estimator: ContactEstimator) -> None:
    """Run everything that streams, services and changes use once; spoils the estimator's state."""
    slip_and_shape = SlipAndShape(estimator, SlipSettings(), PoseSettings())
    slip_and_shape.see_area(0, (0.5, 0.1), NO_OUTLINE)
    slip_and_shape.see_area(1, (np.nan, np.nan), NO_OUTLINE)
    estimator.reset()
    for stamp_ns in range(1, 3):
        for estimate in estimator.add_wrench(stamp_ns * 10**9, (0.0, 0.0, 0.0)):
            slip_and_shape.process(estimate, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    estimator.change_surface()
    slip_and_shape.keep_up()
    estimator.predict(np.array([0.1]), np.array([0.01]))
    estimator.force_for_area(1e-6)
    estimator.mismatch()
    # Of a calibration, beside which streams go on.
    one = np.zeros(1, sensitivities.SENSITIVITIES)
    sensitivities.set_shift_1(one, np.zeros(sensitivities.DIRECTIONS))


@functools.cache
def warm_up_all() -> None:
    """`warm_up`, once in a process, for the default finger and for those of other lengths, which
    files may bring."""
    for model in (ReducedModel.load(), load_population(Geometry())):
        warm_up(ContactEstimator(model))


if __name__ == "__main__":
    warm_up_all()
