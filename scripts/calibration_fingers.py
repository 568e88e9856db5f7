# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Force alone after a calibration: drawn fingers, their guided presses, and ten presses after.

    python scripts/calibration_fingers.py [--fingers 40] [--seed 11] [--width 11mm] [--presses 6]

Fingers and the ten presses are drawn as in `population_fingers.py`; each has a moisture reading.
The camera sees the guided presses and is off in those after. Each finger is calibrated twice: with
the default lengths, and with its width and depth by calipers, with their error. --width: all
fingers are scaled to this width. --presses: so many guided presses, over again if need be.

With --tissue: how well the deviations of stiffness, creep time and creep hold for these fingers,
which stiffen and have several branches, and what STRUCTURE_SD of `finger_model.calibration` is to
be for that (--seed 77 --fingers 100 for the shipped values). The truth is the finger's long-term
modulus, creep (the modulus that relaxes over the long-term one), and mean creep time: under a
constant stress the mean of the time, weighted by the rate of creep.
"""

from __future__ import annotations

import argparse
import itertools
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from population_fingers import FRAME, KINDS, START, force_of, rms

from finger_common.guided_presses import CALIBRATION_PRESSES, GuidedPress
from finger_common.usable_press import TYPICAL_AREA_NOISE
from finger_model.anthropometry import CALIPER_DEVIATION, estimate_geometry, parse_length
from finger_model.calibration import STRUCTURE_SD, CalibrationPress, calibrate, subject_model
from finger_model.estimator import ContactEstimator
from finger_model.finger import load_reduced
from finger_model.geometry import Geometry
from finger_model.laws import MaxwellLaw, StandardLinearSolid
from finger_model.parameter_sets import ParameterSets
from finger_model.people import People, Person
from finger_model.reduced import ReducedModel
from finger_model.reduced.model import load_population
from finger_sim.press import guided_style, plan_press

GOAL = 0.04
"""RMS of the area's error over that of the area."""


@dataclass(frozen=True, eq=False)
class Finger:
    """A finger, its guided presses as measured, and the presses after them.

    after: time (n,) in s, force (n,) in N, true area (n,) in m² and the press's own factor in it.
    factor: mean of the guided presses' own. width, depth: by calipers, in m.
    """

    person: Person
    guided: tuple[CalibrationPress, ...]
    after: tuple[tuple[np.ndarray, np.ndarray, np.ndarray, float], ...]
    factor: float
    width: float
    depth: float


def pressed(
    seed: int,
    index: int,
    plan: Sequence[GuidedPress] = CALIBRATION_PRESSES,
    person: Person | None = None,
) -> Finger:
    """The index-th finger of a seed, or this person's with the presses of that one."""
    rng = np.random.default_rng([seed, index])
    people = People.default()
    drawn = people.draw(rng)
    person = person or drawn
    model = load_population(person.geometry).for_material(person.material)
    constants = model.constants(person.material)
    state, at, before = model.state_at_rest(constants), 1.0, 0.0
    guided, factors, after = [], [], []
    for press in plan:
        planned = plan_press(rng, style=guided_style(press), target_force=press.target_force)
        time, force = at + planned.time, planned.force
        area = model.run(constants, state, time[::5], force[::5], before)[:, 0]
        factors.append(people.press_gain * rng.normal())
        area *= np.exp(factors[-1])
        before, at = time[::5][-1], time[-1] + 2.0
        frames = np.arange(time[0] + FRAME * rng.random(), time[-1], FRAME)
        seen = np.interp(frames, time[::5], area)
        frames, seen = frames[seen > 0], seen[seen > 0]
        measured = np.maximum(seen + TYPICAL_AREA_NOISE * rng.normal(size=len(seen)), 1e-7)
        columns = frames, measured, np.full(len(frames), TYPICAL_AREA_NOISE)
        guided.append(CalibrationPress(time, force, *columns))
    for kind in KINDS:
        since, force = force_of(rng, kind)
        time = at + since
        gain = float(np.exp(people.press_gain * rng.normal()))
        area = gain * model.run(constants, state, time, force, before)[:, 0]
        before, at = time[-1], time[-1] + 2.0
        after.append((time, force, area, gain))
    width, depth = (
        2.0 * length + CALIPER_DEVIATION * rng.normal()
        for length in (person.geometry.pad_semi_axis_radial, person.geometry.pad_semi_axis_axial)
    )
    factor = float(np.exp(np.mean(factors)))
    return Finger(person, tuple(guided), tuple(after), factor, width, depth)


def force_only(
    finger: Finger, model: ReducedModel, sets: ParameterSets
) -> tuple[float, float, float]:
    """Of the presses after, without camera: RMS of the area's error over that of the area, the same
    with the presses' own factors left out, and the share that the 95 % interval covers."""
    estimator = ContactEstimator(model, sets)
    estimator.add_moisture(START - 10**9, finger.person.reading)
    columns = []
    for time, force, area, gain in finger.after:
        fine = np.arange(time[0] - 0.3, time[-1] + 0.3, 0.004)
        normal = np.interp(fine, time, force, 0.0, 0.0)
        stamps = START + np.round(fine * 1e9).astype(np.int64)
        block = estimator.add_wrenches(stamps, np.column_stack([0 * normal, 0 * normal, -normal]))
        truth = np.interp(fine, time, area, 0.0, 0.0)
        use = block.column("in_contact") & (truth > 0)
        found, deviation = block.column("area")[use], block.column("area_stddev")[use]
        columns.append([found, deviation, truth[use], truth[use] / gain])
    found, deviation, truth, alike = np.hstack(columns)
    covered = np.abs(found - truth) <= 1.96 * deviation
    return (
        rms(found - truth) / rms(truth),
        rms(found - alike) / rms(alike),
        float(np.mean(covered)),
    )


