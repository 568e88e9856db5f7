# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""What has been printed about people's fingers, beside the model's own numbers.

The paper's three conditions answer for the exponents and their order. One generic finger, with
three relaxation times and a stiffening bulk, answers for all rows that a normal load on a smooth
plate can answer. docs/published.md explains the misses.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from scipy.optimize import curve_fit, minimize_scalar

from ..fem.full_order import FullOrderModel
from ..geometry import Geometry
from ..laws import ConstitutiveLaw, from_branches
from ..paper import CONDITIONS, TARGET_FORCE
from .cases import STUDY

GENERIC_MATERIAL = from_branches(
    {
        "E0": 110e3,
        "branches": [
            {"fraction": 0.35, "tau": 0.004},
            {"fraction": 0.45, "tau": 0.07},
            {"fraction": 0.08, "tau": 1.4},
        ],
        "E2": 800e3,
        "stiffening": 10.0,
    },
    "generic finger",
)
"""Found by a scan of the full-order model over E∞, stiffening, E2 and the fractions; the times are
those of Pawluk and Howe 1999. The lengths are those of the default finger."""

THE_PAPER = "Nam and Kuchenbecker 2021, IEEE Trans. Haptics 14, 303"


@dataclass(frozen=True)
class PublishedResult:
    """One printed result and the model's.

    printed: as printed, None where only an order or a range is; low, high: its spread between
    people, None where open; model: None where the model has no such quantity; note: why.
    """

    name: str
    printed: float | None
    low: float | None
    high: float | None
    model: float | None
    source: str
    note: str = ""

    @property
    def passed(self) -> bool:
        """Whether the model lies within the spread."""
        if self.model is None or not np.isfinite(self.model):
            return False
        above = self.low is None or self.model >= self.low
        return bool(above and (self.high is None or self.model <= self.high))

    def to_dict(self) -> dict[str, Any]:
        """As in the table of `--published -o`."""
        row = asdict(self)
        note = row.pop("note")
        row["model"] = None if self.model is None else float(self.model)
        source = row.pop("source")
        return {**row, "passed": self.passed, "source": source, "note": note}


def _press(duration: float) -> tuple[np.ndarray, np.ndarray]:
    """Times (s) and forces (N) at 10 Hz of a press to the target force."""
    time = np.linspace(0.0, duration, round(10 * duration) + 1)
    return time, TARGET_FORCE * (time / duration) ** 1.15


PRESSES = tuple(_press(duration) for duration in (0.6, 1.0, 1.6))
"""(time (s), force (N)) of the presses on which the power law is fitted."""


def weighted_power_law(
    force: np.ndarray, area: np.ndarray, weight: np.ndarray
) -> tuple[float, float, float]:
    """k, m and the weighted sum of squares that A = k F^m leaves of areas (n,) at forces (n,) in N.

    In the units of the areas, which should not be tiny: mm² rather than m².
    """

    def best(m: float) -> float:
        return float((weight * force**m * area).sum() / (weight * force ** (2 * m)).sum())

    def cost(m: float) -> float:
        return float((weight * (best(m) * force**m - area) ** 2).sum())

    found = minimize_scalar(cost, bounds=(0.1, 1.5), method="bounded")
    return best(float(found.x)), float(found.x), float(found.fun)


def power_law_of(areas: Sequence[np.ndarray]) -> tuple[float, float]:
    """k (m²/N^m) and m of A = k F^m that minimise J over the areas (m²) of PRESSES.

    Frames from 0.05 N on, trials weighted alike, as in the paper's fit.
    """
    forces, seen, weights = [], [], []
    for (_, force), area in zip(PRESSES, areas):
        counts = force >= 0.05
        forces.append(force[counts])
        seen.append(1e6 * area[counts])
        weights.append(np.full(counts.sum(), 1.0 / counts.sum()))
    k, m, _ = weighted_power_law(*map(np.concatenate, (forces, seen, weights)))
    return 1e-6 * k, m


def press_power_law(model: FullOrderModel, material: ConstitutiveLaw) -> tuple[float, float]:
    """`power_law_of` the full-order areas of a finger."""
    return power_law_of([model.simulate(material, *press).area for press in PRESSES])


def slow_press(model: FullOrderModel, material: ConstitutiveLaw) -> dict[str, float]:
    """A press to 10 N in 2 s: ratios of area and of indentation, exponent of area."""
    small = [0.0, 0.1, 0.25, 0.5, 0.75, 1.0, 1.5, 2.0, 3.0, 4.0, 5.2]
    force = np.array([*small, 6.0, 7.0, 8.0, 9.0, 10.0])
    history = model.simulate(material, 0.2 * force, force)
    area, depth = (dict(zip(force, values)) for values in (history.area, history.indentation))
    high = force >= 0.5
    slope = np.polyfit(np.log(force[high]), np.log(history.area[high]), 1)[0]
    return {
        "area_ratio": area[1.0] / area[10.0],
        "exponent": float(slope),
        "depth_ratio": depth[1.0] / depth[5.2],
        "area_1N": area[1.0],
        "depth_1N": depth[1.0],
    }


def tap_loss(model: FullOrderModel, material: ConstitutiveLaw) -> float:
    """Share of the work of a tap that is lost: a half-sine of 1.5 N and 60 ms."""
    time = np.linspace(0.0, 0.06, 25)
    stepper = model.start(material)
    work = []
    for instant in time[1:]:
        stepper.step(float(instant), float(1.5 * np.sin(np.pi * instant / 0.06)))
        work.append(stepper.state.work)
    return work[-1] / max(work)


