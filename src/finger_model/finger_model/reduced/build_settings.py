# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Settings of a build of the reduced model."""

from __future__ import annotations

from dataclasses import dataclass

from finger_common.errors import InputError
from finger_common.settings import Settings, setting

from .. import paper

MODES = 8
"""Coordinates of the internal strain that are kept of every run; a model uses the first of them."""


@dataclass(frozen=True)
class BuildSettings(Settings):
    """What a build depends on beside the geometry."""

    histories: int = setting(
        600, "Training histories; fewer is faster and less exact.", minimum=12, maximum=100_000
    )
    held_out: int = setting(
        204, "Histories on which the error is measured.", minimum=6, maximum=100_000
    )
    pilots: int = setting(42, "Histories that choose the coordinates.", minimum=3, maximum=1000)
    latents: int = setting(4, "Coordinates of the internal strain.", minimum=1, maximum=MODES)
    drive_width: int = setting(
        24, "Width of the layers of the network for strain and indentation.", minimum=2, maximum=512
    )
    contact_width: int = setting(
        32, "Width of the layers of the network for area and pressure.", minimum=2, maximum=512
    )
    betas: list = setting(
        [0.03, 0.15], "Memory of the friction states, in logarithm of indentation.", minimum=1e-6
    )
    iterations: int = setting(
        20, "Steps of each training; more is more exact.", minimum=1, maximum=10_000
    )
    seed: int = setting(1, "Seed of the random histories.", minimum=0, maximum=2**31 - 1)
    refinement: float = setting(1.0, "Divides the node spacing.", minimum=0.25, maximum=8.0)
    friction: float = setting(paper.FRICTION, "Friction coefficient.", minimum=0.0, maximum=1.0)

    def validate(self) -> None:
        if self.drive_width % 4:
            raise InputError(
                f"drive_width is {self.drive_width}, a multiple of 4 is needed (its kernel takes "
                "four units at a time)"
            )
