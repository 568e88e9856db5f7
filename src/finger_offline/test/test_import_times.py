# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Times of tables as people write them, and clocks that differ."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from import_files import (
    ABOUT,
    FIFTEEN,
    FRAMES,
    LASER,
    TIME,
    area_at,
    check_trials,
    csv,
    force_at,
    indentation_at,
    long_files,
)

from finger_bag.validate import validate
from finger_common.errors import InputError
from finger_offline.importing.cells import stamp_of
from finger_offline.importing.settings import ImportSettings
from finger_offline.importing.tables import Table
from finger_offline.importing.trial import import_trial
from finger_offline.trials import load_trials


def test_times_in_milliseconds_without_a_unit_are_refused(
    files: dict[str, str], tmp_path: Path
) -> None:
    csv(Path(files["force"]), "time_s,force_n", TIME * 1e3, force_at(TIME))
    with pytest.raises(InputError, match=r"first press lasts 2.*e\+03 s; .*--time-unit"):
        import_trial(ImportSettings(**files), tmp_path / "bag")


def test_short_presses_at_2_khz_in_milliseconds_are_refused(
    files: dict[str, str], tmp_path: Path
) -> None:
    """Presses of 0.75 s; their force alone could be that of long ones, their frames are too few."""
    time = np.arange(0.0, 8.5, 1 / 600)
    csv(Path(files["force"]), "time_s,force_n", 300.0 * time, force_at(time))
    csv(Path(files["area"]), "time_s,area_mm2", 300.0 * FRAMES, area_at(FRAMES))
    with pytest.raises(InputError, match=r"first press lasts 7\d\d s; .*--time-unit"):
        import_trial(ImportSettings(**files), tmp_path / "bag")


def test_times_in_minutes_are_read_and_those_in_unknown_units_refused(
    files: dict[str, str], tmp_path: Path
) -> None:
    for name in ("Time (minutes)", "Time [hr]"):
        factor = 60.0 if "min" in name else 3600.0
        csv(Path(files["force"]), f"{name},force_n", TIME / factor, force_at(TIME))
        bag = tmp_path / f"bag_{factor:.0f}"
        import_trial(ImportSettings(**files, force_time=name), bag)
        check_trials(bag, 0.02)
    odd = "Time [fortnights]"
    csv(Path(files["force"]), f"{odd},force_n", TIME, force_at(TIME))
    with pytest.raises(InputError, match=r"'fortnights', which is not known; .*--time-unit"):
        import_trial(ImportSettings(**files, force_time=odd), tmp_path / "bag")
    import_trial(ImportSettings(**files, force_time=odd, time_unit="s"), tmp_path / "bag")


@pytest.mark.parametrize(
    "area_time, words",
    [
        (FIFTEEN, None),
        (FIFTEEN / 1.03, "grows by"),
        (2.0 * FIFTEEN, "falls by 500 ms a second"),
        (FIFTEEN - 1.2, "areas come 12.. ms late"),
        (np.roll(FIFTEEN, 150), "jumps|do not follow"),
    ],
)
def test_areas_on_a_wrong_clock_are_not_fit_for_use(
    tmp_path: Path, area_time: np.ndarray, words: str | None
) -> None:
    files = long_files(tmp_path, area_time)
    bag = import_trial(ImportSettings(**files), tmp_path / "bag").path
    found = {check.name: check for check in validate(bag).checks}["sync of force and image"]
    assert found.status == ("ok" if words is None else "fail"), found
    assert words is None or re.search(words, found.detail)


def test_a_date_that_64_bits_do_not_hold_is_refused() -> None:
    stamps = np.array([10**18, 2 * 10**18], "datetime64[s]")
    with pytest.raises(InputError, match=r"t\.parquet, row 1, column 'time'.* is no time"):
        Table("t.parquet", {"time": stamps}).times("time")


@pytest.mark.parametrize(
    ("cells", "absolute"),
    [
        (["2024-05-01 13:45:10.25", "2024-05-01T13:45:10.5000000"], True),
        (["01.05.2024 13:45:10,250", "1.5.2024 13:45:10,500"], True),
        (["2024/05/01 13:45:10.25", "2024/5/1 13:45:10.5"], True),
        (["9:45:10.25", "9:45:10.5"], False),
        (np.array([10_250, 10_500], "timedelta64[ms]"), False),
        (["45413.573", "45413.5730028935185"], True),
        (["739373.573", "739373.5730028935185"], True),
    ],
)
def test_times_as_programs_write_them(cells: Any, absolute: bool) -> None:
    table = Table("t", {"Zeit [d]": cells})
    times = table.times("Zeit [d]")
    assert times.absolute == absolute and times.known.all()
    assert np.diff(times.ns)[0] == pytest.approx(0.25e9, abs=1e4)
    if absolute:
        day = times.ns[0] // (86400 * 10**9)
        assert np.datetime64(int(day), "D") == np.datetime64("2024-05-01")


