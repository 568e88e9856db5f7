# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""`finger-model geometry`: from caliper readings to geometry.yaml."""

import re

import pytest

from finger_common.cli import run
from finger_common.errors import InputError
from finger_model.anthropometry import FINGERS, estimate_geometry, parse_length
from finger_model.cli import _main
from finger_model.geometry import LENGTHS, Geometry, StatedGeometry


@pytest.mark.parametrize("text", ["14mm", "14 mm", "1.4cm", "0.014m", "0.014", "14,0 mm", "14MM"])
def test_lengths_in_mm_cm_and_m(text):
    assert parse_length(text, "--width") == pytest.approx(0.014)


@pytest.mark.parametrize("text", ["14", "0.5", "14in", "-14mm", "nan", "1e3mm", "mm", "", "14mm 2"])
def test_other_lengths_are_refused_in_one_sentence(text):
    with pytest.raises(InputError, match="--width is ") as refused:
        parse_length(text, "--width")
    assert "\n" not in str(refused.value)
    if text == "14":
        assert "is it 14mm?" in str(refused.value)


def test_file_has_every_key_with_its_deviation_and_is_read_back(tmp_path):
    path = tmp_path / "g.yaml"
    assert run(_main, ["geometry", "--width", "14mm", "--depth", "11mm", "-o", str(path)]) == 0
    text = path.read_text()
    lines = [n for n in text.partition("deviations:")[0].splitlines() if not n.startswith("#")]
    assert [line.split(":")[0] for line in lines] == list(LENGTHS) == list(Geometry().to_dict())
    estimate = estimate_geometry(width=14e-3, depth=11e-3)
    for line in lines:
        key = line.split(":")[0]
        deviation = float(re.search(r"# ± ([-\d.e]+);", line)[1])
        assert deviation == pytest.approx(estimate.deviations[key], rel=0.05) and deviation > 0
    stated = StatedGeometry.load(path)
    assert stated.deviations == pytest.approx(estimate.deviations, rel=0.05)
    geometry = Geometry.load(path)
    assert geometry == estimate.geometry == stated.geometry
    assert geometry.pad_semi_axis_radial == 7e-3
    assert geometry.pad_semi_axis_axial == 5.5e-3


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("deviations: 0.1", "give standard deviations in m below it"),
        ("deviations: {width: 0.001}", "unknown key 'width' in 'deviations'"),
        ("deviations: {nail_radius: thin}", "deviations: 'nail_radius' is 'thin'"),
        ("deviations: {nail_radius: -0.001}", "deviation of 'nail_radius' is -0.001 m"),
        ("deviations: {pad_semi_axis_radial: 0.1}", "of a length of 0.0085 m; give the standard"),
    ],
)
def test_deviations_that_are_none_are_refused_with_file_and_key(tmp_path, text, words):
    path = tmp_path / "g.yaml"
    path.write_text(f"epidermis_thickness: 0.0003\n{text}\n")
    with pytest.raises(InputError, match=re.escape(words)) as refused:
        Geometry.load(path)
    assert str(refused.value).startswith(str(path))


def test_a_file_without_deviations_states_none(tmp_path):
    path = tmp_path / "g.yaml"
    path.write_text("epidermis_thickness: 0.0004\n")
    stated = StatedGeometry.load(path)
    assert stated.deviations == {} and stated.geometry.epidermis_thickness == 0.0004


def test_less_measured_is_less_known():
    measured = estimate_geometry(width=17e-3, depth=11e-3, length=25.5e-3, nail_width=14e-3)
    typical = estimate_geometry(finger="index")
    # The typical readings themselves: the same finger, better known.
    for key, value in typical.geometry.to_dict().items():
        assert measured.geometry.to_dict()[key] == pytest.approx(value, abs=1e-6)
        assert measured.deviations[key] <= typical.deviations[key]
    axial = "pad_semi_axis_axial"
    assert measured.deviations[axial] < 0.7 * typical.deviations[axial]


def test_every_finger_has_a_preset_and_size_follows_it():
    widths = {f: estimate_geometry(finger=f).geometry.pad_semi_axis_radial for f in FINGERS}
    assert widths["thumb"] > widths["middle"] > widths["index"] > widths["ring"] > widths["little"]
    assert widths["little"] == pytest.approx(0.5 * FINGERS["little"].width)


def test_age_and_length_change_what_they_should():
    young, old = (estimate_geometry(finger="index", age=age).geometry for age in (25, 75))
    assert old.epidermis_thickness < young.epidermis_thickness == 0.3e-3
    long = estimate_geometry(width=17e-3, length=30e-3).geometry
    short = estimate_geometry(width=17e-3, length=20e-3).geometry
    assert long.pad_semi_axis_radial > 8.5e-3 > short.pad_semi_axis_radial
    assert long.pad_semi_axis_axial == short.pad_semi_axis_axial


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ([], "--width 14mm"),
        (["--width", "14"], "is it 14mm"),
        (["--width", "140mm"], "8 … 30 mm"),
        (["--width", "14mm", "--depth", "1mm"], "5 … 25 mm"),
        (["--width", "14mm", "--nail-width", "16mm"], "larger than the width"),
        (["--width", "17mm", "--length", "12mm"], "length 12 mm is 0.71 of the width of 17 mm"),
        (["--width", "12mm", "--length", "30mm"], "1.1 to 2.2 of it"),
        (["--finger", "toe"], "thumb, index"),
        (["--finger", "index", "--age", "500"], "1 … 120"),
        (["--width", "14mm", "--age", "nan"], "1 … 120"),
        (["--width", "11mm", "--depth", "17mm"], "exchanged"),
        (["--finger", "index", "--age", "8"], "give the width"),
    ],
)
def test_bad_readings_end_with_one_sentence(tmp_path, capsys, options, words):
    path = tmp_path / "g.yaml"
    assert run(_main, ["geometry", *options, "-o", str(path)]) == 2
    error = capsys.readouterr().err.strip()
    assert words in error and "\n" not in error
    assert not path.exists()


def test_a_finger_that_no_shipped_model_serves_is_noted(tmp_path, capsys):
    path = tmp_path / "g.yaml"
    assert run(_main, ["geometry", "--width", "17mm", "--length", "36mm", "-o", str(path)]) == 0
    assert "outside the population box" in capsys.readouterr().err
    assert run(_main, ["geometry", "--width", "17mm", "-o", str(path)]) == 0
    assert capsys.readouterr().err == ""


def test_help_lists_the_keys(capsys):
    with pytest.raises(SystemExit):
        run(_main, ["geometry", "--help"])
    text = capsys.readouterr().out
    assert all(key in text for key in LENGTHS)
