# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""What is known of a finger before it is seen: distribution of the estimator's finger states.

`prior` in parameters.yaml::

    prior:
      mean: […]           # (5,) of gain, slope, stiffness, time, creep, in logarithms
      covariance: [[…]]   # (5, 5)
      misfit_sd: 0.02     # of ln area: what these five cannot describe of the finger
      moisture_sd: 22.0   # a.u., of a finger without reading
      reading_sd: 3.0     # a.u., of a reading
      peak_mean: 0.15     # of ln (peak over mean pressure), less the model's; may be absent
      peak_sd: 0.19       # of the same; may be absent

gain and slope: of ln A over ln F; stiffness, time, creep: of the material parameters, see
`estimator.members`. Without this key the sets' covariances and the estimator's settings serve.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from finger_common.errors import InputError
from finger_common.files import number

COORDINATES = ("gain", "slope", "stiffness", "time", "creep")


@dataclass(frozen=True)
class FingerPrior:
    """Distribution of the finger states; see the module."""

    mean: tuple[float, ...]
    covariance: tuple[tuple[float, ...], ...]
    misfit_sd: float
    moisture_sd: float
    reading_sd: float
    peak_mean: float = 0.0
    peak_sd: float = 0.0

    def to_dict(self) -> dict[str, Any]:
        """As the key `prior` of parameters.yaml."""
        return {
            "mean": list(self.mean),
            "covariance": [list(row) for row in self.covariance],
            "misfit_sd": self.misfit_sd,
            "moisture_sd": self.moisture_sd,
            "reading_sd": self.reading_sd,
            **{name: value for name, value in self._peak().items() if value},
        }

    def _peak(self) -> dict[str, float]:
        """What earlier files do not have."""
        return {"peak_mean": self.peak_mean, "peak_sd": self.peak_sd}

    @classmethod
    def parse(cls, data: Any, where: str) -> FingerPrior:
        """From the key `prior`; raises InputError naming `where` and key."""
        if not isinstance(data, dict):
            raise InputError(f"{where}: 'prior' needs 'key: value' lines; see docs/people.md")
        n = len(COORDINATES)
        try:
            mean = np.array(data.get("mean"), dtype=float)
            covariance = np.array(data.get("covariance"), dtype=float)
        except (TypeError, ValueError):
            mean = covariance = np.array(math.nan)
        if mean.shape != (n,) or covariance.shape != (n, n):
            raise InputError(
                f"{where}: 'prior' needs a mean of {n} and a covariance of {n} × {n} numbers; "
                "correct it"
            )
        finite = np.isfinite(mean).all() and np.isfinite(covariance).all()
        symmetric = np.allclose(covariance, covariance.T, rtol=1e-6, atol=1e-12)
        if not finite or not symmetric or np.linalg.eigvalsh(covariance)[0] < -1e-9:
            raise InputError(
                f"{where}: 'covariance' of 'prior' is not a covariance (finite, symmetric, no "
                "negative variance); correct it"
            )
        rest = [number(data, name, where) for name in ("misfit_sd", "moisture_sd", "reading_sd")]
        peak = {n: number(data, n, where) for n in ("peak_mean", "peak_sd") if n in data}
        if min(*rest, peak.get("peak_sd", 0.0)) < 0:
            raise InputError(f"{where}: a deviation of 'prior' is negative; correct it")
        return cls(tuple(mean.tolist()), tuple(map(tuple, covariance.tolist())), *rest, **peak)
