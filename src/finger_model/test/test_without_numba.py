# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""What the estimator needs: numba for speed only; what it and the command import: little."""

from __future__ import annotations

import subprocess
import sys

import pytest

WAY = """
import sys
if sys.argv[1] == "plain":
    sys.modules["numba"] = None
"""
SCRIPT = f"""{WAY}
from finger_model.estimator import ContactEstimator
from finger_model.reduced import ReducedModel

estimator = ContactEstimator(ReducedModel.load())
start = 1_700_000_000_000_000_000
for i, force in enumerate((0.0, 0.2, 0.6)):
    (estimate,) = estimator.add_wrench(start + 2_000_000 * i, (0.0, 0.0, force))
    print(estimate.in_contact, estimate.area, estimate.indentation, estimate.peak_pressure)
"""
SLIP = f"""{WAY}
import numpy as np
from finger_model.slip import SlipEstimator

n, slip = 5, SlipEstimator()
samples = np.arange(n) * 2_000_000, np.ones(n), np.full((n, 2), 0.1), np.ones(n), np.full(n, 1e-3)
for row in slip.add_many(*samples):
    print(row["flags"], row["friction"], row["slip_probability"], row["tangential_stiffness"])
"""


def estimates(way: str, script: str) -> tuple[list[list[str]], str]:
    done = subprocess.run(
        [sys.executable, "-c", script, way], capture_output=True, text=True, check=True
    )
    return [line.split() for line in done.stdout.splitlines()], done.stderr


@pytest.mark.parametrize(("script", "count"), [(SCRIPT, 3), (SLIP, 5)])
def test_the_estimators_run_without_numba_and_say_once_that_it_is_slow(
    script: str, count: int
) -> None:
    plain, said = estimates("plain", script)
    compiled, silent = estimates("compiled", script)
    assert len(plain) == count and said.count("numba is not installed") == 1 and not silent
    assert [row[0] for row in plain] == [row[0] for row in compiled]
    for slow, fast in zip(plain, compiled, strict=True):
        for a, b in zip(map(float, slow[1:]), map(float, fast[1:]), strict=True):
            assert abs(a - b) <= 1e-9 * abs(b)


def test_a_first_estimate_does_not_wait_for_imports_that_it_does_not_need() -> None:
    """Each of these takes a third of a second or more."""
    needless = ("scipy.optimize", "scipy.stats", "scipy.sparse", "matplotlib", "meshio", "cv2")
    script = f"{SCRIPT}\nassert not [n for n in {needless} if n in sys.modules], sys.modules.keys()"
    subprocess.run([sys.executable, "-c", script, "compiled"], check=True)


def test_help_does_not_wait_for_imports_that_it_does_not_need() -> None:
    script = (
        "import sys; from finger_model.cli import parser; parser()\n"
        'assert not {"scipy.optimize", "scipy.sparse", "matplotlib"} & set(sys.modules)'
    )
    subprocess.run([sys.executable, "-c", script], check=True)