def relaxation_times(model: FullOrderModel, material: ConstitutiveLaw) -> np.ndarray:
    """Three times (s), shortest first, fitted to the force after 1 mm of indentation in 2 ms."""
    stepper = model.start(material)
    for k in range(1, 7):
        stepper.step_to_position(0.002 * k / 6, 1e-3 * k / 6)
    time = np.geomspace(3e-4, 8.0, 32)
    force = np.array([stepper.step_to_position(0.002 + t, 1e-3).force for t in time])

    def decay(t, constant, *terms):
        return constant + sum(a * np.exp(-t / np.exp(b)) for a, b in zip(terms[::2], terms[1::2]))

    top = force[0]
    start = [0.2 * top] + [v for t in (0.005, 0.08, 1.2) for v in (0.25 * top, np.log(t))]
    found, _ = curve_fit(decay, time, force, start, maxfev=20000)
    return np.sort(np.exp(found[2::2]))


def held_growth(model: FullOrderModel, material: ConstitutiveLaw) -> float:
    """Growth of the area in % from 20 s to 40 s under 1 N."""
    time = np.array([0.0, 0.25, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 30.0, 40.0])
    force = np.where(time < 0.5, 2.0 * time, 1.0)
    area = model.simulate(material, time, force).area
    return 100.0 * (area[-1] / area[-3] - 1.0)


def published(refinement: float = 1.0) -> list[PublishedResult]:
    """Every printed result beside the model's."""
    model, skin = FullOrderModel(Geometry(), refinement), GENERIC_MATERIAL
    laws = {name: press_power_law(model, material) for name, material in STUDY.items()}
    slow = slow_press(model, skin)
    times = relaxation_times(model, skin)
    k = {name: law[0] for name, law in laws.items()}
    rows = [
        PublishedResult(
            f"exponent m of A = k F^m to 1.35 N, {name}",
            c.power_law_exponent,
            c.power_law_exponent - 0.04,
            c.power_law_exponent + 0.04,
            laws[name][1],
            f"{THE_PAPER}, Table and text; the spread is ours",
        )
        for name, c in CONDITIONS.items()
    ]
    no_shear = "no tangential load in this model"
    rows += [
        PublishedResult(
            "k natural over k dry: slightly above one", None, 1.0, 1.25,
            k["natural"] / k["dry"], f"{THE_PAPER}, Fig. 6; the upper limit is ours",
        ),
        PublishedResult(
            "k moist over k natural: above one", None, 1.0, None, k["moist"] / k["natural"],
            f"{THE_PAPER}, Fig. 6",
        ),
        PublishedResult(
            "A(1 N) / A(10 N)", 0.60, 0.50, 0.70, slow["area_ratio"],
            "compiled from several studies of gross contact area",
        ),
        PublishedResult(
            "exponent of gross area over 0.5–10 N", 0.54, 0.44, 0.64, slow["exponent"],
            "Warman and Ennos 2009, J. Exp. Biol. 212, 2016 (to 15 N); the spread is ours",
        ),
        PublishedResult(
            "indentation at 1 N over that at 5.2 N", 0.82, 0.72, 0.92, slow["depth_ratio"],
            "Serina et al. 1997, J. Biomech. 30, 1035; the spread is ours",
        ),
        *(
            PublishedResult(
                f"stress relaxation, {name} time (s)", value, 0.5 * value, 2.0 * value, found,
                "Pawluk and Howe 1999, J. Biomech. Eng. 121, 605; the spread is ours",
            )
            for name, value, found in zip(("short", "middle", "long"), (0.004, 0.07, 1.4), times)
        ),
        PublishedResult(
            "energy lost in a tap (%)", 81.0, 76.0, 86.0, 100.0 * tap_loss(model, skin),
            "Jindrich et al. 2003, J. Biomech. 36, 497",
        ),
        PublishedResult(
            "growth of area from 20 s to 40 s of a held load (%): saturated", None, -0.5, 2.0,
            held_growth(model, skin),
            "Dzidek et al. 2017 (real area, saturates in under 20 s); the limit is ours",
        ),
        PublishedResult(
            "stick ratio at half the limiting tangential force", 0.5, 0.4, 0.6, None,
            "André et al. 2011", no_shear,
        ),
        PublishedResult(
            "real area under shear before slip, fall in %", 30.0, 0.0, 30.0, None,
            "Sahli et al. 2018, PNAS 115, 471", no_shear + ", no real area",
        ),
        PublishedResult(
            "long-term modulus of the bulk (kPa)", 25.0, 12.5, 50.0,
            1e-3 * skin.E0 * skin.long_term_fraction, "Willemet (lumped finite-element finger)",
        ),
        PublishedResult(
            "modulus of the epidermis (MPa)", 1.54, 0.77, 3.1, 1e-6 * skin.epidermis_modulus,
            "Willemet (lumped finite-element finger)",
        ),
        PublishedResult(
            "area moist over natural at 1 N", 1.0, 0.85, 1.15, k["moist"] / k["natural"],
            "Serhat et al. 2022 (dry, water, glycerin alike), against the paper's order",
            "the paper's composites and E2 fix this ratio",
        ),
        PublishedResult(
            "width of the fingertip (mm)", None, 16.0, 20.0,
            2e3 * Geometry().pad_semi_axis_radial,
            "Dandekar et al. 2003, J. Biomech. Eng. 125, 682",
        ),
    ]  # fmt: skip
    return rows
