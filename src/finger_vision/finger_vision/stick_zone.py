# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Share of a contact that sticks, from how far places in it have slipped.

A partial slip front runs inwards from the rim (C. Cattaneo 1938; R. D. Mindlin 1949): the stick
zone is the outline shrunk about a point, and slip grows outwards from the zone's edge, in one
direction or about the centre. Zones and growths of many kinds are compared with all places at once,
each together with a small shift of the whole picture: camera and plate vibrate against each other.
A place weighs as much as its slip is known. So the edge is found better than at any single place,
also where the slip beside it is still less than the noise.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

SCALES = np.concatenate([[-1.0, -0.3, -0.1], np.arange(24) / 24])
"""Sizes of the stick zone that are compared, over that of the contact. In a negative one nothing
sticks, and the centre of the contact has slipped by so much more."""

SHIFTS = np.array([-0.6, -0.3, 0.0, 0.3, 0.6])
"""Shifts of the zone's centre along the slip, over its distance from the rim."""

STRAIGHT = 0.05
"""Probability of a straight front that comes from one side, over that of a zone of one shift."""

POWERS = (0.35, 0.7, 1.0, 1.5)
"""Powers with which slip grows outwards."""

ALL_SLIPS = 0.1
"""Probability, before anything is seen, that a contact that slips somewhere slips everywhere."""

LIKENESS = 5.0
"""Neighbouring places that say one thing, as their patches share pixels."""

ENOUGH = 300
"""Places that are compared at most; of more, these many stand for all."""

LEAST_SLIP = 40e-6
"""m; a zone that leaves the share 1 − m of the radius to slip is less probable where the rim has
slipped by less than (1 − m)² of this."""

TAIL = 4.0
"""Degrees of freedom of the errors (Student): places that were followed wrongly count little."""

LARGEST_SLIP = 10e-3
"""m; keeps amplitudes finite that no place tells."""

MOST = 8.0
"""Most that one place tells against a zone: outlines, for one, stand still within a contact."""

BLUR = 0.2e-3
"""m; the travel of a place is the mean over 1.2 times this to either side."""

SHAKEN = 1e-6
"""m, standard deviation of a shift of the whole picture."""

EVIDENCE, DOUBT = 7.0, 2.0
"""Twice the logarithm of the likelihoods' ratio at which slip is as probable as none, and the
change of it that makes slip e times as probable."""

UNSEEN, UNSEEN_SD = 0.98, 0.06
"""Stick ratio where no slip is seen: slip at the rim is seen late."""

LEAST_SD = 0.03
"""Deviation of the stick ratio where the zone's edge is known exactly: it is no shrunk outline."""


