# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""The default law: the paper's standard linear solid under an elastic epidermis."""

from __future__ import annotations

from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from .. import paper
from .law import IN_KPA, parameter
from .maxwell import Branch, MaxwellLaw
from .space import DerivedQuantity

MODULUS_RANGE = (1e3, 3e7)
"""Pa, accepted moduli. Below, a number in kPa or MPa is likelier than a finger; under a stiffer
epidermis the contact at 1 N is narrower than a few elements of the default mesh, and its area is
not found."""


def composite_modulus(vectors: np.ndarray) -> np.ndarray:
    """Long-term modulus E = 1/(1/E0 + 1/E1) in Pa of vectors (…, 4)."""
    return 1.0 / (1.0 / vectors[..., 0] + 1.0 / vectors[..., 1])


def _with_composite_modulus(vectors: np.ndarray, modulus: np.ndarray) -> np.ndarray:
    """Vectors (…, 4) with E1 set so that E has the given values (Pa); NaN where E ≥ E0."""
    out = vectors.copy()
    rest = 1.0 / modulus - 1.0 / vectors[..., 0]
    out[..., 1] = np.divide(1.0, rest, out=np.full(rest.shape, np.nan), where=rest > 0)
    return out


COMPOSITE_MODULUS = DerivedQuantity(
    "composite_E",
    **IN_KPA,
    meaning="Long-term modulus of the bulk tissue, 1/(1/E0 + 1/E1).",
    symbol="E",
    decimals=2,
    value=composite_modulus,
    solve=_with_composite_modulus,
    solves_for="E1",
    of=("E0", "E1"),
)


def _paper(name: str, meaning: str, **description):
    """A parameter with the paper's search box, whose default is that of the natural condition."""
    return parameter(
        paper.NATURAL.parameters[name], meaning, bounds=paper.SEARCH_BOX[name], **description
    )


@dataclass(frozen=True, kw_only=True)
class StandardLinearSolid(MaxwellLaw):
    """Spring E0 in series with a Kelvin element: spring E1 beside a damper, τ1 = η1/G1.

    Nam and Kuchenbecker 2021, eq. 2. The equal parallel form is used, a spring G∞ beside one
    Maxwell branch (G0 − G∞, τ), with G = E/(2(1+ν)) of each modulus:

        W = ½ G∞ (tr C̄ − 3) + ½ (G0 − G∞) (A : C̄ − ln det A − 3) + ½ K (J − 1)²
        dA/dt = (C̄⁻¹ − A)/τ,   G∞ = G0 G1/(G0 + G1),   τ = τ1 G1/(G0 + G1),   K = E0/(3(1−2ν))

    The spring G∞ may stiffen, see `MaxwellLaw`. Why this form: docs/theory.md, section 3. An
    elastic tissue is written with E1 very large against E0.
    """

    name = "standard_linear_solid"
    DERIVED = (COMPOSITE_MODULUS,)
    # The steps are about a standard deviation of a fit of 15 presses.
    CORRECTION = MappingProxyType({"composite_E": 0.08, "E0": 0.3, "tau1": 0.3, "E2": 0.12})
    INTERNAL_TENSORS = 1
    STIFFNESS_ADVICE = "lower 'E0' against 'E1' or 'poisson_ratio_bulk'"

    E0: float = _paper(
        "E0",
        "Modulus of the spring of the bulk tissue: its stiffness under a sudden load.",
        **IN_KPA,
        symbol="E₀",
        decimals=1,
        range=(30e3, 300e3),
        allowed=MODULUS_RANGE,
    )
    E1: float = _paper(
        "E1",
        "Modulus of the Kelvin element in series with E0.",
        **IN_KPA,
        symbol="E₁",
        decimals=2,
        range=(8e3, 120e3),
        allowed=(MODULUS_RANGE[0], np.inf),
    )
    tau1: float = _paper(
        "tau1",
        "Creep time of the Kelvin element: shear viscosity over shear modulus.",
        unit="s",
        symbol="τ₁",
        display_unit="s",
        display_factor=1.0,
        decimals=3,
        range=(0.002, 3.0),
    )
    E2: float = _paper(
        "E2",
        "Modulus of the elastic epidermis.",
        **IN_KPA,
        symbol="E₂",
        decimals=0,
        range=(300e3, 5000e3),
        allowed=MODULUS_RANGE,
    )

    @property
    def composite_modulus(self) -> float:
        """Long-term modulus E = 1/(1/E0 + 1/E1) in Pa (paper)."""
        return 1.0 / (1.0 / self.E0 + 1.0 / self.E1)

    @property
    def epidermis_modulus(self) -> float:
        """E2 in Pa."""
        return self.E2

    @property
    def instantaneous_shear_modulus(self) -> float:
        """G0 = E0/(2(1+ν)) in Pa."""
        return self.E0 / (2.0 * (1.0 + self.poisson_ratio_bulk))

    @property
    def kelvin_shear_modulus(self) -> float:
        """G1 = E1/(2(1+ν)) in Pa."""
        return self.E1 / (2.0 * (1.0 + self.poisson_ratio_bulk))

    @property
    def long_term_shear_modulus(self) -> float:
        """G∞ = 1/(1/G0 + 1/G1) in Pa."""
        return 1.0 / (1.0 / self.instantaneous_shear_modulus + 1.0 / self.kelvin_shear_modulus)

    @property
    def relaxation_time(self) -> float:
        """τ = τ1 G1/(G0 + G1) in s, in which stress relaxes at constant strain."""
        return self.tau1 * self.E1 / (self.E0 + self.E1)

    @property
    def branches(self) -> tuple[Branch, ...]:
        """The branch (G0 − G∞)/G0 = E0/(E0 + E1) with τ."""
        return (Branch(self.E0 / (self.E0 + self.E1), self.relaxation_time),)

    @property
    def creep_time(self) -> float:
        """τ1 in s, in which strain creeps at constant stress."""
        return self.tau1


PARAMETERS = StandardLinearSolid.PARAMETERS
"""E0, E1 (Pa), tau1 (s), E2 (Pa), and the composite modulus."""
