# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Stick ratio from slips that are known but for noise, of zones of many kinds."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from finger_vision.stick_zone import ENOUGH, stick_ratio

RADIUS, NOISE = 4e-3, 1.2e-6
STICKING = (0.05, 0.2, 0.4, 0.6, 0.8)


def places_and_ridges(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Places (n, 2) over the unit disc, and gradients (n, 3) of ridges of all directions."""
    axis = np.arange(-0.95, 0.96, 0.09)
    grid = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    places = grid[np.hypot(*grid.T) < 0.96]
    angle = rng.uniform(0.0, math.pi, len(places))
    across, along = 100.0, 10.0
    c, s = np.cos(angle), np.sin(angle)
    xx, yy = across * c**2 + along * s**2, across * s**2 + along * c**2
    return places, np.column_stack([xx, (across - along) * c * s, yy])


def concentric(places: np.ndarray, ratio: float, power: float, shift: float = 0.0) -> np.ndarray:
    """Growth (n,) of the slip, in an arbitrary direction; the zone is a shrunk circle."""
    size = math.sqrt(ratio)
    # The scale of the circle through a place by bisection, not by a formula.
    low, high = np.zeros(len(places)), np.full(len(places), 3.0)
    for _ in range(60):
        middle = 0.5 * (low + high)
        outside = np.hypot(places[:, 0] - shift * (1.0 - middle), places[:, 1]) > middle
        low, high = np.where(outside, middle, low), np.where(outside, high, middle)
    return np.maximum(high - size, 0.0) ** power / max(1.0 - size, 1e-9) ** power


def straight(places: np.ndarray, ratio: float) -> np.ndarray:
    fronts = np.linspace(-1.0, 1.0, 4001)
    shares = np.array(1.0 - (np.arccos(fronts) - fronts * np.sqrt(1.0 - fronts**2)) / math.pi)
    return np.maximum(places[:, 0] - np.interp(ratio, shares, fronts), 0.0)


KINDS: dict[str, Callable[[np.ndarray, float], np.ndarray]] = {
    "even growth": lambda places, ratio: concentric(places, ratio, 1.0),
    "Mindlin's growth": lambda places, ratio: concentric(places, ratio, 1.5),
    "a jump": lambda places, ratio: (concentric(places, ratio, 1.0) > 0.0).astype(float),
    "shifted": lambda places, ratio: concentric(places, ratio, 0.7, 0.45),
    "shifted back": lambda places, ratio: concentric(places, ratio, 1.0, -0.45),
    "from one side": straight,
}


def of_patches(kind: Callable[[np.ndarray, float], np.ndarray], ratio: float) -> np.ndarray:
    """Mean growth (n,) over the patch about each place, half of which is 0.27 mm wide."""
    places, _ = places_and_ridges(np.random.default_rng(0))
    offsets = np.linspace(-0.27e-3, 0.27e-3, 5) / RADIUS
    moved = [places + np.array([x, y]) for x in offsets for y in offsets]
    return np.mean([kind(place, ratio) for place in moved], axis=0)


def seen(
    growth: np.ndarray, amount: float, turning: bool = False, way: float = 0.0, seed: int = 0
) -> tuple[float, float]:
    """Stick ratio of slips with noise, known better across ridges than along them."""
    rng = np.random.default_rng(seed)
    places, gradients = places_and_ridges(rng)
    c, s = math.cos(way), math.sin(way)
    turned = places @ np.array([[c, s], [-s, c]])
    unit = np.column_stack([-turned[:, 1], turned[:, 0]]) if turning else np.array([[c, s]])
    slips = amount * growth[:, None] * unit
    for k, (xx, xy, yy) in enumerate(gradients):
        tensor = np.array([[xx, xy], [xy, yy]]) / 55.0
        slips[k] += NOISE * np.linalg.cholesky(np.linalg.inv(tensor)) @ rng.normal(size=2)
    # Ridges lie in all directions anyway, so only places and slips are turned.
    noise = np.hypot(NOISE, 0.2 * np.hypot(*slips.T))
    return stick_ratio(turned, slips, noise, gradients, RADIUS)


@pytest.mark.parametrize("number", [1, 2, 4])
def test_hardly_any_places_are_no_error(number: int) -> None:
    rng = np.random.default_rng(6)
    places, gradients = places_and_ridges(rng)
    slips = rng.normal(size=(number, 2)) * 20e-6
    noise = np.full(number, NOISE)
    for texture in (gradients[:number], np.zeros((number, 3))):
        ratio, sd = stick_ratio(places[:number], slips, noise, texture, RADIUS)
        assert 0.0 <= ratio <= 1.0 and math.isfinite(sd)


@pytest.mark.parametrize("kind", KINDS)
def test_stick_ratio_of_many_kinds_of_zones(kind: str) -> None:
    scores, errors = [], []
    for k, true in enumerate(STICKING):
        ratio, sd = seen(of_patches(KINDS[kind], true), 60e-6, way=0.9 * k, seed=k)
        errors.append(ratio - true)
        scores.append(errors[-1] / sd)
    assert np.sqrt(np.mean(np.square(errors))) < 0.06, np.round(errors, 3)
    assert np.sqrt(np.mean(np.square(scores))) < 2.0


@pytest.mark.parametrize("true", STICKING)
def test_stick_ratio_of_a_twist(true: float) -> None:
    ratio, sd = seen(of_patches(KINDS["even growth"], true), 60e-6, turning=True)
    assert abs(ratio - true) < min(0.1, 3.0 * sd)


def test_noise_alone_is_no_slip_and_a_slide_leaves_nothing() -> None:
    places, _ = places_and_ridges(np.random.default_rng(0))
    assert len(places) > ENOUGH
    still = [seen(np.zeros(len(places)), 0.0, seed=k) for k in range(20)]
    assert min(ratio for ratio, _ in still) > 0.9
    for amount in (10e-6, 1e-3):
        ratio, sd = seen(np.ones(len(places)), amount, way=2.0)
        assert ratio < 0.02 and sd < 0.05


@pytest.mark.parametrize("shift", [0.6e-6, 1.0e-6, 2.0e-6])
def test_a_shift_of_the_whole_picture_is_no_slip(shift: float) -> None:
    """As camera and plate shake against each other."""
    places, _ = places_and_ridges(np.random.default_rng(0))
    for k in range(5):
        ratio, _ = seen(np.ones(len(places)), shift, way=1.3 * k, seed=k)
        assert ratio > 0.9


def test_places_that_were_followed_wrongly_count_little() -> None:
    rng = np.random.default_rng(4)
    places, gradients = places_and_ridges(rng)
    slips = 60e-6 * of_patches(KINDS["even growth"], 0.4)[:, None] * np.array([[0.0, 1.0]])
    slips += NOISE * rng.normal(size=slips.shape)
    wrong = rng.random(len(places)) < 0.1
    slips[wrong] = rng.normal(size=(wrong.sum(), 2)) * 100e-6
    ratio, _ = stick_ratio(places, slips, np.full(len(places), NOISE), gradients, RADIUS)
    assert ratio == pytest.approx(0.4, abs=0.08)


def test_a_few_places_give_a_wide_deviation() -> None:
    places, gradients = places_and_ridges(np.random.default_rng(5))
    few = np.arange(0, len(places), 60)
    slips = 8e-6 * of_patches(KINDS["even growth"], 0.5)[:, None] * np.array([[1.0, 0.0]])
    noise = np.full(len(places), NOISE)
    _, many_sd = stick_ratio(places, slips, noise, gradients, RADIUS)
    ratio, sd = stick_ratio(places[few], slips[few], noise[few], gradients[few], RADIUS)
    assert sd > 2.0 * many_sd and abs(ratio - 0.5) < 2.0 * sd
