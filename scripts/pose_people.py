# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""How wrong outline and centre of pressure are for a finger whose lengths nobody told.

    python scripts/pose_people.py

draws fingers of people, presses each in POSES poses, and takes each for the default finger with the
default skin; what a contact looks like is told by the correction for elliptical pads and tilted
plates. Prints the errors (root mean square) that `finger_model.pose.lengths.PEOPLE_SD` and
`finger_model.shape.estimator` count with, and the deviation for lengths from calipers.
"""

from __future__ import annotations

import argparse
import math
from typing import NamedTuple

import numpy as np

from finger_model.anthropometry import estimate_geometry
from finger_model.geometry import Geometry, StatedGeometry
from finger_model.people import People
from finger_model.pose.correction import Outline, PoseCorrection
from finger_model.pose.lengths import stretch_sd
from finger_model.pose.networks import MIDDLE_SKIN_RATIO
from finger_model.pose.pose import Pose

FINGERS, POSES = 2000, 4
TILT = math.radians(12.0)
"""Deviation of pitch and roll."""
STEEPEST = math.radians(25.0)


class Errors(NamedTuple):
    """Of n contacts. factor: by how much too small a tilt is found by the contact's place, as a
    share of it; rest, torque_rest: what that factor leaves wrong of the centres of contact and of
    pressure (m); shape: of ln(a/b), times cosine and sine of twice the direction."""

    factor: np.ndarray
    rest: np.ndarray
    torque_rest: np.ndarray
    shape: np.ndarray


def errors(fingers: int, seed: int = 0) -> Errors:
    """Errors of the default finger's lengths for those of people."""
    rng = np.random.default_rng(seed)
    found = []
    for _ in range(fingers):
        person = People.default().draw(rng)
        skin = person.material.skin_ratio
        for _ in range(POSES):
            tilt = np.clip(TILT * rng.standard_normal(2), -STEEPEST, STEEPEST).tolist()
            pose, area = Pose(float(rng.uniform(1.0, 1.5)), *tilt), float(rng.uniform(2e-5, 6e-5))
            true = PoseCorrection(person.geometry, pose, skin).outline(area)
            taken = PoseCorrection(Geometry(), pose, MIDDLE_SKIN_RATIO).outline(area)
            way = taken.center @ taken.center
            factor = float(true.center @ taken.center / way)
            rest = true.center - factor * taken.center
            torque_rest = true.center_of_pressure - factor * taken.center_of_pressure
            found.append((1.0 / factor - 1.0, rest, torque_rest, shape(true) - shape(taken)))
    return Errors(*(np.array(column) for column in zip(*found)))


def shape(outline: Outline) -> np.ndarray:
    """ln(a/b) times cosine and sine of twice the direction (2,)."""
    double = 2.0 * outline.orientation
    size = math.log(outline.semi_axes[0] / outline.semi_axes[1])
    return size * np.array([math.cos(double), math.sin(double)])


def main() -> None:
    """Command line."""
    argparse.ArgumentParser(description=__doc__.splitlines()[0]).parse_args()
    found = errors(FINGERS)

    def size(values: np.ndarray) -> float:
        return math.sqrt(float(np.mean(values**2)))

    print(f"{FINGERS} fingers in {POSES} poses each")
    print(f"tilt by the place of the contact: {100 * size(found.factor):.0f} % of it")
    for name, rest in (("contact", found.rest), ("pressure", found.torque_rest)):
        print(f"centre of {name}, by that factor: {1e3 * size(rest):.3f} mm")
    print(f"ln(a/b): {size(found.shape):.3f}")
    calipers = estimate_geometry(0.017, 0.011)
    stated = StatedGeometry(calipers.geometry, calipers.deviations)
    share = stretch_sd(calipers.geometry, stated)
    print(f"tilt, lengths from {calipers.measured}: {100 * share:.0f} % of it")


if __name__ == "__main__":
    main()
