"""Material of the finger: what `material.yaml` holds, its checks and the moduli derived from it."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from finger_common.errors import InputError
from finger_common.files import from_numbers, load_yaml

LARGEST_POISSON_RATIO = 0.4999
"""Above it the pressure loses more digits than Newton's criterion leaves."""

MODULUS_RANGES = {
    "E0": (1e3, 3e7),
    "E1": (1e3, math.inf),
    "E2": (1e3, 3e7),
    "nail_modulus": (1e3, 1e12),
}
"""Moduli (Pa) taken for meant. Below, a number in kPa or MPa is likelier than a finger; under a stiffer epidermis the
contact at 1 N is narrower than a few elements of the default mesh, and its area is not found."""

LARGEST_BULK_OVER_SHEAR = 2e5
"""Largest bulk modulus over long-term shear modulus of the bulk: beyond it Newton's method loses its digits."""


@dataclass(frozen=True)
class Material:
    """Moduli (Pa), time constant (s), Poisson's ratios and friction coefficient of the finger.

    Bulk tissue: spring E0 in series with a Kelvin element (spring E1 beside a damper), tau1 = η1/G1 with the
    damper's shear viscosity η1 (Nam and Kuchenbecker 2021, eq. 2). Epidermis (E2) and nail are elastic. An elastic
    bulk is written with E1 very large against E0. The default is the natural set of the study.

    Raises InputError for moduli or times that are not positive, moduli outside MODULUS_RANGES, a Poisson's ratio
    outside 0 … 0.4999, E0 so far above E1 that the bulk is all but incompressible, or a friction coefficient
    outside 0 … 1.
    """

    E0: float = 140e3  # paper, Fig. 3 (natural)
    E1: float = 22.35e3  # from the paper's composite modulus 19.27 kPa (natural) and E0
    tau1: float = 0.5  # paper, Fig. 3 (natural)
    E2: float = 1795e3  # paper (natural)
    nail_modulus: float = 170e6  # assumption
    poisson_ratio_bulk: float = 0.48  # Fung 1993
    poisson_ratio_epidermis: float = 0.48  # Fung 1993
    poisson_ratio_nail: float = 0.38  # assumption
    friction: float = 0.25  # paper

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if isinstance(value, bool) or not isinstance(value, (int, float, np.number)):
                raise InputError(f"material: '{field.name}' is {value!r}, a number is needed")
            object.__setattr__(self, field.name, float(value))
            if not math.isfinite(value):
                raise InputError(f"material: '{field.name}' is {value}, a finite number is needed")
        for name, unit in (
            ("E0", "Pa"),
            ("E1", "Pa"),
            ("tau1", "s"),
            ("E2", "Pa"),
            ("nail_modulus", "Pa"),
        ):
            if getattr(self, name) <= 0:
                raise InputError(
                    f"material: '{name}' is {getattr(self, name):g} {unit}, a positive value is needed"
                )
        for name, (low, high) in MODULUS_RANGES.items():
            if not low <= getattr(self, name) <= high:
                span = f"{low:g} … {high:g} Pa" if math.isfinite(high) else f"{low:g} Pa and more"
                raise InputError(
                    f"material: '{name}' is {getattr(self, name):g} Pa, outside {span}; give moduli in Pa"
                )
        for name in ("poisson_ratio_bulk", "poisson_ratio_epidermis", "poisson_ratio_nail"):
            value = getattr(self, name)
            if not 0 <= value <= LARGEST_POISSON_RATIO:
                raise InputError(
                    f"material: '{name}' is {value:g}, outside 0 … {LARGEST_POISSON_RATIO}; "
                    "use 0.48 for soft tissue"
                )
        ratio = self.bulk_modulus / self.long_term_shear_modulus
        if ratio > LARGEST_BULK_OVER_SHEAR:
            raise InputError(
                f"material: the bulk modulus is {ratio:.2g} times the long-term shear modulus, more than "
                f"{LARGEST_BULK_OVER_SHEAR:g}; lower 'E0' against 'E1' or 'poisson_ratio_bulk'"
            )
        if not 0 <= self.friction <= 1:
            raise InputError(f"material: 'friction' is {self.friction:g}, outside 0 … 1; use 0.25")

    @property
    def composite_modulus(self) -> float:
        """Long-term modulus E = 1/(1/E0 + 1/E1) of the bulk in Pa (paper)."""
        return 1.0 / (1.0 / self.E0 + 1.0 / self.E1)

    @property
    def instantaneous_shear_modulus(self) -> float:
        """G0 = E0/(2(1+ν)) of the bulk in Pa."""
        return self.E0 / (2.0 * (1.0 + self.poisson_ratio_bulk))

    @property
    def kelvin_shear_modulus(self) -> float:
        """G1 = E1/(2(1+ν)) of the Kelvin element in Pa."""
        return self.E1 / (2.0 * (1.0 + self.poisson_ratio_bulk))

    @property
    def long_term_shear_modulus(self) -> float:
        """G∞ = 1/(1/G0 + 1/G1) of the bulk in Pa."""
        return 1.0 / (1.0 / self.instantaneous_shear_modulus + 1.0 / self.kelvin_shear_modulus)

    @property
    def relaxation_time(self) -> float:
        """τ = τ1 G1/(G0 + G1) in s, at which stress relaxes at constant strain."""
        return self.tau1 * self.E1 / (self.E0 + self.E1)

    @property
    def bulk_modulus(self) -> float:
        """K = E0/(3(1−2ν)) of the bulk in Pa, constant in time."""
        return self.E0 / (3.0 * (1.0 - 2.0 * self.poisson_ratio_bulk))

    def vector(self) -> np.ndarray:
        """[E0, E1, tau1, E2] (4,) in Pa, Pa, s, Pa."""
        return np.array([self.E0, self.E1, self.tau1, self.E2])

    def with_vector(self, parameters: np.ndarray) -> Material:
        """The material with [E0, E1, tau1, E2] (4,) replaced."""
        E0, E1, tau1, E2 = (float(value) for value in parameters)
        return replace(self, E0=E0, E1=E1, tau1=tau1, E2=E2)

    @classmethod
    def from_dict(cls, data: dict[str, Any], where: str = "material") -> Material:
        """Material from a mapping; keys left out keep their default, unknown keys raise InputError."""
        return from_numbers(cls, data, where)

    @classmethod
    def load(cls, path: str | Path) -> Material:
        """Material from a YAML file (SI); raises InputError naming file and key."""
        return cls.from_dict(load_yaml(path, "material file"), str(path))

    def to_dict(self) -> dict[str, float]:
        """The keys of `material.yaml` and their values (SI)."""
        return asdict(self)
