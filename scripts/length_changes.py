"""What one standard deviation of each assumed length does to area and indentation at 1 N.

    python scripts/length_changes.py [--write]

The default finger, natural skin, a press to 1.35 N in 1 s, by the full order; the same for
friction, Poisson's ratio and nail. With --write the tables go into docs/limitations.md.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
from doc_tables import replace_between

from finger_common.files import atomic_write
from finger_model.anthropometry import estimate_geometry
from finger_model.fem.full_order import FullOrderModel
from finger_model.geometry import Geometry
from finger_model.material import Material
from finger_sim.conditions import STUDY

PAGE = Path(__file__).resolve().parent.parent / "docs" / "limitations.md"
TIME = np.linspace(0.0, 1.0, 41)
LARGEST, AT = 1.35, 1.0
"""N: end of the press, and where area and indentation are taken."""

CHOICES: Mapping[str, Mapping[str, float]] = {
    "no friction": {"friction": 0.0},
    "friction 0.6": {"friction": 0.6},
    "friction 1": {"friction": 1.0},
    "Poisson's ratio of the bulk 0.45": {"poisson_ratio_bulk": 0.45},
    "nail of 17 MPa": {"nail_modulus": 17e6},
}


def pressed(geometry: Geometry, material: Material) -> np.ndarray:
    """Area (mm²) and indentation (mm) (2,) at AT."""
    force = LARGEST * TIME
    found = FullOrderModel(geometry).simulate(material, TIME, force)
    area = np.interp(AT, force, found.area)
    return np.array([area * 1e6, np.interp(AT, force, found.indentation) * 1e3])


def percent(values: np.ndarray, base: np.ndarray) -> list[str]:
    """Changes (2,) in %, without the sign of nothing."""
    return [f"{round(change):+d} %".replace("+0 %", "0 %") for change in 100 * (values / base - 1)]


def tables() -> str:
    """Both tables, with a sentence about the base."""
    estimate = estimate_geometry(width=0.017, depth=0.011)
    geometry, material = estimate.geometry, STUDY["natural"].material
    base = pressed(geometry, material)
    lines = [
        f"At 1 N the area is {base[0]:.1f} mm² and the indentation {base[1]:.2f} mm.",
        "",
        "| length, with width and depth measured | 1 SD | change of area, +1 SD / −1 SD | "
        "of indentation |",
        "|---|---|---|---|",
    ]
    squares = np.zeros(2)
    for name, deviation in estimate.deviations.items():
        sides = []
        for sign in (1.0, -1.0):
            length = getattr(geometry, name) + sign * deviation
            sides.append(pressed(replace(geometry, **{name: length}), material))
        squares += (np.subtract(*sides) / 2 / base) ** 2
        changes = zip(percent(sides[0], base), percent(sides[1], base))
        cells = " | ".join(f"{up} / {down}" for up, down in changes)
        lines.append(f"| `{name}` | {1e3 * deviation:.2f} mm | {cells} |".replace("-", "−"))
    both = [f"{100 * value:.0f} %" for value in np.sqrt(squares)]
    lines += [
        f"| all, root of the sum of squares | | {both[0]} | {both[1]} |",
        "",
        "| what is assumed | change of area | of indentation |",
        "|---|---|---|",
    ]
    for name, values in CHOICES.items():
        changes = 100 * (pressed(geometry, replace(material, **values)) / base - 1)
        cells = " | ".join(f"{change:+.1f} %".replace("-", "−") for change in changes)
        lines.append(f"| {name} | {cells} |")
    return "\n".join(lines)


def main() -> None:
    """Print the tables, or write them."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--write", action="store_true", help="put them into docs/limitations.md")
    write = parser.parse_args().write
    text = tables()
    print(text)
    if write:
        page = replace_between(PAGE.read_text(encoding="utf-8"), "lengths", text)
        with atomic_write(PAGE) as file:
            file.write(page)


if __name__ == "__main__":
    main()