def least_error(finger: Finger) -> float:
    """As the first of `force_only`, for one who knows the finger, and the mean of the guided
    presses' own factors for that of those after."""
    error = np.hstack([area * (1.0 - finger.factor / gain) for *_, area, gain in finger.after])
    return rms(error) / rms(np.hstack([area for *_, area, _ in finger.after]))


def scaled(person: Person, width: float) -> Person:
    """The same person with a fingertip of this width (m); skin and nail keep their thickness."""
    factor = 0.5 * width / person.geometry.pad_semi_axis_radial
    lengths = {
        name: value if "thickness" in name else factor * value
        for name, value in person.geometry.to_dict().items()
    }
    return replace(person, geometry=Geometry(**lengths))


def scores(finger: Finger, calipers: bool) -> tuple[float, float, float]:
    """`force_only` after a calibration, with calipers or without."""
    estimate = estimate_geometry(finger.width, finger.depth) if calipers else None
    model, lengths = subject_model(load_reduced(), estimate)
    sets = ParameterSets.default()
    found = calibrate(model, sets, finger.guided, finger.person.reading, lengths=lengths)
    return force_only(finger, model, found.sets)


def tissue_of(law: MaxwellLaw) -> dict[str, float]:
    """Long-term modulus (Pa), mean creep time (s) and creep of the bulk tissue, by the names of the
    quantities of a calibration."""
    relaxing = sum(branch.fraction for branch in law.branches)
    long_term = 1.0 - relaxing
    time = sum(branch.fraction * branch.relaxation_time for branch in law.branches) / relaxing
    return {
        "stiffness": law.instantaneous_modulus * long_term,
        "time": time / long_term,
        "creep": relaxing / long_term,
    }


def tissue_errors(finger: Finger, calipers: bool) -> dict[str, tuple[float, float, float]]:
    """Of a calibration: errors of stiffness, creep time and creep, their stated deviations, and
    what of these is STRUCTURE_SD; all of the natural logarithm."""
    reading, sets = finger.person.reading, ParameterSets.default()
    estimate = estimate_geometry(finger.width, finger.depth) if calipers else None
    model, lengths = subject_model(load_reduced(), estimate)
    found = calibrate(model, sets, finger.guided, reading, lengths=lengths)
    shipped = StandardLinearSolid().with_vector(sets.interpolate(reading).parameters)
    assert isinstance(shipped, StandardLinearSolid)
    true, one = tissue_of(finger.person.material), tissue_of(shipped)
    structure = STRUCTURE_SD[bool(lengths.deviations)]
    rows = {}
    for q in found.quantities:
        if q.name in structure:
            error = float(np.log(q.value * one[q.name] / true[q.name]))
            rows[q.name] = error, q.deviation / q.value, structure[q.name]
    return rows


def print_tissue(fingers: Sequence[Finger]) -> None:
    """How errors and deviations of `tissue_errors` go together over the fingers."""
    stiffen = np.array([finger.person.material.stiffening > 0 for finger in fingers])
    for calipers in STRUCTURE_SD:
        rows = [tissue_errors(finger, calipers) for finger in fingers]
        for name in rows[0]:
            error, stated, structure = np.array([row[name] for row in rows]).T
            left = np.mean(error**2 - stated**2 + structure**2)
            print(
                f"{'calipers' if calipers else 'default lengths'}: {name} error "
                f"{np.mean(error[stiffen]):+.2f} in the mean of {stiffen.sum()} that stiffen, "
                f"{np.mean(error[~stiffen]):+.2f} of the others, {rms(error):.2f} RMS; "
                f"over its deviation {rms(error / stated):.2f} RMS; "
                f"STRUCTURE_SD {np.sqrt(max(left, 0.0)):.2f}"
            )


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--fingers", type=int, default=40)
    parser.add_argument("--seed", type=int, default=11)
    parser.add_argument("--width", default="", metavar="LENGTH")
    parser.add_argument("--presses", type=int, default=len(CALIBRATION_PRESSES))
    parser.add_argument("--tissue", action="store_true", help="the deviations of the tissue alone")
    args = parser.parse_args()
    plan = list(itertools.islice(itertools.cycle(CALIBRATION_PRESSES), args.presses))
    found: dict[bool, list[tuple[float, float, float]]] = {False: [], True: []}
    fingers, least = [], []
    for index in range(args.fingers):
        person = People.default().draw(np.random.default_rng([args.seed, index]))
        if args.width:
            person = scaled(person, parse_length(args.width, "--width"))
        fingers.append(pressed(args.seed, index, plan, person))
    if args.tissue:
        print_tissue(fingers)
        return 0
    for finger in fingers:
        least.append(least_error(finger))
        for calipers, rows in found.items():
            rows.append(scores(finger, calipers))
    for calipers, rows in found.items():
        error, alike, covered = np.array(rows).T
        print(
            f"{'calipers' if calipers else 'default lengths'}, {len(rows)} fingers: "
            f"{100 * np.mean(error <= GOAL):.0f} % within {100 * GOAL:g} %, "
            f"90 % within {100 * np.percentile(error, 90):.2f} %, RMS {100 * rms(error):.2f} %; "
            f"scatter of presses left out {100 * rms(alike):.2f} %; "
            f"covered {100 * np.mean(covered):.1f} %"
        )
    print(
        f"at best, finger known: {100 * np.mean(np.array(least) <= GOAL):.0f} % within "
        f"{100 * GOAL:g} %, 90 % within {100 * np.percentile(least, 90):.2f} %"
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
