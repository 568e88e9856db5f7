# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""A finger that the reduced model cannot follow to its force limit, in commands and in fits."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest
from yielding_finger import THIN, YIELDING

from finger_bag.cli import command as bag_command
from finger_bag.writer import BagWriter
from finger_common.errors import InputError
from finger_fit import Fit, Trial, fit
from finger_fit.design.plan import Plan
from finger_fit.options import FitOptions
from finger_model.laws import StandardLinearSolid
from finger_model.parameter_sets import ParameterSet, ParameterSets
from finger_model.reduced import ReducedModel

START = 1_700_000_000_000_000_000
CARRIED = StandardLinearSolid(E0=273e3, E1=100e3, tau1=0.02, E2=350e3, friction=0.05)
"""Tissue of the same finger that carries 8 N."""

QUICK = {
    "nuisances": False,
    "full_order": False,
    "profiles": False,
    "bootstrap": 0,
    "bias_pairs": 0,
    "rounds": 4,
    "particles": 8,
    "target_force": 6.0,
}


@pytest.fixture(scope="module")
def model() -> ReducedModel:
    return ReducedModel.load(geometry=THIN).for_material(YIELDING)


def press(rise: float, peak: float = 6.3) -> tuple[np.ndarray, np.ndarray]:
    """Time (s) and force (N) at 100 Hz."""
    time = np.arange(0.0, rise + 1.0, 0.01)
    return time, peak * np.interp(time, [0.3, 0.3 + rise, 0.6 + rise], [0.0, 1.0, 0.0])


def trials_of(model: ReducedModel) -> list[Trial]:
    """Presses by the tissue that carries them."""
    found = []
    for rise in (0.5, 1.0, 2.0):
        time, force = press(rise)
        area = model.simulate(CARRIED, time, force).area
        found.append(Trial(time, force, area[::5], time[::5], "dry"))
    return found


def fitted(model: ReducedModel, *bounds: str) -> Fit:
    return fit(trials_of(model), model=model, grid=2, bounds=list(bounds), **QUICK)


def test_particles_that_the_model_refuses_do_not_win_the_search(model: ReducedModel) -> None:
    found = fitted(model, "E0=50e3:300e3", "E1=8e3:120e3", "E2=300e3:2200e3")
    (condition,) = found.result.fits.values()
    refused = ~np.isfinite(condition.grid.costs)
    assert 0 < refused.sum() < refused.size
    assert np.isfinite(condition.cost) and np.isfinite(condition.areas).all()
    assert condition.covariance is not None and np.isfinite(condition.covariance.covariance).all()
    assert condition.quantity("composite_E") == pytest.approx(100e3 * 273e3 / 373e3, rel=0.1)

    time, force = press(20.0, peak=8.0)
    condition.parameters = YIELDING.vector()
    with pytest.raises(InputError, match=r"cannot follow the force of .* lower the force"):
        found.predict(time, force)


def test_a_box_of_fingers_that_are_all_refused_is_told_the_remedy(model: ReducedModel) -> None:
    with pytest.raises(InputError, match=r"cannot follow them; check the units .* --bounds") as e:
        fitted(model, "E0=270e3:280e3", "E1=8e3:12e3", "tau1=0.01:0.011", "E2=300e3:310e3")
    assert "\n" not in str(e.value)


def test_a_plan_for_a_finger_that_is_refused_is_told_what_to_change(model: ReducedModel) -> None:
    plan = Plan(presses=4, peak=8.0, shortest=2.0, longest=8.0)
    with pytest.raises(InputError, match=r"cannot follow a press of .* s to 8 N .* lower peak"):
        plan.problem(model, YIELDING.vector(), FitOptions())


def test_a_recording_is_processed_beyond_what_the_model_follows(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Areas stay finite, and the run says which part is not to be believed."""
    soft = ParameterSet("dry", 60.0, 1.0, tuple(YIELDING.vector()))
    (tmp_path / "parameters.yaml").write_text(ParameterSets([soft], geometry=THIN).to_yaml())
    time, force = press(4.0, peak=8.0)
    with BagWriter(tmp_path / "bag", {"condition": "dry", "subject": "S01"}) as bag:
        for t, f in zip(time, force):
            stamp = START + round(t * 1e9)
            header = {"stamp": stamp, "frame_id": "force_sensor"}
            bag.write("wrench", {"header": header, "wrench": {"force": {"z": -f}}})
            if round(t * 100) % 10 == 0:
                fields = {"header": {"stamp": stamp}, "gross_area": 60e-6 * f**0.4}
                bag.write("contact_area", {**fields, "area_stddev": 2e-6})
    files = {n: str(tmp_path / n) for n in ("bag", "out", "parameters.yaml", "out.csv")}
    options = ["-o", files["out"], "--parameters", files["parameters.yaml"]]
    assert bag_command(["process", files["bag"], *options, "--csv", files["out.csv"]]) == 0
    said = capsys.readouterr().out
    assert "FORCE_OUT_OF_RANGE" in said and "beyond the model" in said
    with (tmp_path / "out.csv").open() as table:
        rows = list(csv.DictReader(table))
    assert all(np.isfinite(float(row["area_mm2"])) for row in rows)
