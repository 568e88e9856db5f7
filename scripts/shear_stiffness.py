# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Tangential stiffness that the slip estimator assumes, against the three-dimensional model.

    python scripts/shear_stiffness.py [--fingers 12] [--seed 31]

Fingers of the population box are pressed to three depths. At each the plate, which does not slip,
moves sideways by 10 µm. Prints force over that travel, and how far the law of `slip.shear` is from
it; a finger takes half a minute.
"""

from __future__ import annotations

import argparse

import numpy as np

from finger_model.pose.correction import SKIN_RATIOS
from finger_model.reduced.population_runs import random_geometry
from finger_model.slip.shear import DEPTHS, shear_curve
from finger_model.solid3d.full_order import SolidModel
from finger_model.verification.cases import elastic

MODULUS = 30e3
"""Pa; only ratios count."""
PRESSED = (0.03, 0.08, 0.15)
"""Indentation over the pad's radial semi-axis."""
STEPS = 3
TRAVEL = 1e-5
"""m."""
OVER_INDENTATION = 0.58
"""Stiffness over force per indentation, the same for all fingers: what was assumed before."""


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--fingers", type=int, default=12)
    parser.add_argument("--seed", type=int, default=31)
    arguments = parser.parse_args()
    rng = np.random.default_rng(arguments.seed)
    errors = []
    for finger in range(arguments.fingers):
        geometry = random_geometry(rng, finger % 3 != 0)
        ratio = float(np.exp(rng.uniform(*np.log(SKIN_RATIOS))))
        material = elastic(MODULUS, E2=ratio * MODULUS, friction=1.0)
        stepper = SolidModel(geometry).start(material)
        curve = shear_curve(geometry, material)
        found, depth, time, shift = [], 0.0, 0.0, 0.0
        for share in PRESSED:
            before, depth = depth, share * geometry.pad_semi_axis_radial
            for part in np.linspace(before, depth, STEPS + 1)[1:]:
                time += 1.0
                point = stepper.step_to_position(time, float(part), (shift, 0.0))
            time, shift, held = time + 1.0, shift + TRAVEL, point.tangential_x
            point = stepper.step_to_position(time, depth, (shift, 0.0))
            exact = (point.tangential_x - held) / TRAVEL
            secant = point.force / depth
            ours = float(np.interp(np.log(share), np.log(DEPTHS), curve))
            found.append((exact, ours / exact - 1.0, OVER_INDENTATION * secant / exact - 1.0))
        table = np.array(found)
        errors.append(table[:, 1:])
        print(
            f"{np.round(table[:, 0])} N/m, off by {np.round(100 * table[:, 1])} %, "
            f"E2/E {ratio:.0f}, {geometry}",
            flush=True,
        )
    for name, column in (("law", 0), ("0.58 P/δ", 1)):
        all_of = 100.0 * np.array(errors)[:, :, column]
        rms, worst = np.sqrt((all_of**2).mean(axis=0)), np.abs(all_of).max(axis=0)
        print(f"{name}: RMS {np.round(rms, 1)} %, worst {np.round(worst)} % at {PRESSED} of L")


if __name__ == "__main__":
    main()
