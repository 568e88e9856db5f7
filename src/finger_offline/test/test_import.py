# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Files of a laboratory become session bags that are fit for use, or are refused in a sentence."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from import_files import ABOUT, FRAMES, TIME, area_at, check_trials, csv, force_at, load_start

from finger_bag.cli import command
from finger_bag.reader import open_bag
from finger_bag.validate import validate
from finger_common.errors import InputError
from finger_offline.importing.settings import ImportSettings
from finger_offline.importing.trial import import_trial
from finger_offline.trials import load_trials

NOISE = "time_s,force_n\n" + "".join(f"{0.1 * i:.1f},{i % 3}\n" for i in range(3100))


def test_csv_files_of_the_contract_make_a_bag_fit_for_use(
    files: dict[str, str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bag = tmp_path / "bag"
    options = [f"--{k}={v}" for k, v in files.items()]
    assert command(["import", "-o", str(bag), *options]) == 0
    assert "2 presses to 1.20 … 1.50 N," in capsys.readouterr().out
    trials = check_trials(bag)
    assert [t.index for t in trials] == [0, 1]
    assert trials[0].onset_ns > load_start(bag)
    with open_bag(bag) as reader:
        text = reader.info.metadata.to_mapping()
    assert text["source"] == "finger-bag import" and "area.csv sha256:" in text["files"]


@pytest.mark.parametrize(
    ("given", "use"),
    [
        ("--keep-images", "--video and --images"),
        ("--indentation-unit=mm", "--indentation"),
        ("--indentation-time-offset=0.2", "--indentation"),
    ],
)
def test_an_option_without_a_use_is_refused(
    files: dict[str, str], tmp_path: Path, given: str, use: str
) -> None:
    options = [f"--{k}={v}" for k, v in files.items()]
    name = given.partition("=")[0]
    with pytest.raises(InputError, match=f"^{name} is for {use}; give that too, or leave it out"):
        command(["import", "-o", str(tmp_path / "bag"), *options, given])
    assert not (tmp_path / "bag").exists()


def test_areas_of_a_table_have_a_deviation_and_correct_the_model(
    files: dict[str, str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for share in (0.03, 0.1):
        imported = import_trial(ImportSettings(**files, area_sd=share), tmp_path / f"{share}")
        found = load_trials(imported.path).trials[0]
        assert np.allclose(found.area_sd, np.maximum(share * found.area, 0.5e-6), rtol=1e-5)
    assert command(["process", str(tmp_path / "0.03"), "-o", str(tmp_path / "out")]) == 0
    assert "AREA_REJECTED" not in capsys.readouterr().out


def test_dates_three_axes_tare_and_a_clock_that_differs(tmp_path: Path) -> None:
    time = np.datetime64("2024-05-01T10:00:00") + (1e6 * TIME).astype("timedelta64[us]")
    lines = ["when,Fx,Fy,Fz"]
    force = force_at(TIME)
    lines += [f"{w},{f + 0.3:.6f},{0.1 * f:.6f},0.2" for w, f in zip(time, force)]
    (tmp_path / "force.csv").write_text("\n".join(lines))
    unix = 1_714_557_600.0 - 3600.0  # the camera's clock is an hour behind
    area = csv(tmp_path / "area.csv", "t,A", FRAMES + unix, area_at(FRAMES))
    settings = ImportSettings(
        force=str(tmp_path / "force.csv"),
        area=area,
        force_time="when",
        force_column="Fx,Fy,Fz",
        force_unit="N",
        normal_axis="+x",
        tare=0.4,
        area_time="t",
        area_column="A",
        area_unit="mm2",
        time_offset=3600.0,
        **ABOUT,
    )
    import_trial(settings, tmp_path / "bag")
    trials = check_trials(tmp_path / "bag", 1e-3)
    middle = len(trials[0].force) // 2
    assert trials[0].lateral_force[middle] == pytest.approx(0.1 * trials[0].force[middle], abs=1e-3)
    assert load_start(tmp_path / "bag") == 1_714_557_600_000_000_000


@pytest.mark.parametrize("start", ["2024-05-01T10:00:00Z", "2024-05-01T12:00:00+0200"])
def test_the_start_is_read_with_its_difference_from_utc(
    files: dict[str, str], tmp_path: Path, start: str
) -> None:
    import_trial(ImportSettings(**files, start=start), tmp_path / "bag")
    assert load_start(tmp_path / "bag") == 1_714_557_600_000_000_000


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"area_unit": "cm2"}, r"largest area is 7\d+ mm².*--area-unit"),
        ({"area_unit": "m2"}, r"largest area is 7.*--area-unit"),
        ({"force_unit": "kN"}, r"force goes up to 150. N.*--force-unit"),
        ({"force_unit": "mN"}, r"no press of 0.2 N.*--force-unit"),
        ({"force_sign": "negative"}, r"goes down to -1.5 N.*--force-sign"),
        ({"time_offset": 100.0}, r"no area during a press.*--time-offset"),
        ({"force_column": "Fz"}, r"'Fz' does not exist.*force_n.*--force-column"),
        ({"condition": ""}, r"no condition.*--condition"),
        ({"subject": "../S01"}, r"subject .* is not valid; use letters"),
        ({"moisture": ["1e9"]}, r"moisture '1e9' is no reading"),
        ({"area": ""}, r"give one of --area, --video and --images"),
        ({"area": "", "video": "v.mp4"}, r"--calibration .* or --area-per-pixel"),
        ({"area": "", "video": "no.mp4", "area_per_pixel": 1e-9}, r"no\.mp4: no such video"),
        ({"force": "nothing.csv"}, r"nothing\.csv: no such file"),
        ({"force": __file__}, r"no table of a known kind.*\.csv"),
        ({"area_per_pixel": 1e-9}, r"areas in mm2; --area-per-pixel"),
        ({"start": "yesterday"}, r"--start 'yesterday' is no date"),
        ({"start": "9999-12-31"}, r"--start: a time is in the year 9999, messages hold 1970 to"),
        ({"start": "1969-12-31"}, r"--start: a time is in the year 1969"),
        ({"start": "2038-01-19T03:14:06"}, r"force\.csv: a time is in the year 2038"),
        ({"frame_rate": 1e-300, "area": "", "video": "v", "area_per_pixel": 1e-9}, r"below 0\.001"),
        ({"force_rate": 100.0}, r"'time_s' come at 250 Hz, and --force-rate says 100 Hz; leave"),
        ({"normal_axis": "+x"}, r"--normal-axis is for three columns of the force"),
        ({"tare": 2.0}, r"varies by .* --tare"),
        ({"time_unit": "us"}, r"first press lasts .*e-06 s; give the right --time-unit"),
    ],
)
def test_what_cannot_be_meant_is_refused_and_nothing_is_written(
    files: dict[str, str], tmp_path: Path, change: dict[str, Any], sentence: str
) -> None:
    with pytest.raises(InputError) as caught:
        import_trial(ImportSettings(**{**files, **change}), tmp_path / "bag")
    assert re.search(sentence, str(caught.value)), caught.value
    assert not [p for p in tmp_path.iterdir() if p.suffix != ".csv"]


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("time_s,force_n\n0,0\n0.1,0.5\n0.05,1\n", r"row 4, column 'time_s': time runs back"),
        ("time_s,force_n\n0,0\n0.1,much\n", r"row 3, column 'force_n': 'much' is no number"),
        ("time_s,force_n\n0,0\n0.1,inf\n", r"row 3, column 'force_n': 'inf' is no finite"),
        ("time_s,force_n\n9999-12-31T23:59:59+14:00,1\n", r"row 2, column 'time_s': .* year 9999"),
        ("time_s,force_n\n0001-01-01T00:00:00,1\n", r"row 2, column 'time_s': .* year 1,"),
        (NOISE, r"10\d\d presses, 1000 at most are read; check --tare"),
        ("time_s,force_n\n", r"holds no row"),
        ("", r"holds no row"),
        ("time_s,force\n0,0\n1,2\n", r"column 'force_n' does not exist.*did you mean 'force'"),
        ("t;F\n0;1\n", r"known are t, F"),
    ],
)
def test_bad_rows_are_named(
    files: dict[str, str], tmp_path: Path, text: str, sentence: str
) -> None:
    Path(files["force"]).write_text(text)
    with pytest.raises(InputError) as caught:
        import_trial(ImportSettings(**files), tmp_path / "bag")
    assert re.search(sentence, str(caught.value)), caught.value