def stick_ratio(
    places: np.ndarray,
    slips: np.ndarray,
    noise: np.ndarray,
    gradients: np.ndarray,
    radius: float,
) -> tuple[float, float]:
    """Stick ratio and its standard deviation.

    places (n, 2): in the contact, in a frame in which its outline is about the unit circle. slips
    (n, 2): since each place last stuck, along the axes of that frame, m. noise (n,): standard
    deviation of the slips, m, at the median texture. gradients (n, 3): mean products xx, xy, yy of
    the texture's gradients there along these axes; slip is known across ridges, not along them.
    radius: m, of a disc as large as the contact.
    """
    some = slice(None, None, -(-len(places) // ENOUGH))
    likeness = LIKENESS * len(places[some]) / len(places)
    places, slips, noise, gradients = (a[some] for a in (places, slips, noise, gradients))
    far = np.hypot(*slips.T)
    slip, basis = _whitened(places, slips, likeness * noise**2, gradients)
    mean = slips[far >= np.quantile(far, 0.7)].mean(axis=0)
    way = mean / max(float(np.hypot(*mean)), 1e-12)
    along = np.column_stack([places @ way, places @ np.array([-way[1], way[0]])])
    trust = np.ones(len(slips))
    # Once roughly, to find the places that were followed wrongly, and once without them.
    for powers in (POWERS[1:2], POWERS):
        costs, areas, priors, errors = [], [], [], []
        for reached, area, prior in _zones(along):
            outside = reached[:, None] - SCALES
            blurred = sum(np.maximum(outside + k * BLUR / radius, 0.0) for k in (-1.2, 0.0, 1.2))
            for power in powers:
                amplitude, cost, error = _fitted(slip, basis, trust, (blurred / 3.0) ** power)
                rim = np.hypot(*amplitude[:, :2].T) + np.abs(amplitude[:, 2])
                rim *= np.maximum(1.0 - SCALES, 0.0) ** power
                little = np.log(LEAST_SLIP * (1.0 - SCALES) ** 2 / np.maximum(rim, 1e-9))
                costs.append(cost + (2.0 * np.maximum(little, 0.0)) ** 2)
                areas.append(area)
                priors.append(prior)
                errors.append(error[:, :, np.argmin(cost)].copy())
        cost, area = np.array(costs), np.array(areas)
        least = float(cost.min())
        best = errors[np.argmin(cost.min(axis=1))]
        trust = 1.0 / (1.0 + (best**2).sum(axis=0) / TAIL)
    weight = np.exp(-0.5 * (cost - least)) * np.array(priors)
    weight /= weight.sum()
    _, nothing, _ = _fitted(slip, basis, trust, np.zeros((len(slips), 1)))
    gain = float(nothing[0]) - least
    slips_somewhere = 1.0 / (1.0 + math.exp(min((EVIDENCE - gain) / DOUBT, 50.0)))
    ratio, square = (
        slips_somewhere * float((weight * area**k).sum()) + (1.0 - slips_somewhere) * unseen
        for k, unseen in ((1, UNSEEN), (2, UNSEEN**2 + UNSEEN_SD**2))
    )
    return ratio, math.hypot(math.sqrt(max(square - ratio**2, 0.0)), LEAST_SD)


def _fitted(
    slip: np.ndarray, basis: np.ndarray, trust: np.ndarray, growth: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Amplitudes (k, 3) of slips that grow by `growth` (n, k), the cost (k,) and the errors
    (2, n, k), with the most probable shift of the whole picture.

    slip (2, n), basis (2, n, 3): from `_whitened`. trust (n,): weight of each place.
    """
    heavy = basis * trust[:, None]
    products = (heavy[..., None] * basis[:, :, None]).sum(axis=0)
    wanted = (heavy * slip[:, :, None]).sum(axis=0)
    normal = np.empty((growth.shape[1], 5, 5))
    normal[:, :3, :3] = ((growth**2).T @ products.reshape(-1, 9)).reshape(-1, 3, 3)
    normal[:, :3, 3:] = (growth.T @ products[:, :, :2].reshape(-1, 6)).reshape(-1, 3, 2)
    normal[:, 3:, :3] = normal[:, :3, 3:].transpose(0, 2, 1)
    normal[:, 3:, 3:] = products[:, :2, :2].sum(axis=0)
    normal += np.diag(np.array([LARGEST_SLIP] * 3 + [SHAKEN] * 2) ** -2.0)
    right = np.empty((growth.shape[1], 5))
    right[:, :3], right[:, 3:] = growth.T @ wanted, wanted[:, :2].sum(axis=0)
    found = np.linalg.solve(normal, right[..., None])[..., 0]
    amplitude, shift = found[:, :3], found[:, 3:]
    error = slip[:, :, None] - basis @ amplitude.T * growth - basis[:, :, :2] @ shift.T
    return amplitude, _cost(error) + (shift**2).sum(axis=1) / SHAKEN**2, error


def _zones(along: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Of each kind of stick zone the scale (n,) whose rim goes through each place (n, 2), of which
    the first axis is along the slip; the share of the contact's area and the probability before
    anything is seen (k,) at SCALES.

    A circle of scale m has its centre at shift (1 − m). A straight front comes from one side.
    """
    for shift in SHIFTS:
        x, y = along[:, 0] - shift, along[:, 1]
        free = 1.0 - shift**2
        yield (
            (shift * x + np.sqrt((shift * x) ** 2 + free * (x**2 + y**2))) / free,
            _DISC,
            _prior(_DISC),
        )
    for side in (1.0, -1.0):
        yield 0.5 * (1.0 + side * along[:, 0]), _SEGMENT, STRAIGHT * _prior(_SEGMENT)


def _prior(area: np.ndarray) -> np.ndarray:
    """Probability of zones (k,) at SCALES before anything is seen: every share is as probable."""
    some = SCALES >= 0.0
    prior = np.full(area.shape, ALL_SLIPS / (~some).sum())
    prior[some] = np.gradient(area[some])
    return prior


_DISC = np.maximum(SCALES, 0.0) ** 2
_FRONT = np.clip(2.0 * SCALES - 1.0, -1.0, 1.0)
_SEGMENT = 1.0 - (np.arccos(_FRONT) - _FRONT * np.sqrt(1.0 - _FRONT**2)) / np.pi


def _whitened(
    places: np.ndarray,
    slips: np.ndarray,
    variance: np.ndarray,
    gradients: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Slips (2, n) and unit slips along both axes and around the centre (2, n, 3), in units of what
    is known of each."""
    strength = np.median(gradients[:, 0] + gradients[:, 2]) / 2.0
    xx, xy, yy = (gradients / max(float(strength), 1e-9) / variance[:, None]).T
    xx = np.maximum(xx, 1e-3 * (xx + yy) + 1e-9)
    first = np.sqrt(xx)
    mixed = xy / first
    second = np.sqrt(np.maximum(yy - mixed**2, 1e-9 * xx))

    def weighed(x: np.ndarray | float, y: np.ndarray | float) -> np.ndarray:
        return np.stack([first * x + mixed * y, second * y])

    units = [weighed(1.0, 0.0), weighed(0.0, 1.0), weighed(-places[:, 1], places[:, 0])]
    return weighed(*slips.T), np.stack(units, axis=-1)


def _cost(error: np.ndarray) -> np.ndarray:
    """Minus twice the logarithm of the likelihood (k,) of whitened errors (2, n, k)."""
    return np.minimum(TAIL * np.log1p((error**2).sum(axis=0) / TAIL), MOST).sum(axis=0)