@pytest.mark.parametrize(
    ("cells", "seconds", "absolute"),
    [
        (["01:45:10.25 PM", "1:45:10.5 pm"], 49_510.25, False),
        (["12:00:01.25 AM", "12:00:01.5 a.m."], 1.25, False),
        (["00:28.25", "00:28.5"], 28.25, False),
        (["75:10,25", "75:10,5"], 4510.25, False),
        (["23:59:59.9", "0:00:00.15"], 86_399.9, False),
        (["05/13/2024 13:45:10.25", "05/13/2024 13:45:10.5"], 1_715_607_910.25, True),
        (["13/05/2024 13:45:10.25", "13/05/2024 13:45:10.5"], 1_715_607_910.25, True),
        (["05/06/2024 01:45:10.25 PM", "05/06/2024 01:45:10.5 PM"], 1_715_003_110.25, True),
        (["2024-05-01 13:45:10.25 CEST", "2024-05-01 13:45:10.5 CEST"], 1_714_563_910.25, True),
        (["2024-05-01 13:45:10:250", "2024-05-01 13:45:10:500"], 1_714_571_110.25, True),
        (["20240501_134510.250", "20240501_134510.500"], 1_714_571_110.25, True),
        (["20240501134510.25", "20240501134510.5"], 1_714_571_110.25, True),
    ],
)
def test_times_of_other_programs(cells: list[str], seconds: float, absolute: bool) -> None:
    times = Table("t", {"time": cells}).times("time")
    assert times.absolute == absolute
    assert times.ns[0] == round(seconds * 1e3) * 1_000_000
    assert np.diff(times.ns)[0] == 250_000_000


@pytest.mark.parametrize(
    ("cell", "sentence"),
    [
        ("05/06/2024 13:45:10.25", "may have its day or its month first; export dates with the"),
        ("2024-05-01 13:45:10.25 CST", r"names the time zone 'CST'; give it as .* \+02:00"),
        ("13:45:10.25 PM", "is no time as in"),
        ("1_000.5", "is no number; correct it"),
        ("12345678901.5", "is no time in seconds; name its unit with --time-unit"),
    ],
)
def test_times_that_cannot_be_told_are_refused_by_their_first_row(cell: str, sentence: str) -> None:
    table = Table("t.csv", {"time": [cell, cell.replace("5", "6")]}, first_row=2)
    with pytest.raises(
        InputError, match=f"row 2, column 'time': {re.escape(repr(cell))} {sentence}"
    ):
        table.times("time")


def test_a_recording_over_midnight_and_a_footer(files: dict[str, str], tmp_path: Path) -> None:
    def clock(seconds: np.ndarray) -> list[str]:
        midnight = np.datetime64("2024-05-01T00:00")
        at = [midnight + np.timedelta64(round(1e3 * (s - 1.0)), "ms") for s in seconds]
        return [str(t).split("T")[1] for t in at]

    forces = [f"{t},{f:.5f}" for t, f in zip(clock(TIME), force_at(TIME))]
    # The camera begins behind midnight.
    seen = FRAMES[FRAMES >= 1.0]
    areas = [f"{t},{a:.5f}" for t, a in zip(clock(seen), area_at(seen))]
    for name, rows in (("force_n", forces), ("area_mm2", areas)):
        text = "\n".join([f"time_s,{name}", *rows, "End of file,"])
        (tmp_path / f"{name[:-2].strip('_m')}.csv").write_text(text)
    imported = import_trial(ImportSettings(**files), tmp_path / "bag")
    onset = (imported.presses[0][0] - imported.area_stamps[0]) * 1e-9
    assert onset == pytest.approx(0.533 - 1.0, abs=0.01)


