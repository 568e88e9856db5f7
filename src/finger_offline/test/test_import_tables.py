# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Tables as other programs write them: kinds of files, headings, numbers."""

from __future__ import annotations

import re
import struct
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import openpyxl
import pytest
from import_files import (
    ABOUT,
    FRAMES,
    TIME,
    area_at,
    check_trials,
    force_at,
    load_start,
    write_excel,
    write_german,
)
from xdf_files import number_header, stream_chunks, write_xdf

from finger_bag.cli import command
from finger_common.errors import InputError
from finger_common.files import read_csv
from finger_common.units import FORCE_UNITS
from finger_driver.protocols.export_table import TableFormat, parse_table
from finger_offline.importing.settings import ImportSettings
from finger_offline.importing.tables import Table, of_rows, read_table
from finger_offline.importing.trial import import_trial
from finger_offline.trials import load_trials


def arrays() -> dict[str, np.ndarray]:
    area = np.where(np.arange(len(TIME)) % 25 == 0, area_at(TIME) / 100, np.nan)
    return {"Zeit_ms": 1e3 * TIME, "Kraft_mN": -1e3 * force_at(TIME), "Fläche_cm2": area}


def write_parquet(path: Path) -> None:
    pyarrow = pytest.importorskip("pyarrow", reason="Parquet needs pyarrow")
    pytest.importorskip("pyarrow.parquet").write_table(pyarrow.table(arrays()), path)


def write_hdf5(path: Path) -> None:
    h5py = pytest.importorskip("h5py", reason="HDF5 needs h5py")
    with h5py.File(path, "w") as file:
        group = file.create_group("recordings/press")
        for name, values in arrays().items():
            group[name] = values


def write_matlab(path: Path) -> None:
    from scipy.io import savemat

    savemat(path, {"press": {k.replace("ä", "a"): v for k, v in arrays().items()}})


@pytest.mark.parametrize(
    ("name", "write", "part"),
    [
        ("log.csv", write_german, ""),
        ("log.xlsx", write_excel, "::press"),
        ("log.parquet", write_parquet, ""),
        ("log.h5", write_hdf5, "::recordings/press"),
        ("log.mat", write_matlab, "::press"),
    ],
)
def test_tables_of_other_programs_with_their_headings_and_units(
    tmp_path: Path, name: str, write: Callable[[Path], None], part: str
) -> None:
    write(tmp_path / name)
    table = str(tmp_path / name) + part
    suffix = ("_ms", "_mN", "_cm2") if name[-3:] in ("uet", ".h5", "mat") else ("", "", "")
    columns = [a + b for a, b in zip(("Zeit", "Kraft", "Fläche"), suffix)]
    if name.endswith("mat"):
        columns[2] = "Flache_cm2"
    settings = ImportSettings(
        force=table,
        area=table,
        force_time=columns[0],
        area_time=columns[0],
        force_column=columns[1],
        area_column=columns[2],
        force_sign="negative",
        moisture=["41.5", "42"],
        **ABOUT,
    )
    import_trial(settings, tmp_path / "bag")
    trials = check_trials(tmp_path / "bag")
    assert [t.moisture for t in trials] == [41.75, 41.75]


def test_names_in_hdf5_that_are_no_utf8_are_read(tmp_path: Path) -> None:
    """Programs on Windows write them so; h5py gives bytes, at which the import ended."""
    h5py = pytest.importorskip("h5py", reason="HDF5 needs h5py")
    path = tmp_path / "log.h5"
    with h5py.File(path, "w") as file:
        group = file.create_group("Prüfung".encode("latin-1"))
        group["Fläche_cm2".encode("latin-1")] = area_at(TIME)
        group["t_s"] = TIME
    with pytest.raises(InputError, match="Prüfung"):
        read_table(str(path))
    table = read_table(f"{path}::Prüfung")
    assert sorted(table.columns) == ["Fläche_cm2", "t_s"]


@pytest.mark.parametrize("encoding", ["cp1252", "utf-16", "utf-8-sig"])
def test_headings_in_the_encodings_of_other_programs(
    files: dict[str, str], tmp_path: Path, encoding: str
) -> None:
    path = tmp_path / "flaeche.csv"
    rows = Path(files["area"]).read_text().splitlines()[1:]
    text = "Messung 3, linker Finger\nZeit [s];Fläche [mm²]\n"
    text += "\n".join(rows).replace(",", ";").replace(".", ",")
    path.write_bytes(text.encode(encoding))
    named = {"area": str(path), "area_time": "Zeit", "area_column": "Fläche"}
    import_trial(ImportSettings(**{**files, **named}), tmp_path / "bag")
    check_trials(tmp_path / "bag")


