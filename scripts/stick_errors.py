# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Print how the stick ratio errs that the ridges of rendered pulls give.

    python scripts/stick_errors.py [--pulls 60] [--seed 5000]

First over random pulls by the slip law, by skin and by the true ratio (CAMERA of
scripts/slip_study.py), then over nine pulls each of skin that slips in other ways, and of contacts
that change meanwhile.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import cv2
import numpy as np

from finger_sim.ftir import Contact, FtirRenderer, Scene
from finger_sim.skin_slip import SkinSlip
from finger_vision.ftir import FtirSegmenter
from finger_vision.ridge_motion import RidgeMotion

SKINS = ("dry", "natural", "moist")
PRESS = (0.98, 0.99, 0.996, 1.0)
"""Radii of the end of a press before a pull, over that of the pull."""

Pull = tuple[FtirRenderer, Contact, list[SkinSlip]]
"""Renderer, contact at its full radius, and the slips of a pull."""


def first_pull(seed: int) -> Pull:
    """A pull of random skin, size, direction, slip, shift of the stick zone, noise, vignetting and
    number of images; a fifth are twists."""
    rng = np.random.default_rng(seed)
    scene = Scene(noise=rng.uniform(1.0, 4.0), vignetting=rng.uniform(0.0, 0.4))
    twist = bool(rng.random() < 0.2)
    slip = SkinSlip(
        direction=rng.uniform(-math.pi, math.pi),
        reach=rng.uniform(40e-6, 160e-6),
        lag=0.0 if twist or rng.random() < 0.4 else rng.uniform(0.1, 0.6),
        twist=twist,
    )
    shape = {"aspect": rng.uniform(1.0, 1.5), "angle": rng.uniform(-1.5, 1.5)}
    contact = Contact(rng.uniform(3.0e-3, 4.5e-3), **shape)
    ratios = np.linspace(0.0, 0.96, int(rng.integers(6, 40)))
    renderer = FtirRenderer(SKINS[seed % 3], seed, scene, width=640, height=480)
    return renderer, contact, [replace(slip, ratio=float(ratio)) for ratio in ratios]


@dataclass(frozen=True)
class OtherSlip(SkinSlip):
    """Skin that slips by `amount` (m) times a power of the distance from a zone of scale `size`;
    straight: a front from one side, at `size` of the contact's half width."""

    power: float = 1.0
    straight: bool = False
    size: float = 1.0
    amount: float = 0.0

    @property
    def stick_ratio(self) -> float:
        if self.straight:
            return 1.0 - (math.acos(self.size) - self.size * math.sqrt(1 - self.size**2)) / math.pi
        return self.size**2

    def touched_at(self, x: np.ndarray, y: np.ndarray, rho: np.ndarray) -> tuple:
        along = rho[..., 0] - self.lag
        free, square = 1.0 - self.lag**2, along**2 + rho[..., 1] ** 2
        scale = (self.lag * along + np.sqrt((self.lag * along) ** 2 + free * square)) / free
        outside = np.maximum((rho[..., 0] if self.straight else scale) - self.size, 0.0)
        way = (self.amount * np.where(outside > 0.0, outside**self.power, 0.0)).astype(np.float32)
        return x - way * math.cos(self.direction), y - way * math.sin(self.direction)


KINDS = {
    "all alike outside the zone": {"power": 0.0},
    "power 1.5": {"power": 1.5},
    "power 2": {"power": 2.0},
    "a straight front": {"straight": True},
}


def other_pull(seed: int, kind: str) -> Pull:
    """A pull of 14 images of skin that slips in another way."""
    rng = np.random.default_rng(seed)
    renderer = FtirRenderer(
        SKINS[seed % 3], seed, Scene(noise=rng.uniform(1.0, 4.0)), width=640, height=480
    )
    shape = {"aspect": rng.uniform(1.0, 1.5), "angle": rng.uniform(-1.5, 1.5)}
    contact = Contact(rng.uniform(3.0e-3, 4.5e-3), **shape)
    slip = OtherSlip(direction=rng.uniform(-math.pi, math.pi), **KINDS[kind])
    slip = slip if slip.straight else replace(slip, lag=float(rng.choice([0.0, 0.3])))
    found = []
    for part in np.linspace(0.0, 1.0, 14):
        size = 1.0 - 1.9 * part if slip.straight else max(1.0 - part, 0.02)
        amount = 25e-6 * part if slip.power == 0.0 else 100e-6 * (part + 0.1)
        found.append(replace(slip, size=float(size), amount=float(amount)))
    return renderer, contact, found


Change = Callable[[Contact, float], Contact]
"""Contact from that of a pull and how much of the pull is over, 0 to 1."""

