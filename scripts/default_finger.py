"""The default finger against the paper's printed curves, and how many other fingers do as well.

    python scripts/default_finger.py [--fingers 3000] [--seed 1] [--write]

The paper (Nam and Kuchenbecker 2021) prints the exponents m of A = k F^m and the order of the
areas of three conditions; it does not print lengths, nor E0 and tau1 of the dry and natural
finger. First the default finger is pressed with the full-order model. Then fingers are drawn:
lengths as adults differ (data/people.yaml), E0 and tau1 of both conditions from the paper's
search box. What it prints (composite moduli, E2, the moist tau1, friction) stays. Those that meet
every printed result show how little the print says about what it leaves out. --write puts these
tables into docs/published.md.

Last, J of the power law over that of the model, at the trial-to-trial gains that give the paper's
J: 300 studies of 15 presses. The model's best fit is that of its areas' linear answer to E0, E1,
tau1 and E2.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np
from doc_tables import replace_between
from nuisance_table import press, published_scatter

from finger_common.errors import InputError
from finger_model.fem.full_order import FullOrderModel
from finger_model.geometry import Geometry
from finger_model.material import Material
from finger_model.paper import CONDITIONS, SEARCH_BOX, TARGET_FORCE, TRIALS_PER_CONDITION
from finger_model.people import People
from finger_model.reduced.model import load_population
from finger_model.verification.published import PRESSES, power_law_of, weighted_power_law

PAGE = Path(__file__).resolve().parent.parent / "docs" / "published.md"
TOLERANCE = 0.04
"""Largest difference from a printed exponent."""
SLIGHTLY = 1.25
"""Natural over dry areas, from above 1 to this, counts as "slightly above"."""
COMPARED = np.array([0.2, 0.5, 1.0, TARGET_FORCE])
"""N, at which areas are compared."""
TRIES = 40
"""Pairs of E0 and tau1 drawn for each condition of a finger."""
SHOWN = {
    "pad_semi_axis_radial": "half width of the pad",
    "pad_semi_axis_axial": "height of the pad",
    "epidermis_thickness": "epidermis",
    "bone_semi_axis_radial": "half width of the bone",
    "bone_semi_axis_axial": "height of the bone",
}


def series_modulus(composite: float, E0: np.ndarray) -> np.ndarray:
    """E1 (Pa) that gives the composite modulus with E0 (n,) (Pa)."""
    return 1.0 / (1.0 / composite - 1.0 / E0)


def described(areas: list[np.ndarray]) -> tuple[float, float, np.ndarray]:
    """k (mm²/N^m), m and areas (4,) in mm² at COMPARED of the press in 1 s."""
    k, m = power_law_of(areas)
    at = np.interp(COMPARED, PRESSES[1][1], areas[1])
    return 1e6 * k, m, 1e6 * at


def default_table() -> str:
    """k, m and areas of the default finger, full order."""
    model = FullOrderModel(Geometry())
    rows = ["| condition | m, printed | m | k (mm²/N^m) | area at 0.2, 0.5, 1.0, 1.35 N (mm²) |"]
    rows.append("|---|---|---|---|---|")
    for name, condition in CONDITIONS.items():
        material = Material(**condition.parameters)
        k, m, at = described([model.simulate(material, t, f).area for t, f in PRESSES])
        areas = ", ".join(f"{a:.1f}" for a in at)
        rows.append(
            f"| {name} | {condition.power_law_exponent:.2f} | {m:.3f} | {k:.1f} | {areas} |"
        )
    return "\n".join(rows)


def drawn_sets(rng: np.random.Generator, name: str) -> np.ndarray:
    """Parameter sets (n, 4) of a condition: E0 and tau1 drawn where the paper prints none."""
    condition = CONDITIONS[name]
    if name == "moist":
        return np.array([list(condition.parameters.values())])
    E0 = rng.uniform(*SEARCH_BOX["E0"], TRIES)
    tau = np.exp(rng.uniform(*np.log(SEARCH_BOX["tau1"]), TRIES))
    E1 = series_modulus(condition.composite_E, E0)
    inside = (E1 >= SEARCH_BOX["E1"][0]) & (E1 <= SEARCH_BOX["E1"][1])
    E2 = np.full(TRIES, condition.parameters["E2"])
    return np.column_stack([E0, E1, tau, E2])[inside]


def as_printed(geometry: Geometry, rng: np.random.Generator) -> list[dict[str, float]]:
    """Choices of E0 and tau1 with which a finger meets every printed result."""
    model = load_population(geometry)
    good: dict[str, list[tuple[np.ndarray, float, np.ndarray]]] = {}
    for name in ("moist", "dry", "natural"):
        sets = drawn_sets(rng, name)
        areas = model.batch(sets, PRESSES)
        kept = []
        for row, values in enumerate(sets):
            k, m, at = described([a[row] for a in areas])
            if abs(m - CONDITIONS[name].power_law_exponent) <= TOLERANCE:
                kept.append((values, k, at))
        if not kept:
            return []
        good[name] = kept
    moist_k = good["moist"][0][1]
    found = []
    for dry, dry_k, dry_at in good["dry"]:
        for natural, natural_k, natural_at in good["natural"]:
            ratio = natural_at / dry_at
            if dry_k < natural_k < moist_k and np.all((ratio > 1.0) & (ratio <= SLIGHTLY)):
                found.append(
                    {
                        "E0 dry": dry[0],
                        "tau1 dry": dry[2],
                        "E0 natural": natural[0],
                        "tau1 natural": natural[2],
                    }
                )
    return found


def others_table(number: int, seed: int) -> str:
    """Ranges of the fingers that meet every printed result."""
    rng, people = np.random.default_rng(seed), People.default()
    lengths, choices, tried = [], [], 0
    for _ in range(number):
        geometry = people.draw(rng).geometry
        try:
            found = as_printed(geometry, rng)
        except InputError:
            continue
        tried += 1
        if found:
            lengths.append([getattr(geometry, name) for name in SHOWN])
            choices.append(found[rng.integers(len(found))])
    rows = [
        f"{len(lengths)} of {tried} fingers meet every printed result with some choice of E0 and "
        "τ1. Their ranges:",
        "",
        "| | default | 5 % | median | 95 % |",
        "|---|---|---|---|---|",
    ]
    for (key, label), found in zip(SHOWN.items(), 1e3 * np.array(lengths).T):
        default = 1e3 * getattr(Geometry(), key)
        low, middle, high = np.percentile(found, [5, 50, 95])
        rows.append(f"| {label} (mm) | {default:.2g} | {low:.2f} | {middle:.2f} | {high:.2f} |")
    for name in ("dry", "natural"):
        for key, label, scale in (("E0", "E0, {} (kPa)", 1e-3), ("tau1", "τ1, {} (s)", 1.0)):
            default = CONDITIONS[name].parameters[key] * scale
            values = [choice[f"{key} {name}"] * scale for choice in choices]
            low, middle, high = np.percentile(values, [5, 50, 95])
            label = label.format(name)
            rows.append(f"| {label} | {default:.3g} | {low:.3g} | {middle:.3g} | {high:.3g} |")
    return "\n".join(rows)


def margins(name: str, scatter: float, studies: int, seed: int) -> np.ndarray:
    """J of the power law less J of the model (mm⁴) in studies (n,) of 15 presses of a condition.

    scatter: deviation of the logarithm of the gain of a press's areas.
    """
    model, truth = load_population(Geometry()), CONDITIONS[name].parameters
    drives = []
    for index in range(TRIALS_PER_CONDITION):
        drawn, frames, _ = press(name, index)
        seen = (frames > drawn.onset + 0.05) & (frames <= drawn.cue + 0.1)
        knots = np.union1d(drawn.time[::5], frames[seen])
        force = np.interp(knots, drawn.time, drawn.force)
        drives.append((knots, force, np.searchsorted(knots, frames[seen])))
    forces = np.concatenate([force[rows] for _, force, rows in drives])
    sizes = [len(rows) for _, _, rows in drives]
    trial = np.repeat(np.arange(len(drives)), sizes)
    weight = np.repeat(1.0 / np.array(sizes), sizes)
    points = np.log(np.tile(list(truth.values()), (5, 1)))
    points[np.arange(1, 5), np.arange(4)] += 0.01
    areas = 1e6 * np.concatenate(model.batch(np.exp(points), drives), axis=1)
    base, slopes = areas[0], (areas[1:] - areas[0]).T / 0.01
    rng, root = np.random.default_rng(seed), np.sqrt(weight)
    found = []
    for _ in range(studies):
        measured = base * np.exp(scatter * rng.normal(size=len(drives)))[trial]
        change = np.linalg.lstsq(root[:, None] * slopes, root * (measured - base), rcond=None)[0]
        own = float(weight @ (measured - base - slopes @ change) ** 2)
        found.append(weighted_power_law(forces, measured, weight)[2] - own)
    return np.array(found)


def margins_text(seed: int) -> str:
    """Margins of all conditions, without scatter and with the paper's."""
    rows = ["| condition | without scatter | gains of the paper's J | margin | reaches 500 mm⁴ |"]
    rows.append("|---|---|---|---|---|")
    for name in CONDITIONS:
        scatter = published_scatter(name)
        found = margins(name, scatter, 300, seed)
        rows.append(
            f"| {name} | {margins(name, 0.0, 1, seed)[0]:.0f} mm⁴ | {100 * scatter:.0f} % | "
            f"{found.mean():.0f} mm⁴ | {100 * np.mean(found >= 500):.0f} % |"
        )
    return "\n".join(rows)


def main() -> int:
    """Print or write the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--fingers", type=int, default=3000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--write", action="store_true", help="into docs/published.md")
    args = parser.parse_args()
    parts = (
        default_table(),
        others_table(args.fingers, args.seed),
        "J of the power law less that of the model:\n\n" + margins_text(args.seed),
    )
    text = "\n\n".join(parts)
    print(text)
    if args.write:
        page = replace_between(PAGE.read_text(), "default-finger", text)
        PAGE.write_text(page)
    return 0


if __name__ == "__main__":
    sys.exit(main())
