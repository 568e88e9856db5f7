# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Are the errors of neighbouring frames alike? Then many frames tell less than as many independent
ones.

The errors of a press's frames are taken as a white part and one whose correlation falls as
exp(−Δt/τ). Both variances and τ follow from the products of residuals some frames apart, summed
over all presses. A fit takes a part of the errors into its parameters, and leaves residuals that
are less alike than the errors: with residuals (I − H) e, the expected products of errors of
covariance R are those of (I − H) R (I − H)ᵀ.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

LAGS = (0, 1, 2, 3, 5, 8, 13, 21)
"""Frames between two residuals whose products are summed."""

TIMES = 12
"""Correlation times that are tried, from one frame period to `LONGEST`."""

LONGEST = 2.0
"""s, longest correlation time that is tried; slower errors are those of a whole press."""

SIGNIFICANT = 9.0
"""Drop of χ² from which errors count as alike: three deviations."""


@dataclass(frozen=True)
class FrameErrors:
    """White and correlated variance (m⁴) of a frame's error, and the correlation time (s), 0 for
    independent frames."""

    white: float
    alike: float = 0.0
    time: float = 0.0

    @property
    def share(self) -> float:
        """Part of the variance that neighbouring frames share."""
        return self.alike / (self.white + self.alike)

    def information(self, rows: np.ndarray, frames: list[np.ndarray]) -> np.ndarray:
        """Covariance (M, M) of the sums Σ rows e, rows (M, n), n frames; frames: times (k,) in s of
        those of each press in turn."""
        found = self.white * rows @ rows.T
        if self.alike > 0.0:
            for part, time in zip(np.split(rows, _starts(frames), axis=1), frames):
                found += self.alike * part @ _correlated(time, self.time, part.T)
        return found


def frame_errors(
    residual: np.ndarray,
    used: np.ndarray,
    slope: np.ndarray,
    gain: np.ndarray,
    frames: list[np.ndarray],
    white: float,
) -> FrameErrors:
    """Find the errors of n frames from their residuals (n,) in m².

    used (n,): frames that count; slope (n, k), gain (k, n): H = slope @ gain; frames: times (k,) in
    s of those of each press in turn; white: m⁴, variance of independent frames, the result where
    nothing shows more.
    """
    trial = np.repeat(np.arange(len(frames)), [len(time) for time in frames])
    pairs = []
    for lag in LAGS:
        first = np.arange(max(len(residual) - lag, 0))
        kept = (trial[first] == trial[first + lag]) & used[first] & used[first + lag]
        if kept.any():
            pairs.append((first[kept], first[kept] + lag))
    steps = np.concatenate([np.diff(time) for time in frames])
    period = float(np.median(steps)) if len(steps) else LONGEST
    if len(pairs) < 3 or not 0.0 < period < LONGEST:
        return FrameErrors(white)
    count = np.array([len(i) for i, _ in pairs])
    products = np.array([residual[i] @ residual[j] for i, j in pairs])
    scale = np.sqrt(count) / max(products[0], 1e-300) * count[0] / count

    def expected(time: float) -> np.ndarray:
        answer = np.empty_like(slope)
        for place, own in zip(np.split(np.arange(len(residual)), _starts(frames)), frames):
            answer[place] = _correlated(own, time, gain[:, place].T)
        whole = gain @ answer
        clock = np.concatenate(frames)
        found = []
        for i, j in pairs:
            apart = np.abs(clock[j] - clock[i])
            direct = np.exp(-apart / time).sum() if time else float((i == j).sum())
            cross = (slope[i] * answer[j]).sum() + (answer[i] * slope[j]).sum()
            found.append(direct - cross + ((slope[i] @ whole) * slope[j]).sum())
        return np.array(found)

    from scipy.optimize import nnls  # half a second

    alone = expected(0.0)
    _, plain = nnls((alone * scale)[:, None], products * scale)
    best, found = plain**2 - SIGNIFICANT, FrameErrors(white)
    for time in np.geomspace(period, LONGEST, TIMES):
        parts, left = nnls(
            np.column_stack([alone, expected(time)]) * scale[:, None], products * scale
        )
        if left**2 < best:
            best, found = left**2, FrameErrors(float(parts[0]), float(parts[1]), float(time))
    return found


def _correlated(time: np.ndarray, decay: float, columns: np.ndarray) -> np.ndarray:
    """R x of columns x (k, m), R the correlation (k, k) of errors at times (k,) in s, which falls
    as exp(−Δt/decay); x itself without decay.

    The correlation over two steps is the product of theirs, so that sums over the frames before,
    and over those after, follow from frame to frame.
    """
    if not decay:
        return columns
    kept = np.exp(-np.diff(time) / decay)
    before, after = columns.copy(), columns.copy()
    for k in range(1, len(time)):
        before[k] += kept[k - 1] * before[k - 1]
    for k in range(len(time) - 2, -1, -1):
        after[k] += kept[k] * after[k + 1]
    return before + after - columns


def _starts(frames: list[np.ndarray]) -> np.ndarray:
    return np.cumsum([len(time) for time in frames])[:-1]
