"""What linear elasticity and incompressible tissue do to areas and to a fitted E.

Writes docs/paper_choices.md's table: `python scripts/paper_choices.py > table.md`, some minutes.
"""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np
from scipy.optimize import minimize_scalar

from finger_common.errors import ModelError
from finger_model.fem.full_order import FullOrderModel
from finger_model.material import Material
from finger_model.verification.cases import STUDY, elastic

LOADS = np.array([0.2, 0.5, 1.0, 1.35])
REFINEMENT = 0.5
INCOMPRESSIBLE = {f"poisson_ratio_{part}": 0.4999 for part in ("bulk", "epidermis", "nail")}
CHOICES = {
    "neo-Hooke, ν 0.48 (default)": ("neo-hooke", {}),
    "all incompressible, ν 0.4999": ("neo-hooke", INCOMPRESSIBLE),
    "linear epidermis": ("linear-epidermis", {}),
    "linear epidermis, all incompressible": ("linear-epidermis", INCOMPRESSIBLE),
    "small strain": ("small-strain", {}),
    "St Venant–Kirchhoff": ("st-venant-kirchhoff", {}),
}


def areas(model: FullOrderModel, material: Material) -> tuple[np.ndarray, float]:
    """Areas (4,) in mm² at LOADS, NaN where the model ends, and the last force reached (N)."""
    stepper, found = model.start(material), np.full(len(LOADS), np.nan)
    for row, force in enumerate(LOADS):
        try:
            found[row] = stepper.step(row + 1.0, float(force)).area * 1e6
        except ModelError:
            break
    return found, float(stepper.state.force)


def fitted(model: FullOrderModel, material: Material, data: np.ndarray) -> float:
    """E (Pa) whose areas are nearest to data (4,) in least squares, E2 kept."""

    def misfit(log_modulus: float) -> float:
        modulus = float(np.exp(log_modulus))
        found, _ = areas(model, replace(material, E0=modulus, E1=1e9 * modulus))
        rows = np.isfinite(data) & np.isfinite(found)
        return float(np.mean((found - data)[rows] ** 2)) if rows.any() else 1e9

    start = np.log(material.E0)
    result = minimize_scalar(
        misfit, bounds=(start - 1.6, start + 0.8), method="bounded", options={"xatol": 5e-3}
    )
    return float(np.exp(result.x))


def main() -> None:
    """Print the table."""
    head = " | ".join(f"{load:g} N" for load in LOADS)
    print(f"| finger | choice | {head} | fitted E (kPa) | change |")
    print("|---" * (len(LOADS) + 4) + "|")
    for name, condition in STUDY.items():
        modulus = condition.composite_modulus
        truth, data = elastic(modulus, E2=condition.E2), None
        for choice, (elasticity, others) in CHOICES.items():
            model = FullOrderModel(refinement=REFINEMENT, elasticity=elasticity)
            material = replace(truth, **others)
            found, reached = areas(model, material)
            if data is None:
                data = found
            cells = [f"{value:.1f}" if np.isfinite(value) else "–" for value in found]
            if reached < LOADS[-1]:
                fit = [f"ends before {LOADS[LOADS > reached][0]:g} N", "–"]
            elif choice == next(iter(CHOICES)):
                fit = [f"{modulus * 1e-3:.2f}", "0 %"]
            else:
                value = fitted(model, material, data)
                fit = [f"{value * 1e-3:.2f}", f"{100 * (value / modulus - 1):+.0f} %"]
            print("|", " | ".join([name, choice, *cells, *fit]), "|")
            sys.stdout.flush()


if __name__ == "__main__":
    main()
