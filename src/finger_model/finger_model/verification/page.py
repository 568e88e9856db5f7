# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""The verification page."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from textwrap import fill

from matplotlib.figure import Figure

from finger_common.files import atomic_write

from ..figures import save
from . import (
    fingers,
    frictions,
    homogeneous,
    numerics,
    pulled_spheres,
    solids,
    spheres,
    twisted_spheres,
)
from .check import Check

CHECKS: dict[str, Callable[[], Check]] = {
    "patch": numerics.patch_tests,
    "newton": numerics.newton,
    "space": numerics.space,
    "time": numerics.time_steps,
    "hertz": spheres.hertz,
    "lee_radok": spheres.lee_radok,
    "lee_radok_branches": spheres.lee_radok_branches,
    "homogeneous": homogeneous.points,
    "cylinder": homogeneous.cylinder,
    "limits": fingers.time_limits,
    "calculix": fingers.calculix,
    "small_strain": fingers.small_strain,
    "energy": fingers.energy,
    "energy_branches": lambda: fingers.energy(branches=True),
    "smoothness": fingers.smoothness,
    "smoothness_friction": lambda: fingers.smoothness(0.25),
    "monotonicity": fingers.monotonicity,
    "friction_area": frictions.effect_on_area,
    "coulomb": frictions.coulomb,
    "disc": frictions.disc,
    "solid_axisymmetric": solids.axisymmetric,
    "solid_mindlin": pulled_spheres.cattaneo_mindlin,
    "solid_twist": twisted_spheres.twisted,
    "solid_shear": solids.shear,
    "solid_tilt": solids.tilted,
    "solid_ellipse": solids.elliptical,
}


def write_page(checks: Sequence[Check], folder: Path) -> Path:
    """Write verification.md and figures/verification_*.png into a folder; returns the path."""
    lines = [
        "# Verification of the full-order model",
        "",
        "Made by `finger-model verify -o docs`. Theory and symbols: [theory.md](theory.md). The",
        "mesh is the default one (refinement 1) unless the text names another.",
        "",
        "| check | result |",
        "|---|---|",
    ]
    for check in checks:
        words = check.title.lower().replace(" ", "-")
        anchor = "".join(c for c in words if c.isalnum() or c == "-")
        result = "passes" if check.passes else "**fails**"
        lines.append(f"| [{check.title}](#{anchor}) | {result} |")
    for check in checks:
        text = fill(check.text, 100, break_long_words=False, break_on_hyphens=False)
        lines += ["", f"## {check.title}", "", text, "", "| measured | value | limit |"]
        lines.append("|---|---|---|")
        for measure in check.measures:
            mark = "" if measure.passes else " **fails**"
            unit = f" {measure.unit}" if measure.unit else ""
            limit = measure.limit()
            limit += unit if limit != "reported" else ""
            what = measure.what.replace("|", "\\|")
            lines.append(f"| {what} | {measure.value:.3g}{unit}{mark} | {limit} |")
        if check.panels:
            name = f"figures/verification_{check.name}.png"
            figure = Figure(figsize=(7.5, 3.6), layout="constrained")
            for axes, panel in zip(
                figure.subplots(1, len(check.panels), squeeze=False)[0], check.panels
            ):
                panel.draw(axes)
            save(figure, folder / name, dpi=110)
            lines += ["", f"![{check.title}]({name})"]
    path = folder / "verification.md"
    with atomic_write(path) as file:
        file.write("\n".join(lines) + "\n")
    return path
