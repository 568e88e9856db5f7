# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Errors that neighbouring frames share."""

from __future__ import annotations

import sys
import tracemalloc
from types import SimpleNamespace

import numpy as np
import pytest

from finger_fit.uncertainty import covariance
from finger_fit.uncertainty.frame_errors import FrameErrors, frame_errors


def correlation(time: np.ndarray, decay: float) -> np.ndarray:
    return np.exp(-np.abs(time[:, None] - time) / decay)


def test_sums_over_presses_have_the_variance_of_their_correlation() -> None:
    """Also for frames at uneven times."""
    rng = np.random.default_rng(0)
    frames = [np.cumsum(rng.uniform(0.01, 0.3, n)) for n in (40, 1, 25)]
    rows = rng.normal(size=(3, 66))
    found = FrameErrors(0.3, 0.7, 0.2).information(rows, frames)
    expected = 0.3 * rows @ rows.T
    for part, time in zip(np.split(rows, [40, 41], axis=1), frames):
        expected += 0.7 * part @ correlation(time, 0.2) @ part.T
    np.testing.assert_allclose(found, expected, rtol=1e-12)


def test_correlated_errors_of_one_long_press_are_found() -> None:
    """The memory grows with the frames, not with their square, of which 20,000 take 3 GB."""
    rng = np.random.default_rng(0)
    time = np.arange(20_000) * 0.02
    kept = np.exp(-0.02 / 0.2)
    error = np.empty(len(time))
    error[0] = rng.normal()
    for k, kick in enumerate(rng.normal(size=len(time) - 1)):
        error[k + 1] = kept * error[k] + np.sqrt(1.0 - kept**2) * kick
    slope = np.column_stack([np.ones_like(time), time])
    gain = np.linalg.pinv(slope)
    residual = error + 0.5 * rng.normal(size=len(time))
    residual -= slope @ (gain @ residual)
    tracemalloc.start()
    found = frame_errors(residual, np.ones(len(time), bool), slope, gain, [time], 1.25)
    spread = found.information(gain, [time])
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert 0.7 < found.share < 0.9 and 0.15 < found.time < 0.25
    assert spread[0, 0] > 5.0 * 1.25 * (gain @ gain.T)[0, 0]
    assert peak < 100e6


@pytest.mark.parametrize("white, alike", [(0.2, 0.1), (0.2, 0.8), (0.5, 2.0)])
def test_no_combination_of_parameters_errs_less_than_by_independent_frames(
    white: float, alike: float, double: SimpleNamespace, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where the frames share errors, what differs from frame to frame is known better; it is not
    counted on."""
    problem = double.make_problem(noise=0.3e-6, trials=4)

    def found(white: float, alike: float) -> np.ndarray:
        def shared(*known: object) -> FrameErrors:
            return FrameErrors(white * known[-1], alike * known[-1], 0.3)

        monkeypatch.setattr(sys.modules[covariance.__module__], "frame_errors", shared)
        return covariance(problem, double.TRUTH).frame_information

    alone = found(1.0, 0.0)
    scale = np.sqrt(np.diag(alone))
    more = (found(white, alike) - alone) / np.outer(scale, scale)
    assert np.linalg.eigvalsh(more).min() > -1e-9
    assert np.linalg.eigvalsh(more).max() > 0.1 or alike < 0.5


def test_rounding_errors_of_an_exact_fit_are_no_errors_of_frames(double: SimpleNamespace) -> None:
    problem = double.make_problem(trials=4, frame_period=1 / 30)
    time = np.concatenate([trial.frame_time for trial in problem.trials])
    exact, shares = problem.outputs(double.TRUTH)[0], []
    for size in (1e-3, 1e-11):
        problem.measured = exact * (1.0 + size * np.sin(20.0 * time))
        shares.append(covariance(problem, double.TRUTH).frames.share)
    assert shares[0] > 0.5 and shares[1] == 0.0
