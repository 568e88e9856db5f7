# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Forces of a table: tare, drift, spikes, gaps."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from import_files import FRAMES, TIME, area_at, check_trials, csv, force_at, load_start

from finger_bag.cli import command
from finger_bag.reader import open_bag
from finger_bag.validate import validate
from finger_common.errors import InputError
from finger_offline.importing.settings import ImportSettings
from finger_offline.importing.trial import import_trial
from finger_offline.trials import load_trials
from finger_offline.unloaded import without_spikes


def test_rows_without_a_force_are_left_out_and_told(files: dict[str, str], tmp_path: Path) -> None:
    path = Path(files["force"])
    heading, *rows = path.read_text().splitlines()
    for k, cell in ((700, "NaN"), (701, ""), (702, "nan")):
        rows[k] = f"{rows[k].split(',')[0]},{cell}"
    path.write_text("\n".join([heading, *rows]) + "\n")
    found = import_trial(ImportSettings(**files), tmp_path / "bag")
    assert any("3 rows without a force" in note for note in found.notes)
    check_trials(tmp_path / "bag")


@pytest.mark.parametrize("offset", [-0.3, 0.3])
def test_a_force_that_was_not_tared_is_told_the_option(
    files: dict[str, str], tmp_path: Path, offset: float
) -> None:
    csv(Path(files["force"]), "time_s,force_n", TIME, force_at(TIME) + offset)
    words = rf"force is {offset:.2f} N while nothing touches the plate .*--tare"
    with pytest.raises(InputError, match=words):
        import_trial(ImportSettings(**files), tmp_path / "bag")
    import_trial(ImportSettings(**files, tare=0.4), tmp_path / "bag")
    check_trials(tmp_path / "bag", 3e-3)


@pytest.mark.parametrize("first, last", [(0.04, 0.04), (0.09, 0.09), (0.0, 0.09)])
def test_a_tare_that_passes_or_drifts_merges_no_presses(
    files: dict[str, str], tmp_path: Path, first: float, last: float
) -> None:
    force = force_at(TIME) + np.interp(TIME, [0.0, 9.0], [first, last])
    csv(tmp_path / "force.csv", "time_s,force_n", TIME, force)
    areas = np.where(area_at(FRAMES) > 1e-9, area_at(FRAMES), 0.0)
    csv(tmp_path / "area.csv", "time_s,area_mm2", FRAMES, areas)
    imported = import_trial(ImportSettings(**files), tmp_path / "bag")
    assert len(imported.presses) == 2
    onsets = [(t.onset_ns - load_start(imported.path)) * 1e-9 for t in load_trials(imported.path)]
    assert onsets == pytest.approx([0.533, 5.042], abs=0.02)
    assert validate(imported.path).fit


def test_a_force_that_drifts_is_not_told_to_tare_again(
    files: dict[str, str], tmp_path: Path
) -> None:
    csv(tmp_path / "force.csv", "time_s,force_n", TIME, force_at(TIME) + 0.03 * TIME)
    areas = np.where(area_at(FRAMES) > 1e-9, area_at(FRAMES), 0.0)
    csv(tmp_path / "area.csv", "time_s,area_mm2", FRAMES, areas)
    with pytest.raises(InputError, match=r"drifts from 0.00 N to 0.25 N .* without drift"):
        import_trial(ImportSettings(**files, tare=0.1), tmp_path / "bag")


def test_spikes_of_single_samples_make_no_press_and_no_target(
    files: dict[str, str], tmp_path: Path
) -> None:
    force = force_at(TIME)
    for row in (300, 1000, 1500):
        force[row] += 5.0
    force[2100] = force[2101] = -4.0
    csv(tmp_path / "force.csv", "time_s,force_n", TIME, force)
    imported = import_trial(ImportSettings(**files), tmp_path / "bag")
    assert [round(peak, 1) for _, _, peak in imported.presses] == [1.5, 1.2]
    assert [t.target_force for t in load_trials(imported.path)] == pytest.approx(
        [1.42, 1.14], abs=0.02
    )
    assert "5 isolated spikes" in imported.notes[0] and "row 302 (6.05 N" in imported.notes[0]
    with open_bag(imported.path) as reader:
        forces = [m.message.wrench.force.z for m in reader.messages(["/finger/wrench"])]
    assert min(forces) < -6.0


