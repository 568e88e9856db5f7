"""Draw every length of geometry.yaml into docs/figures/geometry.svg."""

from __future__ import annotations

from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from finger_model.geometry import Geometry

OUTPUT = Path(__file__).resolve().parent.parent / "docs" / "figures" / "geometry.svg"


def main() -> None:
    g = Geometry(
        pad_semi_axis_radial=8.5e-3,
        pad_semi_axis_axial=6.0e-3,
        epidermis_thickness=0.7e-3,
        bone_semi_axis_radial=4.0e-3,
        bone_semi_axis_axial=2.5e-3,
        nail_thickness=0.6e-3,
    )
    plt.rcParams["svg.hashsalt"] = "geometry"
    figure, axes = plt.subplots(figsize=(8.0, 5.2))
    angle = np.linspace(-np.pi, 0.0, 200)

    def half(a: float, b: float, **style) -> None:
        axes.fill(1e3 * a * np.cos(angle), 1e3 * b * np.sin(angle), **style)

    half(g.pad_semi_axis_radial, g.pad_semi_axis_axial, fc="#e8b48c", ec="0.2", lw=1.0)
    half(*g.bulk_semi_axes, fc="#f7e3d3", ec="0.45", lw=0.7)
    half(g.bone_semi_axis_radial, g.bone_semi_axis_axial, fc="#fbf9f3", ec="0.3", lw=0.9)
    nail, thick = 1e3 * g.nail_radius, 1e3 * g.nail_thickness
    axes.fill_between([-nail, nail], 0, thick, fc="#d9d2c5", ec="0.3", lw=0.9)
    axes.plot([0, 0], [-6.9, 1.6], color="0.4", lw=0.7, ls=(0, (8, 3, 2, 3)))
    for x, y, text in (
        (0.15, -1.2, "bone, rigid"),
        (0.15, -4.3, "bulk tissue"),
        (-6.9, 0.12, "nail"),
    ):
        axes.text(x, y, text, fontsize=9, color="0.25")
    axes.text(-5.3, -5.35, "epidermis", fontsize=9, color="0.25", rotation=-26)
    axes.fill_between([-9.2, 9.2], -6.6, -6.02, fc="#cfe0ec", lw=0)
    axes.text(-9.0, -6.45, "glass plate, moves up", fontsize=9, color="#345")

    def arrow(start, end, text, place, align="center") -> None:
        style = {"arrowstyle": "<->", "lw": 0.9, "color": "#a02020", "shrinkA": 0, "shrinkB": 0}
        axes.annotate("", end, start, arrowprops=style)
        axes.text(*place, text, fontsize=8.5, color="#a02020", ha=align, va="center")

    arrow((0, 2.3), (8.5, 2.3), "pad_semi_axis_radial", (4.25, 2.65))
    arrow((0, 1.2), (nail, 1.2), "nail_radius", (3.5, 1.5))
    arrow((9.3, 0), (9.3, -6.0), "pad_semi_axis_axial", (9.5, -3.0), "left")
    arrow((7.4, 0), (7.4, thick), "nail_thickness", (7.6, 0.3), "left")
    arrow((-4.0, 0.95), (0, 0.95), "bone_semi_axis_radial", (-0.2, 1.3), "right")
    arrow((-0.25, 0), (-0.25, -2.5), "bone_semi_axis_axial", (-0.6, -3.0), "center")
    inner = 1e3 * g.bulk_semi_axes[0]
    arrow((-8.5, 0.9), (-inner, 0.9), "", (0, 0))
    axes.text(-9.4, 1.3, "epidermis_thickness", fontsize=8.5, color="#a02020")
    for x in (8.5, -8.5, -inner):
        axes.plot([x, x], [0, 2.4 if x > 0 else 1.0], color="0.6", lw=0.5)
    axes.plot([-4, -4], [0, 1.0], color="0.6", lw=0.5)
    axes.plot([0, 9.4], [-6.0, -6.0], color="0.6", lw=0.5)
    axes.plot([7, 9.4], [0, 0], color="0.6", lw=0.5)
    axes.plot(0, 0, "o", ms=3.5, color="0.2")
    axes.annotate(
        "bone_center_height = 0:\nthe bone's centre lies on the flat top",
        (0, 0), (-9.4, 2.35), fontsize=8.5, color="#a02020", va="center",
        arrowprops={"arrowstyle": "-", "lw": 0.6, "color": "#a02020"},
    )  # fmt: skip
    axes.set_aspect("equal")
    axes.set_xlim(-9.6, 12.9)
    axes.set_ylim(-7.0, 3.0)
    axes.set_axis_off()
    figure.savefig(OUTPUT, metadata={"Date": None}, bbox_inches="tight")


if __name__ == "__main__":
    main()
