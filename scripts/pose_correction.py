# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Learn the correction for elliptical pads and tilted plates, and judge it.

    python scripts/pose_correction.py TRUTH --held-out HELD_OUT --learn LINEAR...

reads tables of `scripts/pose_truth.py` and `scripts/pose_linear.py`, writes
`finger_model/data/pose_correction.json`, and prints the errors on the tables of the truth, those of
the first one also when learned without the finger (in FOLDS parts), and those on CalculiX's tilted
plate and elliptical pad. Without --learn the shipped correction is judged.
"""

from __future__ import annotations

import argparse
import csv
import json
import math
import os
import time
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import replace
from itertools import repeat
from pathlib import Path

import numpy as np
from pose_networks import Contacts, Network

from finger_common.files import atomic_write
from finger_common.flags import ShapeFlag
from finger_common.processes import worker_pool
from finger_model.estimator import ContactEstimate
from finger_model.estimator.estimate import ESTIMATE_FIELDS
from finger_model.geometry import Geometry
from finger_model.pose import correction
from finger_model.pose.networks import MIDDLE_SKIN_RATIO, inputs
from finger_model.pose.pose import Pose
from finger_model.pose.touch import first_touch
from finger_model.shape.estimate import MeasuredOutline, ShapeEstimate
from finger_model.shape.estimator import PoseEstimator
from finger_model.shape.settings import PoseSettings
from finger_model.verification.cases import CALCULIX_FINGER, STUDY, reference, smooth_area

PLACE = 0.2e-3
"""m, by which the place of the finger is known where the tilt is judged."""
SMALL, SMALL_WEIGHT = 0.2, 0.3
"""Depth below which a contact is a few nodes wide, and its weight."""
FOLDS = 5
NETWORKS = 4
SIZE = 2.0 ** np.arange(correction.POWERS)
"""Of the coefficients of the powers of the depth."""
VALUES = 7
"""Of a contact: ln of the area over that of the round pad, the two of its shape, and centre and
centre of pressure over half the pad's width."""


def terms_of(geometry: Geometry, pose: Pose) -> np.ndarray:
    """Terms (12, VALUES) of the coefficients by the values they make."""
    touch = first_touch(geometry, pose)
    terms = np.zeros((12, VALUES))
    terms[:6, 0] = correction.area_terms(touch)
    terms[6:8, 1:3] = correction.shape_terms(touch)
    place = touch.place / geometry.pad_semi_axis_radial
    terms[8:10, 3:5] = terms[10:12, 5:7] = np.outer(correction.center_terms(touch), place)
    return terms


class Row:
    """One contact of a table."""

    def __init__(self, row: dict[str, str]) -> None:
        value = {name: float(text) for name, text in row.items()}
        self.geometry, self.skin_ratio, self.pose = _finger_in_pose(value)
        self.touch = first_touch(self.geometry, self.pose)
        self.default = self.geometry == Geometry()
        self.number, self.force = int(value["number"]), value["force_n"]
        self.area, self.round_area = value["area_m2"], value["round_area_m2"]
        self.s = min(
            math.sqrt(self.round_area / math.pi) / self.geometry.pad_semi_axis_radial,
            correction.LARGEST_DEPTH,
        )
        self.ratio = value["axis_a_m"] / value["axis_b_m"]
        double = 2.0 * math.radians(value["orientation_deg"])
        self.shape = math.log(self.ratio) * np.array([math.cos(double), math.sin(double)])
        self.center = np.array([value[f"center_{k}_m"] for k in "xy"])
        self.pressure = np.array([value[f"pressure_{k}_m"] for k in "xy"])
        self.weight = 1.0 if self.s > SMALL else SMALL_WEIGHT
        self.name = (
            f"finger {self.number}, aspect {self.pose.aspect:.2f}, tilt {value['pitch_deg']:.0f}° "
            f"{value['roll_deg']:.0f}°"
        )

    @property
    def values(self) -> list[float]:
        """VALUES of the contact."""
        places = np.concatenate([self.center, self.pressure]) / self.geometry.pad_semi_axis_radial
        return [math.log(self.area / self.round_area), *self.shape, *places]


def _finger_in_pose(value: dict[str, float]) -> tuple[Geometry, float, Pose]:
    """Lengths, ratio of the moduli and pose of a row of either kind of table."""
    lengths = (value[k] for k in "width height skin bone_width bone_height".split())
    tilt = (math.radians(value[k]) for k in ("pitch_deg", "roll_deg"))
    geometry = Geometry(*lengths, 0.0, value["nail"])
    return geometry, value["skin_ratio"], Pose(value["aspect"], *tilt)


