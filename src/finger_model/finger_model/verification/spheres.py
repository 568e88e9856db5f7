# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Hertz and Lee–Radok: spheres on a rigid plane."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from ..fem.full_order import FullOrderModel
from ..material import Material
from .cases import elastic, reference, sphere
from .check import Check, Curve, Measure, Panel, largest, percent
from .homogeneous import creep_response, tissue

RADIUS = 10e-3
INCOMPRESSIBLE = 0.4999


def hertz() -> Check:
    """Radius law and pressure profile of an incompressible elastic sphere at small load."""
    modulus = 30e3
    material = elastic(
        modulus,
        E2=modulus,
        friction=0.0,
        poisson_ratio_bulk=INCOMPRESSIBLE,
        poisson_ratio_epidermis=INCOMPRESSIBLE,
    )
    stepper = sphere(RADIUS).start(material)
    loads = np.geomspace(3e-3, 3e-2, 12)
    radius = np.array([stepper.step(k + 1.0, load).radius for k, load in enumerate(loads)])
    exact = np.cbrt(9 * loads * RADIUS / (16 * modulus))
    exponent = float(np.polyfit(np.log(loads), np.log(math.pi * radius**2), 1)[0])
    fields = stepper.fields()
    at, pressure = fields.contact_radius / exact[-1], fields.contact_pressure
    peak = 1.5 * loads[-1] / (math.pi * exact[-1] ** 2)
    inside = (at > 0.1) & (at < 0.8)
    misfit = percent(pressure[inside], peak * np.sqrt(1 - at[inside] ** 2))
    touched, dense = pressure > 0, np.linspace(0, 1, 200)
    return Check(
        "hertz",
        "Hertz contact",
        "Homogeneous sphere, R = 10 mm, E = 30 kPa, ν = 0.4999, 3 to 30 mN: a³ = 9FR/(16E).",
        [
            Measure(
                "largest error of the coefficient a³/F",
                largest(percent(radius**3, exact**3)),
                "%",
                high=2.0,
            ),
            Measure("exponent of area over force", exponent, low=2 / 3 - 0.01, high=2 / 3 + 0.01),
            Measure("largest error of pressure, 0.1 < r/a < 0.8", largest(misfit), "%", high=3.0),
        ],
        [
            Panel(
                "force (N)",
                "contact radius (mm)",
                [
                    Curve(loads, radius * 1e3, "o", "model"),
                    Curve(loads, exact * 1e3, "k-", "Hertz"),
                ],
                "loglog",
            ),
            Panel(
                "r/a",
                "pressure (kPa)",
                [
                    Curve(at[touched], pressure[touched] * 1e-3, "o", "model"),
                    Curve(dense, peak * np.sqrt(1 - dense**2) * 1e-3, "k-", "Hertz"),
                ],
            ),
        ],
    )


def lee_radok() -> Check:
    """Radius of a viscoelastic sphere under ramps to 0.1 N and a hold."""
    material = Material(
        E0=140e3,
        E1=20e3,
        tau1=0.5,
        E2=140e3,
        friction=0.0,
        poisson_ratio_bulk=INCOMPRESSIBLE,
        poisson_ratio_epidermis=INCOMPRESSIBLE,
    )
    table = reference("lee_radok")
    measures, curves = [], []
    for refinement in (1.0, 1.5):
        # The whole ball is viscoelastic here: no elastic skin.
        model = sphere(RADIUS, refinement)
        mesh = replace(model.mesh, part=np.zeros_like(model.mesh.part))
        model = FullOrderModel(model.geometry, refinement, mesh)
        for name in ("05", "10", "20"):
            duration = float(name) / 10
            rows = table["t_s"] <= duration + 0.4
            time, load = table["t_s"][rows], table[f"F_N_T{name}"][rows]
            exact = table[f"a_mm_T{name}"][rows] * 1e-3
            radius = model.simulate(material, time, load).radius
            ramp = (load > 0.005) & (time <= duration + 1e-9)
            where = f"{duration:g} s, refinement {refinement:g}"
            measures += [
                Measure(
                    f"largest radius error, ramp of {where}",
                    largest(percent(radius[ramp], exact[ramp])),
                    "%",
                    high=2.0,
                ),
                Measure(
                    f"radius error at the end, hold after {where}",
                    largest(percent(radius[-1], exact[-1])),
                    "%",
                    high=2.0 if refinement > 1.0 else None,
                ),
            ]
            if refinement == 1.0:
                curves += [
                    Curve(time, exact * 1e3, "k-"),
                    Curve(time, radius * 1e3, ".", f"model, ramp of {duration:g} s"),
                ]
    return Check(
        "lee_radok",
        "Lee–Radok sphere",
        "Incompressible standard linear solid sphere, R = 10 mm, (140 kPa, 20 kPa, 0.5 s), ramps "
        "to 0.1 N and hold in steps of 0.05 s against a³ = (9R/16) ∫ D(t − s) dF(s). The solution "
        "is of small strain; a/R reaches 0.31. Where the skin itself creeps, unlike the finger's "
        "elastic epidermis, the edge is found to 0.15 of an element only: 2 % of the radius on the "
        "default mesh, held for 0.4 s.",
        measures,
        [Panel("time (s)", "contact radius (mm)", curves, legend="lines: Lee–Radok")],
    )


def lee_radok_branches() -> Check:
    """Radius of a sphere of three branches under a ramp to 0.1 N and a hold."""
    law = tissue(
        (0.35, 0.25, 0.2),
        (0.01, 0.1, 1.0),
        0.0,
        E2=80e3,
        friction=0.0,
        poisson_ratio_bulk=INCOMPRESSIBLE,
        poisson_ratio_epidermis=INCOMPRESSIBLE,
    )
    model = sphere(RADIUS, 1.5)
    mesh = replace(model.mesh, part=np.zeros_like(model.mesh.part))
    model = FullOrderModel(model.geometry, 1.5, mesh)
    measures, curves = [], []
    for index, duration in enumerate((0.2, 1.0)):
        steps = 20
        time = np.concatenate(
            [np.linspace(0, duration, steps + 1), duration + np.linspace(0, 0.5, 6)[1:]]
        )
        load = 0.05 * np.minimum(time / duration, 1.0)
        exact = np.cbrt(9 * RADIUS / (16 * law.E0) * creep_response(law, time, load))
        radius = model.simulate(law, time, load).radius
        rows = load > 0.005
        error = largest(percent(radius[rows], exact[rows]))
        measures.append(
            Measure(f"largest radius error, ramp of {duration:g} s and hold", error, "%", high=2.0)
        )
        curves += [
            Curve(time, exact * 1e3, f"C{index}-"),
            Curve(time, radius * 1e3, f"C{index}.", f"model, ramp of {duration:g} s"),
        ]
    return Check(
        "lee_radok_branches",
        "Lee–Radok sphere of three branches",
        "Incompressible sphere, R = 10 mm, E0 = 80 kPa, branches (0.35, 10 ms), (0.25, 0.1 s) and "
        "(0.2, 1 s), ramps to 0.05 N and hold of 0.5 s, mesh of refinement 1.5. The creep "
        "compliance follows exactly from the relaxation modulus, s Ĵ · s Ĝ = 1.",
        measures,
        [Panel("time (s)", "contact radius (mm)", curves, legend="lines: Lee–Radok")],
    )
