# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Contacts of elliptical pads on tilted plates, by the three-dimensional model.

    python scripts/pose_truth.py learn src/finger_model/finger_model/data/pose_truth.csv
    python scripts/pose_truth.py test src/finger_model/finger_model/data/pose_held_out.csv

writes a row for each pose and force. `learn` gives the runs that `finger_model.pose` is fitted to;
`test` those kept aside: other poses, loads and a stiffer tissue. The mesh has 0.7 of the default
fineness. Runs that the file has already are kept. A run takes some 15 s of a core.

A pad that is tilted about its long axis is solved as half a finger too: with x and y exchanged.
"""

from __future__ import annotations

import argparse
import csv
import math
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from finger_model.fem.equilibrium import OPEN
from finger_model.geometry import Geometry
from finger_model.pose.pose import Pose
from finger_model.solid3d.full_order import SolidModel, SolidStepper
from finger_model.verification.cases import CALCULIX_FINGER, elastic

LOADS = (0.2, 0.4, 0.7, 1.2, 2.0)
TEST_LOADS = (0.3, 0.9)
"""N."""
COLUMNS = (
    "finger,aspect,pitch_deg,roll_deg,modulus_pa,friction,refinement,force_n,area_m2,semi_axis_a_m,"
    "semi_axis_b_m,orientation_rad,center_x_m,center_y_m,pressure_x_m,pressure_y_m,travel_m"
).split(",")

FINGERS = {"default": Geometry(), "calculix": CALCULIX_FINGER}


@dataclass(frozen=True)
class Run:
    """One finger pressed onto one plate; tilts in degrees."""

    aspect: float
    pitch_deg: float = 0.0
    roll_deg: float = 0.0
    finger: str = "default"
    modulus_pa: float = 30e3
    friction: float = 0.0
    refinement: float = 0.7


def learned() -> list[Run]:
    """Runs to learn from."""
    runs = [Run(1.0, tilt) for tilt in (0.0, 15.0, 30.0)]
    for aspect in (1.6, 1.25):
        runs += [Run(aspect, tilt) for tilt in (0.0, 30.0, 15.0)]
        runs += [Run(aspect, 0.0, tilt) for tilt in (30.0, 15.0)]
    return runs


def kept_aside() -> list[Run]:
    """Runs to judge by; each material begins with the round pad on a level plate."""
    stiff = [Run(1.0, modulus_pa=80e3), Run(1.3, 20.0, modulus_pa=80e3)]
    return [Run(1.0), Run(1.4, 22.0), Run(1.15, 0.0, 26.0), *stiff]


def contacts(run: Run, loads: tuple[float, ...]) -> list[dict[str, float | str]]:
    """Rows of one run."""
    geometry, pose = FINGERS[run.finger], Pose(run.aspect, math.radians(run.pitch_deg))
    swapped = run.roll_deg != 0.0 and run.pitch_deg == 0.0
    if swapped:
        geometry = replace(
            geometry,
            **{
                name: getattr(geometry, name) * run.aspect
                for name in ("pad_semi_axis_radial", "bone_semi_axis_radial", "nail_radius")
            },
        )
        pose = Pose(1.0 / run.aspect, math.radians(run.roll_deg))
    elif run.roll_deg:
        pose = Pose(run.aspect, math.radians(run.pitch_deg), math.radians(run.roll_deg))
    stepper = SolidModel(geometry, pose, run.refinement).start(
        elastic(run.modulus_pa, E2=1795e3, friction=run.friction)
    )
    rows: list[dict[str, float | str]] = []
    for k, load in enumerate(loads, 1):
        point = stepper.step(float(k), load)
        center = np.array([point.center_x, point.center_y])
        pressure = center_of_pressure(stepper)
        turn = point.orientation
        if swapped:
            # The pad's x is the run's y, its y the run's x.
            center, pressure, turn = center[::-1], pressure[::-1], 0.5 * math.pi - turn
        rows.append(
            {
                **asdict(run),
                "force_n": load,
                "area_m2": point.area,
                "semi_axis_a_m": point.semi_axis_a,
                "semi_axis_b_m": point.semi_axis_b,
                "orientation_rad": turn,
                "center_x_m": center[0],
                "center_y_m": center[1],
                "pressure_x_m": pressure[0],
                "pressure_y_m": pressure[1],
                "travel_m": point.indentation,
            }
        )
    return rows


def center_of_pressure(stepper: SolidStepper) -> np.ndarray:
    """Point (2,) in m of the plate about which the normal forces have no torque."""
    contact, mesh = stepper.state.contact, stepper.model.mesh
    skin = stepper.state.positions[mesh.surface]
    force = np.where(contact.status != OPEN, contact.force[:, 2], 0.0)
    center = force @ skin[:, :2] / force.sum()
    if mesh.half:
        center[1] = 0.0
    return center


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("which", choices=("learn", "test"))
    parser.add_argument("table", type=Path)
    arguments = parser.parse_args()
    done = set()
    if arguments.table.exists():
        with arguments.table.open() as file:
            done = {tuple(row[c] for c in COLUMNS[:7]) for row in csv.DictReader(file)}
    else:
        arguments.table.write_text(",".join(COLUMNS) + "\n")
    learn = arguments.which == "learn"
    for run in learned() if learn else kept_aside():
        values = asdict(run)
        key = tuple(str(values[c]) for c in COLUMNS[:7])
        if key in done:
            continue
        rows = contacts(run, LOADS if learn else TEST_LOADS)
        with arguments.table.open("a", newline="") as file:
            writer = csv.writer(file, lineterminator="\n")
            for row in rows:
                cells = [row[c] for c in COLUMNS]
                writer.writerow([*cells[:8], *(f"{float(v):.7g}" for v in cells[8:])])
        print(run, flush=True)


if __name__ == "__main__":
    main()
