# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""A measured indentation beside force and area."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from import_files import FIFTEEN, FRAMES, LASER, area_at, csv, force_at, indentation_at, long_files

from finger_bag.cli import command
from finger_bag.reader import open_bag
from finger_bag.validate import validate
from finger_common.errors import InputError
from finger_offline.importing.settings import ImportSettings
from finger_offline.importing.trial import import_trial
from finger_offline.trials import load_trials


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
