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
import time
from collections import defaultdict
from pathlib import Path

import numpy as np

from finger_common.files import atomic_write
from finger_common.flags import ShapeFlag
from finger_model.estimator import ContactEstimate
from finger_model.estimator.estimate import ESTIMATE_FIELDS
from finger_model.geometry import Geometry
from finger_model.pose import correction
from finger_model.pose.estimator import MeasuredOutline, PoseEstimator, ShapeEstimate
from finger_model.pose.pose import Pose
from finger_model.pose.settings import PoseSettings
from finger_model.pose.touch import first_touch
from finger_model.verification.cases import CALCULIX_FINGER, reference

FINGERS = {"default": Geometry(), "calculix": CALCULIX_FINGER}
PLACE = 0.2e-3
"""m, by which the place of the finger is known where the tilt is judged."""
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


def tilts(rows: list[Row]) -> None:
    """Print what the pose estimator finds in a press of one second through the loads of each pose,
    with noise: 10 outlines, torques at 500 Hz, the finger's place known to PLACE."""
    groups: dict[str, list[Row]] = defaultdict(list)
    for r in rows:
        groups[r.name].append(r)
    rng = np.random.default_rng(0)
    print("\ntilt found: errors of pitch and roll (°), their deviations, aspect")
    began, missed, all_errors = time.process_time(), 0, []
    for name, press in groups.items():
        shape = _pressed(press, rng)
        pose = press[0].pose
        errors = np.degrees([shape.pitch - pose.pitch, shape.roll - pose.roll])
        all_errors += np.abs(errors).tolist()
        sds = np.degrees([shape.pitch_sd, shape.roll_sd])
        missed += bool(np.any(np.abs(errors) > 3.0) and not shape.flags & ShapeFlag.TILT_UNCERTAIN)
        print(f"{errors.round(1)} {sds.round(1)} {shape.pad_aspect:.2f} {name}")
    spent = (time.process_time() - began) / len(groups)
    inside = sum(error < 3.0 for error in all_errors)
    print(f"{inside} of {len(all_errors)} within 3°; {missed} poses beyond and not flagged")
    print(f"{100.0 * spent:.0f} % of a core")


def _pressed(press: list[Row], rng: np.random.Generator) -> ShapeEstimate:
    place = np.array([1e-3, -2e-3])
    told = (place + PLACE * rng.standard_normal(2)).tolist()
    settings = PoseSettings(
        pad_x=told[0], pad_y=told[1], pad_place_sd=PLACE, finger_direction=0.0, sensor_depth=0.02
    )
    estimator = PoseEstimator(press[0].geometry, settings)
    loads = [r.force for r in press]

    def between(values: list) -> np.ndarray:
        return np.array([np.interp(force, loads, column) for column in np.transpose(values)])

    for k, force in enumerate(np.linspace(loads[0], loads[-1], 500)):
        stamp = 10**9 + 2_000_000 * k
        round_area, area = np.exp(
            between([[math.log(r.round_area), math.log(r.area)] for r in press])
        )
        if k % 50 == 0:
            double = between([r.shape for r in press])
            ratio = math.exp(math.hypot(*double))
            minor = 2.0 * math.sqrt(area / (math.pi * ratio))
            axes = np.array([minor * ratio, minor]) * (1.0 + 0.01 * rng.standard_normal(2))
            center = between([r.center for r in press]) + place + 5e-5 * rng.standard_normal(2)
            estimator.expect_outline(
                stamp,
                MeasuredOutline(
                    (float(center[0]), float(center[1])),
                    float(axes.max()),
                    float(axes.min()),
                    0.5 * math.atan2(double[1], double[0]),
                    5e-5,
                    *(0.01 * np.sort(axes)[::-1]).tolist(),
                ),
                0.0,
            )
        pull = np.array([0.1 * force, 0.05 * force, -force])
        pressed = between([r.pressure for r in press]) + place
        torque = np.cross([*pressed, 0.02], pull) + 5e-4 * rng.standard_normal(3)
        values = {field.name: 0 for field in ESTIMATE_FIELDS}
        values |= {"stamp_ns": stamp, "onset_ns": 10**9, "in_contact": True, "parameter_set": ""}
        values |= {"area": round_area, "normal_force": force}
        estimate = ContactEstimate(**values)
        estimator.follow(estimate, pull.tolist(), torque.tolist())
    return estimator.shape(estimate)


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
        tilts(rows_of(arguments.held_out) + rows)
    calculix()


if __name__ == "__main__":
    main()
