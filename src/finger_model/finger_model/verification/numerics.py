# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Patch tests, orders of convergence, mesh and time-step error of the defaults."""

from __future__ import annotations

import numpy as np

from ..fem.full_order import FullOrderModel
from ..material import Material
from .cases import LOAD, STUDY, block, elastic, ramp
from .check import Check, Curve, Measure, Panel, largest, percent


def patch_tests() -> Check:
    """Homogeneous deformation of a distorted patch, and uniform pressure under a flat block."""
    model = block(1e-2, 1e-2, 4, 4, distortion=0.25)
    equilibrium, mesh = model.equilibrium, model.mesh
    stepper = model.start(elastic(30e3, friction=0.0))
    material = stepper.mesh_material.step(0.0, stepper.state.tissue)
    exact = mesh.nodes * [1.15, 0.8]
    outline = (
        (mesh.nodes[:, 0] <= 0)
        | (mesh.nodes[:, 0] >= 1e-2)
        | (mesh.nodes[:, 1] >= 0)
        | (mesh.nodes[:, 1] <= -1e-2 * (1 - 1e-9))
    )
    away = np.random.default_rng(2).uniform(-2e-4, 2e-4, exact.shape)
    start = np.where(outline[:, None], exact, exact + away)
    equilibrium.fixed = np.flatnonzero(np.repeat(outline, 2))
    found, _ = equilibrium.solve(start, equilibrium.unloaded_contact(), material, 0.0, 0.0)
    error = float(np.abs(found - exact).max()) / 1e-2

    flat = block(1e-2, 1e-2, 4, 6, distortion=0.25).start(elastic(30e3, friction=0.0))
    for k in range(1, 6):
        flat.step_to_position(float(k), 4e-4 * k)
    fields = flat.fields()
    pressure = fields.contact_pressure
    return Check(
        "patch",
        "Patch tests",
        "A distorted patch of 16 elements whose outline is stretched by 1.15 and 0.8 must find the "
        "homogeneous deformation inside. A block of distorted elements pressed flat by 20 % must "
        "have an even pressure.",
        [
            Measure("largest error of position over size", error, high=1e-9),
            Measure(
                "spread of contact pressure", float(np.ptp(pressure) / pressure.mean()), high=1e-7
            ),
            Measure(
                "spread of axial stress",
                float(np.ptp(fields.stress[:, 1]) / pressure.mean()),
                high=1e-7,
            ),
        ],
    )


def newton() -> Check:
    """Order of convergence of Newton's method near the solution."""
    model = FullOrderModel()
    material = Material(friction=0.0)
    stepper = model.start(material)
    for k in range(1, 11):
        stepper.step(0.05 * k, 0.09 * k)
    # Another stepper knows no step before: an extrapolated start is too good to show an order.
    another = model.start(material)
    another.state = stepper.state
    another.step(0.55, 1.0)
    residuals = np.array(model.equilibrium.residuals)
    tail = residuals[residuals > 1e-9][-3:]
    order = float(np.log(tail[2] / tail[1]) / np.log(tail[1] / tail[0]))
    return Check(
        "newton",
        "Quadratic convergence of Newton's method",
        "Residuals, relative to the plate's force, of the iterations of one step from 0.9 N to "
        "1 N: " + ", ".join(f"{value:.1e}" for value in residuals) + ".",
        [Measure("order of the last three iterations", order, low=1.7)],
    )


def space() -> Check:
    """Order of convergence in space and the mesh error of the default settings."""
    loads = np.array([0.1, 0.2, 0.5, 1.0, LOAD])
    table = {}
    refinements = (0.5, 1.0, 2.0)
    for name in ("dry", "moist"):
        material = elastic(STUDY[name].composite_modulus, E2=STUDY[name].E2, friction=0.0)
        for refinement in refinements:
            history = FullOrderModel(refinement=refinement).simulate(
                material, np.arange(1.0, len(loads) + 1), loads
            )
            table[name, refinement] = (history.indentation, history.area)
    measures = []
    series = {}
    for name in ("dry", "moist"):
        coarse, middle, fine = (table[name, r] for r in refinements)
        for index, what in enumerate(("indentation", "area")):
            a, b, c = coarse[index][-1], middle[index][-1], fine[index][-1]
            order = float(np.log2(abs((a - b) / (b - c))))
            limit = fine[index] + (fine[index] - middle[index]) / (2.0**1.5 - 1.0)
            measures.append(Measure(f"{name}: order of {what} at 1.35 N", order, low=1.0))
            measures.append(
                Measure(
                    f"{name}: largest {what} error of the default mesh, 0.1 … 1.35 N",
                    largest(percent(table[name, 1.0][index], limit)),
                    "%",
                    high=1.0,
                )
            )
            series[name, what] = [
                largest(percent(table[name, r][index], limit)) for r in refinements
            ]

    spacing = 1 / np.array(refinements)
    return Check(
        "space",
        "Convergence in space",
        "Elastic composite sets of the study, frictionless, on meshes of refinement "
        + ", ".join(f"{r:g}" for r in refinements)
        + "; the limit is extrapolated from the two finest with order 1.5. Contact edge and "
        "clamped rims are singular, so that the full order 2 of the element is not reached.",
        measures,
        [
            Panel(
                "node spacing over default",
                "largest error, 0.1–1.35 N (%)",
                [
                    Curve(spacing, values, "o-", f"{name}, {what}")
                    for (name, what), values in series.items()
                ],
                "loglog",
            )
        ],
    )


def time_steps() -> Check:
    """Order of convergence in time and the error of 20 steps."""
    model = FullOrderModel()
    counts = (5, 10, 20, 40, 80)
    fine = model.simulate(Material(friction=0.0), *ramp(LOAD, 1.0, 320))
    errors = {}
    for count in counts:
        history = model.simulate(Material(friction=0.0), *ramp(LOAD, 1.0, count))
        rows = 320 // count * np.arange(1, count + 1)
        errors[count] = (
            abs(history.indentation[-1] / fine.indentation[-1] - 1),
            float(np.abs(history.area[1:] / fine.area[rows] - 1).max()),
        )
    order = float(np.log2(errors[40][0] / errors[80][0]))
    with_friction = model.simulate(Material(), *ramp(LOAD, 1.0, 20))
    finest = model.simulate(Material(), *ramp(LOAD, 1.0, 160))
    rows = 8 * np.arange(1, 21)
    friction_error = np.abs(with_friction.area[1:] / finest.area[rows] - 1)[1:].max()

    order_2 = 100 * errors[80][0] * (80 / np.array(counts)) ** 2
    return Check(
        "time",
        "Convergence in time",
        "Natural set to 1.35 N in 1 s against 320 steps, with friction against 160. With fewer "
        "than 40 steps two errors of the indentation have opposite signs and nearly cancel.",
        [
            Measure("order of indentation, 40 to 80 steps", order, low=1.8),
            Measure("indentation error of 20 steps", 100 * errors[20][0], "%", high=0.3),
            Measure("area error of 20 steps, frictionless", 100 * errors[20][1], "%", high=0.3),
            Measure(
                "area error of 20 steps, friction 0.25, F ≥ 0.1 N",
                float(100 * friction_error),
                "%",
                high=0.3,
            ),
        ],
        [
            Panel(
                "steps to 1.35 N in 1 s",
                "error (%)",
                [
                    Curve(counts, [100 * errors[n][0] for n in counts], "o-", "indentation, end"),
                    Curve(counts, [100 * errors[n][1] for n in counts], "s-", "area, largest"),
                    Curve(counts, order_2, "k:", "order 2"),
                ],
                "loglog",
            )
        ],
    )
