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
      walk_sd: 0.08       # of ln area, by which it strays over an e-fold of force above 1.35 N,
                          # beside these five; may be absent
      peak_mean: [0, …]   # (5,) of ln (peak over mean pressure), less the model's, at PRIOR_FORCES;
                          # or one number for all forces; may be absent
      peak_sd: [0.1, …]   # of the same
      indentation_mean: [0, …]  # (5,) of ln indentation, less that which follows from the areas,
      indentation_sd: [0.1, …]  # likewise

gain and slope: of ln A over ln F; stiffness, time, creep: of the material parameters, see
`estimator.sensitivities`. Without this key the sets' covariances and the estimator's settings
serve.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from finger_common.errors import InputError
from finger_common.files import number

COORDINATES = ("gain", "slope", "stiffness", "time", "creep")

PRIOR_FORCES = (0.15, 0.5, 1.35, 3.5, 9.0)
"""N, at which peak over mean pressure and indentation are given; linear in ln F between them."""
AS_THE_MODEL = (0.0,) * len(PRIOR_FORCES)
"""Of a finger whose peak or indentation is the model's."""
_BY_FORCE = ("peak_mean", "peak_sd", "indentation_mean", "indentation_sd")


@dataclass(frozen=True)
class FingerPrior:
    """Distribution of the finger states; see the module."""

    mean: tuple[float, ...]
    covariance: tuple[tuple[float, ...], ...]
    misfit_sd: float
    moisture_sd: float
    reading_sd: float
    walk_sd: float = 0.0
    peak_mean: tuple[float, ...] = AS_THE_MODEL
    peak_sd: tuple[float, ...] = AS_THE_MODEL
    indentation_mean: tuple[float, ...] = AS_THE_MODEL
    indentation_sd: tuple[float, ...] = AS_THE_MODEL

    def to_dict(self) -> dict[str, Any]:
        """As the key `prior` of parameters.yaml."""
        return {
            "mean": list(self.mean),
            "covariance": [list(row) for row in self.covariance],
            "misfit_sd": self.misfit_sd,
            "moisture_sd": self.moisture_sd,
            "reading_sd": self.reading_sd,
            **self._later(),
        }

    def _later(self) -> dict[str, Any]:
        """What earlier files do not have."""
        found: dict[str, Any] = {"walk_sd": self.walk_sd} if self.walk_sd else {}
        by_force = {name: list(getattr(self, name)) for name in _BY_FORCE}
        return found | {name: values for name, values in by_force.items() if any(values)}

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
        misfit_sd, moisture_sd, reading_sd = (
            number(data, name, where) for name in ("misfit_sd", "moisture_sd", "reading_sd")
        )
        walk_sd = number(data, "walk_sd", where) if "walk_sd" in data else 0.0
        by_force = {name: _by_force(data, name, where) for name in _BY_FORCE if name in data}
        of_forces = [v for name, values in by_force.items() if name.endswith("_sd") for v in values]
        if min(misfit_sd, moisture_sd, reading_sd, walk_sd, *of_forces) < 0:
            raise InputError(f"{where}: a deviation of 'prior' is negative; correct it")
        return cls(
            tuple(mean.tolist()),
            tuple(map(tuple, covariance.tolist())),
            misfit_sd,
            moisture_sd,
            reading_sd,
            walk_sd,
            **by_force,
        )


def _by_force(data: dict[str, Any], key: str, where: str) -> tuple[float, ...]:
    """Numbers at PRIOR_FORCES, where one number is that of all of them."""
    values, n = data[key], len(PRIOR_FORCES)
    if not isinstance(values, list):
        values = n * [values]
    if len(values) != n:
        forces = ", ".join(f"{force:g}" for force in PRIOR_FORCES)
        raise InputError(f"{where}: '{key}' needs one number, or {n}: at {forces} N; correct it")
    return tuple(number({key: value}, key, where) for value in values)