def rows_of(path: Path) -> list[Row]:
    """Rows of a table."""
    with path.open() as file:
        return [Row(row) for row in csv.DictReader(file)]


def truth_of(rows: list[Row]) -> Contacts:
    """What is learned from rows of the truth."""
    seen = [(r.geometry, r.skin_ratio, r.pose) for r in rows]
    depth, values = np.array([r.s for r in rows]), np.array([r.values for r in rows])
    return _contacts(seen, depth, values, np.array([r.weight**2 for r in rows]), True)


def linear_of(paths: list[Path]) -> Contacts:
    """What is learned from tables of `scripts/pose_linear.py`."""
    names = "log_ratio elongation_x elongation_y center_x center_y pressure_x pressure_y".split()
    seen, depth, values = [], [], []
    for path in paths:
        with path.open() as file:
            for row in csv.DictReader(file):
                value = {name: float(text) for name, text in row.items()}
                seen.append(_finger_in_pose(value))
                depth.append(value["depth"])
                values.append([value[name] for name in names])
    return _contacts(seen, np.array(depth), np.array(values), np.ones(len(seen)), False)


def _contacts(
    seen: Sequence[tuple[Geometry, float, Pose]],
    depth: np.ndarray,
    values: np.ndarray,
    weight: np.ndarray,
    large: bool,
) -> Contacts:
    known = {key: k for k, key in enumerate(dict.fromkeys(seen))}
    number = np.array([known[key] for key in seen])
    finger = np.array([inputs(g, ratio, pose, first_touch(g, pose)) for g, ratio, pose in known])
    terms = np.array([terms_of(geometry, pose) for geometry, _, pose in known])
    powers = depth[:, None] ** np.arange(correction.POWERS) * SIZE
    return Contacts(finger[number], powers, terms[number], values, weight, large)


def learn(linear: Contacts, truth: Contacts, seed: int) -> list[np.ndarray]:
    """Layers of a network. Every second row of small strain is enough; which, the seed tells."""
    size = np.sqrt(np.mean(np.sum(linear.terms**2, axis=2), axis=0))
    half = linear.where(np.arange(seed % 2, len(linear.values), 2))
    sets = [replace(some, terms=some.terms / size[:, None]) for some in (half, truth)]
    network = Network(linear.inputs.shape[1], correction.POWERS * len(size), seed)
    network.learn(sets)
    *hidden, last = network.at_large_strain
    return [*hidden, last * (SIZE[:, None] / size).ravel()]


def learn_all(linear: Contacts, truths: list[Contacts]) -> list[list[np.ndarray]]:
    """Stacked layers of NETWORKS networks for each truth."""
    tasks = [(truth, seed) for truth in truths for seed in range(NETWORKS)]
    with worker_pool(os.cpu_count() or 1, needs_main=True) as pool:
        found = list(pool.map(learn, repeat(linear), *zip(*tasks, strict=True)))
    return [
        [np.array(layer) for layer in zip(*found[k : k + NETWORKS], strict=True)]
        for k in range(0, len(found), NETWORKS)
    ]


def use(found: list[np.ndarray]) -> None:
    """Let the correction have these layers."""
    correction.layers()[:] = found


def errors(rows: list[Row], skin_known: bool = True) -> np.ndarray:
    """Errors (n, 6) of area (%), [its change (%)], axis ratio (%), orientation (°), centre and
    centre of pressure (mm); skin_known: with the modulus of the finger's own epidermis."""
    table = []
    for r in rows:
        skin = r.skin_ratio if skin_known else MIDDLE_SKIN_RATIO
        found = correction.PoseCorrection(r.geometry, r.pose, skin).outline(r.round_area)
        ratio = found.semi_axes[0] / found.semi_axes[1]
        turn = (found.orientation - 0.5 * math.atan2(r.shape[1], r.shape[0])) % math.pi
        table.append(
            [
                100.0 * (found.area / r.area - 1.0),
                100.0 * (r.area / r.round_area - 1.0),
                100.0 * (ratio / r.ratio - 1.0),
                math.degrees(min(turn, math.pi - turn)) if r.ratio > 1.05 else 0.0,
                1e3 * float(np.hypot(*(found.center - r.center))),
                1e3 * float(np.hypot(*(found.center_of_pressure - r.pressure))),
            ]
        )
    return np.array(table)


