# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Files of a laboratory become session bags that are fit for use, or are refused in a sentence."""

from __future__ import annotations

import re
import struct
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import openpyxl
import pytest
from xdf_files import number_header, stream_chunks, write_xdf

from finger_bag.cli import command
from finger_bag.reader import open_bag
from finger_bag.validate import validate
from finger_common.cli import run
from finger_common.errors import InputError
from finger_common.files import read_csv
from finger_common.image_size import ALL_PIXELS, PixelBudget
from finger_common.units import FORCE_UNITS
from finger_driver.protocols.export_table import TableFormat, parse_table
from finger_model.reduced import ReducedModel
from finger_offline.importing.cells import stamp_of
from finger_offline.importing.pictures import frames_of
from finger_offline.importing.settings import ImportSettings
from finger_offline.importing.tables import Table, of_rows, read_table
from finger_offline.importing.trial import import_trial
from finger_offline.process import process
from finger_offline.process_options import ProcessOptions
from finger_offline.trial_records import TrialRecord
from finger_offline.trials import load_trials
from finger_offline.unloaded import without_spikes
from finger_vision.images import read_signal

TIME = np.arange(0.0, 9.0, 0.004)
FRAMES = np.arange(0.0, 9.0, 0.1)
FIFTEEN = np.arange(0.0, 20.0, 1 / 15)
ABOUT = {"subject": "S01", "condition": "dry"}


NOISE = "time_s,force_n\n" + "".join(f"{0.1 * i:.1f},{i % 3}\n" for i in range(3100))


def force_at(time: np.ndarray) -> np.ndarray:
    """Two presses, to 1.5 and to 1.2 N, with a tremor that keeps samples apart."""
    first = 1.5 * np.clip(np.minimum(time - 0.5, 3.0 - time), 0.0, 1.0)
    both = first + 1.2 * np.clip(np.minimum(time - 5.0, 8.0 - time), 0.0, 1.0)
    return both * (1.0 + 0.002 * np.sin(50.0 * time))


def area_at(time: np.ndarray) -> np.ndarray:
    """mm²."""
    return 60.0 * force_at(time) ** 0.4


def csv(path: Path, heading: str, *columns: np.ndarray) -> str:
    np.savetxt(path, np.column_stack(columns), "%.6f", ",", header=heading, comments="")
    return str(path)


@pytest.fixture
def files(tmp_path: Path) -> dict[str, str]:
    """Settings that name a force and an area file as the contract has them."""
    return {
        "force": csv(tmp_path / "force.csv", "time_s,force_n", TIME, force_at(TIME)),
        "area": csv(tmp_path / "area.csv", "time_s,area_mm2", FRAMES, area_at(FRAMES)),
        **ABOUT,
    }


def check_trials(bag: Path, tolerance: float = 1e-5) -> list[TrialRecord]:
    """The bag is fit for use and gives both presses with their forces and areas."""
    result = validate(bag)
    assert result.fit, result.to_data()
    found = load_trials(bag)
    assert found.problems == [] and found.exclusions == []
    assert [(t.subject, t.condition) for t in found] == [("S01", "dry")] * 2
    for trial, peak in zip(found, (1.5, 1.2)):
        assert trial.peak_force == pytest.approx(peak, rel=0.01)
        assert trial.target_force == pytest.approx(0.95 * trial.peak_force, abs=0.011)
        start = load_start(bag)
        time = (trial.stamp_ns - start) * 1e-9
        assert np.allclose(trial.force, force_at(time), atol=max(tolerance, 1e-3))
        frames = (trial.area_stamp_ns - start) * 1e-9
        assert np.allclose(trial.area * 1e6, area_at(frames), atol=60 * tolerance)
    return list(found)


def load_start(bag: Path) -> int:
    with open_bag(bag) as reader:
        assert reader.info.start_ns is not None
        return reader.info.start_ns