def test_a_marker_among_the_areas_is_named(files: dict[str, str], tmp_path: Path) -> None:
    area = np.where(np.arange(len(FRAMES)) % 30 == 10, 9999.0, area_at(FRAMES))
    csv(tmp_path / "area.csv", "time_s,area_mm2", FRAMES, area)
    words = r"area 11 of 90 is 9999 mm², .*as are 2 more; .*leave its cell empty"
    with pytest.raises(InputError, match=words):
        import_trial(ImportSettings(**files), tmp_path / "bag")


def test_a_single_area_far_above_the_others_is_noted(files: dict[str, str], tmp_path: Path) -> None:
    for name, wrong in (("one", 1500.0), ("none", 0.0)):
        area = area_at(FRAMES) + wrong * (np.arange(len(FRAMES)) == 16)
        csv(tmp_path / "area.csv", "time_s,area_mm2", FRAMES, area)
        import_trial(ImportSettings(**files), tmp_path / name)
        result = validate(tmp_path / name)
        noted = [c.detail for c in result.checks if c.name == "areas" and c.status == "note"]
        assert result.fit and len(noted) == bool(wrong)
        assert not wrong or re.search(
            r"single areas lie far above .*\(trial 0: 15\d\d mm²\)", noted[0]
        )


def test_a_slow_force_says_nothing_of_the_clock(files: dict[str, str], tmp_path: Path) -> None:
    csv(tmp_path / "force.csv", "time_s,force_n", FRAMES, force_at(FRAMES))
    import_trial(ImportSettings(**files), tmp_path / "bag")
    found = {c.name: c for c in validate(tmp_path / "bag").checks}
    assert found["rate of wrench"].status == "fail"
    sync = found["sync of force and image"]
    assert sync.status == "note" and "does not tell it" in sync.detail