def judge(rows: list[Row], table: np.ndarray, what: str, each: bool) -> None:
    """Print the largest and RMS errors, and those of each finger and pose."""
    print(f"\n{what}: root mean square / largest errors of area (%), [its change (%)],")
    print("axis ratio (%), orientation (°), centre and centre of pressure (mm)")
    groups: dict[str, list[int]] = defaultdict(list)
    for k, r in enumerate(rows):
        if each:
            groups[r.name].append(k)
        if r.s > SMALL:
            groups[f"depth above {SMALL}"].append(k)
            steep = float(np.hypot(*r.touch.aside)) > correction.STEEP
            groups[f"of these, aside {'above' if steep else 'to'} {correction.STEEP}"].append(k)
        if r.default:
            groups["default finger"].append(k)
        else:
            groups["other fingers"].append(k)
        groups["all"].append(k)
    for name, members in groups.items():
        part = np.abs(table[members])
        rms, most = np.sqrt(np.mean(part**2, axis=0)), part.max(axis=0)
        within = np.mean(part[:, 0] < 2.0)
        figures = "  ".join(f"{a:.2f}/{b:.2f}" for a, b in zip(rms, most, strict=True))
        print(figures, f" {100 * within:.0f} % of areas within 2 %,", name)


def crossed(rows: list[Row], linear: Contacts) -> np.ndarray:
    """Errors of fingers that were not learned from."""
    table = np.zeros((len(rows), 6))
    numbers = np.array([r.number for r in rows])
    order = sorted(set(numbers.tolist()))
    outside = [np.isin(numbers, order[fold::FOLDS]) for fold in range(FOLDS)]
    truth = truth_of(rows)
    for out, found in zip(outside, learn_all(linear, [truth.where(~o) for o in outside])):
        use(found)
        table[out] = errors([row for row, left in zip(rows, out) if left])
    return table


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
        sds = np.degrees([shape.pitch_stddev, shape.roll_stddev])
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
    assumed = correction.PoseCorrection(press[0].geometry, Pose(), press[0].skin_ratio)
    estimator = PoseEstimator(assumed, settings)
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
            )
        pull = np.array([0.1 * force, 0.05 * force, -force])
        pressed = between([r.pressure for r in press]) + place
        torque = np.cross([*pressed, 0.02], pull) + 5e-4 * rng.standard_normal(3)
        values = {field.name: 0 for field in ESTIMATE_FIELDS}
        values |= {"stamp_ns": stamp, "onset_ns": 10**9, "in_contact": True, "parameter_set": ""}
        values |= {"area": round_area, "normal_force": force}
        estimate = ContactEstimate(**values)
        estimator.add(estimate, pull.tolist(), torque.tolist())
    return estimator.shape(estimate)


def calculix() -> None:
    """Print the errors against CalculiX; its round pad is its own axisymmetric curve."""
    for name, pose in (("tilt_20deg", Pose(pitch=math.radians(20.0))), ("ellipse_135", Pose(1.35))):
        table = reference(name)
        load = table["normal_force_n"]
        inside = (load > 0.1) & (load < 1.4)
        # The tissue of these runs is a little stiffer, 30.23 in place of 30 kPa.
        level = smooth_area("dry_frictionless", load * 30.0 / 30.23)
        fixed = correction.PoseCorrection(CALCULIX_FINGER, pose, STUDY["dry"].skin_ratio)
        found = np.array([fixed.outline(a * 1e-6).area * 1e6 for a in level])
        error = 100.0 * (found / table["area_mm2"] - 1.0)[inside]
        text = " ".join(f"{e:+.1f}" for e in error)
        print(f"CalculiX {name}: area {text} % at {load[inside].round(2)} N")


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("truth", type=Path)
    parser.add_argument("--held-out", type=Path)
    parser.add_argument("--learn", type=Path, nargs="+", metavar="LINEAR")
    arguments = parser.parse_args()
    rows = rows_of(arguments.truth)
    if arguments.learn:
        linear = linear_of(arguments.learn)
        fingers = len({r.number for r in rows})
        judge(rows, crossed(rows, linear), f"learned without the finger, of {fingers}", False)
        found = learn_all(linear, [truth_of(rows)])[0]
        found = [np.vectorize(lambda weight: float(f"{weight:.4g}"))(layer) for layer in found]
        with atomic_write(correction.FILE) as file:
            layers = ",\n".join(json.dumps(layer.tolist()) for layer in found)
            file.write(f'{{"layers": [\n{layers}\n]}}\n')
        use(found)
    judge(rows, errors(rows), "learned from", False)
    calculix()
    if arguments.held_out:
        held_out = rows_of(arguments.held_out)
        judge(held_out, errors(held_out), "kept aside", True)
        judge(held_out, errors(held_out, False), "kept aside, as if all skins had one ratio", False)
        tilts(held_out)


if __name__ == "__main__":
    main()