def test_force_and_areas_may_have_times_of_different_units(
    files: dict[str, str], tmp_path: Path
) -> None:
    csv(tmp_path / "force.csv", "time,force_n", 1e3 * TIME, force_at(TIME))
    csv(tmp_path / "area.csv", "time,area_mm2", 1e9 * FRAMES, area_at(FRAMES))
    csv(tmp_path / "laser.csv", "time,indentation_mm", 1e6 * LASER, indentation_at(LASER))
    columns = {name: "time" for name in ("force_time", "area_time", "indentation_time")}
    units = {"force_time_unit": "ms", "area_time_unit": "ns", "indentation_time_unit": "us"}
    import_trial(ImportSettings(**files, **columns, **units), tmp_path / "bag")
    check_trials(tmp_path / "bag")
    laser = {"indentation": str(tmp_path / "laser.csv")}
    import_trial(ImportSettings(**files, **columns, **units, **laser), tmp_path / "laser")
    for trial in load_trials(tmp_path / "laser"):
        assert np.ptp(trial.indentation) == pytest.approx(1e-3, rel=0.2)


def test_times_to_the_second_are_refused(files: dict[str, str], tmp_path: Path) -> None:
    csv(Path(files["force"]), "time_s,force_n", np.floor(TIME), force_at(TIME))
    with pytest.raises(InputError, match=r"of 2250 rows of column 'time_s' repeat .*milliseconds"):
        import_trial(ImportSettings(**files), tmp_path / "bag")
    even = {"force_rate": 250.0, "frame_rate": 10.0}
    import_trial(ImportSettings(**files, **even), tmp_path / "bag")
    check_trials(tmp_path / "bag")


def test_areas_beside_forces_keep_their_rows_where_times_repeat(tmp_path: Path) -> None:
    """Times of two decimals at 500 Hz: the area does not stand in the first row of its time."""
    rows = ["time_s,force_n,area_mm2"]
    time = np.arange(0.0, 9.0, 0.002)
    for k, (at, force) in enumerate(zip(time, force_at(time))):
        area = f"{area_at(at):.4f}" if k % 50 == 3 else ""
        rows.append(f"{np.floor(100 * at + 1e-6) / 100:.2f},{force:.5f},{area}")
    (tmp_path / "both.csv").write_text("\n".join(rows) + "\n")
    both = str(tmp_path / "both.csv")
    found = import_trial(ImportSettings(force=both, area=both, **ABOUT), tmp_path / "bag")
    assert len(found.areas) == 90
    assert len(load_trials(tmp_path / "bag").trials) == 2


def test_numbers_of_frames_are_no_seconds(files: dict[str, str], tmp_path: Path) -> None:
    counts = np.arange(len(FRAMES), dtype=float)
    named = {"area": csv(tmp_path / "p.csv", "frame,area_mm2", counts, area_at(FRAMES))}
    settings = {**files, **named, "area_time": "frame"}
    with pytest.raises(InputError, match=r"'frame' counts rows; give --frame-rate in place of it"):
        import_trial(ImportSettings(**settings), tmp_path / "bag")
    import_trial(ImportSettings(**settings, frame_rate=10.0), tmp_path / "bag")
    check_trials(tmp_path / "bag")


def test_a_print_that_stays_on_the_plate_is_no_wrong_clock(tmp_path: Path) -> None:
    files = long_files(tmp_path, FIFTEEN)
    time, area = np.loadtxt(files["area"], delimiter=",", skiprows=1).T
    csv(Path(files["area"]), "time_s,area_mm2", time, np.where(time > 2.0, 70.0 + 0.0 * area, area))
    bag = import_trial(ImportSettings(**files), tmp_path / "bag").path
    found = {check.name: check for check in validate(bag).checks}["sync of force and image"]
    assert found.status == "fail" and "frames between the presses" in found.detail, found
    assert "a print or dirt on the plate" in found.detail


def test_times_of_any_number_of_decimals_are_read_by_every_python() -> None:
    assert stamp_of("2024-05-01T13:45:10.25Z") == 1_714_571_110_250_000_000
    assert stamp_of("01.05.2024 13:45:10,5") == 1_714_571_110_500_000_000


@pytest.mark.parametrize("zone", ["+02:00", "+0200", "+02"])
def test_a_difference_from_utc_is_read_with_and_without_its_colon(zone: str) -> None:
    assert stamp_of(f"2024-05-01 15:45:10.25{zone}") == 1_714_571_110_250_000_000
    assert stamp_of(f"2024-05-01T15:45{zone}") == 1_714_571_100_000_000_000