@pytest.mark.parametrize("named", ["Force, mN", "force", "Fx, mN,Fy, mN,Force, mN", "Fx,Fy,Force"])
def test_a_heading_may_hold_a_comma(files: dict[str, str], tmp_path: Path, named: str) -> None:
    force = 1e3 * force_at(TIME)
    sign = -1.0 if "F" in named.replace("Force", "") else 1.0
    rows = [f"{1e3 * t:.1f};0;0;{sign * f:.4f}" for t, f in zip(TIME, force)]
    path = tmp_path / "commas.csv"
    path.write_text("\n".join(["Time, ms;Fx, mN;Fy, mN;Force, mN", *rows]))
    columns = {"force": str(path), "force_column": named, "force_time": "Time, ms"}
    import_trial(ImportSettings(**{**files, **columns}), tmp_path / "bag")
    check_trials(tmp_path / "bag")


@pytest.mark.parametrize("name", ["a.xlsx", "a.parquet", "a.h5", "a.mat", "a.npz"])
def test_damaged_tables_are_refused_in_a_sentence(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_bytes(b"\x89HDF\r\n\x1a\n" + bytes(range(256)))
    with pytest.raises(InputError, match=re.escape(name)):
        read_table(str(tmp_path / name))


def workbook(path: Path, change: Callable[[bytes], bytes]) -> str:
    """A workbook of 3,000 rows whose sheet is changed."""
    book = openpyxl.Workbook(write_only=True)
    sheet = book.create_sheet()
    sheet.append(["time_s", "force_n"])
    for number in range(3000):
        sheet.append([0.002 * number, 0.1])
    book.save(path.with_suffix(".whole"))
    with zipfile.ZipFile(path.with_suffix(".whole")) as old:
        with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as new:
            for name in old.namelist():
                data = old.read(name)
                new.writestr(name, change(data) if "sheet1" in name else data)
    return str(path)


def test_a_workbook_whose_stated_size_is_wrong_is_read_whole(tmp_path: Path) -> None:
    def small(sheet: bytes) -> bytes:
        return sheet.replace(b"<sheetData>", b'<dimension ref="A1:A9"/><sheetData>')

    path = workbook(tmp_path / "a.xlsx", small)
    assert len(read_table(path).numbers("force_n")) == 3000
    found, malformed = parse_table(
        Path(path).read_bytes(), path, TableFormat(export_value_column="force_n")
    )
    assert (len(found), malformed.rows) == (3000, 0)


def test_a_heading_that_is_there_twice_is_not_guessed(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("time_s,force_n,force_n,x,x\n0,1,2,3,4\n1,1,2,3,4\n")
    table = read_table(str(tmp_path / "a.csv"))
    assert len(table.numbers(table.heading("time_s", "--force-time"))) == 2
    with pytest.raises(InputError, match="'force_n' is there twice"):
        table.heading("force_n", "--force-column")
    with pytest.raises(InputError, match="'force_n' is there twice"):
        read_csv(tmp_path / "a.csv", ["time_s", "force_n"])


@pytest.mark.parametrize(
    ("cells", "expected"),
    [
        (["0,5", "12,25", "3"], [0.5, 12.25, 3.0]),
        (["1.234,5", "1.234", "12.345"], [1234.5, 1234.0, 12345.0]),
        (["1,234", "12,345,678"], [1234.0, 12345678.0]),
        (["0.419", "1.234", "999"], [0.419, 1.234, 999.0]),
        (["1.234", "2.500", "99"], [1.234, 2.5, 99.0]),
        (["1,5e-3", "n/a"], [0.0015, np.nan]),
    ],
)
def test_the_decimal_mark_is_that_of_the_column(cells: list[str], expected: list[float]) -> None:
    table = Table("t", {"a": cells})
    assert np.array_equal(table.numbers("a", gaps=True), expected, equal_nan=True)


@pytest.mark.parametrize("mark", [".", ","])
def test_thousands_that_may_be_decimals_are_refused(mark: str) -> None:
    """1.419 mN beside 998 mN: 1419 or 1.419?"""
    table = Table("t.csv", {"mN": ["5", "998", f"1{mark}419"]}, first_row=2)
    with pytest.raises(InputError, match=r"row 4, column 'mN': .* may have a mark between"):
        table.numbers("mN")
    with pytest.raises(InputError, match=r"row 3, .* no number with the decimal mark ','"):
        Table("t.csv", {"mN": ["0,5", "1.5"]}, first_row=2).numbers("mN")


def test_two_blocks_of_one_sheet_may_differ_in_length(
    files: dict[str, str], tmp_path: Path
) -> None:
    book = openpyxl.Workbook()
    sheet = book.active
    sheet.append(["Sensor", None, None, "Kamera"])
    sheet.merge_cells("A1:B1")
    sheet.append(["Zeit [s]", "Fz [N]", None, "Zeit [s]", "Fläche [mm²]"])
    for row, (time, force) in enumerate(zip(TIME, force_at(TIME)), 3):
        sheet.cell(row, 1, float(time))
        sheet.cell(row, 2, float(force))
    for row, (time, area) in enumerate(zip(FRAMES, area_at(FRAMES)), 3):
        sheet.cell(row, 4, float(time))
        sheet.cell(row, 5, float(area))
    book.save(tmp_path / "two.xlsx")
    one = {"force": str(tmp_path / "two.xlsx"), "area": str(tmp_path / "two.xlsx"), **ABOUT}
    named = {"force_column": "Fz", "area_column": "Fläche", "force_time": "Zeit"}
    with pytest.raises(InputError, match=r"'Zeit' is there twice; name one of 'Zeit \[s\] #1', "):
        import_trial(ImportSettings(**one, **named, area_time="Zeit"), tmp_path / "bag")
    named["force_time"] = "Zeit [s] #1"
    import_trial(ImportSettings(**one, **named, area_time="Zeit [s] #2"), tmp_path / "bag")
    check_trials(tmp_path / "bag")


@pytest.mark.parametrize("separator", [" ", "  ", "|", "\t"])
def test_columns_between_blanks_and_bars(
    files: dict[str, str], tmp_path: Path, separator: str
) -> None:
    rows = Path(files["force"]).read_text().splitlines()[1:]
    text = "\n".join([separator.join(["# Zeit [s]", "Fz [N]"]), *rows, ","])
    (tmp_path / "force.dat").write_text(text.replace(",", separator))
    named = {"force": str(tmp_path / "force.dat"), "force_time": "Zeit", "force_column": "Fz"}
    import_trial(ImportSettings(**{**files, **named}), tmp_path / "bag")
    check_trials(tmp_path / "bag")


def test_quoted_cells_may_follow_a_blank(files: dict[str, str], tmp_path: Path) -> None:
    rows = [line.split(",") for line in Path(files["force"]).read_text().splitlines()]
    text = "\n".join(", ".join(f'"{cell}"' for cell in row) for row in rows)
    Path(files["force"]).write_text(text)
    import_trial(ImportSettings(**files), tmp_path / "bag")
    check_trials(tmp_path / "bag")


def test_commas_that_are_decimal_marks_and_separators_are_refused(
    files: dict[str, str], tmp_path: Path
) -> None:
    text = "time_s,force_n\n" + "".join(f"{i // 10},{i % 10},0,{i % 7}\n" for i in range(30))
    Path(files["force"]).write_text(text)
    with pytest.raises(InputError, match=r"decimal mark and separator at once, .*semicolons"):
        import_trial(ImportSettings(**files), tmp_path / "bag")


def test_formulas_without_values_are_told_the_remedy(tmp_path: Path) -> None:
    book = openpyxl.Workbook()
    book.active.append(["time_s", "raw", "force_n"])
    for row in range(2, 9):
        book.active.append([0.1 * row, 1.0, f"=B{row}*2"])
    book.save(tmp_path / "f.xlsx")
    with pytest.raises(InputError, match=r"'force_n' holds no number.*formulas.*save it"):
        read_table(str(tmp_path / "f.xlsx")).numbers("force_n", gaps=True)


def test_axes_of_different_lengths_are_refused(files: dict[str, str], tmp_path: Path) -> None:
    columns = {"t_s": TIME, "fx_n": 0 * TIME, "fy_n": 0 * TIME[1:], "fz_n": -force_at(TIME)}
    np.savez(tmp_path / "axes.npz", **columns)
    named = {"force": str(tmp_path / "axes.npz"), "force_time": "t_s"}
    settings = {**files, **named, "force_column": "fx_n,fy_n,fz_n"}
    with pytest.raises(InputError, match="columns 't_s' and 'fy_n' have 2250 and 2249 values"):
        import_trial(ImportSettings(**settings), tmp_path / "bag")


def test_arrays_of_different_lengths_in_one_file(
    files: dict[str, str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    both = {"area_mm2": area_at(FRAMES), "fz_n": force_at(TIME), "run": np.ones(len(TIME))}
    np.savez(tmp_path / "all.npz", **both)
    path, about = str(tmp_path / "all.npz"), ["--subject", "S01", "--condition", "dry"]
    command_line = ["import", "-o", str(tmp_path / "bag"), "--force", path, "--area", path, *about]
    command_line += ["--force-column", "fz_n", "--area-column", "area_mm2"]
    rates = [f"--force-rate={1 / np.diff(TIME)[0]:g}", f"--frame-rate={1 / np.diff(FRAMES)[0]:g}"]
    assert command([*command_line, *rates]) == 0, capsys.readouterr().err
    assert load_trials(tmp_path / "bag").trials
    with pytest.raises(InputError, match="column 'area_mm2' has"):
        command([*command_line, *rates, "--trial-column", "run", "-o", str(tmp_path / "no")])


@pytest.fixture
def matlab_parts(tmp_path: Path) -> dict[str, Path]:
    """The same structs as MATLAB writes them in its older and its HDF5 files."""
    import h5py
    from scipy.io import savemat

    camera = {"t": FRAMES, "A": area_at(FRAMES)}
    one = {"t": TIME, "F": force_at(TIME), "camera": camera}
    old, new = tmp_path / "old.mat", tmp_path / "new.mat"
    savemat(old, {"data": one, "trial": [one, one]})
    with h5py.File(new, "w", userblock_size=512) as file:
        for name in ("data", "#refs#/a"):
            group = file.create_group(name)
            for key, value in (("t", TIME), ("F", force_at(TIME))):
                group[key] = value[None, :]
            for key, value in camera.items():
                group.create_group("camera") if "camera" not in group else None
                group["camera"][key] = value[None, :]
        trial = file.create_group("trial")
        for key in ("t", "F", "camera"):
            cell = trial.create_dataset(key, (1, 2), dtype=h5py.ref_dtype)
            cell[0, 0] = cell[0, 1] = file["#refs#/a"][key].ref
        file["both"] = np.stack([TIME, force_at(TIME)])
    with open(new, "r+b") as raw:
        raw.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM")
    return {"old": old, "new": new}


@pytest.mark.parametrize("kind", ["old", "new"])
@pytest.mark.parametrize("part", ["data", "trial(2)"])
def test_structs_of_matlab(
    matlab_parts: dict[str, Path], tmp_path: Path, kind: str, part: str
) -> None:
    file = matlab_parts[kind]
    named = {"force": f"{file}::{part}", "area": f"{file}::{part}.camera", **ABOUT}
    columns = {"force_time": "t", "force_column": "F", "area_time": "t", "area_column": "A"}
    units = {"force_unit": "N", "area_unit": "mm2"}
    import_trial(ImportSettings(**named, **columns, **units), tmp_path / "bag")
    check_trials(tmp_path / "bag")
    with pytest.raises(InputError, match=r"'trial\(3\)' does not exist"):
        read_table(f"{file}::trial(3)")
    with pytest.raises(InputError, match=r"PART.*data.*trial\(1\)"):
        read_table(str(file)).heading("time_s", "--force-time")


def test_matrices_lie_either_way(matlab_parts: dict[str, Path], tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", np.column_stack([TIME, force_at(TIME)]))
    for name in (f"{matlab_parts['new']}::both", str(tmp_path / "a.npy")):
        assert np.allclose(read_table(name).numbers("2"), force_at(TIME))


def test_numbers_of_other_countries() -> None:
    rows = [(1, ["a", "b"]), (2, ["1.234,5", "1,234.5"]), (3, ["-0,5", ""])]
    table = of_rows("t", rows)
    assert table.numbers("a").tolist() == [1234.5, -0.5]
    assert table.numbers("b", gaps=True)[0] == 1234.5
    with pytest.raises(InputError, match="row 3"):
        table.numbers("b")


@pytest.mark.parametrize(
    "before",
    [
        [["Subject", "S01"], ["Date", "2024-05-01"], ["Rate", "500 Hz"]],
        [["Logger 3", ""], ["Channel", "Value"]],
        [],
    ],
)
@pytest.mark.parametrize("units", [[], [["s", "g"]], [["[s]", "[g]"]]])
def test_headings_stand_above_the_numbers(before: list[Any], units: list[Any]) -> None:
    values = [[str(k / 10), str(50 * k)] for k in range(8)]
    rows = [*before, ["Time", "Load"], *units, *values, ["0.8", "n/a"]]
    table = of_rows("t", list(enumerate(rows, 1)))
    assert list(table.columns) == ["Time", "Load"]
    expected = [*(50.0 * k for k in range(8)), np.nan]
    assert np.array_equal(table.numbers("Load", gaps=True), expected, equal_nan=True)
    assert table.unit("Load", FORCE_UNITS) == ("gf" if units else None)
    assert table.first_row == len(before) + len(units) + 2


def test_a_table_of_texts_has_its_headings_first() -> None:
    """A table of trials may hold no number, or a row of nothing but numbers."""
    for first in ("f1.csv", "-"):
        rows = [["force", "subject"], [first, "S01"], ["f2.csv", "S01"], ["3", "4"]]
        assert list(of_rows("t", list(enumerate(rows, 1))).columns) == ["force", "subject"]


def test_another_sheet_is_named_where_the_first_one_does_not_do(tmp_path: Path) -> None:
    write_excel(tmp_path / "log.xlsx")
    other = r"another part as FILE::PART \(press\)"
    with pytest.raises(InputError, match=f"no row of values.*{other}"):
        read_table(str(tmp_path / "log.xlsx"))
    book = openpyxl.load_workbook(tmp_path / "log.xlsx")
    book.worksheets[0].append([1.0])
    book.save(tmp_path / "log.xlsx")
    with pytest.raises(InputError, match=f"'area_mm2' does not exist.*{other}"):
        read_table(str(tmp_path / "log.xlsx")).heading("area_mm2", "--area-column")


def test_streams_of_the_lab_streaming_layer_make_a_bag_fit_for_use(tmp_path: Path) -> None:
    """Force from a second computer whose clock is 3 s behind, areas from this one, and markers."""
    pytest.importorskip("pyxdf", reason="pyxdf is not installed")
    behind = 3.0

    def stream(number: int, name: str, labels: dict[str, str], *data: np.ndarray) -> bytes:
        time, *columns = data
        values = [struct.pack(f"<{len(row)}d", *row) for row in np.column_stack(columns)]
        offset = behind if name == "plate" else 0.0
        header = number_header(name, "Force", labels)
        return stream_chunks(number, header, time - offset, values, [offset] * 9)

    zero = np.zeros_like(TIME)
    file = write_xdf(
        tmp_path / "session.xdf",
        stream(
            1,
            "plate",
            {"Fx": "mN", "Fy": "mN", "Fz": "mN"},
            *(100.0 + TIME, zero, zero, -1e3 * force_at(TIME)),
        ),
        stream(2, "area", {"gross": "mm²"}, 100.0 + FRAMES, area_at(FRAMES)),
    )
    with pytest.raises(InputError, match=r"holds 2 streams of numbers.*::STREAM \(plate, area\)"):
        read_table(str(file))
    with pytest.raises(InputError, match="no stream is called 'plat'; did you mean 'plate'"):
        read_table(f"{file}::plat")
    settings = ImportSettings(
        force=f"{file}::plate",
        force_column="Fx,Fy,Fz",
        area=f"{file}::area",
        area_column="gross",
        **ABOUT,
    )
    bag = tmp_path / "bag"
    import_trial(settings, bag)
    check_trials(bag, 1e-4)
    # The clock of the file, not that of the import.
    assert load_start(bag) == pytest.approx(1795348800 * 10**9, abs=10**9)


def test_a_packed_table_is_to_be_unpacked(tmp_path: Path) -> None:
    (tmp_path / "force.csv.gz").touch()
    with pytest.raises(InputError, match=r"force.csv.gz: no table of a known kind; unpack it"):
        read_table(str(tmp_path / "force.csv.gz"))
