# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""What a material law of the finger is: parameters, fixed properties, and the bulk tissue's
response.

A law is one dataclass in one file. It declares its parameters as fields made with `parameter(…)`,
from which its `ParameterSpace` follows, and gives the finite elements the energy of one time step.
See docs/add_a_law.md for an example, `standard_linear_solid.py` for the default law.
"""

from __future__ import annotations

import contextlib
import dataclasses
import itertools
import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, NamedTuple, TypeVar

import numpy as np

from finger_common.errors import InputError
from finger_common.files import load_yaml, number

from .. import paper
from .space import DerivedQuantity, ParameterSpace, ParameterSpec

LARGEST_POISSON_RATIO = 0.4999
"""Above it the pressure loses more digits than Newton's criterion leaves."""

NAIL_MODULUS_RANGE = (1e3, 1e12)
"""Pa, accepted moduli of the nail."""

LARGEST_BULK_OVER_SHEAR = 2e5
"""Largest bulk modulus over long-term shear modulus of the bulk tissue: beyond it Newton's method
loses its digits."""


def unit(components: int) -> np.ndarray:
    """The unit tensor, stored as (rr, zz, θθ, rz), in three dimensions (xx, yy, zz, xy, yz, xz)."""
    return np.array([1.0, 1.0, 1.0] + [0.0] * (components - 3))


UNIT = unit(4)
"""The unit tensor of an axisymmetric body."""

IN_KPA: dict[str, Any] = {"unit": "Pa", "display_unit": "kPa", "display_factor": 1e-3}
"""Description of a modulus: in Pa, shown in kPa."""

_KEY = "parameter"


def trace(tensors: np.ndarray) -> np.ndarray:
    """Trace (…) of symmetric tensors (…, 4 or 6)."""
    return tensors[..., 0] + tensors[..., 1] + tensors[..., 2]


Law = TypeVar("Law", bound="ConstitutiveLaw")


def parameter(default: float, meaning: str, **description: Any) -> Any:
    """A field of a law that a fit may vary; the arguments are those of `ParameterSpec`."""
    return dataclasses.field(
        default=default, metadata={_KEY: {"default": default, "meaning": meaning, **description}}
    )


class Tissue(NamedTuple):
    """Strain and internal variables at the Gauss points of the n elements of bulk tissue.

    c_bar, c_bar_inverse (n, 4, 4): C̄ = J^(−2/3) FᵀF and its inverse; internal (k, n, 4, 4): the
    law's k internal tensors. Axes: element, Gauss point, component. Arrays are never changed in
    place. In three dimensions an element has 8 points, a tensor 6 components.
    """

    c_bar: np.ndarray
    c_bar_inverse: np.ndarray
    internal: np.ndarray

    @property
    def unit(self) -> np.ndarray:
        """The unit tensor, of as many components as the strains."""
        return unit(self.c_bar.shape[-1])


class StepEnergy(NamedTuple):
    """Isochoric energy of one time step as the elements need it: 2 ∂W/∂C̄ = H + h(Ī₁) 1, Ī₁ = tr
    C̄.

    metric (n, 4, 4): the tensor H in Pa, constant during the step. stiffening: Ī₁ (n, 4) → h and
    dh/dĪ₁ (n, 4) in Pa; None where h is zero, as for neo-Hookean springs.
    """

    metric: np.ndarray
    stiffening: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]] | None = None


