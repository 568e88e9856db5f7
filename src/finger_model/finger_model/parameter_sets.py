"""Fitted material parameters per moisture condition, and their interpolation over moisture.

`parameters.yaml`, written by a fit and loaded by the model node::

    geometry_hash: …          # hash of the geometry the sets were fitted with; "" when unknown
    reduced_model_hash: …     # hash of the reduced model they were fitted with; "" when unknown
    sets:
      - condition: natural
        moisture: 69.31       # a.u., mean reading of the trials
        moisture_sd: 6.54     # a.u.
        E0: 140000.0          # Pa
        E1: 22350.0           # Pa
        tau1: 0.5             # s
        E2: 1795000.0         # Pa
        covariance_log:       # (4, 4), of the natural logarithms of E0, E1, tau1, E2; may be absent
          - [0.09, 0.0, 0.0, 0.0]
          - …

Between two sets the logarithms of E0, E1, tau1 and E2, and the covariance, are interpolated linearly over
moisture; beyond the driest and the wettest set the end set holds and the result says so.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from finger_common.errors import InputError
from finger_common.files import atomic_write, number, parse_yaml, read_text, sha256_of

PARAMETER_NAMES = ("E0", "E1", "tau1", "E2")
"""Order of the four fitted parameters in every vector: E0, E1 (Pa), tau1 (s), E2 (Pa)."""

MOISTURE_MAXIMUM = 130.0
"""a.u., end of the Corneometer CM 825 scale."""


@dataclass(frozen=True)
class ParameterSet:
    """Parameters of one condition.

    moisture, moisture_sd: a.u.; parameters (4,): E0, E1 (Pa), tau1 (s), E2 (Pa);
    covariance_log (4, 4): covariance of their natural logarithms, zero where it is not known.
    """

    condition: str
    moisture: float
    moisture_sd: float
    parameters: tuple[float, float, float, float]
    covariance_log: tuple[tuple[float, ...], ...] = ((0.0,) * 4,) * 4

    def to_dict(self) -> dict[str, Any]:
        """As one entry of `sets` in parameters.yaml."""
        return {
            "condition": self.condition,
            "moisture": self.moisture,
            "moisture_sd": self.moisture_sd,
            **dict(zip(PARAMETER_NAMES, self.parameters)),
            "covariance_log": [list(row) for row in self.covariance_log],
        }


@dataclass(frozen=True)
class InterpolatedParameters:
    """Parameters at one moisture reading.

    parameters (4,): E0, E1 (Pa), tau1 (s), E2 (Pa); covariance_log (4, 4);
    out_of_range: the reading lies outside the fitted sets and an end set is held;
    name: id of the parameters, "HASH@MOISTURE" with the first digits of the sets' hash.
    """

    parameters: np.ndarray
    covariance_log: np.ndarray
    out_of_range: bool
    name: str


class ParameterSets:
    """The sets of one parameters.yaml, in the order of their moisture.

    Raises InputError for no sets, two sets at one moisture, or values that are not positive.
    """

    def __init__(
        self,
        sets: Sequence[ParameterSet],
        geometry_hash: str = "",
        reduced_model_hash: str = "",
        where: str = "parameter sets",
    ) -> None:
        if not sets:
            raise InputError(f"{where}: 'sets' is empty; give at least one parameter set")
        self.sets = tuple(sorted(sets, key=lambda s: s.moisture))
        self.geometry_hash = geometry_hash
        self.reduced_model_hash = reduced_model_hash
        self._moisture = np.array([s.moisture for s in self.sets])
        if np.any(np.diff(self._moisture) <= 0):
            raise InputError(f"{where}: two sets have the same moisture; merge them or correct one")
        self._log = np.log(np.array([s.parameters for s in self.sets]))
        self._covariance = np.array([s.covariance_log for s in self.sets])
        self.hash = sha256_of([s.to_dict() for s in self.sets])

    # Files -----------------------------------------------------------------------------------

    @classmethod
    def parse(cls, text: str, where: str = "parameter sets") -> ParameterSets:
        """From the text of a parameters.yaml; raises InputError naming `where`, the set and the key."""
        data = parse_yaml(text, where)
        entries = data.get("sets")
        if not isinstance(entries, list):
            raise InputError(
                f"{where}: key 'sets' with a list of parameter sets is missing; add it"
            )
        sets = [_parse_set(entry, f"{where}, set {i + 1}") for i, entry in enumerate(entries)]
        return cls(
            sets,
            str(data.get("geometry_hash") or ""),
            str(data.get("reduced_model_hash") or ""),
            where,
        )

    @classmethod
    def load(cls, path: str | Path) -> ParameterSets:
        """From a parameters.yaml; raises InputError."""
        return cls.parse(read_text(path, "parameter file"), str(path))

    @classmethod
    @functools.cache
    def default(cls) -> ParameterSets:
        """The shipped sets: dry, natural and moist finger of the paper (sources in the file)."""
        file = resources.files(__package__) / "data" / "parameters.yaml"
        return cls.parse(file.read_text(encoding="utf-8"), "data/parameters.yaml")

    def to_yaml(self) -> str:
        """Text of a parameters.yaml; `parse` of it gives equal sets, bit for bit."""
        return self._text

    @functools.cached_property
    def _text(self) -> str:
        return yaml.safe_dump(
            {
                "geometry_hash": self.geometry_hash,
                "reduced_model_hash": self.reduced_model_hash,
                "sets": [s.to_dict() for s in self.sets],
            },
            sort_keys=False,
            allow_unicode=True,
        )

    def save(self, path: str | Path) -> None:
        """Write parameters.yaml."""
        with atomic_write(path) as file:
            file.write(self.to_yaml())

    # Use -------------------------------------------------------------------------------------

    def interpolate(self, moisture: float) -> InterpolatedParameters:
        """Parameters at a reading (a.u.); raises InputError when it is not a finite number."""
        if not math.isfinite(moisture):
            raise InputError(f"moisture is {moisture}, a number from 0 to 130 a.u. is needed")
        low, high = self._moisture[0], self._moisture[-1]
        held = min(max(moisture, low), high)
        upper = int(np.searchsorted(self._moisture, held))
        if upper == 0 or self._moisture[upper] == held:
            log, covariance = self._log[upper], self._covariance[upper]
        else:
            below, above = self._moisture[upper - 1], self._moisture[upper]
            weight = (held - below) / (above - below)
            log = (1 - weight) * self._log[upper - 1] + weight * self._log[upper]
            covariance = (1 - weight) * self._covariance[upper - 1]
            covariance = covariance + weight * self._covariance[upper]
        return InterpolatedParameters(
            np.exp(log),
            covariance.copy(),
            bool(moisture < low or moisture > high),
            f"{self.hash[:8]}@{moisture:.2f}",
        )


def _parse_set(entry: Any, where: str) -> ParameterSet:
    if not isinstance(entry, dict):
        raise InputError(f"{where}: expected 'key: value' lines, found {entry!r}")
    condition = str(entry.get("condition") or "")
    values = {key: number(entry, key, where) for key in PARAMETER_NAMES}
    for key, value in values.items():
        if value <= 0:
            raise InputError(f"{where}: '{key}' is {value}, a positive number is needed")
    moisture = number(entry, "moisture", where)
    if not 0 <= moisture <= MOISTURE_MAXIMUM:
        raise InputError(f"{where}: 'moisture' is {moisture}, outside 0 … 130 a.u.; correct it")
    moisture_sd = number(entry, "moisture_sd", where) if "moisture_sd" in entry else 0.0
    covariance = entry.get("covariance_log")
    if covariance is None:
        covariance = np.zeros((4, 4))
    try:
        covariance = np.array(covariance, dtype=float)
    except (TypeError, ValueError):
        covariance = np.array(math.nan)
    if covariance.shape != (4, 4) or not np.all(np.isfinite(covariance)):
        raise InputError(f"{where}: 'covariance_log' is not a 4 × 4 matrix of numbers; correct it")
    if np.any(np.diag(covariance) < 0):
        raise InputError(f"{where}: 'covariance_log' has a negative variance; correct it")
    return ParameterSet(
        condition,
        moisture,
        moisture_sd,
        (values["E0"], values["E1"], values["tau1"], values["E2"]),
        tuple(tuple(float(c) for c in row) for row in covariance),
    )
