"""Building a reduced model: coordinates, gradient of the training, a small build, resuming."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from finger_model.force_histories import FULL_RANGE, KINDS, PAPER_BOX, random_history
from finger_model.full_order import FullOrderModel
from finger_model.geometry import Geometry
from finger_model.reduced import ReducedModel
from finger_model.reduction import BuildSettings, build
from finger_model.reduction_rollout import Rollout, prepare
from finger_model.reduction_runs import (
    principal_modes,
    run_case,
    training_case,
    weight_of,
)
from finger_model.reduction_training import BETAS, Network, fit_samples, samples_of, stack

LENGTH = 8.5e-3
SMALL = BuildSettings(
    histories=12,
    held_out=6,
    pilots=3,
    latents=2,
    hidden=6,
    epochs=5,
    sample_iterations=5,
    history_iterations=3,
    refinement=0.5,
)


@pytest.fixture(scope="module")
def runs() -> list:
    full = FullOrderModel(refinement=0.5)
    fields = [run_case(full, training_case(1, i), None, 0.25)[1] for i in (1, 3)]
    modes = principal_modes(np.concatenate(fields), weight_of(full), 3)
    return [run_case(full, training_case(2, i), modes, 0.25)[0] for i in range(4)]


def test_histories_are_in_order_and_within_the_range() -> None:
    for i in range(60):
        case = training_case(0, i)
        limits = np.array(FULL_RANGE)
        assert np.all((case.parameters >= limits[:, 0]) & (case.parameters <= limits[:, 1]))
        assert np.all(np.diff(case.time) > 0)
        assert case.force.min() >= 0
        assert case.force.max() <= 3.4
    rng = np.random.default_rng(0)
    for kind in KINDS:
        time, force = random_history(rng, kind)
        assert np.all(np.diff(time) > 0)
        assert force.max() >= 0.6
    assert np.all(np.array(PAPER_BOX)[:, 0] >= limits[:, 0])


def test_the_internal_strain_follows_its_equation_in_the_coordinates(runs: list) -> None:
    """τ da/dt = (1 − r) b − a with τ = τ1 r, r = E1/(E0 + E1), exact for b linear within a row."""
    for run in runs:
        E0, E1, tau1, _ = run.parameters
        r = E1 / (E0 + E1)
        a, b = run.internal, (1 - r) * run.total
        h = (np.diff(run.time) / (tau1 * r))[:, None]
        mean = -np.expm1(-h) / h
        expected = np.exp(-h) * a[:-1] + (mean - np.exp(-h)) * b[:-1] + (1 - mean) * b[1:]
        error = np.abs(a[1:] - expected).max(axis=1) / np.abs(a).max()
        # A row that the full order had to cut has b in pieces.
        assert np.median(error) < 1e-9
        assert np.quantile(error, 0.9) < 1e-4


def test_the_gradient_along_histories_is_that_of_the_loss(runs: list) -> None:
    betas = np.array(BETAS)
    samples = stack([samples_of(r, LENGTH, 2, betas) for r in runs])
    network = Network(samples, 8)
    fit_samples(network, samples, 30, 30)
    rollout = Rollout(network, prepare(runs, LENGTH, 2, betas), robust=5.0)
    _, gradient = rollout(network.values)
    rng = np.random.default_rng(0)
    for _ in range(3):
        direction = rng.normal(size=len(gradient))
        step = 1e-5
        ahead = rollout(network.values + step * direction)[0]
        behind = rollout(network.values - step * direction)[0]
        assert (ahead - behind) / (2 * step) == pytest.approx(gradient @ direction, rel=1e-3)


@pytest.mark.slow
def test_an_interrupted_build_goes_on_where_it_stopped(tmp_path: Path) -> None:
    class Enough(Exception):
        pass

    def stop(stage: str, share: float) -> None:
        if stage == "held-out runs" and share == 1.0:
            raise Enough

    output = tmp_path / "model.npz"
    with pytest.raises(Enough):
        build(Geometry(), output, SMALL, 2, stop)
    done = {f: f.stat().st_mtime_ns for f in (tmp_path / "model.npz.parts").glob("training*")}
    assert done
    seen: list[tuple[str, float]] = []
    model, table = build(Geometry(), output, SMALL, 2, lambda *s: seen.append(s))
    assert not [s for s in seen if s[0] in ("full-order runs", "choosing coordinates")]
    assert not (tmp_path / "model.npz.parts").exists()
    again = ReducedModel.load(output, Geometry())
    assert again.hash == model.hash
    assert again.measured_error["pairs"] == len(table.pairs) == 6
