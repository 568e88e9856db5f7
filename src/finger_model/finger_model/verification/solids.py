# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Three-dimensional model: against the axisymmetric one, and CalculiX's shear, tilt and ellipse."""

from __future__ import annotations

import math

import numpy as np

from ..fem.full_order import FullOrderModel
from ..geometry import Geometry
from ..material import Material
from ..pose.pose import Pose
from ..solid3d.full_order import SolidModel, SolidPoint
from .cases import CALCULIX_FINGER, elastic, reference
from .check import Check, Curve, Measure, Panel, largest, percent

FROM_FORCE = 0.1
"""N; below it the contact is a few nodes wide."""
LOADS = np.array([0.1, 0.15, 0.2, 0.3, 0.5, 0.8, 1.1, 1.35])
FIRM = 0.2
"""N, from which the contact is wide enough for its area to be known well."""
SHEAR_DEPTH = 0.818e-3
"""m, indentation at which the plate is then moved sideways."""
REFERENCE_STICK = 2e9
"""N/m³, spring on which skin sticks in the reference of the pull."""
NEARLY_SLIPPING = 0.65
"""mm, travel of the reference's plate beyond which nearly the whole contact slides in one row."""


def _dry(friction: float, modulus: float = 30.23e3) -> Material:
    return elastic(modulus, E2=1652e3, friction=friction)


def _pressed(pose: Pose, loads: np.ndarray) -> list[SolidPoint]:
    stepper = SolidModel(CALCULIX_FINGER, pose).start(_dry(0.0))
    return [stepper.step(float(k), float(load)) for k, load in enumerate(loads, 1)]


def _of(points: list[SolidPoint], name: str) -> np.ndarray:
    return np.array([getattr(point, name) for point in points])


def axisymmetric() -> Check:
    """Round pads pressed straight, with a thick and a thin skin, against the axisymmetric model."""
    areas, depths = [], []
    for geometry in (CALCULIX_FINGER, Geometry()):
        flat = FullOrderModel(geometry).start(_dry(0.0, 30e3))
        solid = SolidModel(geometry).start(_dry(0.0, 30e3))
        for k, load in enumerate(LOADS, 1):
            exact, found = flat.step(float(k), load), solid.step(float(k), load)
            areas.append(percent(found.area, exact.area))
            depths.append(percent(found.indentation, exact.indentation))
    area = np.reshape(areas, (2, -1))
    firm = LOADS >= FIRM
    measures = [
        Measure(
            f"largest difference of area from {FIRM:g} N", largest(area[:, firm]), "%", high=1.0
        ),
        Measure("largest difference of area below", largest(area[:, ~firm]), "%", high=3.0),
        Measure("root mean square of these differences", float(np.sqrt(np.mean(area**2))), "%"),
        Measure("largest difference of indentation", largest(np.array(depths)), "%", high=1.0),
    ]
    return Check(
        "solid_axisymmetric",
        "Third dimension: straight press",
        "Three-dimensional against axisymmetric model, elastic, 30 kPa, 1652 kPa, no friction, "
        "0.1 to 1.35 N; epidermis of 0.6 and of 0.3 mm (default finger).",
        measures,
    )


def pulled(shifts: np.ndarray, stick_stiffness: float = math.inf) -> list[SolidPoint]:
    """Points of a finger pressed to SHEAR_DEPTH whose plate then moves to shifts (n,) in m."""
    model = SolidModel(CALCULIX_FINGER, stick_stiffness=stick_stiffness)
    stepper = model.start(_dry(0.5))
    for k in range(1, 6):
        stepper.step_to_position(float(k), SHEAR_DEPTH * k / 5)
    return [
        stepper.step_to_position(6.0 + k, SHEAR_DEPTH, (float(shift), 0.0))
        for k, shift in enumerate(shifts)
    ]


