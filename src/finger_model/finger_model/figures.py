# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Figures of the full-order and the reduced model."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import matplotlib
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure

from finger_common.files import atomic_write

from .fem.fields import Fields
from .geometry import Geometry
from .history import ContactHistory, ContactPoint

if TYPE_CHECKING:
    from .reduced.error import ErrorTable
    from .reduced.training_runs import Run


def save(figure: Figure, path: str | Path, dpi: int = 150) -> None:
    """Write a figure as PNG, atomically."""
    FigureCanvasAgg(figure)
    with atomic_write(path, "wb") as file:
        figure.savefig(file, format="png", dpi=dpi, metadata={"Software": None})


def half_section(fields: Fields, geometry: Geometry, point: ContactPoint, path: str | Path) -> None:
    """Draw the deformed half-section with the von Mises stress of the soft parts as PNG."""
    figure = Figure(figsize=(7.0, 4.2), layout="constrained")
    axes = figure.add_subplot()
    polygons = fields.deformed[fields.cells] * 1e3
    stress = fields.von_mises * 1e-3
    soft = fields.part < 2
    drawing = PolyCollection(
        list(polygons[soft]),
        array=stress[soft],
        cmap=matplotlib.colormaps["viridis"],
        norm=matplotlib.colors.LogNorm(
            max(stress[soft].max() * 1e-3, np.percentile(stress[soft], 2)), stress[soft].max()
        ),
        edgecolors="face",
        linewidths=0.2,
    )
    axes.add_collection(drawing)
    if not soft.all():
        axes.add_collection(PolyCollection(list(polygons[~soft]), facecolors="0.75"))
    r, z = geometry.bone_profile(np.linspace(0, 1, 60))
    axes.fill(
        np.concatenate([r, [0.0]]) * 1e3, np.concatenate([z, [0.0]]) * 1e3, color="0.9", ec="0.4"
    )
    axes.annotate("bone", (0.35 * r[-1] * 1e3, 0.4 * z[0] * 1e3), ha="center")
    skin = fields.surface
    inner = fields.deformed[fields.interface] * 1e3
    axes.add_collection(LineCollection([inner], colors="w", linewidths=0.6))
    axes.plot(*(fields.deformed[skin] * 1e3).T, color="k", linewidth=0.8)
    height = fields.plate_height * 1e3
    width = 1.05 * fields.deformed[:, 0].max() * 1e3
    axes.fill_between([0, width], height, height - 0.5, color="lightsteelblue", ec="0.3")
    axes.set(
        xlabel="r (mm)",
        ylabel="z (mm)",
        aspect="equal",
        xlim=(0, width),
        title=f"t = {point.time:.3g} s, F = {point.force:.3g} N, A = {point.area * 1e6:.3g} mm²",
    )
    axes.set_ylim(height - 0.5, max(0.3, fields.deformed[:, 1].max() * 1e3 + 0.3))
    figure.colorbar(drawing, ax=axes, label="von Mises stress (kPa)")
    save(figure, path)


def error_distribution(
    table: ErrorTable, run: Run, found: ContactHistory, path: str | Path
) -> None:
    """Draw the errors of a reduced model over all pairs, and one run with its own result."""
    figure = Figure(figsize=(11, 4.2), layout="constrained")
    left, right = figure.subplots(1, 2)
    share = np.linspace(0, 100, len(table.pairs))
    left.plot(share, np.sort([100 * p.rms for p in table.pairs]), label="RMS over the history")
    left.plot(share, np.sort([100 * p.worst for p in table.pairs]), label="worst instant")
    left.axhline(1, color="C0", ls=":")
    left.axhline(2, color="C1", ls=":")
    left.set(xlabel="share of the pairs (%)", ylabel="error of area (% of the largest)", ylim=0)
    left.legend()
    right.plot(run.time, run.area * 1e6, "k", label="full order")
    right.plot(run.time, found.area * 1e6, "C3--", label="reduced")
    right.set(xlabel="time (s)", ylabel="area (mm²)", title=f"worst pair ({run.kind})")
    right.legend()
    save(figure, path, dpi=130)
