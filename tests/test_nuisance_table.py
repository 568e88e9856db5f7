"""A small nuisance table: errors of a rig on the real reduced model, fitted with nuisances."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from finger_fit.options import FitOptions


@pytest.fixture(scope="module")
def script(module_of: Callable[[str], Any]) -> Any:
    return module_of("scripts/nuisance_table.py")


@pytest.fixture(scope="module")
def rows(script: Any) -> dict[str, dict]:
    """One seed of a few cases, with the finger's lengths known: their priors hide the rest."""
    cases = ("tare +0.05 N", "lag +80 ms", "published J, natural, three presses")
    options = FitOptions(step=script.STEP, geometry_sd=[])
    return {case: script.fit_case(case, 0, {}, options) for case in cases}


def test_an_error_of_the_rig_does_not_move_e_out_of_its_interval(rows) -> None:
    for case, row in rows.items():
        found = row["composite_E"]
        assert found["covered"], case
        if not row["active"]:
            assert abs(found["error"]) < 2 * found["deviation"], case
    late = rows["lag +80 ms"]
    assert late["deviations"]["lag"] < 0.02, "the presses tell the lag"
    assert not late["tau1"]["covered_without"] or not late["composite_E"]["covered_without"]


def test_scatter_of_the_published_size_is_stated(rows, script) -> None:
    scatter = script.published_scatter("natural")
    assert 0.25 < scatter < 0.45, "gains of 30 to 40 %"
    few, many = rows["published J, natural, three presses"], rows["lag +80 ms"]
    assert few["scatter"] > 0.2 > 5 * many["scatter"]
    assert few["E2"]["deviation"] > 2 * many["E2"]["deviation"]


def test_the_table_has_a_row_for_each_case(rows, script) -> None:
    text = script.table(list(rows.values()))
    for case in rows:
        assert f"| {case} |" in text
    assert "nan" not in text
    found = script.summary([rows["lag +80 ms"]])
    assert np.isfinite(found["bias"]) and found["coverage"] in (0.0, 1.0)
