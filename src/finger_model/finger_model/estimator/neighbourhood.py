# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""The finger of a reduced model with its neighbours (`members`), followed through known presses."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ..reduced.model import ReducedModel
from . import members


class Followed(NamedTuple):
    """Area (n,) in m², peak pressure (n,) in Pa, and sensitivities (n, 3) of the logarithm of the
    area along the directions of the tissue."""

    area: np.ndarray
    peak_pressure: np.ndarray
    sensitivities: np.ndarray


@dataclass(frozen=True)
class Neighbourhood:
    """A finger and its members: constants and states (4,), the kernels' scratch, and `MEMBERS` (1,)
    with the shift of the finger. `follow` changes the states."""

    model: ReducedModel
    constants: np.ndarray
    states: np.ndarray
    work: np.ndarray
    near: np.ndarray

    @classmethod
    def at(cls, model: ReducedModel, base: np.ndarray, shift: np.ndarray) -> Neighbourhood:
        """At rest, the finger of the constants `base` (1,) shifted by (3,), within the limits."""
        near = np.zeros(1, members.MEMBERS)
        members.shift_all(near, np.ascontiguousarray(shift))
        constants = np.repeat(base, 1 + members.DIRECTIONS)
        states = np.concatenate([model.state_at_rest(base)] * len(constants))
        # Apart from the model's own scratch, which a live estimator may be using.
        work = model.work.copy()
        members.place_all(model.networks, base, constants, states, work, near)
        return cls(model, constants, states, work, near)

    @property
    def shift(self) -> np.ndarray:
        """Of the finger (3,) along the directions."""
        return self.near["shift"][0]

    def follow(self, before: float, time: np.ndarray, force: np.ndarray) -> Followed:
        """Go on from the instant `before` (s) under forces (n,) in N at times (n,) in s."""
        table = np.empty((len(time), 3 + 2 * members.DIRECTIONS))
        near = self.near.copy()
        records = self.model.networks, self.constants, self.states, self.work, near
        members.follow(*records, before, time, force, table)
        return Followed(table[:, 0], table[:, 2], table[:, 3 : 3 + members.DIRECTIONS])