def test_csv_files_of_the_contract_make_a_bag_fit_for_use(
    files: dict[str, str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bag = tmp_path / "bag"
    options = [f"--{k}={v}" for k, v in files.items()]
    assert command(["import", "-o", str(bag), *options]) == 0
    assert "2 presses" in capsys.readouterr().out
    trials = check_trials(bag)
    assert [t.index for t in trials] == [0, 1]
    assert trials[0].onset_ns > load_start(bag)
    with open_bag(bag) as reader:
        text = reader.info.metadata.to_mapping()
    assert text["source"] == "finger-bag import" and "area.csv sha256:" in text["files"]


def test_areas_of_a_table_have_a_deviation_and_correct_the_model(
    files: dict[str, str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for share in (0.03, 0.1):
        imported = import_trial(ImportSettings(**files, area_sd=share), tmp_path / f"{share}")
        found = load_trials(imported.path).trials[0]
        assert np.allclose(found.area_sd, np.maximum(share * found.area, 0.5e-6), rtol=1e-5)
    assert command(["process", str(tmp_path / "0.03"), "-o", str(tmp_path / "out")]) == 0
    assert "AREA_REJECTED" not in capsys.readouterr().out


def write_german(path: Path) -> None:
    lines = ["Messung 3;Kraft und Fläche", "", "Zeit;Kraft;Fläche", "ms;mN;cm²"]
    for number, (time, force) in enumerate(zip(TIME, force_at(TIME))):
        area = f"{area_at(np.array(time)) / 100:.5f}" if number % 25 == 0 else ""
        lines.append(f"{1e3 * time:.1f};{-1e3 * force:.2f};{area}".replace(".", ","))
    path.write_text("\n".join(lines), encoding="utf-8")


def write_excel(path: Path) -> None:
    openpyxl = pytest.importorskip("openpyxl", reason="XLSX needs openpyxl")
    book = openpyxl.Workbook()
    book.active.append(["not this sheet"])
    sheet = book.create_sheet("press")
    sheet.append(["Zeit [ms]", "Kraft (mN)", "Fläche/cm²"])
    for number, (time, force) in enumerate(zip(TIME, force_at(TIME))):
        area = float(area_at(np.array(time))) / 100 if number % 25 == 0 else None
        sheet.append([1e3 * time, -1e3 * force, area])
    book.save(path)


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


PIXEL = 2.5e-9


def picture(area: float, rng: np.random.Generator) -> np.ndarray:
    """FTIR-like frame (240, 320): ridges darken where the finger touches; area in mm²."""
    y, x = np.mgrid[:240, :320]
    radius = np.sqrt(area * 1e-6 / np.pi / PIXEL)
    touched = (np.hypot(x - 160, y - 120) < radius) & (np.sin(x / 2.0) > 0)
    image = np.where(touched, 60.0, 200.0) + rng.normal(0.0, 2.0, x.shape)
    return image.clip(0, 255).astype(np.uint8)


def test_a_video_and_a_folder_of_images_give_areas(files: dict[str, str], tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    times = np.arange(0.0, 4.0, 0.1)
    video = cv2.VideoWriter(
        str(tmp_path / "v.avi"), cv2.VideoWriter_fourcc(*"MJPG"), 10.0, (320, 240), False
    )
    (tmp_path / "images").mkdir()
    for number, time in enumerate(times):
        image = picture(float(area_at(time)), rng)
        video.write(image)
        cv2.imwrite(str(tmp_path / "images" / f"press{number}.png"), image)
    video.release()
    csv(tmp_path / "times.csv", "image,time_ms", np.arange(len(times)), 1e3 * times)
    sources: dict[str, dict[str, Any]] = {
        "video": {"video": str(tmp_path / "v.avi")},
        "images": {
            "images": str(tmp_path / "images"),
            "image_times": str(tmp_path / "times.csv"),
            "area_time": "time_ms",
            "keep_images": True,
        },
    }
    for name, source in sources.items():
        settings = ImportSettings(force=files["force"], area_per_pixel=PIXEL, **source, **ABOUT)
        result = import_trial(settings, tmp_path / f"bag_{name}")
        assert "press 1: 0 areas" in " ".join(result.notes)
        assert validate(tmp_path / f"bag_{name}").fit
        (trial,) = load_trials(tmp_path / f"bag_{name}").trials
        frames = (trial.area_stamp_ns - load_start(tmp_path / f"bag_{name}")) * 1e-9
        assert np.allclose(np.diff(frames), 0.1, atol=1e-6)
        pressed = trial.area > 0
        assert pressed.sum() > 20
        true = area_at(frames[pressed])
        # The ridges end up to a period before the outline.
        assert np.allclose(trial.area[pressed] * 1e6, true, rtol=0.12)
        with open_bag(tmp_path / f"bag_{name}") as reader:
            kept = reader.topic("image_raw/compressed")
            assert (kept is not None) == (name == "images")


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
        ({"subject": "../S01"}, r"subject .* is no name"),
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


def test_rows_without_a_force_are_left_out_and_told(files: dict[str, str], tmp_path: Path) -> None:
    path = Path(files["force"])
    heading, *rows = path.read_text().splitlines()
    for k, cell in ((700, "NaN"), (701, ""), (702, "nan")):
        rows[k] = f"{rows[k].split(',')[0]},{cell}"
    path.write_text("\n".join([heading, *rows]) + "\n")
    found = import_trial(ImportSettings(**files), tmp_path / "bag")
    assert any("3 rows without a force" in note for note in found.notes)
    check_trials(tmp_path / "bag")


def test_times_in_milliseconds_without_a_unit_are_refused(
    files: dict[str, str], tmp_path: Path
) -> None:
    csv(Path(files["force"]), "time_s,force_n", TIME * 1e3, force_at(TIME))
    with pytest.raises(InputError, match=r"first press lasts 2.*e\+03 s; .*--time-unit"):
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
    with pytest.raises(InputError, match=r"drifts from 0.00 N to 0.1\d N .* without drift"):
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


def long_files(tmp_path: Path, area_time: np.ndarray) -> dict[str, str]:
    """Five presses of the model's finger, with areas at 15 Hz."""
    time, frames = np.arange(0.0, 20.0, 0.004), np.arange(0.0, 20.0, 1 / 15)
    force = 1.4 * np.clip(np.minimum(time % 4.0 - 0.5, 2.5 - time % 4.0), 0.0, 1.0)
    model = ReducedModel.load()
    natural = model.space.default[None]
    ((areas, travels),) = model.contacts(natural, [(time, force, np.arange(len(time)))])
    seen = 1e6 * np.interp(area_time, time, areas[0])
    csv(tmp_path / "laser.csv", "time_s,indentation_mm", time, 1e3 * travels[0])
    return {
        "force": csv(tmp_path / "long_f.csv", "time_s,force_n", time, force),
        "area": csv(tmp_path / "long_a.csv", "time_s,area_mm2", frames, seen),
        **ABOUT,
    }


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


def test_images_of_two_cameras_in_one_folder_are_refused(
    files: dict[str, str], tmp_path: Path
) -> None:
    folder = tmp_path / "frames"
    folder.mkdir()
    image = np.zeros((96, 96), np.uint8)
    for number in range(8):
        cv2.imwrite(str(folder / f"cam{number % 2}_{number:04d}.png"), image)
    files |= {"images": str(folder), "area": ""}
    settings = ImportSettings(**files, frame_rate=10.0, area_per_pixel=1e-9)
    with pytest.raises(InputError, match=r"two series of images, 'cam0_' and 'cam1_'.*folder"):
        import_trial(settings, tmp_path / "bag")
    for number in range(8):  # one series, whose names begin in two ways
        name = f"cam{number % 2}_{number:04d}.png"
        (folder / name).rename(folder / f"day{number // 4}_{number:04d}.png")
    with pytest.raises(InputError, match="no area above zero"):
        import_trial(settings, tmp_path / "bag")


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
    assert (len(found), malformed) == (3000, 0)


def test_a_heading_that_is_there_twice_is_not_guessed(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("time_s,force_n,force_n,x,x\n0,1,2,3,4\n1,1,2,3,4\n")
    table = read_table(str(tmp_path / "a.csv"))
    assert len(table.numbers(table.heading("time_s", "--force-time"))) == 2
    with pytest.raises(InputError, match="'force_n' is there twice"):
        table.heading("force_n", "--force-column")
    with pytest.raises(InputError, match="'force_n' is there twice"):
        read_csv(tmp_path / "a.csv", ["time_s", "force_n"])


def test_what_is_cut_off_of_a_video_is_named(
    files: dict[str, str], tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    rng = np.random.default_rng(0)
    code = cv2.VideoWriter_fourcc(*"MJPG")
    video = cv2.VideoWriter(str(tmp_path / "v.avi"), code, 10.0, (320, 240), False)
    for time in np.arange(0.0, 4.0, 0.1):
        video.write(picture(float(area_at(time)), rng))
    video.release()
    data = (tmp_path / "v.avi").read_bytes()
    (tmp_path / "cut.avi").write_bytes(data[: 3 * len(data) // 4])
    # In the header of the container, and in those of the frames.
    for form, sizes in (("<ii", (320, 240)), (">HH", (240, 320))):
        data = data.replace(struct.pack(form, *sizes), struct.pack(form, 16000, 16000))
    (tmp_path / "claims.avi").write_bytes(data)
    options = ["--force", files["force"], "--area-per-pixel", str(PIXEL), "--subject", "S01"]
    options = ["import", *options, "--condition", "dry"]
    whole, cut, claims = (
        ["--video", str(tmp_path / f"{name}.avi"), "-o", str(tmp_path / name)]
        for name in ("v", "cut", "claims")
    )
    run(command, [*options, *whole])
    assert "problem" not in capfd.readouterr().out
    assert run(command, [*options, *cut]) == 1
    assert "of 40 frames could be read" in capfd.readouterr().out
    assert run(command, [*options, *claims]) == 2
    said = capfd.readouterr().err
    assert "claims.avi: " in said and said.count("\n") == 1
    assert not (tmp_path / "claims").exists()


def test_a_video_or_a_folder_holds_no_more_pixels_than_its_bytes_explain(
    files: dict[str, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def budget(*_: int) -> PixelBudget:
        made = PixelBudget()
        made.take(ALL_PIXELS - 29 * 320 * 240)
        return made

    rng = np.random.default_rng(0)
    code = cv2.VideoWriter_fourcc(*"MJPG")
    video = cv2.VideoWriter(str(tmp_path / "v.avi"), code, 10.0, (320, 240), False)
    (tmp_path / "images").mkdir()
    for number, time in enumerate(np.arange(0.0, 4.0, 0.1)):
        image = picture(float(area_at(time)), rng)
        video.write(image)
        cv2.imwrite(str(tmp_path / "images" / f"{number}.png"), image)
    video.release()
    monkeypatch.setattr("finger_offline.importing.pictures.PixelBudget", budget)
    for what, name in (("video", "v.avi"), ("images", "images")):
        source: dict[str, Any] = {what: str(tmp_path / name), "frame_rate": 10.0}
        settings = ImportSettings(force=files["force"], area_per_pixel=PIXEL, **source, **ABOUT)
        result = import_trial(settings, tmp_path / f"bag_{what}")
        assert len(result.areas) == 29
        assert "only the first 29 " in " ".join(result.problems)


def test_a_date_that_64_bits_do_not_hold_is_refused() -> None:
    stamps = np.array([10**18, 2 * 10**18], "datetime64[s]")
    with pytest.raises(InputError, match=r"t\.parquet, row 1, column 'time'.* is no time"):
        Table("t.parquet", {"time": stamps}).times("time")


@pytest.mark.parametrize("name", ["..", ".hidden", "-o", "a/b", "\x1b[2J", "x" * 300])
def test_names_of_bags_in_a_table_of_trials(
    files: dict[str, str], tmp_path: Path, name: str
) -> None:
    cells = [f'"{name}"', "S01", "dry", files["force"], files["area"]]
    (tmp_path / "t.csv").write_text("name,subject,condition,force,area\n" + ",".join(cells) + "\n")
    with pytest.raises(InputError, match=r"row 2: .* is no name for a bag"):
        command(["import", "-o", str(tmp_path / "no"), "--trials", str(tmp_path / "t.csv")])
    assert not (tmp_path / "no").exists()


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


@pytest.mark.parametrize(
    "name", ["im_{0:.0f}ms", "20240501_134510_{0:04.0f}", "{1}", "17145711{2}"]
)
def test_names_of_images_may_be_times(tmp_path: Path, name: str) -> None:
    times = np.array([107.0, 1074.0, 9841.0])
    for time in times:
        text = name.format(time, 1_714_571_110_000 + round(time), f"10.{round(time):04d}")
        cv2.imwrite(str(tmp_path / f"{text}.png"), np.zeros((96, 96), np.uint8))
    settings = ImportSettings(
        force="x",
        images=str(tmp_path),
        area_per_pixel=1e-9,
        **ABOUT,  # type: ignore[arg-type]
    )
    frames, count, absolute = frames_of(settings, [])
    stamps = np.array([stamp for stamp, _ in frames])
    scale = 1e6 if name.startswith(("im", "{1}")) else 1e5
    assert count == 3 and absolute == (not name.startswith("im"))
    assert np.array_equal(np.diff(stamps), np.round(np.diff(times) * scale))


def test_pages_of_one_file_and_dark_pixels_are_refused(
    files: dict[str, str], tmp_path: Path
) -> None:
    given = {**files, "area": "", "frame_rate": 10.0, "area_per_pixel": 1e-9}
    stack = tmp_path / "stack.tif"
    cv2.imwritemulti(str(stack), [np.full((96, 96), 90, np.uint8)] * 3)
    with pytest.raises(InputError, match=r"stack\.tif: is an image and no video; save its pages"):
        import_trial(ImportSettings(**given, video=str(stack)), tmp_path / "bag")
    with pytest.raises(InputError, match=r"stack\.tif: has several pages"):
        read_signal(stack)
    cv2.imwrite(str(tmp_path / "one.tif"), np.full((96, 96), 90, np.uint8))
    assert read_signal(tmp_path / "one.tif").shape == (96, 96)
    (tmp_path / "dark").mkdir()
    for number in range(4):
        image = np.full((96, 96), 16 * (200 + number), np.uint16)
        cv2.imwrite(str(tmp_path / "dark" / f"{number}.png"), image)
    with pytest.raises(
        InputError, match=r"the plate is dark.* pixels of 12 bits; multiply them by 16"
    ):
        import_trial(ImportSettings(**given, images=str(tmp_path / "dark")), tmp_path / "bag")


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


def test_axes_of_different_lengths_are_refused(files: dict[str, str], tmp_path: Path) -> None:
    columns = {"t_s": TIME, "fx_n": 0 * TIME, "fy_n": 0 * TIME[1:], "fz_n": -force_at(TIME)}
    np.savez(tmp_path / "axes.npz", **columns)
    named = {"force": str(tmp_path / "axes.npz"), "force_time": "t_s"}
    settings = {**files, **named, "force_column": "fx_n,fy_n,fz_n"}
    with pytest.raises(InputError, match="columns 't_s' and 'fy_n' have 2250 and 2249 values"):
        import_trial(ImportSettings(**settings), tmp_path / "bag")


def test_a_tare_that_passes_leaves_a_press_its_target(
    files: dict[str, str], tmp_path: Path
) -> None:
    first = TIME < 4.0
    csv(Path(files["force"]), "time_s,force_n", TIME[first], force_at(TIME[first]) + 0.09)
    import_trial(ImportSettings(**files), tmp_path / "bag")
    (trial,) = load_trials(tmp_path / "bag")
    assert trial.target_force == pytest.approx(0.95 * 1.5, abs=0.011)


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


def test_numbers_of_frames_are_no_seconds(files: dict[str, str], tmp_path: Path) -> None:
    counts = np.arange(len(FRAMES), dtype=float)
    named = {"area": csv(tmp_path / "p.csv", "frame,area_mm2", counts, area_at(FRAMES))}
    settings = {**files, **named, "area_time": "frame"}
    with pytest.raises(InputError, match=r"'frame' counts rows; give --frame-rate in place of it"):
        import_trial(ImportSettings(**settings), tmp_path / "bag")
    import_trial(ImportSettings(**settings, frame_rate=10.0), tmp_path / "bag")
    check_trials(tmp_path / "bag")


def test_areas_in_pixels(files: dict[str, str], tmp_path: Path) -> None:
    pixels = area_at(FRAMES) * 1e-6 / 9.86e-10
    named = {"area": csv(tmp_path / "p.csv", "time_s,Area [px]", FRAMES, pixels)}
    settings = {**files, **named, "area_column": "Area"}
    with pytest.raises(InputError, match=r"areas in px; --area-per-pixel"):
        import_trial(ImportSettings(**settings), tmp_path / "bag")
    import_trial(ImportSettings(**settings, area_per_pixel=9.86e-10), tmp_path / "bag")
    check_trials(tmp_path / "bag")


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


def test_a_force_that_is_nowhere_beside_a_time_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "wide.csv"
    path.write_text("t_s,fz_n\n" + "".join(f"{k / 100},\n" for k in range(50)) + ",1.0\n" * 50)
    about = ["--subject", "S01", "--condition", "dry", "--area", str(path)]
    about += ["--force-column", "fz_n", "--force-time", "t_s"]
    with pytest.raises(InputError, match="no row has both a time"):
        command(["import", "-o", str(tmp_path / "bag"), "--force", str(path), *about])


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


def test_images_by_name_of_one_size_and_without_a_gap(
    files: dict[str, str], tmp_path: Path
) -> None:
    folder = tmp_path / "images"
    folder.mkdir()
    for number in range(len(FRAMES)):
        cv2.imwrite(str(folder / f"{number + 1}.png"), plate(area_at(FRAMES[number])))
    # The order of a text column: 1, 10, 11, …
    order = sorted(range(len(FRAMES)), key=lambda i: f"{i + 1}.png")
    lines = ["file,time_s", *(f"{i + 1}.png,{FRAMES[i]:.3f}" for i in order)]
    (tmp_path / "times.csv").write_text("\n".join(lines))
    settings = {"force": files["force"], "images": str(folder), "area_per_pixel": 1e-8, **ABOUT}
    timed = ImportSettings(**settings, image_times=str(tmp_path / "times.csv"))
    found = import_trial(timed, tmp_path / "bag")
    assert np.corrcoef(found.areas, area_at(FRAMES))[0, 1] > 0.99
    cv2.imwrite(str(folder / "7.png"), np.zeros((60, 80), np.uint8))
    with pytest.raises(InputError, match=r"7\.png: has 80 × 60 pixels, .*one size"):
        import_trial(timed, tmp_path / "sizes")
    (folder / "7.png").unlink()
    with pytest.raises(InputError, match=r"column 'file': image '7\.png' does not exist"):
        import_trial(timed, tmp_path / "missing")
    with pytest.raises(InputError, match=r"missing between 6\.png and 8\.png.*--image-times"):
        import_trial(ImportSettings(**settings, frame_rate=10.0), tmp_path / "gap")


def test_images_that_a_camera_repeats_give_no_area(files: dict[str, str], tmp_path: Path) -> None:
    """It froze within the first press, for as long as the second took."""
    rng = np.random.default_rng(0)
    folder = tmp_path / "images"
    folder.mkdir()
    for number, time in enumerate(FRAMES):
        if not 2.0 < time < 8.3:
            image = picture(float(area_at(time)), rng)
        cv2.imwrite(str(folder / f"{number}.png"), image)
    repeated = int(np.count_nonzero((FRAMES > 2.0) & (FRAMES < 8.3)))
    source = {"images": str(folder), "area": "", "frame_rate": 10.0, "area_per_pixel": PIXEL}
    found = import_trial(ImportSettings(**{**files, **source}), tmp_path / "bag")
    assert len(found.areas) == len(FRAMES) - repeated
    assert any(f"{repeated} images equal the one before" in note for note in found.notes)
    # The same from the images of the bag.
    kept = ImportSettings(**{**files, **source}, keep_images=True)
    bag = import_trial(kept, tmp_path / "kept").path
    result = process(bag, tmp_path / "out", ProcessOptions(images="yes"))
    assert result.areas == len(found.areas) and not result.lost
    assert any(f"{repeated} images equal the one before" in text for text in result.problems)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (["minimum_area"], "give NAME=VALUE, such as minimum_area"),
        (["minimum_aria=1e-6"], "'minimum_aria' is no setting of the area sensor"),
        (["minimum_area=2"], "parameter 'minimum_area' is 2"),
        (["minimum_area=4e-5"], ""),
    ],
)
def test_areas_are_measured_with_the_settings_of_the_rig(
    files: dict[str, str], tmp_path: Path, given: list[str], words: str
) -> None:
    """Of a vision node that leaves small contacts out."""
    rng = np.random.default_rng(0)
    folder = tmp_path / "images"
    folder.mkdir()
    for number, time in enumerate(FRAMES):
        cv2.imwrite(str(folder / f"{number}.png"), picture(float(area_at(time)), rng))
    source = {"images": str(folder), "area": "", "frame_rate": 10.0, "area_per_pixel": PIXEL}
    if words:
        with pytest.raises(InputError, match=words):
            ImportSettings(**{**files, **source}, set=given)
        return
    plain = import_trial(ImportSettings(**{**files, **source}, keep_images=True), tmp_path / "bag")
    own = import_trial(ImportSettings(**{**files, **source}, set=given), tmp_path / "own")
    small = [a for a in plain.areas if 0.0 < a < 4e-5]
    assert small and not any(0.0 < a < 4e-5 for a in own.areas)
    said = "areas measured with minimum_area 4e-05 of the area sensor"
    assert said in own.notes and not any("area sensor" in note for note in plain.notes)
    target = str(tmp_path / "out")
    arguments = ["process", str(plain.path), "-o", target, "--images", "yes", "--set", given[0]]
    assert command(arguments) == 0
    with open_bag(tmp_path / "out") as reader:
        topic = "/finger/contact_area"
        again = [m.message.gross_area for m in reader.messages([topic])]
    assert again == pytest.approx(own.areas, rel=1e-6)


def test_a_print_that_stays_on_the_plate_is_no_wrong_clock(tmp_path: Path) -> None:
    files = long_files(tmp_path, FIFTEEN)
    time, area = np.loadtxt(files["area"], delimiter=",", skiprows=1).T
    csv(Path(files["area"]), "time_s,area_mm2", time, np.where(time > 2.0, 70.0 + 0.0 * area, area))
    bag = import_trial(ImportSettings(**files), tmp_path / "bag").path
    found = {check.name: check for check in validate(bag).checks}["sync of force and image"]
    assert found.status == "fail" and "frames between the presses" in found.detail, found
    assert "a print or dirt on the plate" in found.detail


def plate(area: float) -> np.ndarray:
    """A disc of an area (mm²) with ridges; 0.1 mm a pixel."""
    rows, columns = np.mgrid[:120, :160]
    inside = (rows - 60) ** 2 + (columns - 80) ** 2 < area * 100 / np.pi
    return np.where(inside, 120 + 90 * np.sin(rows * 0.8), 12).astype(np.uint8)


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
    with pytest.raises(InputError, match=r"row 3: 's01' and 'S01' differ in case alone"):
        run_of("force 1.csv;area 1.csv;S01;kalt;;;", "force 2.csv;area 1.csv;s01;kalt;;;")


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


def test_scales_show_the_weight_of_a_gram(files: dict[str, str], tmp_path: Path) -> None:
    scale = csv(tmp_path / "scale.csv", "time_s,load_g", TIME, force_at(TIME) / 9.80665e-3)
    named = {"force": scale, "force_column": "load_g"}
    import_trial(ImportSettings(**{**files, **named}), tmp_path / "bag")
    check_trials(tmp_path / "bag")


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


LASER = np.arange(-0.2, 9.4, 0.01)
"""s; a displacement sensor has its own rate, and begins earlier than the force."""


def indentation_at(time: np.ndarray) -> np.ndarray:
    """mm, from the first contact."""
    return 0.8 * force_at(time) ** 0.6


@pytest.mark.parametrize(
    ("column", "scale", "sign", "late"),
    [
        ("indentation_mm", 1.0, "positive", 0.0),
        ("Weg [µm]", 1e3, "negative", 0.0),
        ("travel_m", 1e-3, "positive", 2.5),
    ],
)
def test_a_measured_indentation_keeps_unit_sign_and_clock(
    files: dict[str, str], tmp_path: Path, column: str, scale: float, sign: str, late: float
) -> None:
    """Of a sensor with another zero, sign, unit and clock."""
    facing = -1.0 if sign == "negative" else 1.0
    values = scale * facing * (indentation_at(LASER) + 4.2)
    np.savetxt(
        tmp_path / "laser.csv", np.column_stack([LASER - late, values]), "%.9f", ",",
        header=f"time_s,{column}", comments="", encoding="utf-8",
    )  # fmt: skip
    bag = tmp_path / "bag"
    options = {
        **files,
        "indentation": str(tmp_path / "laser.csv"),
        "indentation-column": column,
        "indentation-sign": sign,
        "indentation-time-offset": str(late),
    }
    assert command(["import", "-o", str(bag), *(f"--{k}={v}" for k, v in options.items())]) == 0
    trials = list(load_trials(bag))
    assert len(trials) == 2
    origin = trials[0].area_stamp_ns[0] - round(
        1e9 * FRAMES[np.searchsorted(FRAMES, 0.05)]
    )  # the first frame of the first trial
    for trial in trials:
        time = (trial.indentation_stamp_ns - origin) * 1e-9
        assert len(time) > 200
        expected = 1e-3 * (indentation_at(time) + 4.2)
        assert np.abs(trial.indentation - expected).max() < 2e-6
    checks = {c.name: c for c in validate(bag).checks}
    assert checks["indentation"].status == "ok" and checks["types"].status == "ok"
    with open_bag(bag) as reader:
        topic = reader.topic("indentation")
        assert topic is not None
        assert reader.info.topics[topic].type == "geometry_msgs/msg/PointStamped"
        first = next(iter(reader.messages([topic]))).message
        assert first.header.frame_id == "finger" and first.point.x == 0.0
        assert "indentation: laser.csv sha256:" in reader.info.metadata.to_mapping()["files"]


def test_copies_of_a_bag_keep_the_indentation(files: dict[str, str], tmp_path: Path) -> None:
    laser = csv(tmp_path / "laser.csv", "time_s,indentation_mm", LASER, indentation_at(LASER))
    import_trial(ImportSettings(**files, indentation=laser), tmp_path / "bag")
    whole = list(load_trials(tmp_path / "bag"))
    for act in ("recover", "anonymise"):
        copy = tmp_path / act
        assert command([act, str(tmp_path / "bag"), "-o", str(copy)]) == 0
        for trial, other in zip(whole, load_trials(copy)):
            assert np.array_equal(trial.indentation, other.indentation)


def test_indentations_of_a_table_of_trials(files: dict[str, str], tmp_path: Path) -> None:
    """A unit in the first row of a table of trials is a value, not a row of units."""
    csv(tmp_path / "laser.csv", "time_s,way", LASER, -indentation_at(LASER))
    (tmp_path / "trials.csv").write_text(
        "force,area,indentation,indentation_column,indentation_unit,indentation_sign,subject,"
        "condition\nforce.csv,area.csv,laser.csv,way,mm,negative,S01,dry\n"
    )
    out = tmp_path / "study"
    assert command(["import", "-o", str(out), "--trials", str(tmp_path / "trials.csv")]) == 0
    found = list(load_trials(out))
    assert len(found) == 2
    assert all(np.ptp(t.indentation) == pytest.approx(1e-3, rel=0.15) for t in found)


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"indentation_unit": "m"}, r"changes by 0\.89\d+ m during .*--indentation-unit"),
        ({"indentation_unit": "um"}, r"changes by 0\.00\d+ mm during .*--indentation-unit"),
        ({"indentation_sign": "negative"}, r"falls by 0\.8\d+ mm while the force rises.*-sign"),
        ({"indentation_time_offset": 100.0}, r"0 readings .*--indentation-time-offset"),
        ({"indentation_column": "z"}, r"'z' does not exist.*--indentation-column"),
        ({"indentation_column": "empty_mm"}, r"'empty_mm' holds no number; name another"),
        ({"indentation_column": "raw"}, r"'raw' does not say its unit.*--indentation-unit mm"),
        ({"indentation": "none.csv"}, r"none\.csv: no such file"),
    ],
)
def test_an_indentation_that_cannot_be_meant_is_refused(
    files: dict[str, str], tmp_path: Path, change: dict[str, Any], sentence: str
) -> None:
    lines = ["time_s,indentation_mm,empty_mm,raw"]
    lines += [f"{t:.3f},{d:.6f},,{d:.6f}" for t, d in zip(LASER, indentation_at(LASER))]
    (tmp_path / "laser.csv").write_text("\n".join(lines))
    settings = {**files, "indentation": str(tmp_path / "laser.csv"), **change}
    with pytest.raises(InputError) as caught:
        import_trial(ImportSettings(**settings), tmp_path / "bag")
    assert re.search(sentence, str(caught.value)), caught.value
    assert not (tmp_path / "bag").exists()


def test_an_indentation_of_another_lab_is_read_by_a_mapping(tmp_path: Path) -> None:
    """A range sensor in mm that falls in the press, and what a check says of a wrong sign."""
    from finger_bag.mapping import TopicMapping
    from finger_bag.writer import BagWriter
    from finger_offline.trial_split import TrialSettings

    start = 1_700_000_000_000_000_000
    with BagWriter(tmp_path / "bag", {"subject": "S01", "condition": "dry"}) as bag:
        bag.add_topic("/laser", "sensor_msgs/msg/Range")
        for time in np.arange(0.0, 4.0, 0.01):
            stamp = start + round(1e9 * time)
            header = {"stamp": stamp, "frame_id": "laser"}
            force = float(force_at(np.array(time)))
            bag.write("wrench", {"header": header, "wrench": {"force": {"z": -force}}}, stamp)
            away = 30.0 - float(indentation_at(np.array(time)))
            bag.write("/laser", {"header": header, "range": away}, stamp, "sensor_msgs/msg/Range")
            if round(100 * time) % 10 == 0:
                area = float(area_at(np.array(time))) * 1e-6
                fields = {"header": header, "gross_area": area, "flags": 0 if area > 0 else 1}
                bag.write("contact_area", fields, stamp)
    entry = {"topic": "/laser", "field": "range", "unit": "mm"}
    for sign, status in (("negative", "ok"), ("positive", "fail")):
        mapping = TopicMapping.from_mapping({"topics": {"indentation": {**entry, "sign": sign}}})
        settings = TrialSettings(mapping)
        (trial,) = load_trials(tmp_path / "bag", settings).trials
        assert np.ptp(trial.indentation) == pytest.approx(1.02e-3, rel=0.02)
        checks = {c.name: c for c in validate(tmp_path / "bag", settings).checks}
        assert checks["indentation"].status == status, checks["indentation"]
    with pytest.raises(InputError, match="sign is 'up', choose positive or negative"):
        TopicMapping.from_mapping({"topics": {"indentation": {**entry, "sign": "up"}}})
    with pytest.raises(InputError, match="'sign', which is for indentation"):
        TopicMapping.from_mapping({"topics": {"wrench": {"topic": "/w", "sign": "negative"}}})


def test_an_indentation_on_another_clock_or_of_another_gain_is_told(tmp_path: Path) -> None:
    """The clock as docs/your_data.md says: refused in one sentence."""
    files = long_files(tmp_path, FIFTEEN) | {"indentation": str(tmp_path / "laser.csv")}
    laser = np.loadtxt(tmp_path / "laser.csv", delimiter=",", skiprows=1)
    csv(tmp_path / "laser.csv", "time_s,indentation_mm", laser[:, 0] + 0.3, laser[:, 1])
    with pytest.raises(InputError, match=r"2\d\d ms late .*; give --indentation-time-offset -0\.2"):
        import_trial(ImportSettings(**files), tmp_path / "late")
    assert not (tmp_path / "late").exists()
    for gain, status in ((1.0, "ok"), (1.5, "note")):
        csv(tmp_path / "laser.csv", "time_s,indentation_mm", laser[:, 0], gain * laser[:, 1])
        bag = import_trial(ImportSettings(**files), tmp_path / f"bag{gain}").path
        found = {c.name: c for c in validate(bag).checks}["indentation"]
        assert found.status == status
        assert gain == 1.0 or "1.6 times that of the default finger" in found.detail


def test_times_of_any_number_of_decimals_are_read_by_every_python() -> None:
    assert stamp_of("2024-05-01T13:45:10.25Z") == 1_714_571_110_250_000_000
    assert stamp_of("01.05.2024 13:45:10,5") == 1_714_571_110_500_000_000