CHANGES: dict[str, Change] = {
    "its radius grows by a tenth": lambda c, part: replace(c, radius=(1.0 + 0.1 * part) * c.radius),
    "its radius shrinks by a tenth": lambda c, part: replace(
        c, radius=(1.0 - 0.1 * part) * c.radius
    ),
    "it rolls by 1 mm, and nothing slips": lambda c, part: replace(
        c, centre=(1e-3 * part, 0.0), slip=replace(c.slip, ratio=0.0)
    ),
}


def followed(pull: Pull, change: Change = lambda contact, _: contact) -> np.ndarray:
    """True stick ratio, the one that was seen, and its stated deviation, of each image (n, 3)."""
    renderer, contact, slips = pull
    calibration = renderer.calibration()
    segmenter, motion = FtirSegmenter(calibration=calibration), RidgeMotion(calibration=calibration)

    def see(contacts: list[Contact]) -> tuple[float, float]:
        image = renderer.render_frame(contacts).image
        seen = motion.track(image, segmenter.process(image))
        return seen.stick_ratio, seen.stick_ratio_sd

    for _ in range(3):
        see([])
    still = replace(slips[0], ratio=0.0)
    for part in PRESS:
        see([replace(contact, slip=still, radius=contact.radius * part)])
    rows = []
    for part, slip in zip(np.linspace(0.0, 1.0, len(slips)), slips):
        now = change(replace(contact, slip=slip), part)
        rows.append((now.slip.stick_ratio, *see([now])))
    return np.array(rows)


def rms(rows: Sequence[np.ndarray]) -> float:
    """RMS error over the images of pulls; those without a ratio do not count."""
    table = np.concatenate(rows)
    return math.sqrt(np.nanmean((table[:, 1] - table[:, 0]) ** 2))


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--pulls", type=int, default=60)
    parser.add_argument("--seed", type=int, default=5000, help="of the first pull")
    values = parser.parse_args()
    cv2.setNumThreads(1)
    seeds = range(values.seed, values.seed + values.pulls)
    found = [followed(first_pull(seed)) for seed in seeds]
    table = np.concatenate(found)
    unknown = np.isnan(table[:, 1])
    error = (table[:, 1] - table[:, 0])[~unknown]
    print(f"{values.pulls} pulls, {len(table)} images, {unknown.sum()} without a ratio")
    print(f"RMS error {rms(found):.3f}, median pull {np.median([rms([f]) for f in found]):.3f}")
    for k, skin in enumerate(SKINS):
        print(f"  {skin} {rms([f for f, seed in zip(found, seeds) if seed % 3 == k]):.3f}")
    print("within 0.05; 0.1: ", *(f"{np.mean(np.abs(error) < b):.0%}" for b in (0.05, 0.1)))
    stated = np.sqrt(np.mean((error / table[~unknown, 2]) ** 2))
    print(f"errors over stated deviations, RMS: {stated:.2f}")

    print("true ratio, mean error, its standard deviation, stated deviation, images:")
    edges = [0.0, *np.arange(0.05, 1.0, 0.1), 1.001]
    scores = np.full(len(table), np.nan)
    for low, high in pairwise(edges):
        which = (table[:, 0] >= low) & (table[:, 0] < high) & ~unknown
        if which.any():
            true, seen, sd = table[which].T
            scores[which] = (seen - true - np.mean(seen - true)) / np.std(seen - true)
            row = (true.mean(), np.mean(seen - true), np.std(seen - true), math.hypot(*sd))
            print(
                "  {:.2f} {:+.3f} {:.3f} {:.3f} {}".format(
                    *row[:3], row[3] / math.sqrt(which.sum()), which.sum()
                )
            )
    ends = np.cumsum([len(f) for f in found])[:-1]
    pairs = np.concatenate([np.column_stack([s[:-1], s[1:]]) for s in np.split(scores, ends)])
    print(f"correlation from image to image {np.nanmean(pairs[:, 0] * pairs[:, 1]):.2f}")

    print("contacts that change meanwhile, RMS error and that over the stated deviation:")
    for name, change in CHANGES.items():
        table = np.concatenate([followed(first_pull(seed), change) for seed in range(50, 59)])
        error = table[:, 1] - table[:, 0]
        score = math.sqrt(np.nanmean((error / table[:, 2]) ** 2))
        print(f"  {name} {rms([table]):.2f} {score:.1f}")
    print("other ways to slip, RMS error:")
    for kind in KINDS:
        print(f"  {kind} {rms([followed(other_pull(seed, kind)) for seed in range(50, 59)]):.2f}")


if __name__ == "__main__":
    main()
