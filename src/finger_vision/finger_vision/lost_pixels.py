# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Frames of which a part never came: its pixels are exactly zero, one after the other."""

from __future__ import annotations

import numpy as np

from .working_grid import WorkingGrid

WIDEST_BLACK = 20e-3
"""Length (m) of a run of black pixels that no contact has, however black its ridges are."""

LIT = 20
"""Greys of a plate from which a pixel of exactly zero is none of its own."""

EVERY = 16
"""Every so many pixels one is looked at first."""


def has_lost_pixels(image: np.ndarray, plate: np.ndarray | None, grid: WorkingGrid) -> bool:
    """Whether a part of a frame (H, W) uint8 was lost: a run of zeros along its rows, longer than a
    contact, where the plate is lit.

    plate: learned one (h, w) uint8 at working resolution. None before one was learned: then the
    run is a whole row or more, with lit pixels before and behind, as a dark border has not.
    """
    width = image.shape[1]
    shortest = width
    if plate is not None:
        shortest = min(width, round(WIDEST_BLACK * grid.step / grid.pitch))
    pixels = image.reshape(-1)
    looked_at = pixels[::EVERY]
    black = np.concatenate(([False], looked_at == 0, [False]))
    steps = np.flatnonzero(black[1:] != black[:-1])
    others = np.ones(len(looked_at), bool)
    for begin, end in zip(steps[::2], steps[1::2]):
        first, last = begin * EVERY, (end - 1) * EVERY
        if (end - begin + 1) * EVERY <= shortest or pixels[first:last].any():
            continue
        if plate is None:
            before, behind = pixels[max(first - width, 0) : first], pixels[last + 1 :][:width]
            lit = _is_lit(before) and _is_lit(behind)
        else:
            row, column = np.array(np.divmod(np.arange(first, last + 1, EVERY), width)) // grid.step
            shown = (row < plate.shape[0]) & (column < plate.shape[1])
            lit = _is_lit(plate[row[shown], column[shown]])
        others[begin:end] &= not lit
    # Where all else is dark, too, the light is off.
    return not others.all() and _is_lit(looked_at[others])


def _is_lit(pixels: np.ndarray) -> bool:
    return len(pixels) > 0 and float(np.median(pixels)) >= LIT
