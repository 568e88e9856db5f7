# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Which of several regions in a frame is the pressing finger's, from frame to frame.

Masks here are (rows, columns) bool on a grid four times coarser than the working image; the weight
of a region is its number of pixels of certain skin.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from .working_grid import Box

LIKE = 0.4
"""Share of a region's weight from which another is of like weight."""

SPECK = 0.05
"""Share of the heaviest region's weight up to which a region is no finger."""

GROWN, STOOD = 1.5, 15
"""A finger grows by this factor as it lands. A region that has not for so many frames may be a drop
or dirt: it gives way to one that is not of like weight, but much heavier."""


@dataclass(frozen=True)
class Followed:
    """The regions of the last frame with a contact.

    own: of the measured region; while two are joined, the part that was measured before. rivals: of
    others of like weight, None without any. least: smallest weight of the measured one since it
    came. grown: whether it has been larger than `GROWN` times that. stood: number of frames since
    it came, or was so last. open: whether nothing tells that a rival is not the pressing finger:
    the measured one had not grown before the rival came.
    """

    own: np.ndarray
    rivals: np.ndarray | None
    least: float
    grown: bool
    stood: int
    open: bool


def match_region(
    labels: np.ndarray, weight: np.ndarray, box: Box, shape: tuple[int, int], past: Followed | None
) -> tuple[int, Followed]:
    """Label of the pressing finger's region, and what the next frame needs to follow it.

    labels: of the regions in `box` of a grid of `shape`, 0 for none. weight: of each label, one
    above zero at least. past: from the last frame; None after one without contact.
    """
    best = int(np.argmax(weight))
    alone = np.count_nonzero(weight) == 1
    if past is not None and not (alone and past.rivals is None):
        shared = np.bincount(labels[past.own[box]], minlength=len(weight))
        shared[weight <= SPECK * weight[best]] = 0
        same = int(np.argmax(shared))
        gives_way = past.stood >= STOOD and weight[same] < LIKE * weight[best]
        if shared[same] == 0 or gives_way:
            past = None
        else:
            best = same
    own = np.zeros(shape, bool)
    rivals = None
    if not alone:
        cut = _cut(labels, len(weight), box, shape)
        if past is None:
            whole = np.where(cut | (weight < LIKE * weight[best]), 0, weight)
            best = int(np.argmax(whole if whole.any() else weight))
        like = (weight >= LIKE * weight[best]) & (cut[best] | ~cut)
        like[[0, best]] = False
        if like.any():
            rivals = np.zeros(shape, bool)
            rivals[box] = like[labels]
    own[box] = labels == best
    size = float(weight[best])
    if past is None:
        return best, Followed(own, rivals, size, False, 1, rivals is not None)
    least = min(size, past.least)
    large = size > GROWN * least
    is_open = rivals is not None and (past.open or not past.grown)
    if past.rivals is not None and (own & past.rivals).any():
        own, joined = _parted(own, past.own, past.rivals)
        if joined is not None:
            rivals = joined if rivals is None else rivals | joined
    stood = 0 if large else past.stood + 1
    return best, Followed(own, rivals, least, past.grown or large, stood, is_open)


def _cut(labels: np.ndarray, count: int, box: Box, shape: tuple[int, int]) -> np.ndarray:
    """Whether each label reaches the frame's border, (count,) bool."""
    (rows, columns), (height, width) = box, shape
    cut = np.zeros(count, bool)
    for at_border, side in (
        (rows.start == 0, labels[0]),
        (rows.stop == height, labels[-1]),
        (columns.start == 0, labels[:, 0]),
        (columns.stop == width, labels[:, -1]),
    ):
        cut[side] |= at_border
    return cut


def _parted(
    joined: np.ndarray, own: np.ndarray, rivals: np.ndarray
) -> tuple[np.ndarray, np.ndarray | None]:
    """The part of a region that is nearer to `own` than to `rivals`, and the rest; None where it is
    not of like size."""
    to_own, to_rivals = (
        cv2.distanceTransform(np.where(m, np.uint8(0), np.uint8(1)), cv2.DIST_L2, 3)
        for m in (own, rivals)
    )
    mine = joined & (to_own <= to_rivals)
    rest = joined & ~mine
    if np.count_nonzero(rest) < LIKE * np.count_nonzero(mine):
        return joined, None
    return mine, rest
