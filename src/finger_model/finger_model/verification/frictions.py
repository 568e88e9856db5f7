# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Friction: its effect on area, Coulomb's law, and a disc on a rough plane."""

from __future__ import annotations

import numpy as np
from scipy.integrate import solve_bvp, trapezoid

from ..fem.equilibrium import SLIP, STICK
from ..fem.full_order import FullOrderModel
from ..material import Material
from ..paper import FRICTION
from .cases import CALCULIX_FINGER, LOAD, block, elastic, ramp, smooth_area
from .check import Check, Curve, Measure, Panel, percent


def effect_on_area() -> Check:
    """A(0)/A(0.25) − 1 against CalculiX."""
    model = FullOrderModel(CALCULIX_FINGER)
    loads = np.array([0.2, 0.5, LOAD])
    time, force = ramp(LOAD, 27.0, 27)
    areas = {}
    for friction in (0.0, FRICTION):
        material = elastic(30e3, E2=1652e3, friction=friction)
        areas[friction] = np.interp(loads, force, model.simulate(material, time, force).area)
    ours = percent(areas[0.0], areas[FRICTION])
    theirs = percent(smooth_area("dry_frictionless", loads), smooth_area("dry_friction", loads))
    measures = []
    for load, own, other in zip(loads, ours, theirs):
        measures.append(Measure(f"A(0)/A(0.25) − 1 at {load:g} N", float(own), "%", low=0.0))
        measures.append(
            Measure(
                f"less CalculiX's {other:.2f} %, at {load:g} N", float(own - other), "%", -1.0, 1.0
            )
        )
    return Check(
        "friction_area",
        "Friction makes the contact smaller",
        "Elastic dry set, friction 0.25 against none; CalculiX by cubics through its rows.",
        measures,
    )


def coulomb() -> Check:
    """|shear| ≤ μ p, no slip where it sticks, friction never gives energy."""
    model = FullOrderModel()
    surface = model.mesh.surface
    stepper = model.start(Material())
    # Short steps at first touch: a longer one is cut into parts, in the first of which a node may
    # slip that sticks at the end.
    pieces = ((0.0, 0.05, 50), (0.05, 0.25, 80), (0.25, 2.5, 90))
    time = np.concatenate([np.linspace(start, end, n + 1)[1:] for start, end, n in pieces])
    force = np.interp(time, [0, 1, 1.5, 2.5], [0, LOAD, LOAD, 0.0])
    excess, creep, work = [], [], []
    fields, status = stepper.fields(), stepper.state.contact.status
    sticking, largest = 0, 0.0
    for instant, load in zip(time, force):
        before = stepper.state
        stepper.step(float(instant), float(load))
        state = stepper.state
        contact = state.contact
        bound = FRICTION * contact.normal
        excess.append(float(np.max(np.abs(contact.shear) - bound)))
        largest = max(largest, float(bound.max()))
        moved = np.abs(state.positions[surface, 0] - before.positions[surface, 0])
        stuck = (contact.status == STICK) & (before.contact.status != 0)
        creep.append(float(moved[stuck].max(initial=0.0)))
        sticking = max(sticking, int((contact.status == STICK).sum()))
        work.append(state.friction_work - before.friction_work)
        if instant <= 1.0:
            fields, status = stepper.fields(), contact.status.copy()

    touched = fields.contact_pressure > 0
    r = fields.contact_radius[touched] * 1e3
    bound = FRICTION * 1e-3 * fields.contact_pressure[touched]
    shear, kind = fields.contact_shear[touched] * 1e-3, status[touched]
    sticks, slips = kind == STICK, kind == SLIP
    return Check(
        "coulomb",
        "Coulomb's law",
        "Natural set, friction 0.25, 1.35 N in 1 s, hold and release, 220 steps.",
        [
            # Newton ends at 1e-8 to 1e-6 of the plate's force, of which a node carries a thirtieth.
            Measure("largest |shear| − μp over the largest μp", max(excess) / largest, high=1e-5),
            Measure("largest slip of a sticking node in a step", max(creep) * 1e9, "nm", high=1e-3),
            Measure("largest number of sticking nodes", sticking, low=3),
            Measure("smallest friction work of a step", min(work) * 1e6, "µJ", low=-1e-12),
        ],
        [
            Panel(
                "r (mm)",
                f"shear traction at {LOAD:g} N (kPa)",
                [
                    Curve(r, bound, "k-", "μ p"),
                    Curve(r, -bound, "k-"),
                    Curve(r[sticks], shear[sticks], "o", "sticks"),
                    Curve(r[slips], shear[slips], "s", "slips"),
                ],
            )
        ],
    )