def test_a_fast_press_is_no_spike() -> None:
    for rise in (2, 3, 5):
        force = np.interp(np.arange(60.0), [20 - rise, 20, 20 + rise + 1], [0.0, 1.5, 0.0])
        _, spikes = without_spikes(force)
        assert len(spikes) == 0


def test_a_press_that_began_before_the_recording_is_a_problem(
    files: dict[str, str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    late = TIME > 1.0
    csv(Path(files["force"]), "time_s,force_n", TIME[late], force_at(TIME)[late])
    options = [text for n in ("force", "area") for text in (f"--{n}", files[n])]
    about = ["--subject", "S01", "--condition", "dry"]
    assert command(["import", "-o", str(tmp_path / "bag"), *options, *about]) == 1
    shown = capsys.readouterr().out
    assert "NOT fit for use" in shown and "0.76 N at its first sample" in shown


def test_a_tare_that_passes_leaves_a_press_its_target(
    files: dict[str, str], tmp_path: Path
) -> None:
    first = TIME < 4.0
    csv(Path(files["force"]), "time_s,force_n", TIME[first], force_at(TIME[first]) + 0.09)
    import_trial(ImportSettings(**files), tmp_path / "bag")
    (trial,) = load_trials(tmp_path / "bag")
    assert trial.target_force == pytest.approx(0.95 * 1.5, abs=0.011)


def test_a_force_that_is_nowhere_beside_a_time_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "wide.csv"
    path.write_text("t_s,fz_n\n" + "".join(f"{k / 100},\n" for k in range(50)) + ",1.0\n" * 50)
    about = ["--subject", "S01", "--condition", "dry", "--area", str(path)]
    about += ["--force-column", "fz_n", "--force-time", "t_s"]
    with pytest.raises(InputError, match="no row has both a time"):
        command(["import", "-o", str(tmp_path / "bag"), "--force", str(path), *about])


def test_scales_show_the_weight_of_a_gram(files: dict[str, str], tmp_path: Path) -> None:
    scale = csv(tmp_path / "scale.csv", "time_s,load_g", TIME, force_at(TIME) / 9.80665e-3)
    named = {"force": scale, "force_column": "load_g"}
    import_trial(ImportSettings(**{**files, **named}), tmp_path / "bag")
    check_trials(tmp_path / "bag")


@pytest.mark.parametrize(
    ("rows", "says"),
    [
        (["1.0,1.0"], "force.csv: holds one row with a force; export the whole recording"),
        (["0.0,0.0", "0.1,-1e308", "0.2,0.0"], r"force.csv, row 3: a force beyond 1e\+06 N"),
    ],
)
def test_a_table_without_a_course_of_forces_is_refused(
    files: dict[str, str], tmp_path: Path, rows: list[str], says: str
) -> None:
    Path(files["force"]).write_text("\n".join(["time_s,force_n", *rows]) + "\n")
    with pytest.raises(InputError, match=says):
        import_trial(ImportSettings(**files), tmp_path / "bag")
    assert not (tmp_path / "bag").exists()


def test_a_sensor_of_100_hz_is_fast_enough_though_its_clock_is_slow(
    files: dict[str, str], tmp_path: Path
) -> None:
    time = np.arange(0.0, 9.0, 0.01) * (1.0 + 1e-5)
    csv(Path(files["force"]), "time_s,force_n", time, force_at(time))
    import_trial(ImportSettings(**files), tmp_path / "bag")
    assert validate(tmp_path / "bag").fit