def shear() -> Check:
    """A pressed finger whose plate moves sideways until it slips, against CalculiX."""
    table = reference("shear_mu0.5")
    shifts = table["plate_shear_mm"][1:] * 1e-3
    points = pulled(shifts)
    soft = _of(pulled(shifts, REFERENCE_STICK), "stick_ratio")
    pull = {name: column[1:] for name, column in table.items()}
    along = _of(points, "tangential_x")
    stick = _of(points, "stick_ratio")
    force = _of(points, "force")
    measures = [
        Measure(f"largest difference of {what}", largest(percent(found, exact)), "%", high=limit)
        for what, found, exact, limit in (
            ("normal force", force, pull["normal_force_n"], 2.0),
            ("tangential force", along, pull["tangential_force_n"], 2.0),
            ("area", _of(points, "area") * 1e6, pull["area_mm2"], 3.0),
        )
    ]
    place = pull["plate_shear_mm"]
    gap = soft - pull["stick_ratio_by_slip"]
    early = place < NEARLY_SLIPPING
    what = "largest difference of stick ratio"
    measures += [
        Measure(f"{what}, same spring, to 0.63 mm", largest(gap[early]), high=0.06),
        Measure(f"{what}, same spring, beyond", largest(gap[~early])),
        Measure(f"{what}, Coulomb's law", largest(stick - pull["stick_ratio_by_slip"])),
    ]
    return Check(
        "solid_shear",
        "Third dimension: pull until slip",
        "The finger of the CalculiX curves (8.5 × 6.5 mm) pressed to 0.818 mm at friction 0.5, "
        "then the plate is moved sideways; "
        "CalculiX 2.20, tangential force good to 1.5 %, stick ratio to 0.03. There skin that "
        "sticks hangs on a spring of 2 N/mm³ and moves by up to some 5 µm before it slips. So it "
        "does here in the rows named same spring.",
        measures,
        [
            Panel(
                "plate travel (mm)",
                "tangential force (N)",
                [
                    Curve(place, along, "C0-", "this model"),
                    Curve(place, pull["tangential_force_n"], "C0o", "CalculiX"),
                ],
            ),
            Panel(
                "plate travel (mm)",
                "stick ratio",
                [
                    Curve(place, stick, "C1-", "Coulomb's law"),
                    Curve(place, soft, "C1--", "spring as in CalculiX"),
                    Curve(place, pull["stick_ratio_by_slip"], "C1o", "CalculiX"),
                ],
            ),
        ],
    )


def tilted() -> Check:
    """A plate tilted by 20°, against CalculiX."""
    table = reference("tilt_20deg")
    load = table["normal_force_n"]
    points = _pressed(Pose(pitch=math.radians(20.0)), load)
    travel = percent(_of(points, "indentation") * 1e3, table["plate_travel_mm"])
    return _pressed_check(
        "solid_tilt",
        "tilted plate",
        "Plate tilted by 20°, no friction.",
        load,
        points,
        table["area_mm2"],
        travel,
        [
            (_of(points, "center_x") * 1e3 - table["center_x_mm"], "centre", "mm", 0.05),
            (
                percent(
                    _of(points, "semi_axis_a") * 1e3, _smooth(load, table["semi_axis_across_mm"])
                ),
                "larger semi-axis",
                "%",
                3.0,
            ),
        ],
    )


def elliptical() -> Check:
    """A pad 1.35 times as long as wide, against CalculiX."""
    table = reference("ellipse_135")
    load = table["normal_force_n"]
    points = _pressed(Pose(1.35), load)
    depth = percent(_of(points, "indentation") * 1e3, table["indentation_mm"])
    axes = [
        (percent(_of(points, name) * 1e3, _smooth(load, table[column])), words, "%", 3.0)
        for name, column, words in (
            ("semi_axis_a", "semi_axis_x_mm", "larger semi-axis"),
            ("semi_axis_b", "semi_axis_y_mm", "smaller semi-axis"),
        )
    ]
    return _pressed_check(
        "solid_ellipse",
        "elliptical pad",
        "Pad, skin, bone and nail 1.35 times as long along x, no friction.",
        load,
        points,
        table["area_mm2"],
        depth,
        axes,
    )


def _smooth(load: np.ndarray, value: np.ndarray) -> np.ndarray:
    """A cubic through logarithms: rows of the reference scatter by 1.4 % (as its areas did)."""
    x = np.log(load)
    return np.exp(np.polyval(np.polyfit(x, np.log(value), 3), x))


def _pressed_check(
    name: str,
    title: str,
    text: str,
    load: np.ndarray,
    points: list[SolidPoint],
    exact: np.ndarray,
    depth: np.ndarray,
    others: list[tuple[np.ndarray, str, str, float]],
) -> Check:
    """Area within 3 % of a smooth curve, indentation within 2 %, and others, from FROM_FORCE on."""
    counted = load >= FROM_FORCE
    found = _of(points, "area") * 1e6
    rows = [(percent(found, exact), "area", "%", 3.0), (depth, "indentation", "%", 2.0), *others]
    return Check(
        name,
        f"Third dimension: {title}",
        f"{text} Elastic, 30.23 kPa, 1652 kPa; CalculiX 2.20, area good to some 2 %.",
        [
            Measure(f"largest difference of {what}", largest(error[counted]), unit, high=limit)
            for error, what, unit, limit in rows
        ],
        [
            Panel(
                "force (N)",
                "area (mm²)",
                [Curve(load, found, "C0-", "this model"), Curve(load, exact, "C0o", "CalculiX")],
            )
        ],
    )
