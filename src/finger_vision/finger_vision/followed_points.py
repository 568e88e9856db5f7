# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Points of the skin that are followed from image to image, in an array of POINT."""

from __future__ import annotations

import numpy as np

SMOOTH = 0.3e-3
"""m, standard deviation of the distance over which neighbouring points are taken together."""

USUAL_ERROR = 4.0
"""Mean difference of a patch from itself in another image, before it was measured."""

NOISIER = 0.5, 10.0
"""Least and greatest `noise` of a point; beyond them it is not believed."""

POINT = np.dtype(
    [
        ("key", "i8"),
        ("begin", "f4", 2),
        ("gradient", "f8", 3),
        ("place", "f4", 2),
        ("missed", "i8"),
        ("own", "f8", 2),
        ("travel", "f8", 2),
        ("stuck", "f8", 2),
        ("held", "f8", 2),
        ("rest", "f8", 2),
        ("area", "f8"),
        ("mark", "f8", 2),
        ("slipped", "?"),
        ("far", "f8"),
        ("error", "f8"),
        ("noise", "f8"),
    ],
    align=True,
)
"""A followed point. Lengths are in pixels of the flow.

key: number of the image that the point is compared with.
begin: its place in that image.
gradient: mean products gxx, gxy, gyy of the gradient of its patch there.
place: its place in the newest image.
missed: images in which it was not found since it was found last; 0 where it is in the newest.
own: its own travel. It begins with the smoothed travel of the nearest point.
travel: its own travel, smoothed over its neighbours.
stuck: `travel` when it last stuck.
held: `own` when it last stuck.
rest: `travel` when it last stuck, or was last seen to go on slipping.
area: logarithm of the contact's area at that time.
mark: `travel` at the last stroke.
slipped: whether it has left `stuck`.
far: how far it has been from `stuck` since.
error: mean difference of its patch from that in its key.
noise: noise of its travel, over that of the usual point.
"""


def in_newest(points: np.ndarray) -> np.ndarray:
    """Which points (n,) were found in the newest image."""
    return points["missed"] == 0


def taken_up(
    places: np.ndarray, gradients: np.ndarray, key: int, area: float, points: np.ndarray
) -> np.ndarray:
    """Begin with points (m,) of POINT at places (m, 2) of an image.

    gradients: (m, 3). key: number of the image. area: logarithm of the contact's area. points: are
    followed already; where some of them were found, a new one goes on from the nearest of these.
    """
    new = np.zeros(len(places), POINT)
    new["begin"] = new["place"] = places
    new["gradient"], new["key"], new["area"] = gradients, key, area
    new["error"], new["noise"] = USUAL_ERROR, 1.0
    found = points[in_newest(points)]
    if len(found):
        beside = found[nearest(places, found["place"])[1]]
        new["own"] = new["travel"] = new["rest"] = beside["travel"]
        new["stuck"] = new["held"] = beside["stuck"]
        new["mark"], new["slipped"] = beside["mark"], beside["slipped"]
    return new


def smoothed(points: np.ndarray, reach: float) -> tuple[np.ndarray, np.ndarray]:
    """Own travel (n, 2) of points and their neighbours together, and its noise (n,).

    Each point counts across its ridges, where its travel is known, not along them. The noise is
    that in the direction in which the travel is known worst, over that of the usual point. reach:
    SMOOTH in pixels of the flow.
    """
    square = squares(points["place"], points["place"])
    good = in_newest(points)
    weight = np.exp(square * (-0.5 / reach**2)) * good
    xx, xy, yy = points["gradient"].T
    x, y = points["own"].T
    rows = np.column_stack([xx, xy, yy, xx * x + xy * y, xy * x + yy * y])
    xx, xy, yy, bx, by = (weight @ rows).T
    root = np.maximum(xx * yy - xy * xy, 1e-3 * (xx + yy) ** 2) + 1e-9
    travel = np.column_stack([yy * bx - xy * by, xx * by - xy * bx]) / root[:, None]
    error = (weight @ points["error"].copy()) / np.maximum(weight.sum(axis=1), 1e-9)
    noise = error * np.sqrt((xx + yy) / root)
    usual = float(np.median(noise[good])) if good.any() else 0.0
    return travel, np.clip(noise / max(usual, 1e-9), *NOISIER)


def nearest(places: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distance (n,) of places (n, 2) from the nearest of points (m, 2), and which one it is."""
    square = squares(places, points)
    index = np.argmin(square, axis=1)
    return np.sqrt(square[np.arange(len(places)), index]), index


def squares(places: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Squared distances (n, m) of places (n, 2) from points (m, 2)."""
    (x, y), (u, v) = (np.ascontiguousarray(a.T) for a in (places, points))
    square = (x[:, None] - u) ** 2
    square += (y[:, None] - v) ** 2
    return square
