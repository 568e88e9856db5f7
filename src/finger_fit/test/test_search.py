# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Grid, PSO and cross-checks: inside the box, repeatable to the bit, resumable, stoppable."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from finger_common.errors import InputError
from finger_fit.search import Stopped, all_free, best_points, search, search_grid
from finger_fit.search.population import grid_points
from finger_model.laws import StandardLinearSolid

PARAMETERS = StandardLinearSolid.PARAMETERS

BOX = np.array([[50e3, 160e3], [15e3, 60e3], [0.01, 0.8], [700e3, 2200e3]])
FREE = all_free(SimpleNamespace(space=PARAMETERS, box=BOX))
GOAL = np.array([90e3, 30e3, 0.1, 1500e3])


def bowl(points: np.ndarray) -> np.ndarray:
    """A narrow curved valley in the logarithms; least at GOAL."""
    u = np.log(points / GOAL)
    return (
        (u[:, 0] + 2 * u[:, 1] - u[:, 2]) ** 2
        + 0.05 * (u**2).sum(axis=1)
        + (u[:, 1] - u[:, 3]) ** 2
    )


def start() -> np.ndarray:
    return best_points(search_grid(bowl, FREE, 3), 5)


def test_grid_holds_the_corners_and_even_ratios() -> None:
    points = grid_points(FREE, 4)
    assert points.shape == (256, 4)
    np.testing.assert_allclose(points.min(axis=0), BOX[:, 0])
    np.testing.assert_allclose(points.max(axis=0), BOX[:, 1])
    values = np.unique(points[:, 0])
    np.testing.assert_allclose(values[1:] / values[:-1], values[1] / values[0])


@pytest.mark.parametrize("name", ["pso", "de", "cmaes"])
def test_search_improves_on_the_grid_inside_the_box(name: str) -> None:
    first = start()
    found = search(name, bowl, FREE, first, 60, seed=1)
    assert found.candidates.shape == (60, 5, 4)
    assert (found.candidates >= BOX[:, 0]).all() and (found.candidates <= BOX[:, 1]).all()
    assert found.best[1] < 0.2 * bowl(first).min()
    assert (np.diff(found.convergence) <= 0).all()


def test_pso_starts_at_the_best_grid_points_and_evaluates_a_round_in_one_batch() -> None:
    first, batches = start(), []

    def cost(points: np.ndarray) -> np.ndarray:
        batches.append(len(points))
        return bowl(points)

    found = search("pso", cost, FREE, first, 60, seed=1)
    assert batches == [5] * 60
    np.testing.assert_allclose(found.candidates[0], first, rtol=1e-12)


@pytest.mark.parametrize("name", ["pso", "de", "cmaes"])
def test_same_seed_same_bits_other_seed_other_path(name: str) -> None:
    runs = [search(name, bowl, FREE, start(), 12, seed=s) for s in (4, 4, 5)]
    np.testing.assert_array_equal(runs[0].candidates, runs[1].candidates)
    assert not np.array_equal(runs[0].candidates, runs[2].candidates)


@pytest.mark.parametrize("name", ["pso", "de", "cmaes"])
def test_resumed_search_is_the_uninterrupted_one(tmp_path: Path, name: str) -> None:
    whole = search(name, bowl, FREE, start(), 20, seed=2)
    path = tmp_path / "checkpoint.json"

    def stop(number: int, *_: object) -> None:
        if number == 7:
            raise KeyboardInterrupt

    cut = search(name, bowl, FREE, start(), 20, seed=2, checkpoint=path, progress=stop)
    assert not cut.complete and len(cut.costs) == 7
    assert cut.best[1] == whole.costs[:7].min()
    calls = []

    def counted(points: np.ndarray) -> np.ndarray:
        calls.append(len(points))
        return bowl(points)

    rest = search(name, counted, FREE, start(), 20, seed=2, checkpoint=path, resume=True)
    assert len(calls) == 13, "recorded rounds are not evaluated again"
    np.testing.assert_array_equal(rest.candidates, whole.candidates)
    np.testing.assert_array_equal(rest.costs, whole.costs)


def test_checkpoint_is_written_after_every_round(tmp_path: Path) -> None:
    path = tmp_path / "c.json"
    seen = []

    def look(*_: object) -> None:
        seen.append(len(json.loads(path.read_text())["costs"]))

    search("pso", bowl, FREE, start(), 4, 0, path, progress=look)
    assert seen == [1, 2, 3, 4]


def test_a_disk_that_is_full_for_a_while_costs_checkpoints_alone(tmp_path: Path) -> None:
    path = tmp_path / "full" / "c.json"
    path.parent.write_text("no folder")

    def free(number: int, *_: object) -> None:
        if number == 2:
            path.parent.unlink()

    whole = search("pso", bowl, FREE, start(), 4, 0)
    full = search("pso", bowl, FREE, start(), 4, 0, path)
    found = search("pso", bowl, FREE, start(), 4, 0, path, progress=free)
    assert found.complete and full.complete
    assert "cannot be written" in full.unsaved and not found.unsaved
    for ended in (full, found):
        np.testing.assert_array_equal(ended.candidates, whole.candidates)
    assert len(json.loads(path.read_text())["costs"]) == 4


def test_checkpoint_of_another_search_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "c.json"
    search("pso", bowl, FREE, start(), 3, 0, path, key="data A")
    for options in ({"seed": 1, "key": "data A"}, {"seed": 0, "key": "data B"}):
        with pytest.raises(InputError, match="another search"):
            search("pso", bowl, FREE, start(), 3, checkpoint=path, resume=True, **options)
    path.write_text("{}")
    with pytest.raises(InputError, match="not a checkpoint"):
        search("pso", bowl, FREE, start(), 3, 0, path, resume=True)


def test_stopping_in_the_grid_keeps_what_was_evaluated() -> None:
    def stop(number: int, *_: object) -> None:
        if number == 2:
            raise Stopped

    found = search_grid(bowl, FREE, 5, stop)
    assert not found.complete
    assert np.isfinite(found.costs).sum() == 250
