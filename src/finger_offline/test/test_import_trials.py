# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Many recordings at once: a table of trials, or columns that tell them apart."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from import_files import FRAMES, TIME, area_at, force_at, write_german

from finger_bag.cli import command
from finger_common.errors import InputError
from finger_offline.trials import load_trials


def test_a_table_of_trials_gives_a_folder_of_bags(files: dict[str, str], tmp_path: Path) -> None:
    write_german(tmp_path / "log.csv")
    (tmp_path / "trials.csv").write_text(
        "force,area,subject,condition,moisture,force_time,area_time,force_column,area_column,"
        "force_sign\n"
        "force.csv,area.csv,S01,dry,40 42,,,,,\n"
        "log.csv,log.csv,S02,dry,,Zeit,Zeit,Kraft,Fläche,negative\n"
    )
    out = tmp_path / "study"
    assert command(["import", "-o", str(out), "--trials", str(tmp_path / "trials.csv")]) == 0
    assert sorted(p.name for p in out.iterdir()) == ["S01_dry_00", "S02_dry_00"]
    found = load_trials(out)
    assert [t.subject for t in found] == ["S01", "S01", "S02", "S02"]
    assert found.trials[0].moisture == 41.0 and np.isnan(found.trials[2].moisture)

    (tmp_path / "twice.csv").write_text(
        "force,area,subject,condition\nforce.csv,area.csv,S01,dry\nforce.csv,area.csv,S01,moist\n"
    )
    with pytest.raises(InputError, match=r"row 3: the force is that of row 2 once more"):
        command(["import", "-o", str(tmp_path / "no"), "--trials", str(tmp_path / "twice.csv")])
    assert not (tmp_path / "no").exists()


@pytest.mark.parametrize("name", ["..", ".hidden", "-o", "a/b", "\x1b[2J", "x" * 300])
def test_names_of_bags_in_a_table_of_trials(
    files: dict[str, str], tmp_path: Path, name: str
) -> None:
    cells = [f'"{name}"', "S01", "dry", files["force"], files["area"]]
    (tmp_path / "t.csv").write_text("name,subject,condition,force,area\n" + ",".join(cells) + "\n")
    with pytest.raises(InputError, match=r"row 2: bag .* is not valid; use letters"):
        command(["import", "-o", str(tmp_path / "no"), "--trials", str(tmp_path / "t.csv")])
    assert not (tmp_path / "no").exists()


