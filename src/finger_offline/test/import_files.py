# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Files of a laboratory with two presses, and the check of the bags made of them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from finger_bag.reader import open_bag
from finger_bag.validate import validate
from finger_model.reduced import ReducedModel
from finger_offline.trial_records import TrialRecord
from finger_offline.trials import load_trials

TIME = np.arange(0.0, 9.0, 0.004)
FRAMES = np.arange(0.0, 9.0, 0.1)
FIFTEEN = np.arange(0.0, 20.0, 1 / 15)
ABOUT = {"subject": "S01", "condition": "dry"}


def force_at(time: np.ndarray) -> np.ndarray:
    """Two presses, to 1.5 and to 1.2 N, with a tremor that keeps samples apart."""
    first = 1.5 * np.clip(np.minimum(time - 0.5, 3.0 - time), 0.0, 1.0)
    both = first + 1.2 * np.clip(np.minimum(time - 5.0, 8.0 - time), 0.0, 1.0)
    return both * (1.0 + 0.002 * np.sin(50.0 * time))


def area_at(time: np.ndarray) -> np.ndarray:
    """mm²."""
    return 60.0 * force_at(time) ** 0.4


def csv(path: Path, heading: str, *columns: np.ndarray) -> str:
    np.savetxt(path, np.column_stack(columns), "%.6f", ",", header=heading, comments="")
    return str(path)


def check_trials(bag: Path, tolerance: float = 1e-5) -> list[TrialRecord]:
    """The bag is fit for use and gives both presses with their forces and areas."""
    result = validate(bag)
    assert result.fit, result.to_data()
    found = load_trials(bag)
    assert found.problems == [] and found.exclusions == []
    assert [(t.subject, t.condition) for t in found] == [("S01", "dry")] * 2
    for trial, peak in zip(found, (1.5, 1.2)):
        assert trial.peak_force == pytest.approx(peak, rel=0.01)
        assert trial.target_force == pytest.approx(0.95 * trial.peak_force, abs=0.011)
        start = load_start(bag)
        time = (trial.stamp_ns - start) * 1e-9
        assert np.allclose(trial.force, force_at(time), atol=max(tolerance, 1e-3))
        frames = (trial.area_stamp_ns - start) * 1e-9
        assert np.allclose(trial.area * 1e6, area_at(frames), atol=60 * tolerance)
    return list(found)


def load_start(bag: Path) -> int:
    with open_bag(bag) as reader:
        assert reader.info.start_ns is not None
        return reader.info.start_ns


def write_german(path: Path) -> None:
    lines = ["Messung 3;Kraft und Fläche", "", "Zeit;Kraft;Fläche", "ms;mN;cm²"]
    for number, (time, force) in enumerate(zip(TIME, force_at(TIME))):
        area = f"{area_at(np.array(time)) / 100:.5f}" if number % 25 == 0 else ""
        lines.append(f"{1e3 * time:.1f};{-1e3 * force:.2f};{area}".replace(".", ","))
    path.write_text("\n".join(lines), encoding="utf-8")


def write_excel(path: Path) -> None:
    openpyxl = pytest.importorskip("openpyxl", reason="XLSX needs openpyxl")
    book = openpyxl.Workbook()
    book.active.append(["not this sheet"])
    sheet = book.create_sheet("press")
    sheet.append(["Zeit [ms]", "Kraft (mN)", "Fläche/cm²"])
    for number, (time, force) in enumerate(zip(TIME, force_at(TIME))):
        area = float(area_at(np.array(time))) / 100 if number % 25 == 0 else None
        sheet.append([1e3 * time, -1e3 * force, area])
    book.save(path)


PIXEL = 2.5e-9


def picture(area: float, rng: np.random.Generator) -> np.ndarray:
    """FTIR-like frame (240, 320): ridges darken where the finger touches; area in mm²."""
    y, x = np.mgrid[:240, :320]
    radius = np.sqrt(area * 1e-6 / np.pi / PIXEL)
    touched = (np.hypot(x - 160, y - 120) < radius) & (np.sin(x / 2.0) > 0)
    image = np.where(touched, 60.0, 200.0) + rng.normal(0.0, 2.0, x.shape)
    return image.clip(0, 255).astype(np.uint8)


def long_files(tmp_path: Path, area_time: np.ndarray) -> dict[str, str]:
    """Five presses of the model's finger, with areas at 15 Hz."""
    time, frames = np.arange(0.0, 20.0, 0.004), np.arange(0.0, 20.0, 1 / 15)
    force = 1.4 * np.clip(np.minimum(time % 4.0 - 0.5, 2.5 - time % 4.0), 0.0, 1.0)
    model = ReducedModel.load()
    natural = model.space.default[None]
    ((areas, travels),) = model.contacts(natural, [(time, force, np.arange(len(time)))])
    seen = 1e6 * np.interp(area_time, time, areas[0])
    csv(tmp_path / "laser.csv", "time_s,indentation_mm", time, 1e3 * travels[0])
    return {
        "force": csv(tmp_path / "long_f.csv", "time_s,force_n", time, force),
        "area": csv(tmp_path / "long_a.csv", "time_s,area_mm2", frames, seen),
        **ABOUT,
    }


LASER = np.arange(-0.2, 9.4, 0.01)
"""s; a displacement sensor has its own rate, and begins earlier than the force."""


def indentation_at(time: np.ndarray) -> np.ndarray:
    """mm, from the first contact."""
    return 0.8 * force_at(time) ** 0.6
