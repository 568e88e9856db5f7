# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""How fingers differ between people: the distribution that the estimator expects and tests draw.

data/people.yaml has the deviations and their sources; docs/people.md explains them.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass, fields
from importlib import resources

import numpy as np

from finger_common.errors import InputError
from finger_common.files import from_numbers, parse_yaml
from finger_common.moisture import MOISTURE_RANGE

from .geometry import Geometry
from .laws import MaxwellLaw, StandardLinearSolid
from .laws.generalized_maxwell import (
    E0_RANGE,
    E2_RANGE,
    LAWS_BY_BRANCHES,
    STIFFENING_RANGE,
    TIME_RANGE,
)
from .parameter_sets import ParameterSets
from .reduced.population import BOX


@dataclass(frozen=True)
class Person:
    """One finger: its shape, its tissue, the skin's moisture and a reading of it (a.u.)."""

    geometry: Geometry
    material: MaxwellLaw
    moisture: float
    reading: float


@dataclass(frozen=True)
class People:
    """Standard deviations between people, as data/people.yaml explains them."""

    size: float
    pad_aspect: float
    epidermis_thickness: float
    bone_width: float
    bone_height: float
    nail_width: float
    modulus: float
    creep_ratio: float
    relaxation_time: float
    branch_spread: float
    most_branches: float
    epidermis_modulus: float
    stiffening: float
    no_stiffening: float
    friction: float
    moisture: float
    moisture_sd: float
    moisture_slope: float
    reading_sd: float
    press_gain: float

    @classmethod
    @functools.cache
    def default(cls) -> People:
        """The shipped distribution."""
        file = resources.files(__package__) / "data" / "people.yaml"
        data = parse_yaml(file.read_text(encoding="utf-8"), "data/people.yaml")
        missing = {f.name for f in fields(cls)} - set(data)
        if missing:
            raise InputError(f"data/people.yaml: key '{min(missing)}' is missing; add it")
        return from_numbers(cls, data, "data/people.yaml")

    def draw(self, rng: np.random.Generator) -> Person:
        """A finger, each value clipped to the population box of the reduced model; its lengths are
        drawn again while they are no possible geometry."""
        moisture = _clip(rng.normal(self.moisture, self.moisture_sd), MOISTURE_RANGE)
        reading = _clip(rng.normal(moisture, self.reading_sd), MOISTURE_RANGE)
        return Person(self._geometry(rng), self._material(rng, moisture), moisture, reading)

    def _geometry(self, rng: np.random.Generator) -> Geometry:
        default = Geometry()
        while True:

            def factor(deviation: float) -> float:
                return math.exp(rng.normal(0.0, deviation))

            radial = default.pad_semi_axis_radial * factor(self.size)
            scale = radial / default.pad_semi_axis_radial
            aspect = default.pad_semi_axis_axial / default.pad_semi_axis_radial
            axial = _within("aspect", aspect * factor(self.pad_aspect)) * radial
            bone = default.bone_semi_axis_radial * scale * factor(self.bone_width) / radial
            height = default.bone_semi_axis_axial / default.pad_semi_axis_axial
            height = _within("bone_axial", height * factor(self.bone_height))
            skin = default.epidermis_thickness * factor(self.epidermis_thickness)
            skin = _within("epidermis_thickness", skin)
            nail = default.nail_radius * scale * factor(self.nail_width) / radial
            try:
                return Geometry(
                    pad_semi_axis_radial=_within("pad_semi_axis_radial", radial),
                    pad_semi_axis_axial=axial,
                    epidermis_thickness=skin,
                    bone_semi_axis_radial=_within("bone_radial", bone) * radial,
                    bone_semi_axis_axial=height * axial,
                    nail_radius=_within("nail_radius", nail) * radial,
                )
            except InputError:
                continue

    def _material(self, rng: np.random.Generator, moisture: float) -> MaxwellLaw:
        """Tissue whose mean is the shipped standard linear solid of this moisture."""
        slope = 1.0 + self.moisture_slope * rng.normal()
        seen = self.moisture + slope * (moisture - self.moisture)
        sets = ParameterSets.default()
        mean = StandardLinearSolid().with_vector(
            sets.interpolate(_clip(seen, MOISTURE_RANGE)).parameters
        )
        assert isinstance(mean, StandardLinearSolid)
        relaxing = 1.0 / mean.long_term_fraction - 1.0
        relaxing *= math.exp(rng.normal(0.0, self.creep_ratio))
        long_term = mean.instantaneous_modulus * mean.long_term_fraction
        long_term *= math.exp(rng.normal(0.0, self.modulus))
        modulus = _clip(long_term * (1.0 + relaxing), E0_RANGE)
        skin = mean.epidermis_modulus * math.exp(rng.normal(0.0, self.epidermis_modulus))
        values = {"E0": modulus, "E2": _clip(skin, E2_RANGE)}
        count = int(rng.integers(1, int(self.most_branches) + 1))
        time = mean.branches[0].relaxation_time * math.exp(rng.normal(0.0, self.relaxation_time))
        shares = rng.dirichlet(2.0 * np.ones(count)) * relaxing / (1.0 + relaxing)
        for k in range(count):
            spread = self.branch_spread * rng.normal() if count > 1 else 0.0
            values[f"tau_{k + 1}"] = _clip(time * math.exp(spread), TIME_RANGE)
            values[f"fraction_{k + 1}"] = float(shares[k])
        stiff = rng.random() >= self.no_stiffening
        stiffening = _clip(rng.uniform(0, self.stiffening), STIFFENING_RANGE) if stiff else 0.0
        values["stiffening"] = stiffening
        friction = StandardLinearSolid().friction * math.exp(rng.normal(0.0, self.friction))
        return LAWS_BY_BRANCHES[count](friction=min(friction, 1.0), **values)


def _clip(value: float, limits: tuple[float, float]) -> float:
    return float(min(max(value, limits[0]), limits[1]))


def _within(name: str, value: float) -> float:
    return _clip(value, (BOX[name].low, BOX[name].high))