def test_zeros_between_the_frames_are_told(files: dict[str, str], tmp_path: Path) -> None:
    for gap in (0.0, -1.0):
        between = np.arange(len(FRAMES)) % 3 > 0
        area = np.where(between, gap, area_at(FRAMES))
        csv(tmp_path / "area.csv", "time_s,area_mm2", FRAMES, area)
        found = import_trial(ImportSettings(**files), tmp_path / f"bag{gap}")
        (note,) = found.notes
        assert re.search(r"\d+ of \d+ areas in the middle of presses are zero or negative", note)
        assert "leave the cells of rows without a frame empty" in note
    csv(tmp_path / "area.csv", "time_s,area_mm2", FRAMES, area_at(FRAMES))
    assert import_trial(ImportSettings(**files), tmp_path / "bag").notes == []


def test_areas_that_a_logger_held_count_once(files: dict[str, str], tmp_path: Path) -> None:
    """One rate for all channels: each area stands in 25 rows, until the camera gives the next."""
    plain = import_trial(ImportSettings(**files), tmp_path / "plain")
    held = area_at(FRAMES)[np.arange(len(TIME)) // 25]
    csv(Path(files["area"]), "time_s,area_mm2", TIME, held)
    imported = import_trial(ImportSettings(**files), tmp_path / "bag")
    (note,) = imported.notes
    assert "2160 rows hold the area of the row before" in note
    assert (imported.area_stamps, imported.areas) == (plain.area_stamps, plain.areas)
    check_trials(tmp_path / "bag")


@pytest.mark.parametrize("ramp", [0.25, 0.004])
def test_areas_that_stand_still_with_the_force_are_not_held(
    files: dict[str, str], tmp_path: Path, ramp: float
) -> None:
    """Those of a model have no noise; steps of the force make runs of one length."""
    steps, since = np.divmod(TIME, 0.5)
    force = 0.1 * (steps + np.clip(since / ramp, 0.0, 1.0)) * ((TIME > 0.5) & (TIME < 8.0))
    csv(Path(files["force"]), "time_s,force_n", TIME, force)
    csv(Path(files["area"]), "time_s,area_mm2", TIME, 60.0 * force**0.4)
    imported = import_trial(ImportSettings(**files), tmp_path / "bag")
    assert len(imported.areas) == len(TIME) and imported.notes == []


def test_areas_in_pixels(files: dict[str, str], tmp_path: Path) -> None:
    pixels = area_at(FRAMES) * 1e-6 / 9.86e-10
    named = {"area": csv(tmp_path / "p.csv", "time_s,Area [px]", FRAMES, pixels)}
    settings = {**files, **named, "area_column": "Area"}
    with pytest.raises(InputError, match=r"areas in px; --area-per-pixel"):
        import_trial(ImportSettings(**settings), tmp_path / "bag")
    import_trial(ImportSettings(**settings, area_per_pixel=9.86e-10), tmp_path / "bag")
    check_trials(tmp_path / "bag")
