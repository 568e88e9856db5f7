# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""A run says how far its estimates can be trusted."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from session_bags import START, press_force, wrench

from finger_bag.cli import command
from finger_bag.writer import BagWriter
from finger_model.estimator import EstimateBlock
from finger_model.reduced import ReducedModel
from finger_offline.process import process


def recorded(path: Path, lag: float = 0.0, tare: float = 0.0, sd: float = 1.5e-6) -> Path:
    """Four presses of the model's finger, with areas at 15 Hz that come late."""
    time, frames = np.arange(0.0, 14.0, 0.002), np.arange(0.0, 14.0, 1 / 15)
    force = press_force(time % 3.5)
    model = ReducedModel.load()
    (areas,) = model.batch(model.space.default[None], [(time, force, np.arange(len(time)))])
    seen = np.interp(frames - lag, time, areas[0])
    rows = [(t, "wrench", f) for t, f in zip(time, force)]
    rows += [(t, "contact_area", a) for t, a in zip(frames, seen)]
    with BagWriter(path, {"subject": "S01", "condition": "natural"}) as bag:
        for t, topic, value in sorted(rows):
            stamp = START + round(t * 1e9)
            area = {"header": {"stamp": stamp}, "gross_area": value, "area_stddev": sd}
            bag.write(topic, wrench(stamp, value + tare) if topic == "wrench" else area)
    return path


def notes(path: Path) -> str:
    return "; ".join(process(path, None).notes)


def test_a_good_recording_has_no_notes(tmp_path: Path) -> None:
    assert process(recorded(tmp_path / "bag"), None).notes == []


def test_areas_of_another_time_are_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = recorded(tmp_path / "bag", lag=0.3)
    assert command(["process", str(path), "-o", str(tmp_path / "out")]) == 0
    assert "MODEL_MISMATCH); check the clocks" in capsys.readouterr().out


def test_areas_without_a_deviation_are_told_with_the_remedy(tmp_path: Path) -> None:
    found = notes(recorded(tmp_path / "bag", sd=float("nan")))
    assert "areas have no standard deviation and were not used; import them again" in found
    mapping = "topics: {contact_area: {field: gross_area}}"
    (tmp_path / "map.yaml").write_text(mapping)
    output = ["-o", str(tmp_path / "out"), "--mapping", str(tmp_path / "map.yaml")]
    assert command(["process", str(tmp_path / "bag"), *output]) == 0


def test_the_default_finger_is_estimated_far_beyond_three_newtons(
    session: Callable[..., Path], tmp_path: Path
) -> None:
    strong = session("strong", trials=1, peak=8.0)
    assert not any("FORCE_OUT_OF_RANGE" in n for n in process(strong, tmp_path / "out").notes)
    # A second run follows the events of the first, with its model.
    first: list[EstimateBlock] = []
    second: list[EstimateBlock] = []
    process(strong, None, on_block=first.append)
    assert process(tmp_path / "out", None, on_block=second.append).replayed
    again = np.concatenate([block.column("area") for block in second])
    assert np.array_equal(again, np.concatenate([b.column("area") for b in first])[-len(again) :])