@dataclass(frozen=True, kw_only=True)
class ConstitutiveLaw(ABC):
    """Material of the whole finger: a law of the bulk tissue, elastic epidermis and nail, friction.

    A subclass is a frozen keyword-only dataclass. Its fields made with `parameter` form PARAMETERS;
    the fields here are fixed properties, which no fit varies. Epidermis and nail are neo-Hookean,
    and the volume of every part is elastic: W_vol = ½ K (J − 1)².

    Raises InputError for a value that is not finite or outside its allowed range, a Poisson's ratio
    outside 0 … 0.4999, tissue that is all but incompressible, or friction outside 0 … 1.
    """

    name: ClassVar[str]
    """As in `law: NAME` of material.yaml and in the entry points `finger_model.law`."""
    PARAMETERS: ClassVar[ParameterSpace]
    """What a fit varies; made from the fields."""
    DERIVED: ClassVar[tuple[DerivedQuantity, ...]] = ()
    CORRECTION: ClassVar[Sequence[str] | Mapping[str, float]] = ()
    """Quantities in whose logarithms a model correction is linear; all parameters by default."""
    INTERNAL_TENSORS: ClassVar[int] = 0
    """Internal tensors per Gauss point, the unit tensor at rest."""
    STIFFNESS_ADVICE: ClassVar[str] = "lower 'poisson_ratio_bulk'"
    """What to change when the tissue is all but incompressible."""

    nail_modulus: float = 170e6  # assumption
    poisson_ratio_bulk: float = 0.48  # Fung 1993
    poisson_ratio_epidermis: float = 0.48  # Fung 1993
    poisson_ratio_nail: float = 0.38  # assumption
    friction: float = paper.FRICTION

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        found = {p.name: p for p in getattr(cls, "PARAMETERS", ())}
        for name, value in vars(cls).items():
            if isinstance(value, dataclasses.Field) and _KEY in value.metadata:
                found[name] = ParameterSpec(name, **value.metadata[_KEY])
        cls.PARAMETERS = ParameterSpace(list(found.values()), cls.DERIVED, cls.CORRECTION)

    @classmethod
    def check_class(cls, name: str) -> None:
        """Raises InputError for a class that is no complete law or has another name, and for a
        parameter with a default that is not allowed or bounds that are no search box."""
        where = f"material law '{name}' ({cls.__module__}:{cls.__qualname__})"
        fault = None
        missing = sorted(cls.__abstractmethods__)
        if missing:
            fault = f"has no {', '.join(missing)}; add them"
        elif any(isinstance(v, dataclasses.Field) for c in cls.__mro__ for v in vars(c).values()):
            fault = "is no dataclass; put @dataclass(frozen=True, kw_only=True) before it"
        elif not len(cls.PARAMETERS):
            fault = "has no parameters; make a field of it with parameter(…)"
        elif getattr(cls, "name", None) != name:
            fault = f"has the name {getattr(cls, 'name', None)!r}; give it that of its entry point"
        if fault:
            raise InputError(f"{where} {fault}")
        for spec in cls.PARAMETERS:
            spec.check(spec.default, f"{where}: default", allowed=True)
            if spec.bounds != ParameterSpec.bounds:
                spec.check_bounds(where)

    def __post_init__(self) -> None:
        for name in self.to_dict():
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, (int, float, np.number)):
                raise InputError(f"material: '{name}' is {value!r}, a number is needed")
            object.__setattr__(self, name, float(value))
            if not math.isfinite(value):
                raise InputError(f"material: '{name}' is {value}, a finite number is needed")
        for spec in self.PARAMETERS:
            spec.check(getattr(self, spec.name), "material", allowed=True)
        low, high = NAIL_MODULUS_RANGE
        if not low <= self.nail_modulus <= high:
            raise InputError(
                f"material: 'nail_modulus' is {self.nail_modulus:g} Pa, outside {low:g} … "
                f"{high:g} Pa; give moduli in Pa"
            )
        for part in ("bulk", "epidermis", "nail"):
            value = getattr(self, f"poisson_ratio_{part}")
            if not 0 <= value <= LARGEST_POISSON_RATIO:
                raise InputError(
                    f"material: 'poisson_ratio_{part}' is {value:g}, outside "
                    f"0 … {LARGEST_POISSON_RATIO}; use 0.48 for soft tissue"
                )
        if not 0 <= self.friction <= 1:
            raise InputError(f"material: 'friction' is {self.friction:g}, outside 0 … 1; use 0.25")
        self._check_moduli()

    def _check_moduli(self) -> None:
        """Raises InputError for tissue that relaxes to nothing or is all but incompressible."""
        rest = self.long_term_shear_modulus
        if not rest > 0.0:
            raise InputError(
                f"material: the long-term shear modulus is {rest:.3g} Pa, it must be above zero; "
                f"{self.STIFFNESS_ADVICE}"
            )
        ratio = self.bulk_modulus / rest
        if ratio > LARGEST_BULK_OVER_SHEAR:
            raise InputError(
                f"material: the bulk modulus is {ratio:.2g} times the long-term shear modulus, "
                f"more than {LARGEST_BULK_OVER_SHEAR:g}; {self.STIFFNESS_ADVICE}"
            )

    # Moduli ----------------------------------------------------------------------------------

    @property
    @abstractmethod
    def epidermis_modulus(self) -> float:
        """Modulus of the elastic epidermis (Pa)."""

    @property
    @abstractmethod
    def instantaneous_shear_modulus(self) -> float:
        """Shear modulus (Pa) of the resting bulk tissue under a sudden small strain."""

    @property
    def long_term_shear_modulus(self) -> float:
        """Shear modulus (Pa) of the bulk tissue under a constant small strain, after relaxation."""
        return self.instantaneous_shear_modulus

    @property
    def skin_ratio(self) -> float:
        """Modulus of the epidermis over the long-term one of the bulk tissue, E₂/E."""
        tissue = 2.0 * (1.0 + self.poisson_ratio_bulk) * self.long_term_shear_modulus
        return self.epidermis_modulus / tissue

    @property
    def bulk_modulus(self) -> float:
        """K = 2 G (1 + ν)/(3 (1 − 2ν)) of the bulk tissue in Pa, constant in time."""
        ratio = self.poisson_ratio_bulk
        shear = self.instantaneous_shear_modulus
        return 2.0 * shear * (1.0 + ratio) / (3.0 * (1.0 - 2.0 * ratio))

    @property
    def creep_time(self) -> float:
        """Time (s) in which the strain follows a change of load; infinite for elastic tissue."""
        return math.inf

    def longest_creep_time(self, box: np.ndarray) -> float:
        """Longest time (s) in which strain creeps at constant stress, of all parameters that the
        law allows in a box (n, 2); 0 for elastic tissue."""
        found = [0.0]
        for corner in itertools.product(*box):
            with contextlib.suppress(InputError):
                found.append(self.with_vector(np.array(corner)).creep_time)
        return max(time for time in found if math.isfinite(time))

    # Response of the bulk tissue -------------------------------------------------------------

    @abstractmethod
    def step_energy(self, duration: float, before: Tissue) -> StepEnergy:
        """Energy of a step of `duration` (s, zero for none) that starts from `before`."""

    def update(
        self, duration: float, before: Tissue, c_bar: np.ndarray, c_bar_inverse: np.ndarray
    ) -> np.ndarray:
        """Internal tensors (k, n, 4, 4) after a step of `duration` (s) to this strain (n, 4, 4)."""
        return before.internal

    @abstractmethod
    def energies(self, weight: np.ndarray, before: Tissue, after: Tissue) -> tuple[float, float]:
        """Isochoric energy stored after a step and energy dissipated in it (J/rad).

        weight (n, 4): reference volume of the Gauss points in m³/rad.
        """

    # Vectors, mappings, files ----------------------------------------------------------------

    def vector(self) -> np.ndarray:
        """The parameters (n,) in the order of PARAMETERS."""
        return np.array([getattr(self, name) for name in self.PARAMETERS.names])

    def with_vector(self: Law, vector: np.ndarray) -> Law:
        """The same fixed properties with other parameters (n,)."""
        return dataclasses.replace(self, **self.PARAMETERS.mapping(vector))

    def to_dict(self) -> dict[str, float]:
        """Parameters and fixed properties (SI), as in material.yaml."""
        return {name: getattr(self, name) for name in self.keys()}

    @classmethod
    def keys(cls) -> tuple[str, ...]:
        """Names of parameters, then of fixed properties."""
        names = cls.PARAMETERS.names
        return names + tuple(f.name for f in dataclasses.fields(cls) if f.name not in names)

    @classmethod
    def from_dict(cls: type[Law], data: Mapping[str, Any], where: str = "material") -> Law:
        """From a mapping; keys left out keep their default. Raises InputError naming the key."""
        for key in data:
            if key not in cls.keys():
                raise InputError(
                    f"{where}: unknown key '{key}'; the keys are {', '.join(cls.keys())}"
                )
        values = {key: number(dict(data), key, where) for key in data}
        try:
            return cls(**values)
        except InputError as error:
            raise InputError(str(error).replace("material:", f"{where}:", 1)) from None

    @classmethod
    def load(cls: type[Law], path: str | Path) -> Law:
        """From a material.yaml of this law (SI); raises InputError naming file and key."""
        data = load_yaml(path, "material file")
        name = data.pop("law", cls.name)
        if name != cls.name:
            raise InputError(f"{path}: 'law' is {name!r}, {cls.name} is needed")
        return cls.from_dict(data, str(path))