def test_columns_tell_recordings_apart(
    files: dict[str, str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Time begins anew in each; the areas have a table of their own."""
    names = ("Proband", "Haut", "Versuch")
    whose = [("S01", "trocken", 1), ("S01", "trocken", 2), ("S02", "feucht", 1)]
    for name, heading, clock, values in (
        ("force", "force_n", TIME, force_at(TIME)),
        ("area", "area_mm2", FRAMES, area_at(FRAMES)),
    ):
        lines = [",".join([*names, "time_s", heading])]
        for number, about in enumerate(whose):
            scale = (1.0 + 0.1 * number) if name == "force" else 1.0
            lines += [
                ",".join([*map(str, about), f"{t:.4f}", f"{scale * v:.6f}"])
                for t, v in zip(clock, values)
            ]
        (tmp_path / f"{name}.csv").write_text("\n".join(lines))
    options = [text for n in ("force", "area") for text in (f"--{n}", files[n])]
    columns = ["--subject-column", "Proband", "--condition-column", "Haut"]
    with pytest.raises(InputError, match=r"time runs back by 9 s.*--trial-column"):
        command(["import", "-o", str(tmp_path / "no"), *options, *columns])
    columns += ["--trial-column", "Versuch"]
    assert command(["import", "-o", str(tmp_path / "study"), *options, *columns]) == 0
    assert "3 of 3 bags are fit for use" in capsys.readouterr().out
    found = load_trials(tmp_path / "study")
    assert [(t.subject, t.condition, t.index) for t in found] == [
        ("S01", "trocken", 0), ("S01", "trocken", 1),
        ("S01", "trocken", 1), ("S01", "trocken", 2),
        ("S02", "feucht", 0), ("S02", "feucht", 1),
    ]  # fmt: skip
    assert [round(t.peak_force / 1.5, 1) for t in list(found)[::2]] == [1.0, 1.1, 1.2]


def test_a_table_of_trials_as_people_write_it(files: dict[str, str], tmp_path: Path) -> None:
    for name in ("force", "area"):
        Path(files[name]).rename(tmp_path / f"{name} 1.csv")
    heads = "Force;Area;Subject;Condition;Moisture;Time offset;_remark"

    def run_of(*rows: str) -> int:
        (tmp_path / "t.csv").write_text("\n".join([heads, *rows]))
        output = tmp_path / f"study{len(list(tmp_path.iterdir()))}"
        return command(["import", "-o", str(output), "--trials", str(tmp_path / "t.csv")])

    assert run_of(".\\force 1.csv;area 1.csv;S01;kalt;40,5 42;0,0;ok") == 0
    for row, words in (
        ("force 1.csv;area 1.csv;S01;kalt;40,5;0,0;", "'40,5' may be one number or two"),
        ("force 2.csv;area 1.csv;S01;kalt;;;", r"row 2, Force: .*force 2\.csv does not exist"),
    ):
        with pytest.raises(InputError, match=words):
            run_of(row)
    content = (tmp_path / "force 1.csv").read_text()
    (tmp_path / "force 2.csv").write_text(content + "8.9999,0\n")
    with pytest.raises(InputError, match=r"row 3: 's01' and 'S01' differ in case or spaces alone"):
        run_of("force 1.csv;area 1.csv;S01;kalt;;;", "force 2.csv;area 1.csv;s01;kalt;;;")


@pytest.mark.parametrize("labels", [("S01", "nat", 2), ("NA", "dry", 2), ("S01", "dry", "none")])
def test_labels_that_read_like_no_value_are_labels(tmp_path: Path, labels: tuple) -> None:
    """NA is natural skin or a code, and no recording of it is lost."""
    write_table(tmp_path / "all.csv", [("S01", "dry", 1), labels])
    assert command(grouped(tmp_path, "study")) == 0
    found = load_trials(tmp_path / "study")
    assert {(t.subject, t.condition) for t in found} == {("S01", "dry"), labels[:2]}
    assert len({t.bag for t in found}) == 2


@pytest.mark.parametrize("column", range(3))
def test_presses_without_a_label_are_refused(tmp_path: Path, column: int) -> None:
    labels = ["S01", "dry", 2]
    labels[column] = ["", " ", "NaN"][column]
    write_table(tmp_path / "all.csv", [("S01", "dry", 1), tuple(labels)])
    name, first = ("Proband", "Haut", "Versuch")[column], len(TIME) + 2
    where = f"'{name}' is empty in {len(TIME)} rows with values.*rows {first} to"
    with pytest.raises(InputError, match=where):
        command(grouped(tmp_path, "study"))
    assert not (tmp_path / "study").exists()


def test_rows_without_a_label_and_a_press_are_noted(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lines = write_table(tmp_path / "all.csv", [("S01", "dry", 1), ("S01", "dry", 2)])
    for row in (2, 3, 4, len(TIME) + 2):
        lines[row] = lines[row].replace("S01,dry,1,", "S01,dry,,").replace("dry,2,", "dry,,")
    lines.append("S01,dry,,,,")
    (tmp_path / "all.csv").write_text("\n".join(lines))
    assert command(grouped(tmp_path, "study")) == 0
    said = capsys.readouterr().out
    where = f"(rows 3 to 5, {len(TIME) + 3})"
    note = f"4 rows with values have nothing in column 'Versuch', left out {where}"
    assert said.count(note) == 1


def test_areas_of_a_recording_without_force_are_not_lost(tmp_path: Path) -> None:
    write_table(tmp_path / "all.csv", [("S01", "dry", 1)])
    write_table(tmp_path / "areas.csv", [("S01", "dry", 1), ("S01", "dry", 2)])
    options = grouped(tmp_path, "study")
    options[options.index("--area") + 1] = str(tmp_path / "areas.csv")
    with pytest.raises(InputError, match="has no row with Proband S01, Haut dry, Versuch 2, as"):
        command(options)


def test_presses_of_one_clock_have_the_force_before_them(tmp_path: Path) -> None:
    """A row for each sample of a session, a column that counts its presses: each bag has its own
    press, and the tissue remembers those before; not those of another subject."""
    rest, lines = 0.3, ["Proband,Haut,Versuch,time_s,force_n,area_mm2"]
    for number in range(4):
        subject = "S01" if number < 3 else "S02"
        time = number * (2.0 + rest) + np.arange(0.0, 2.0 + rest, 0.004)
        own = time - time[0]
        force = 1.5 * np.clip(np.minimum(own - rest, 2.0 + rest - 0.1 - own) / 0.5, 0.0, 1.0)
        for row, (t, f) in enumerate(zip(time, force)):
            area = f"{60.0 * f**0.4:.4f}" if row % 25 == 0 else ""
            lines.append(f"{subject},dry,{number},{t:.4f},{f:.5f},{area}")
    (tmp_path / "all.csv").write_text("\n".join(lines))
    assert command(grouped(tmp_path, "study")) == 0
    found = load_trials(tmp_path / "study")
    assert [t.subject for t in found] == ["S01", "S01", "S01", "S02"] and not found.exclusions
    assert len({t.bag for t in found}) == 4
    for trial, presses in zip(found, (0, 1, 2, 0)):
        assert trial.peak_force == pytest.approx(1.5, abs=0.01)
        seconds = 1e-9 * (trial.stamp_ns[0] - trial.history_ns)
        assert np.sum(np.diff(trial.history > 0.2, prepend=False, append=False)) == 2 * presses
        assert not presses or seconds.max() == pytest.approx(presses * 2.3, abs=0.5)
        assert len(trial.area) < 25


def write_table(path: Path, whose: list[tuple]) -> list[str]:
    """Recordings below one another, each with its time from 0; gives the lines."""
    lines = ["Proband,Haut,Versuch,time_s,force_n,area_mm2"]
    area = dict(zip(np.searchsorted(TIME, FRAMES - 1e-9), area_at(FRAMES)))
    for number, about in enumerate(whose):
        lines += [
            ",".join([*map(str, about), f"{t:.4f}", f"{(1 + 0.1 * number) * v:.6f}", cell])
            for row, (t, v) in enumerate(zip(TIME, force_at(TIME)))
            for cell in [f"{area[row]:.5f}" if row in area else ""]
        ]
    path.write_text("\n".join(lines))
    return lines


def grouped(folder: Path, name: str) -> list[str]:
    """Arguments that import all.csv into a folder of bags."""
    table = str(folder / "all.csv")
    options = ["import", "-o", str(folder / name), "--force", table, "--area", table]
    columns = {"subject": "Proband", "condition": "Haut", "trial": "Versuch"}
    return [*options, *(t for n, c in columns.items() for t in (f"--{n}-column", c))]
