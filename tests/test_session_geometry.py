"""Calipers that were typed into the operator's page give the session a geometry of its finger."""

from __future__ import annotations

from pathlib import Path

import pytest

from finger_common.errors import InputError
from finger_model.geometry import Geometry
from finger_operator.session_store import further_files
from finger_operator.study_plan import StudyPlan


def test_calipers_give_the_geometry_of_the_session(tmp_path: Path) -> None:
    plan = StudyPlan("S01", "S01_a", finger_width=0.014, finger_depth=0.011, age=70)
    (name, text), *others = further_files(plan).items()
    assert name == "geometry.yaml" and not others
    path = tmp_path / name
    path.write_text(text)
    geometry = Geometry.load(path)
    assert geometry.pad_semi_axis_radial == pytest.approx(0.007)
    assert geometry.pad_semi_axis_axial == pytest.approx(0.0055)
    assert geometry.epidermis_thickness < 0.3e-3  # skin gets thinner with age


def test_without_calipers_there_is_none() -> None:
    assert further_files(StudyPlan("S01", "S01_a", age=70, finger="thumb")) == {}


@pytest.mark.parametrize(
    ("readings", "said"),
    [({"finger_width": 0.002}, "8 … 30 mm"), ({"finger_depth": 0.011}, "no width")],
)
def test_calipers_that_no_fingertip_has_are_refused(readings: dict[str, float], said: str) -> None:
    with pytest.raises(InputError, match=said):
        further_files(StudyPlan("S01", "S01_a", **readings))
