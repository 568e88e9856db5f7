"""The paper's law: a standard linear solid of bulk tissue under an elastic epidermis."""

from __future__ import annotations

import numpy as np

from .. import paper
from .space import DerivedQuantity, ParameterSpace, ParameterSpec


def composite_modulus(vectors: np.ndarray) -> np.ndarray:
    """Long-term modulus E = 1/(1/E0 + 1/E1) in Pa of vectors (…, 4)."""
    return 1.0 / (1.0 / vectors[..., 0] + 1.0 / vectors[..., 1])


def _with_composite_modulus(vectors: np.ndarray, modulus: np.ndarray) -> np.ndarray:
    """Vectors (…, 4) with E1 set so that E has the given values (Pa); NaN where E ≥ E0."""
    out = vectors.copy()
    rest = 1.0 / modulus - 1.0 / vectors[..., 0]
    out[..., 1] = np.divide(1.0, rest, out=np.full(rest.shape, np.nan), where=rest > 0)
    return out


def _parameter(name: str, **description) -> ParameterSpec:
    return ParameterSpec(
        name, default=paper.NATURAL.parameters[name], bounds=paper.SEARCH_BOX[name], **description
    )


PARAMETERS = ParameterSpace(
    [
        _parameter(
            "E0",
            unit="Pa",
            meaning="Modulus of the spring of the bulk tissue: stiffness under a sudden load.",
            symbol="E₀",
            display_unit="kPa",
            display_factor=1e-3,
            decimals=1,
            range=(30e3, 300e3),
        ),
        _parameter(
            "E1",
            unit="Pa",
            meaning="Modulus of the Kelvin element (spring beside a damper) in series with E0.",
            symbol="E₁",
            display_unit="kPa",
            display_factor=1e-3,
            decimals=2,
            range=(8e3, 120e3),
        ),
        _parameter(
            "tau1",
            unit="s",
            meaning="Creep time of the Kelvin element: shear viscosity over shear modulus.",
            symbol="τ₁",
            display_unit="s",
            display_factor=1.0,
            decimals=3,
            range=(0.002, 3.0),
        ),
        _parameter(
            "E2",
            unit="Pa",
            meaning="Modulus of the elastic epidermis.",
            symbol="E₂",
            display_unit="kPa",
            display_factor=1e-3,
            decimals=0,
            range=(300e3, 5000e3),
        ),
    ],
    derived=[
        DerivedQuantity(
            "composite_E",
            unit="Pa",
            meaning="Long-term modulus of the bulk tissue, 1/(1/E0 + 1/E1).",
            symbol="E",
            display_unit="kPa",
            display_factor=1e-3,
            decimals=2,
            value=composite_modulus,
            solve=_with_composite_modulus,
            solves_for="E1",
            of=("E0", "E1"),
        )
    ],
    correction=("composite_E", "E0", "tau1", "E2"),
)
"""E0, E1 (Pa), tau1 (s), E2 (Pa), and the composite modulus."""
