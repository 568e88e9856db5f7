# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Areas of the three-dimensional model against the axisymmetric one, on fingers of all kinds.

    python scripts/solid_areas.py [--fingers 12]

presses round pads straight, without friction, and prints the differences of area and indentation
in %. Four fingers are named here, the others are drawn from the population box. A finger takes
half a minute.
"""

from __future__ import annotations

import argparse

import numpy as np

from finger_model.fem.full_order import FullOrderModel
from finger_model.geometry import Geometry
from finger_model.pose.correction import SKIN_RATIOS
from finger_model.reduced.population_runs import random_geometry
from finger_model.solid3d.full_order import SolidModel
from finger_model.verification.cases import CALCULIX_FINGER, elastic

MODULUS = 30e3
"""Pa; only ratios count."""
LOADS = np.geomspace(0.07, 0.85, 8)
"""Force over the modulus and the square of the pad's semi-axis."""
SEED = 7


def fingers() -> list[tuple[Geometry, float]]:
    """Twelve fingers with the ratio of the moduli of skin and tissue."""
    small = Geometry(6e-3, 4.5e-3, 0.8e-3, 2.4e-3, 1.8e-3, 0.0, 4.8e-3)
    large = Geometry(11e-3, 9e-3, 0.35e-3, 4.4e-3, 3.6e-3, 0.0, 8.5e-3)
    found = [(CALCULIX_FINGER, 55.0), (Geometry(), 60.0), (small, 55.0), (large, 55.0)]
    rng = np.random.default_rng(SEED)
    for k in range(8):
        geometry = random_geometry(rng, k % 2 == 0)
        found.append((geometry, float(np.exp(rng.uniform(*np.log(SKIN_RATIOS))))))
    return found


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--fingers", type=int, default=12)
    errors = []
    for geometry, ratio in fingers()[: parser.parse_args().fingers]:
        material = elastic(MODULUS, E2=ratio * MODULUS, friction=0.0)
        flat = FullOrderModel(geometry, refinement=1.5).start(material)
        solid = SolidModel(geometry).start(material)
        for k, load in enumerate((LOADS * MODULUS * geometry.pad_semi_axis_radial**2).tolist(), 1):
            exact, point = flat.step(float(k), load), solid.step(float(k), load)
            pairs = (point.area, exact.area), (point.indentation, exact.indentation)
            errors.append([100.0 * (a / b - 1.0) for a, b in pairs])
        area, depth = np.round(errors[-len(LOADS) :], 1).T
        print(f"E2/E {ratio:.0f}, area {area}, indentation {depth}, {geometry}", flush=True)
    table = np.array(errors)
    rms, most = np.sqrt(np.mean(table**2, axis=0)), np.abs(table).max(axis=0)
    print("root mean square / largest: area", *(f"{v[0]:.2f}" for v in (rms, most)), end=" %, ")
    print("indentation", *(f"{v[1]:.2f}" for v in (rms, most)), "%")


if __name__ == "__main__":
    main()
