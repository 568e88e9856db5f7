# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""The simulated study has the paper's moisture and composite moduli."""

import numpy as np
import pytest

from finger_common.errors import InputError
from finger_sim.conditions import STUDY, condition

PRINTED = {"dry": (30.23e3, 1652e3), "natural": (19.27e3, 1795e3), "moist": (13.71e3, 700e3)}


@pytest.mark.parametrize("name", PRINTED)
def test_truth_has_the_composite_modulus_and_e2_that_the_paper_prints(name: str) -> None:
    composite, epidermis = PRINTED[name]
    assert STUDY[name].material.composite_modulus == pytest.approx(composite, rel=1e-3)
    assert STUDY[name].material.E2 == epidermis


@pytest.mark.parametrize("name", PRINTED)
def test_trial_averages_scatter_as_in_the_paper(name: str) -> None:
    rng = np.random.default_rng(3)
    trials = np.array([STUDY[name].draw_moisture(rng) for _ in range(4000)])
    averages = trials.mean(axis=1)
    assert averages.mean() == pytest.approx(STUDY[name].moisture, abs=0.4)
    assert averages.std() == pytest.approx(STUDY[name].moisture_sd, rel=0.05)
    assert trials.std(axis=1, ddof=1).mean() == pytest.approx(2.0, rel=0.1)
    assert np.all((trials >= 0) & (trials <= 130))


def test_unknown_condition_is_refused_with_the_known_ones() -> None:
    with pytest.raises(InputError, match="dry, natural, moist"):
        condition("wet")
