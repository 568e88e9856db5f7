# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Finger: limits in time, independent reference curves, energy, smoothness, monotonicity."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..fem.full_order import FullOrderModel
from ..geometry import Geometry
from ..laws.standard_linear_solid import PARAMETERS
from ..material import Material
from ..paper import FRICTION
from .cases import (
    CALCULIX_FINGER,
    ELASTIC,
    LOAD,
    STUDY,
    elastic,
    long_term,
    ramp,
    reference,
    smooth_area,
)
from .check import Check, Curve, Measure, Panel, largest, percent
from .homogeneous import tissue


def time_limits(names: tuple[str, ...] = ("dry", "natural", "moist")) -> Check:
    """τ1 → ∞ and τ1 → 0 against elastic solids."""
    model = FullOrderModel()
    time, force = ramp(LOAD, 1.0, 27)
    measures, curves = [], []
    for index, name in enumerate(names):
        material = STUDY[name]
        slow, stiff, fast, soft = (
            model.simulate(case, time, force).area
            for case in (
                replace(material, tau1=1e4),
                replace(material, E1=ELASTIC * material.E0),
                replace(material, tau1=1e-4),
                long_term(material),
            )
        )
        early = np.abs(percent(fast[1:], soft[1:]))
        measures += [
            Measure(
                f"{name}: τ1 = 10⁴ s against E0, largest difference of area",
                largest(percent(slow[1:], stiff[1:])),
                "%",
                high=0.1,
            ),
            Measure(
                f"{name}: τ1 = 10⁻⁴ s against G∞, 0.1 N, difference of area",
                float(early[1]),
                "%",
                high=0.1,
            ),
            Measure(
                f"{name}: τ1 = 10⁻⁴ s against G∞, 1.35 N, difference of area", float(early[-1]), "%"
            ),
        ]
        curves += [
            Curve(force, stiff * 1e6, f"C{index}-", f"{name}, elastic limits"),
            Curve(force, soft * 1e6, f"C{index}-"),
            Curve(force, slow * 1e6, f"C{index}o"),
            Curve(force, fast * 1e6, f"C{index}s"),
        ]
    return Check(
        "limits",
        "Limits in time",
        "Both limits of the parallel form of the standard linear solid are exactly neo-Hookean at "
        "any load. What remains is that a ramp of 1 s is not infinitely slow or fast. Two "
        "neo-Hookean springs in series would differ from one at 1.35 N; the form used here does "
        "not (docs/theory.md).",
        measures,
        [Panel("force (N)", "area (mm²)", curves, legend="circles τ1 = 10⁴ s, squares 10⁻⁴ s")],
    )


def calculix() -> Check:
    """Area and indentation against the CalculiX curves."""
    model = FullOrderModel(CALCULIX_FINGER)
    measures, areas, depths = [], [], []
    for index, (name, friction) in enumerate(
        (("dry_friction", FRICTION), ("dry_frictionless", 0.0), ("dry_friction_finest", FRICTION))
    ):
        table = reference(name)
        load = table["force_N"]
        material = elastic(30e3, E2=1652e3, friction=friction)
        history = model.simulate(material, np.arange(1.0, len(load) + 1), load)
        # A row's area carries up to 1 % of the other mesh's scatter; the curve through all rows
        # does not.
        smooth = smooth_area(name, load) if len(load) > 4 else table["area_mm2"]
        rows = load >= 0.1
        area = percent(history.area * 1e6, smooth)[rows]
        depth = percent(history.indentation * 1e3, table["indentation_mm"])[rows]
        measures += [
            Measure(f"{name}: largest area difference", largest(area), "%", high=2.0),
            Measure(f"{name}: mean area difference", float(area.mean()), "%"),
            Measure(f"{name}: largest indentation difference", largest(depth), "%", high=1.0),
        ]
        areas += [
            Curve(load, history.area * 1e6, f"C{index}-"),
            Curve(load, table["area_mm2"], f"C{index}o", name),
        ]
        depths += [
            Curve(load, history.indentation * 1e3, f"C{index}-"),
            Curve(load, table["indentation_mm"], f"C{index}o"),
        ]
    others = reference("other_fingers")
    for row in range(len(others["force_N"])):
        measures += _other_finger(others, row)
    return Check(
        "calculix",
        "CalculiX",
        "Elastic dry set (30 kPa, 1652 kPa) on the finger of the curves (`CALCULIX_FINGER`: pad "
        "8.5 × 6.5 mm, epidermis 0.6 mm, bone 3.5 × 2.5 mm), F ≥ 0.1 N. The area is "
        "compared with a cubic in log force and log area through the rows of a file, for the file "
        "of four rows with the rows themselves. Then fingers of other shapes and elastic "
        "materials, at one load each, named by the pad's semi-axes, epidermis, height of the "
        "bone's centre, E and E2; CalculiX's mesh is refined around the edge there. Soft tissue "
        "under a thin, very stiff skin: with friction the area is given without a limit, because "
        "CalculiX's three increments hardly resolve friction there; without friction it has one. "
        "CalculiX has no exponential energy: a stiffening spring is taken to the third order of "
        "Ī₁ − 3 in both codes (its YEOH).",
        measures,
        [
            Panel("force (N)", "area (mm²)", areas, legend="points CalculiX, lines model"),
            Panel("force (N)", "indentation (mm)", depths),
        ],
    )


