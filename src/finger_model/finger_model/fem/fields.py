# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Displacement, stress and contact tractions of a state, for figures and files."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import meshio
import numpy as np

from finger_common.files import atomic_write

from .contact_radius import contact_pressure, contact_shear
from .elements import Stiffness
from .equilibrium import Contact, Equilibrium
from .mesh import BULK, EPIDERMIS


@dataclass(frozen=True)
class Fields:
    """Fields on the half-section (SI).

    nodes (N, 2): undeformed r, z; displacement (N, 2); cells (E, 4); part (E,): 0 bulk, 1
    epidermis, 2 nail; stress (E, 4): mean Cauchy stress (rr, zz, θθ, rz) of an element; von_mises,
    pressure (E,), pressure positive in compression. surface (S,): skin nodes from the axis
    outwards; contact_radius (S,): their deformed radius; contact_pressure, contact_shear (S,):
    tractions there, shear outwards; plate_height: z of the plate.
    """

    nodes: np.ndarray
    displacement: np.ndarray
    cells: np.ndarray
    part: np.ndarray
    stress: np.ndarray
    von_mises: np.ndarray
    pressure: np.ndarray
    surface: np.ndarray
    contact_radius: np.ndarray
    contact_pressure: np.ndarray
    contact_shear: np.ndarray
    plate_height: float

    @property
    def deformed(self) -> np.ndarray:
        """Deformed r, z (N, 2) of the nodes."""
        return self.nodes + self.displacement

    @property
    def bulk(self) -> np.ndarray:
        """Which cells (E,) are bulk tissue."""
        return self.part == BULK

    @property
    def epidermis(self) -> np.ndarray:
        """Which cells (E,) are epidermis."""
        return self.part == EPIDERMIS

    @property
    def interface(self) -> np.ndarray:
        """Nodes between bulk and epidermis, from the axis outwards."""
        shared = np.intersect1d(self.cells[self.bulk], self.cells[self.epidermis])
        r, z = self.nodes[shared].T
        return shared[np.argsort(np.arctan2(r, -z))]

    def to_vtu(self, path: str | Path) -> None:
        """Write an unstructured VTK file of the deformed half-section in the x–z plane (SI)."""
        pad = np.zeros(len(self.nodes))
        points = np.column_stack([self.deformed[:, 0], pad, self.deformed[:, 1]])
        moved = np.column_stack([self.displacement[:, 0], pad, self.displacement[:, 1]])
        normal, shear = np.zeros(len(self.nodes)), np.zeros(len(self.nodes))
        normal[self.surface] = self.contact_pressure
        shear[self.surface] = self.contact_shear
        mesh = meshio.Mesh(
            points,
            [("quad", self.cells)],
            point_data={
                "displacement": moved,
                "contact_pressure": normal,
                "contact_shear": shear,
            },
            cell_data={
                "von_mises": [self.von_mises],
                "pressure": [self.pressure],
                "stress_rr_zz_tt_rz": [self.stress],
                "part": [self.part.astype(np.int32)],
            },
        )
        with atomic_write(path, "wb") as file:
            meshio.write(file.name, mesh, file_format="vtu")


def fields_of(
    equilibrium: Equilibrium,
    x: np.ndarray,
    contact: Contact,
    material: Stiffness,
) -> Fields:
    """Fields at positions x (N, 2) of a material there."""
    mesh = equilibrium.mesh
    stress = np.empty((len(mesh.cells), 4))
    for group in equilibrium.groups:
        stress[group.index] = group.cauchy(x, material)
    rr, zz, tt, rz = stress.T
    von_mises = np.sqrt(0.5 * ((rr - zz) ** 2 + (zz - tt) ** 2 + (tt - rr) ** 2) + 3.0 * rz**2)
    skin = x[mesh.surface]
    return Fields(
        nodes=mesh.nodes,
        displacement=x - mesh.nodes,
        cells=mesh.cells,
        part=mesh.part,
        stress=stress,
        von_mises=von_mises,
        pressure=-stress[:, :3].mean(axis=1),
        surface=mesh.surface,
        contact_radius=skin[:, 0],
        contact_pressure=contact_pressure(skin, contact),
        contact_shear=contact_shear(skin, contact),
        plate_height=contact.height,
    )
