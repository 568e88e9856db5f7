# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""In which strain measure the parts of the finger are elastic: finite strain, or linear elasticity.

The model's own choice is finite strain throughout (neo-Hooke with split volume). The others are
options of the full-order model, to know what linear elasticity does (docs/paper_choices.md).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from finger_common.errors import InputError

from . import elements, linear_elements
from .elements import Elements, Stiffness
from .mesh import BULK, EPIDERMIS, NAIL, Mesh

NEO_HOOKE = "neo-hooke"
_SMALL, _GREEN_LAGRANGE = False, True

_LINEAR_PARTS: dict[str, tuple[tuple[int, ...], bool]] = {
    NEO_HOOKE: ((), _GREEN_LAGRANGE),
    "linear-epidermis": ((EPIDERMIS,), _GREEN_LAGRANGE),
    "st-venant-kirchhoff": ((BULK, EPIDERMIS, NAIL), _GREEN_LAGRANGE),
    "small-strain": ((BULK, EPIDERMIS, NAIL), _SMALL),
}
ELASTICITIES = tuple(_LINEAR_PARTS)
"""Names of the options. Linear epidermis: Hooke's law between Green–Lagrange's strain and Piola and
Kirchhoff's stress in the epidermis alone; St Venant–Kirchhoff: the same in all parts; small strain:
linear elasticity on the undeformed shape."""


class Measures(NamedTuple):
    """Strain at the Gauss points of n elements.

    c_bar, c_bar_inverse (n, 4, 4); dilatation (n, 4): J − 1, or tr E of linear elasticity;
    smallest: J.
    """

    c_bar: np.ndarray
    c_bar_inverse: np.ndarray
    dilatation: np.ndarray
    smallest: float


class FiniteStrain:
    """Elements of an index (slice or (n,)) whose energy is that of C̄ and J."""

    def __init__(self, reference: Elements, index: slice | np.ndarray) -> None:
        self.index = index
        self.elements = reference.only(index)

    def assemble(
        self,
        x: np.ndarray,
        material: Stiffness,
        stiffness: bool,
        force: np.ndarray,
        band: np.ndarray,
    ) -> float:
        """Add to force (2N,) and band; returns the smallest J."""
        return elements.assemble(
            x, self.elements, material.only(self.index), stiffness, force, band
        )

    def measures(self, x: np.ndarray) -> Measures:
        """Strain at node positions x (N, 2)."""
        shape = self.elements.weight.shape
        c_bar, inverse, jacobian = np.empty((*shape, 4)), np.empty((*shape, 4)), np.empty(shape)
        elements.strain_measures(x, self.elements, c_bar, inverse, jacobian)
        return Measures(c_bar, inverse, jacobian - 1.0, float(jacobian.min()))

    def cauchy(self, x: np.ndarray, material: Stiffness) -> np.ndarray:
        """Mean Cauchy stress (n, 4) of the elements in Pa: ∫ τ dV / v over the deformed element."""
        metric, _, bulk = material.only(self.index)
        weight = self.elements.weight
        gradient, hoop = deformation_gradients(x, self.elements)
        jacobian = np.linalg.det(gradient) * hoop
        kirchhoff = _push_forward(gradient, hoop, metric) * jacobian[..., None] ** (-2.0 / 3.0)
        kirchhoff[..., :3] -= kirchhoff[..., :3].mean(axis=-1, keepdims=True)
        volume = (weight * jacobian).sum(axis=1)
        stress = np.einsum("ep,epk->ek", weight, kirchhoff) / volume[:, None]
        stress[:, :3] += (bulk * (volume / weight.sum(axis=1) - 1.0))[:, None]
        return stress


