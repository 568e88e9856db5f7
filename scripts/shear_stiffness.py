# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Tangential stiffness and displacement of the slip estimator against the three-dimensional model.

    python scripts/shear_stiffness.py [--fingers 12] [--seed 31] [--refinement 0.5]

Fingers of the population box, every third elastic, the others with laws of one to three branches,
are pressed by 0.04 to 0.16 of the pad's semi-axis within 0.1 to 2 s; some are held. Then the plate
moves sideways: by 10 µm at once, within 0.02 to 0.2 s until it slips, or within 0.3 to 3 s. Prints
how far stiffness and displacement are off, of laws that stiffen by strain on lines of their own. A
finger takes some seconds; with refinement 1 some minutes.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from finger_model.geometry import Geometry
from finger_model.laws import MaxwellLaw
from finger_model.reduced.population_runs import random_geometry, random_material
from finger_model.slip import elements
from finger_model.slip.kernels import pull_along
from finger_model.slip.shear import set_finger
from finger_model.solid3d.full_order import SolidModel, SolidPoint
from finger_model.verification.cases import elastic

STEPS = 3
TRAVEL, SUDDEN = 1e-5, 1e-9
"""m and s of the sudden pull."""
PULLED = (0.25, 0.5, 0.75, 1.0)
"""Parts of a pull."""
FINE = 20
"""Samples of the estimator for each row of the three-dimensional model."""
USED = 0.85
"""|Q|/(μP) up to which displacements count."""
EDGES = (0.0, 0.08, 0.12, 0.2)
"""Of δ/L, between which stiffnesses are put together."""


def random_finger(rng: np.random.Generator, number: int) -> tuple[Geometry, MaxwellLaw]:
    """A finger of the population box with friction 0.25 to 0.9."""
    geometry = random_geometry(rng, number % 3 != 0)
    material = random_material(rng, True, 1 + int(rng.integers(3)))
    if number % 3 == 0:
        modulus = material.instantaneous_modulus
        material = elastic(modulus, E2=material.epidermis_modulus)
    friction = float(np.exp(rng.uniform(*np.log((0.25, 0.9)))))
    return geometry, replace(material, friction=friction)


def displacement_error(
    geometry: Geometry, material: MaxwellLaw, points: Sequence[SolidPoint], pressed: int
) -> float:
    """Mean relative error of the displacement over the rows of a pull, those from `pressed` on, up
    to USED of the friction; NaN without such a row."""
    names = "time", "force", "area", "indentation", "tangential_x"
    rows = np.array([[getattr(p, name) for name in names] for p in points])
    at = np.linspace(0.0, len(rows), FINE * len(rows) + 1)
    whole = np.arange(len(rows) + 1.0)
    columns = [np.interp(at, whole, np.append(0.0, column)) for column in rows.T]
    finger, state = np.zeros(1, elements.FINGER)[0], np.zeros(1, elements.ELEMENTS)[0]
    set_finger(finger, geometry, material)
    table = np.full((len(at), 3), np.nan)
    pull_along(finger, state, *columns, float(material.friction), table)
    found = table[FINE::FINE, 2][pressed:]
    exact = np.array([p.shift_x for p in points[pressed:]])
    used = np.array([p.slip_margin > 1.0 - USED for p in points[pressed:]])
    return float(np.mean((found / exact - 1.0)[used])) if used.any() else np.nan


def errors(
    rng: np.random.Generator, number: int, refinement: float
) -> tuple[MaxwellLaw, list[float], list[float], list[float], str]:
    """Of one finger: its law; depths δ/L, and relative errors of the stiffness there; relative
    errors of the displacement in a fast and a slow pull; words about it."""
    geometry, material = random_finger(rng, number)
    depth, press = rng.uniform(0.04, 0.16), np.exp(rng.uniform(*np.log((0.1, 2.0))))
    hold = rng.choice([0.0, 0.0, 0.5, 3.0])
    durations = np.exp(rng.uniform(*np.log([(0.02, 0.2), (0.3, 3.0)]).T))
    length = geometry.pad_semi_axis_radial
    finger = np.zeros(1, elements.FINGER)[0]
    set_finger(finger, geometry, material)
    stepper = SolidModel(geometry, refinement=refinement).start(material)
    points, depths, off = [], [], []
    for part in np.linspace(0.0, 1.0, STEPS + 1)[1:]:
        to = part * depth * length
        points.append(stepper.step_to_position(part * press, to))
        if part > 0.5:
            before = stepper.state.copy()
            pulled = stepper.step_to_position(part * press + SUDDEN, to, (TRAVEL, 0.0))
            stepper.state = before
            exact = (pulled.tangential_x - points[-1].tangential_x) / TRAVEL
            depths.append(to / length)
            off.append(elements.stiffness(finger, to, points[-1].force)[0] / exact - 1.0)
    for part in (0.2, 1.0) if hold else ():
        points.append(stepper.step_to_position(press + part * hold, depth * length))
    held, pressed, moved = stepper.state.copy(), len(points), []
    reach = material.friction * points[-1].force / exact
    for duration, more in zip(durations, (1.0, 1.3), strict=True):
        stepper.state = held.copy()
        pull = [
            stepper.step_to_position(
                points[-1].time + part * duration, depth * length, (part * more * reach, 0.0)
            )
            for part in PULLED
        ]
        moved.append(displacement_error(geometry, material, points + pull, pressed))
    words = (
        f"{exact:.0f} N/m at {depth:.3f} L, E2/E {material.skin_ratio:.0f}, "
        f"E∞/E {material.long_term_fraction:.2f}, stiffening {material.stiffening:.1f}, {geometry}"
    )
    return material, depths, off, moved, words


def summary(name: str, found: np.ndarray) -> None:
    """Print mean, RMS and worst of relative errors (n,); NaNs do not count."""
    used = 100.0 * found[np.isfinite(found)]
    if len(used):
        rms = np.sqrt(np.mean(used**2))
        print(
            f"{name}: mean {used.mean():+.1f} %, RMS {rms:.1f} %, worst {np.abs(used).max():.0f} %"
            f" of {len(used)}"
        )


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--fingers", type=int, default=12)
    parser.add_argument("--seed", type=int, default=31)
    parser.add_argument("--refinement", type=float, default=0.5, help="of the mesh")
    arguments = parser.parse_args()
    kinds, depths, stiffnesses, pulls = [], [], [], []
    for number in range(arguments.fingers):
        rng = np.random.default_rng([arguments.seed, number])
        material, at, off, moved, words = errors(rng, number, arguments.refinement)
        relaxes = material.long_term_fraction < 0.9
        kinds.append("stiffening" if material.stiffening else "relaxing" if relaxes else "elastic")
        depths.append(at)
        stiffnesses.append(off)
        pulls.append(moved)
        print(f"off by {np.round(100.0 * np.array(off + moved))} %, {words}", flush=True)
    of_kind, at, off, moved = (np.array(v) for v in (kinds, depths, stiffnesses, pulls))
    for kind in ("elastic", "relaxing", "stiffening"):
        used = of_kind == kind
        for low, high in pairwise(EDGES):
            inside = (at[used] >= low) & (at[used] < high)
            summary(f"{kind}: stiffness, {low:g} to {high:g} L", off[used][inside])
        summary(f"{kind}: displacement, fast pulls", moved[used, 0])
        summary(f"{kind}: displacement, slow pulls", moved[used, 1])


if __name__ == "__main__":
    main()
