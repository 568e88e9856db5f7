"""Hertz and Lee–Radok: spheres on a rigid plane."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from matplotlib.figure import Figure

from ..fem.full_order import FullOrderModel
from ..material import Material
from .cases import ELASTIC, reference, sphere
from .check import Check, Measure

RADIUS = 10e-3
INCOMPRESSIBLE = 0.4999


def hertz(refinement: float = 1.0) -> Check:
    """Radius law and pressure profile of an incompressible elastic sphere at small load."""
    modulus = 30e3
    material = Material(
        E0=modulus,
        E1=ELASTIC * modulus,
        E2=modulus,
        friction=0.0,
        poisson_ratio_bulk=INCOMPRESSIBLE,
        poisson_ratio_epidermis=INCOMPRESSIBLE,
    )
    stepper = sphere(RADIUS, refinement).start(material)
    loads = np.geomspace(3e-3, 3e-2, 12)
    radius = np.array([stepper.step(k + 1.0, load).radius for k, load in enumerate(loads)])
    exact = np.cbrt(9 * loads * RADIUS / (16 * modulus))
    exponent = float(np.polyfit(np.log(loads), np.log(math.pi * radius**2), 1)[0])
    fields = stepper.fields()
    at = fields.contact_radius / exact[-1]
    profile = 1.5 * loads[-1] / (math.pi * exact[-1] ** 2) * np.sqrt(np.maximum(1 - at**2, 0))
    inside = (at > 0.1) & (at < 0.8)
    misfit = np.abs(fields.contact_pressure[inside] / profile[inside] - 1)

    def draw(figure: Figure) -> None:
        left, right = figure.subplots(1, 2)
        left.loglog(loads, radius * 1e3, "o", label="model")
        left.loglog(loads, exact * 1e3, "k-", label="Hertz")
        left.set(xlabel="force (N)", ylabel="contact radius (mm)")
        left.legend()
        touched = fields.contact_pressure > 0
        right.plot(at[touched], fields.contact_pressure[touched] * 1e-3, "o", label="model")
        dense = np.linspace(0, 1, 200)
        peak = 1.5 * loads[-1] / (math.pi * exact[-1] ** 2)
        right.plot(dense, peak * np.sqrt(1 - dense**2) * 1e-3, "k-", label="Hertz")
        right.set(xlabel="r/a", ylabel="pressure (kPa)")
        right.legend()

    return Check(
        "hertz",
        "Hertz contact",
        "Homogeneous sphere, R = 10 mm, E = 30 kPa, ν = 0.4999, 3 to 30 mN: a³ = 9FR/(16E).",
        [
            Measure(
                "largest error of the coefficient a³/F",
                float(100 * np.abs((radius / exact) ** 3 - 1).max()),
                "%",
                high=2.0,
            ),
            Measure("exponent of area over force", exponent, low=2 / 3 - 0.01, high=2 / 3 + 0.01),
            Measure(
                "largest error of pressure, 0.1 < r/a < 0.8",
                float(100 * misfit.max()),
                "%",
                high=3.0,
            ),
        ],
        draw,
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
            time = table["t_s"][rows]
            load = table[f"F_N_T{name}"][rows]
            exact = table[f"a_mm_T{name}"][rows] * 1e-3
            history = model.simulate(material, time, load)
            ramp = (load > 0.005) & (time <= duration + 1e-9)
            error = 100 * np.abs(history.radius / np.where(exact > 0, exact, 1) - 1)
            where = f"{duration:g} s, refinement {refinement:g}"
            measures += [
                Measure(f"largest radius error, ramp of {where}", error[ramp].max(), "%", high=2.0),
                Measure(
                    f"radius error at the end, hold after {where}",
                    error[-1],
                    "%",
                    high=2.0 if refinement > 1.0 else None,
                ),
            ]
            if refinement == 1.0:
                curves.append((duration, time, history.radius, exact))

    def draw(figure: Figure) -> None:
        axes = figure.add_subplot()
        for duration, time, found, exact in curves:
            axes.plot(time, exact * 1e3, "k-", linewidth=0.8)
            axes.plot(time, found * 1e3, ".", label=f"model, ramp of {duration:g} s")
        axes.set(xlabel="time (s)", ylabel="contact radius (mm)")
        axes.legend(title="lines: Lee–Radok")

    return Check(
        "lee_radok",
        "Lee–Radok sphere",
        "Incompressible standard linear solid sphere, R = 10 mm, (140 kPa, 20 kPa, 0.5 s), ramps to 0.1 N and hold "
        "in steps of 0.05 s against a³ = (9R/16) ∫ D(t − s) dF(s). The solution is of small strain; a/R reaches "
        "0.31. Where the skin itself creeps, unlike the finger's elastic epidermis, the edge is found to 0.15 of an "
        "element only: 2 % of the radius on the default mesh, held for 0.4 s.",
        measures,
        draw,
    )