def disc() -> Check:
    """Thin disc squeezed between a smooth and a rough plane: it slips everywhere."""
    radius, height, friction, squeeze = 10e-3, 0.5e-3, 0.015, 0.004
    modulus, ratio = 30e3, 0.3
    shear = modulus / (2 * (1 + ratio))
    lame = modulus * ratio / ((1 + ratio) * (1 - 2 * ratio))

    def slab(r: np.ndarray, y: np.ndarray) -> np.ndarray:
        u, slope = y
        with np.errstate(divide="ignore", invalid="ignore"):
            hoop = np.where(r > 0, u / np.where(r > 0, r, 1.0), slope)
            pressure = (lame + 2 * shear) * squeeze - lame * (slope + hoop)
            bend = np.where(r > 0, (slope - hoop) / np.where(r > 0, r, 1.0), 0.0)
        return np.vstack([slope, friction * pressure / (height * (lame + 2 * shear)) - bend])

    def ends(inner: np.ndarray, outer: np.ndarray) -> np.ndarray:
        rim = (lame + 2 * shear) * outer[1] + lame * (outer[0] / radius - squeeze)
        return np.array([inner[0], rim])

    grid = np.linspace(1e-9, radius, 400)
    start = np.vstack([ratio * squeeze * grid, np.full_like(grid, ratio * squeeze)])
    exact = solve_bvp(slab, ends, grid, start, tol=1e-8)
    u, slope = exact.sol(grid)
    pressure = (lame + 2 * shear) * squeeze - lame * (slope + u / grid)
    force = float(trapezoid(2 * np.pi * grid * pressure, grid))

    model = block(radius, height, 5, 100)
    material = elastic(modulus, friction=friction, poisson_ratio_bulk=ratio)
    stepper = model.start(material)
    stepper.step_to_position(0.0, 1e-6 * squeeze * height)
    for k in range(1, 5):
        stepper.step_to_position(float(k), squeeze * height * k / 4)
    fields = stepper.fields()
    surface = model.mesh.surface
    moved = fields.displacement.reshape(101, 6, 2)[::-1, :, 0].mean(axis=1)
    nodes = model.mesh.nodes[surface, 0]
    slipping = np.mean(stepper.state.contact.status[1:] == SLIP)
    return Check(
        "disc",
        "Disc on a rough plane",
        "A disc of radius 10 mm and height 0.5 mm (30 kPa, ν = 0.3) squeezed by 0.4 % between a "
        "smooth and a rough plane, μ = 0.015. It slips outwards everywhere. The slab theory of "
        "upsetting (Siebel's friction hill, here with an elastic disc) is "
        "h (dσ_r/dr + (σ_r − σ_θ)/r) = μ p with Hooke's law and uniform axial strain.",
        [
            Measure("share of slipping nodes", float(slipping), low=0.98),
            Measure(
                "error of the rim's displacement", float(percent(moved[-1], u[-1])), "%", -2, 2
            ),
            Measure("error of the force", float(percent(stepper.state.force, force)), "%", -1, 1),
            Measure(
                "rim displacement over the frictionless one",
                float(u[-1] / (ratio * squeeze * radius)),
            ),
        ],
        [
            Panel(
                "r (mm)",
                "radial displacement (µm)",
                [
                    Curve(grid * 1e3, u * 1e6, "k-", "slab theory"),
                    Curve(nodes * 1e3, moved * 1e6, ".", "model"),
                    Curve(grid * 1e3, ratio * squeeze * grid * 1e6, "k:", "no friction"),
                ],
            ),
            Panel(
                "r (mm)",
                "contact pressure (Pa)",
                [
                    Curve(grid * 1e3, pressure, "k-"),
                    Curve(nodes[:-1] * 1e3, fields.contact_pressure[:-1], "."),
                ],
            ),
        ],
    )