class CubicStiffening(Material):
    """The default law with its stiffening spring to the third order of Ī₁ − 3, as YEOH has it.

    2 ∂W∞/∂Ī₁ = G∞ (1 + b x + ½ b² x²) with x = Ī₁ − 3.
    """

    def _spring(self, invariant: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        x = self.stiffening * (invariant - 3.0)
        shear = self.long_term_shear_modulus
        return shear * (1.0 + x + 0.5 * x * x), shear * self.stiffening * (1.0 + x)


def _other_finger(table: dict[str, np.ndarray], row: int) -> list[Measure]:
    """Area and indentation of the default mesh against one row of the table of other fingers."""
    case = {name: float(column[row]) for name, column in table.items()}
    geometry = Geometry(**{field: case[f"{field}_mm"] * 1e-3 for field in Geometry().to_dict()})
    others = {"friction": case["friction"], "stiffening": case["stiffening"]}
    material = elastic(case["E_kPa"] * 1e3, E2=case["E2_kPa"] * 1e3, **others)
    if case["stiffening"]:
        material = CubicStiffening(**material.to_dict())
    history = FullOrderModel(geometry).simulate(material, *ramp(case["force_N"], 1.0, 4))
    name = (
        f"{case['pad_semi_axis_radial_mm']:g} × {case['pad_semi_axis_axial_mm']:g} mm, "
        f"{case['epidermis_thickness_mm']:g} mm, {case['bone_center_height_mm']:g} mm, "
        f"{case['E_kPa']:g} kPa, {case['E2_kPa']:g} kPa, "
        + (f"stiffening {case['stiffening']:g}, " if case["stiffening"] else "")
        + f"friction {case['friction']:g}, "
        f"{case['force_N']:.2f} N"
    )
    limit = 2.0 if case["area_limited"] else None
    area = float(percent(history.area[-1] * 1e6, case["area_mm2"]))
    depth = float(percent(history.indentation[-1] * 1e3, case["indentation_mm"]))
    return [
        Measure(f"{name}: area difference", area, "%", limit and -limit, limit),
        Measure(f"{name}: indentation difference", depth, "%", -1.0, 1.0),
    ]


def small_strain() -> Check:
    """Small-strain linear elasticity against CalculiX."""
    table = reference("dry_friction_small_strain")
    load = table["force_N"]
    model = FullOrderModel(CALCULIX_FINGER, elasticity="small-strain")
    history = model.simulate(elastic(30e3, E2=1652e3), np.arange(1.0, len(load) + 1), load)
    rows = load >= 0.1
    area = percent(history.area * 1e6, table["area_mm2"])[rows]
    depth = percent(history.indentation * 1e3, table["indentation_mm"])[rows]
    return Check(
        "small_strain",
        "Small strain",
        "The option small-strain of the full-order model (linear elasticity on the undeformed "
        "shape) with the elastic dry set (30 kPa, 1652 kPa) on the finger of the curves, friction "
        "0.25, F ≥ 0.1 N, against CalculiX without NLGEOM.",
        [
            Measure("largest area difference", largest(area), "%", high=2.0),
            Measure("largest indentation difference", largest(depth), "%", high=1.0),
        ],
    )


def energy(steps: int = 400, branches: bool = False) -> Check:
    """Dissipation and energy balance over load, hold, release and rest.

    branches: of tissue of three branches that stiffens, instead of the default law.
    """
    time = np.linspace(0.0, 3.0, steps + 1)
    force = np.interp(time, [0, 1, 1.5, 2.5, 3], [0, LOAD, LOAD, 0, 0])
    law = tissue((0.3, 0.2, 0.3), (0.004, 0.07, 0.4), 3.0) if branches else Material()
    rests = 40.0 if branches else 10.0
    stepper = FullOrderModel().start(law)
    states = [stepper.state]
    for instant, load in zip(time[1:], force[1:]):
        stepper.step(float(instant), float(load))
        states.append(stepper.state)
    work, stored, dissipated, friction = (
        np.array([getattr(state, name) for state in states])
        for name in ("work", "stored", "dissipation", "friction_work")
    )
    spent = dissipated[-1] + friction[-1]
    balance = abs(work[-1] - stored[-1] - spent) / spent
    for k in range(1, 41):
        stepper.step(3.0 + rests * k / 40, 0.0)
    rest = largest(stepper.fields().displacement)
    return Check(
        "energy_branches" if branches else "energy",
        "Energy of three branches with stiffening" if branches else "Energy",
        ("E0 80 kPa, branches of 4, 70 and 400 ms, stiffening 3" if branches else "Natural set")
        + ", friction 0.25: 1.35 N in 1 s, held 0.5 s, released in 1 s, left alone for "
        f"{rests:g} s.",
        [
            Measure(
                "smallest dissipation of a step", min(np.diff(dissipated)) * 1e6, "µJ", low=0.0
            ),
            # By the trapezoid rule, which errs where a node turns round within a step.
            Measure(
                "smallest friction work of a step over the energy dissipated in the cycle",
                min(np.diff(friction)) / spent,
                low=-5e-5,
            ),
            Measure("energy dissipated in the cycle", spent * 1e6, "µJ", low=1.0),
            Measure("error of the energy balance", 100 * balance, "%", high=0.5),
            Measure(
                f"largest displacement after {rests:g} s of rest", rest * 1e9, "nm", high=100.0
            ),
        ],
        [
            Panel(
                "time (s)",
                "energy (µJ)",
                [
                    Curve(time, work * 1e6, label="work of the plate"),
                    Curve(time, stored * 1e6, label="stored"),
                    Curve(time, dissipated * 1e6, label="dissipated in the bulk tissue"),
                    Curve(time, friction * 1e6, label="friction"),
                ],
            )
        ],
    )


def smoothness(friction: float = 0.0) -> Check:
    """Second differences of area over 200 even load steps."""
    model = FullOrderModel()
    cases = {name: replace(STUDY[name], friction=friction) for name in STUDY}
    cases["dry, elastic"] = elastic(STUDY["dry"].composite_modulus, E2=1652e3, friction=friction)
    least = 0.05 if friction > 0.0 else 0.2
    time, force = ramp(LOAD, 1.0, 200)
    inner = force[1:-1]
    measures, areas, seconds = [], [], []
    for name, material in cases.items():
        area = model.simulate(material, time, force).area
        second = np.abs(np.diff(area, 2))
        local = np.array([np.median(second[max(0, i - 5) : i + 6]) for i in range(len(second))])
        ratio = second / local
        measures.append(
            Measure(
                f"{name}: largest |Δ²A| over its local median",
                float(ratio[inner >= least].max()),
                high=3.0,
            )
        )
        if least > 0.05:
            from_small = float(ratio[inner >= 0.05].max())
            measures.append(Measure(f"{name}: the same from 0.05 N", from_small))
        areas.append(Curve(force, area * 1e6, label=name))
        seconds.append(Curve(inner, second * 1e6))
    where = f"friction {friction:g}" if friction else "frictionless"
    return Check(
        "smoothness_friction" if friction else "smoothness",
        f"Smoothness of area, {where}",
        f"200 even load steps to 1.35 N in 1 s, F ≥ {least:g} N, local median over 11 steps.",
        measures,
        [
            Panel("force (N)", "area (mm²)", areas),
            Panel("force (N)", "|Δ²A| (mm²)", seconds, "semilogy"),
        ],
    )


def monotonicity() -> Check:
    """Area at given force and force at given indentation over the moduli."""
    model = FullOrderModel()
    time, force = ramp(LOAD, 1.0, 14)
    instants = [4, 7, 14]
    measures, panels = [], []
    for key in ("E0", "E1", "E2"):
        values = np.geomspace(*PARAMETERS[key].range, 7)
        area_rows, force_rows = [], []
        for value in values:
            material = replace(STUDY["natural"], **{key: float(value)})
            area_rows.append(model.simulate(material, time, force).area[instants])
            stepper = model.start(material)
            found = [stepper.step_to_position(0.1 * k, 1e-4 * k).force for k in range(1, 9)]
            force_rows.append(np.array(found)[[1, 3, 7]])
        areas, forces = np.array(area_rows), np.array(force_rows)
        panels.append(
            Panel(
                f"{key} (kPa)",
                "area (mm²)",
                [
                    Curve(values * 1e-3, column * 1e6, "o-", f"{load:.2f} N")
                    for column, load in zip(areas.T, force[instants])
                ],
                "semilogx",
            )
        )
        rise = float(np.diff(areas, axis=0).max() * 1e6)
        if key == "E2":
            change = float(percent(areas[-1], areas[0])[-1])
            measures += [
                Measure("E2 from 0.3 to 5 MPa: change of area at 1.35 N", change, "%"),
                Measure("largest change of area with a step of E2", rise, "mm²"),
            ]
            continue
        measures += [
            Measure(f"{key}: largest change of area with a step of modulus", rise, "mm²", high=0.0),
            Measure(
                f"{key}: smallest change of force at given indentation",
                float(np.diff(forces, axis=0).min()),
                "N",
                low=0.0,
            ),
        ]
    return Check(
        "monotonicity",
        "Monotonicity",
        "Natural set with one modulus varied, ramp of 1.35 N/s and plate speed 1 mm/s, seven "
        "values each, at three loads and indentations. A stiffer epidermis makes the contact "
        "smaller too.",
        measures,
        panels,
    )
