# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Simulated pulls as bags: what `finger-bag process --slip` learns from them of the friction."""

import json
import math
from pathlib import Path

import numpy as np
import pytest

from finger_bag.cli import command
from finger_bag.reader import open_bag
from finger_common.cli import run
from finger_sim.pull import PAUSE
from finger_sim.study import simulate_study
from finger_sim.study_trial import plan_study_trial

SEED = 4


@pytest.mark.parametrize("images", [False, True])
def test_friction_is_learned_from_a_pull(tmp_path: Path, images: bool) -> None:
    study = tmp_path / "study"
    (bag,) = simulate_study(SEED, study, images, trials=1, conditions=("natural",), processes=1,
                            refinement=0.5, report=None, slip=True)  # fmt: skip
    out = tmp_path / "out"
    options = ["--slip", *(["--images", "yes"] if images else [])]
    assert run(command, ["process", str(bag), "-o", str(out), *options]) == 0
    with open_bag(out) as reader:
        slips = [m.message for m in reader.messages(["/finger/contact_slip"])]
        areas = [m.message for m in reader.messages(["/finger/contact_area"])]
    trial = plan_study_trial(SEED, "natural", 0, refinement=0.5, slip=True)
    truth = trial.pull
    assert truth is not None
    of_study = json.loads((study / "truth.json").read_text())["friction"]["natural"]
    assert truth.friction == pytest.approx(of_study, rel=0.1)
    last = slips[-1]
    assert last.friction == pytest.approx(truth.friction, rel=0.1) and last.slips == 1
    start = slips[0].header.stamp.sec + 1e-9 * slips[0].header.stamp.nanosec

    def at(message) -> float:
        return message.header.stamp.sec - start + 1e-9 * message.header.stamp.nanosec

    # Announced while it is pulled and before it slips.
    begin = trial.press.cue + PAUSE
    warned = [at(m) for m in slips if at(m) > begin and m.slip_probability >= 0.15]
    assert begin + 0.2 < min(warned) < truth.slip - 0.02
    seen = [m for m in areas if math.isfinite(m.stick_ratio) and begin < at(m) < truth.slip + 0.3]
    gaps = [m.stick_ratio - truth.skin(at(m), (0.0, 0.0)).stick_ratio for m in seen]
    assert len(seen) > 25 and np.sqrt(np.mean(np.square(gaps))) < 0.08
