# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Stick and slip along a given history of P and Q at a known friction, by the elements alone."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from finger_common.errors import InputError

from ..geometry import Geometry
from ..history import CSV_HEADER, ContactHistory, csv_of
from ..laws import MaxwellLaw
from .elements import ELEMENTS, FINGER
from .kernels import pull_along
from .shear import set_finger

PULL_CSV_HEADER = CSV_HEADER + ",stick_ratio,slip_margin,tangential_displacement_mm"


@dataclass(frozen=True)
class PullHistory:
    """A contact history with stick_ratio, slip_margin (n,), NaN without contact, and
    tangential_displacement (n,) in m, NaN without contact and from the first slip on."""

    contact: ContactHistory
    stick_ratio: np.ndarray
    slip_margin: np.ndarray
    tangential_displacement: np.ndarray

    def csv_text(self) -> str:
        """The header PULL_CSV_HEADER and one line per instant."""
        contact = self.contact
        own = self.stick_ratio, self.slip_margin, self.tangential_displacement * 1e3
        return csv_of(PULL_CSV_HEADER, contact.time, contact.force, *contact.csv_columns(), *own)


def pull_history(
    contact: ContactHistory, tangential: np.ndarray, geometry: Geometry, material: MaxwellLaw
) -> PullHistory:
    """Stick and slip under tangential forces (n,) in N along x; the material's friction > 0.

    Raises InputError for another shape and for forces that are not finite.
    """
    tangential = np.ascontiguousarray(tangential, float)
    if tangential.shape != (len(contact),) or not np.isfinite(tangential).all():
        raise InputError(
            f"tangential forces: {len(contact)} finite numbers are needed, one for each row of the "
            f"contact; the array has the shape {tangential.shape}"
        )
    finger, state = np.zeros(1, FINGER)[0], np.zeros(1, ELEMENTS)[0]
    set_finger(finger, geometry, material)
    table = np.full((len(tangential), 3), np.nan)
    pull_along(
        finger,
        state,
        contact.time,
        contact.force,
        contact.area,
        contact.indentation,
        tangential,
        float(material.friction),
        table,
    )
    return PullHistory(contact, *table.T)