class LinearStrain:
    """Elements of an index whose stress is linear in Green–Lagrange's or in the small strain."""

    def __init__(self, reference: Elements, index: slice | np.ndarray, finite: bool) -> None:
        self.index = index
        self.elements = reference.only(index)
        self.finite = finite

    def assemble(
        self,
        x: np.ndarray,
        material: Stiffness,
        stiffness: bool,
        force: np.ndarray,
        band: np.ndarray,
    ) -> float:
        """Add to force (2N,) and band; returns the smallest J."""
        return linear_elements.assemble(
            x, self.elements, material.only(self.index), self.finite, stiffness, force, band
        )

    def measures(self, x: np.ndarray) -> Measures:
        """Strain at node positions x (N, 2)."""
        shape = self.elements.weight.shape
        c_bar, inverse, dilatation = np.empty((*shape, 4)), np.empty((*shape, 4)), np.empty(shape)
        smallest = linear_elements.strain_measures(
            x, self.elements, self.finite, c_bar, inverse, dilatation
        )
        return Measures(c_bar, inverse, dilatation, smallest)

    def cauchy(self, x: np.ndarray, material: Stiffness) -> np.ndarray:
        """Mean Cauchy stress (n, 4) of the elements in Pa."""
        metric, _, bulk = material.only(self.index)
        weight = self.elements.weight
        _, inverse, dilatation, _ = self.measures(x)
        third = metric[..., :3].mean(axis=-1, keepdims=True)
        # 1 − C̄⁻¹ is twice the deviatoric strain.
        stress = metric - third * inverse
        pressure = bulk * (weight * dilatation).sum(axis=1) / weight.sum(axis=1)
        stress[..., :3] += pressure[:, None, None]
        if not self.finite:
            return np.einsum("ep,epk->ek", weight, stress) / weight.sum(axis=1)[:, None]
        gradient, hoop = deformation_gradients(x, self.elements)
        volume = (weight * np.linalg.det(gradient) * hoop).sum(axis=1)
        kirchhoff = _push_forward(gradient, hoop, stress)
        return np.einsum("ep,epk->ek", weight, kirchhoff) / volume[:, None]


def groups_of(
    mesh: Mesh, reference: Elements, elasticity: str
) -> list[FiniteStrain | LinearStrain]:
    """The elements of a mesh by their strain measure; raises InputError for an unknown name."""
    if elasticity not in _LINEAR_PARTS:
        raise InputError(
            f"elasticity '{elasticity}' does not exist; the choices are {', '.join(ELASTICITIES)}"
        )
    parts, finite = _LINEAR_PARTS[elasticity]
    linear = np.isin(mesh.part, parts)
    if not linear.any():
        return [FiniteStrain(reference, slice(None))]
    groups: list[FiniteStrain | LinearStrain] = [
        LinearStrain(reference, np.flatnonzero(linear), finite)
    ]
    if not linear.all():
        groups.append(FiniteStrain(reference, np.flatnonzero(~linear)))
    return groups


def deformation_gradients(x: np.ndarray, part: Elements) -> tuple[np.ndarray, np.ndarray]:
    """In-plane F (n, 4, 2, 2) and hoop stretch (n, 4) at node positions x (N, 2)."""
    corners = x[part.cells]
    gradient = np.einsum("eni,epnj->epij", corners, part.gradient)
    return gradient, np.einsum("en,pn->ep", corners[:, :, 0], elements.SHAPE) / part.radius


def _push_forward(gradient: np.ndarray, hoop: np.ndarray, tensor: np.ndarray) -> np.ndarray:
    """F T Fᵀ (n, 4, 4) of tensors T (n, 4, 4)."""
    plane = np.empty((*tensor.shape[:2], 2, 2))
    plane[..., 0, 0], plane[..., 1, 1] = tensor[..., 0], tensor[..., 1]
    plane[..., 0, 1] = plane[..., 1, 0] = tensor[..., 3]
    b = np.einsum("epij,epjk,eplk->epil", gradient, plane, gradient)
    return np.stack([b[..., 0, 0], b[..., 1, 1], hoop**2 * tensor[..., 2], b[..., 0, 1]], axis=-1)
