# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Learn the correction for elliptical pads and tilted plates, and judge it.

    python scripts/pose_correction.py TRUTH --held-out HELD_OUT

reads tables of `scripts/pose_truth.py`, writes `finger_model/data/pose_correction.json`, and prints
the errors on both tables and on CalculiX's tilted plate and elliptical pad. Each run is compared
with that of its round pad on a level plate, on a mesh of the same fineness, in the same table.
"""

from __future__ import annotations

import argparse
import csv
import json
import math
from collections import defaultdict
from pathlib import Path

import numpy as np

from finger_common.files import atomic_write
from finger_model.geometry import Geometry
from finger_model.pose import correction
from finger_model.pose.touch import first_touch
from finger_model.solid3d.mesh import Pose
from finger_model.verification.cases import CALCULIX_FINGER, reference

FINGERS = {"default": Geometry(), "calculix": CALCULIX_FINGER}
RIDGE = 1e-4
"""Of the least squares, beside the mean square of a term."""


class Row:
    """One contact of a table, with the round pad's area of the same force."""

    def __init__(self, row: dict[str, str], round_area: float) -> None:
        tilt = (math.radians(float(row[k])) for k in ("pitch_deg", "roll_deg"))
        self.geometry = FINGERS[row["finger"]]
        self.pose = Pose(float(row["aspect"]), *tilt)
        self.touch = first_touch(self.geometry, self.pose)
        self.force, self.area = float(row["force_n"]), float(row["area_m2"])
        self.round_area = round_area
        self.s = math.sqrt(round_area / math.pi) / self.geometry.pad_semi_axis_radial
        ratio = float(row["semi_axis_a_m"]) / float(row["semi_axis_b_m"])
        double = 2.0 * float(row["orientation_rad"])
        self.ratio = ratio
        self.shape = math.log(ratio) * np.array([math.cos(double), math.sin(double)])
        self.center = np.array([float(row[f"center_{k}_m"]) for k in "xy"])
        self.pressure = np.array([float(row[f"pressure_{k}_m"]) for k in "xy"])
        self.name = (
            f"{row['finger']}, {float(row['modulus_pa']) / 1e3:.0f} kPa, friction "
            f"{row['friction']}, aspect {row['aspect']}, {row['pitch_deg']}° {row['roll_deg']}°"
        )


def rows_of(path: Path) -> list[Row]:
    """Rows of a table but those of the round pads on level plates."""
    table = list(csv.DictReader(path.open()))
    level = {}
    for row in table:
        if _is_level(row):
            level[(*_finger(row), row["force_n"])] = float(row["area_m2"])
    return [Row(row, level[(*_finger(row), row["force_n"])]) for row in table if not _is_level(row)]


def _finger(row: dict[str, str]) -> tuple[str, ...]:
    return tuple(row[k] for k in ("finger", "modulus_pa", "friction", "refinement"))


def _is_level(row: dict[str, str]) -> bool:
    return float(row["aspect"]) == 1.0 and row["pitch_deg"] == row["roll_deg"] == "0.0"


def solve(matrix: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """Least squares, slightly drawn to zero."""
    scale = np.sqrt(np.mean(matrix**2, axis=0))
    scaled = matrix / scale
    square = scaled.T @ scaled + RIDGE * len(wanted) * np.eye(scaled.shape[1])
    return np.linalg.solve(square, scaled.T @ wanted) / scale


def learn(rows: list[Row]) -> dict[str, list[float]]:
    """Coefficients by name."""
    area = solve(
        np.array([correction.area_terms(r.touch, r.s) for r in rows]),
        np.array([math.log(r.area / r.round_area) for r in rows]),
    )
    shape = solve(
        np.concatenate([correction.shape_terms(r.touch, r.s) for r in rows]),
        np.concatenate([r.shape for r in rows]),
    )
    found = {"area": area, "shape": shape}
    for name in ("center", "pressure"):
        tilted = [r for r in rows if np.hypot(*r.touch.place) > 1e-6]
        matrix = np.concatenate(
            [np.outer(r.touch.place, correction.center_terms(r.touch, r.s)) for r in tilted]
        )
        wanted = np.concatenate([getattr(r, name) for r in tilted])
        found[name] = solve(matrix * 1e3, wanted * 1e3)
    return {name: [float(f"{v:.5g}") for v in values] for name, values in found.items()}


def judge(rows: list[Row], what: str) -> None:
    """Print the largest and RMS errors, and those of each pose."""
    groups: dict[str, list[list[float]]] = defaultdict(list)
    for r in rows:
        found = correction.PoseCorrection(r.geometry, r.pose).outline(r.round_area)
        ratio = found.semi_axes[0] / found.semi_axes[1]
        turn = (found.orientation - 0.5 * math.atan2(r.shape[1], r.shape[0])) % math.pi
        groups[r.name].append(
            [
                100.0 * (found.area / r.area - 1.0),
                100.0 * (r.area / r.round_area - 1.0),
                100.0 * (ratio / r.ratio - 1.0),
                math.degrees(min(turn, math.pi - turn)) if r.ratio > 1.05 else 0.0,
                1e3 * float(np.hypot(*(found.center - r.center))),
                1e3 * float(np.hypot(*(found.center_of_pressure - r.pressure))),
            ]
        )
    print(
        f"\n{what}: errors of area (%), [its change (%)], axis ratio (%), orientation (°), centre"
    )
    print("and centre of pressure (mm): root mean square / largest")
    for name, values in [*groups.items(), ("all", [v for g in groups.values() for v in g])]:
        table = np.array(values)
        rms, most = np.sqrt(np.mean(table**2, axis=0)), np.abs(table).max(axis=0)
        print("  ".join(f"{a:.2f}/{b:.2f}" for a, b in zip(rms, most)), name)


def calculix() -> None:
    """Print the errors against CalculiX; its round pad is its own axisymmetric curve."""
    curve = reference("dry_frictionless")
    force, area = (curve[k] for k in list(curve)[:1] + [k for k in curve if "area" in k][:1])
    order = np.argsort(force)
    for name, pose in (("tilt_20deg", Pose(pitch=math.radians(20.0))), ("ellipse_135", Pose(1.35))):
        table = reference(name)
        load = table["normal_force_n"]
        inside = (load > 0.1) & (load < force.max())
        level = np.exp(np.interp(np.log(load), np.log(force[order]), np.log(area[order])))
        fixed = correction.PoseCorrection(CALCULIX_FINGER, pose)
        found = np.array([fixed.outline(a * 1e-6).area * 1e6 for a in level])
        error = 100.0 * (found / table["area_mm2"] - 1.0)[inside]
        text = " ".join(f"{e:+.1f}" for e in error)
        print(f"CalculiX {name}: area {text} % at {load[inside].round(2)} N")


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("truth", type=Path)
    parser.add_argument("--held-out", type=Path)
    arguments = parser.parse_args()
    rows = rows_of(arguments.truth)
    data = {
        "terms": {
            "area": correction.AREA_TERMS,
            "shape": correction.SHAPE_TERMS,
            "center": correction.CENTER_TERMS,
            "pressure": correction.CENTER_TERMS,
        },
        "coefficients": learn(rows),
    }
    with atomic_write(correction.FILE) as file:
        json.dump(data, file, indent=1, ensure_ascii=False)
        file.write("\n")
    judge(rows, "learned from")
    if arguments.held_out:
        judge(rows_of(arguments.held_out), "kept aside")
    calculix()


if __name__ == "__main__":
    main()
