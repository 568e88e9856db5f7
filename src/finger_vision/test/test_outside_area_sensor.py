# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""An area sensor of another package, as docs/add_an_area_sensor.md shows it, used unedited."""

from __future__ import annotations

import csv
import math
import os
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest

from finger_common.image_size import PixelBudget
from finger_offline.image_areas import ImageAreas
from finger_vision.area_sensor import (
    AreaSensor,
    ContactMeasurement,
    NoLight,
    SensorDefect,
    measured,
)
from finger_vision.cli import main

ELECTRODE = 0.5e-3
"""m, side of an electrode; the array has 40 × 48 of them."""

AREA_PER_PIXEL = ELECTRODE**2


@pytest.fixture(scope="module")
def outside(
    tmp_path_factory: pytest.TempPathFactory, project_root: Path, install_package: Callable
) -> dict[str, str]:
    """Environment in which the package of the page is installed: its module and its metadata."""
    tomllib = pytest.importorskip("tomllib", reason="reading pyproject.toml needs Python 3.11")
    page = (project_root / "docs" / "add_an_area_sensor.md").read_text()
    module, project = (
        re.search(rf"^```{kind}\n(.*?)^```$", page, re.M | re.S)[1] for kind in ("python", "toml")
    )
    folder = tmp_path_factory.mktemp("outside")
    entries = tomllib.loads(project)["project"]["entry-points"]
    install_package(folder, {"capacitive_array": module}, entries)
    path = [str(folder), os.environ.get("PYTHONPATH", "")]
    return {"PYTHONPATH": os.pathsep.join(filter(None, path))}


def counts(radius: float, centre: tuple[float, float] = (0.0, 0.0)) -> np.ndarray:
    """Counts (40, 48) uint16 under a disc (m): a baseline that varies, 800 more when covered."""
    fine = 10
    y, x = np.indices((40 * fine, 48 * fine)) + 0.5
    pitch = ELECTRODE / fine
    distance = np.hypot(x * pitch - 12e-3 - centre[0], y * pitch - 10e-3 - centre[1])
    covered = (distance < radius).reshape(40, fine, 48, fine).mean(axis=(1, 3))
    rng = np.random.default_rng(round(1e7 * radius))
    baseline = 2000 + 50 * np.sin(np.arange(48) / 7)
    return np.rint(baseline + 800 * covered + rng.normal(0, 5, covered.shape)).astype(np.uint16)


def run(outside: dict[str, str], *arguments: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, *map(str, arguments)]
    return subprocess.run(command, env={**os.environ, **outside}, capture_output=True, text=True)


def test_the_node_runs_with_it(outside: dict[str, str], vision_node: Callable) -> None:
    pytest.importorskip("rclpy", reason="ROS 2 is not installed")
    from finger_msgs.msg import ContactArea

    peer = vision_node(
        outside, area_sensor="capacitive_array", full_counts=800.0, area_per_pixel=AREA_PER_PIXEL
    )
    empty = peer.ask(peer.image(counts(0.0), 1, "mono16"))
    assert empty.gross_area == 0.0 and empty.flags & ContactArea.FLAG_NO_CONTACT
    pressed = peer.ask(peer.image(counts(5e-3, (2e-3, -1e-3)), 2, "mono16"))
    assert pressed.flags == 0
    assert pressed.gross_area == pytest.approx(np.pi * 5e-3**2, rel=0.02)
    assert 0 < pressed.area_stddev < 2e-6
    # The plate frame has its origin in the middle of the image.
    assert (pressed.centroid.x, pressed.centroid.y) == pytest.approx((2e-3, -1e-3), abs=0.2e-3)
    assert pressed.ellipse_major == pytest.approx(10e-3, rel=0.06)
    assert len(pressed.hull) > 10
    # The settings of every installed area sensor are parameters of the node.
    assert {"full_counts", "noise_counts", "polarity"} <= set(peer.parameters("vision"))


def test_the_command_measures_files_with_it(outside: dict[str, str], tmp_path: Path) -> None:
    for name, radius in (("empty", 0.0), ("small", 2e-3), ("large", 6e-3)):
        cv2.imwrite(str(tmp_path / f"{name}.png"), counts(radius))
    out = tmp_path / "areas.csv"
    command = ("-m", "finger_vision.cli", "area", "--area-sensor", "capacitive_array")
    result = run(
        outside,
        *command,
        *(tmp_path / "small.png", tmp_path / "large.png"),
        *("--background", tmp_path / "empty.png"),
        *("--full-counts", 800, "--area-per-pixel", AREA_PER_PIXEL, "-o", out),
    )
    assert result.returncode == 0, result.stderr
    areas = [float(row["gross_area_mm2"]) for row in csv.DictReader(out.open())]
    assert areas == pytest.approx([np.pi * 2**2, np.pi * 6**2], rel=0.03)
    help_text = run(outside, *command, "--help").stdout
    assert "--full-counts" in help_text and "--polarity" not in help_text
    refused = run(outside, *command, "--full-counts", 0, "x.png")
    assert refused.returncode == 2 and "full_counts" in refused.stderr


def test_bags_are_measured_with_it(
    outside: dict[str, str], tmp_path: Path, write_image_bag: Callable
) -> None:
    write_image_bag(tmp_path / "bag", [counts(0.0), counts(4e-3)], 0.1)
    result = run(
        outside,
        "-c",
        "import sys\n"
        "from finger_bag.reader import open_bag\n"
        "from finger_offline.image_areas import ImageAreas\n"
        "from finger_offline.image_settings import ImageSettings\n"
        "with open_bag(sys.argv[1]) as reader:\n"
        "    settings = ImageSettings(\n"
        "        area_per_pixel=float(sys.argv[2]), area_sensor='capacitive_array'\n"
        "    )\n"
        "    areas = ImageAreas.for_bag(reader, settings)\n"
        "    for item in reader.messages(['/finger/image_raw']):\n"
        "        areas.add(item, item.log_time_ns)\n"
        "print(*areas.table()['area'])\n",
        tmp_path / "bag",
        AREA_PER_PIXEL,
    )
    assert result.returncode == 0, result.stderr
    empty, pressed = map(float, result.stdout.split())
    # Default settings: the array's counts are 80 % of what they take for full coverage.
    assert empty == 0.0
    assert pressed == pytest.approx(0.8 * np.pi * 4e-3**2, rel=0.03)


class Given(AreaSensor):
    """Gives what it was made with."""

    def __init__(self, found: Any) -> None:
        self.found, self.learned = found, 0

    def measure(self, signal: np.ndarray) -> Any:
        if isinstance(self.found, Exception):
            raise self.found
        return self.found


@pytest.mark.parametrize(
    ("found", "sentence"),
    [
        (None, "gives NoneType; a ContactMeasurement is needed"),
        ((5e-5, 1e-6), "gives tuple; a ContactMeasurement is needed"),
        (ZeroDivisionError("no electrode"), r"failed \(ZeroDivisionError: no electrode\)"),
        (ContactMeasurement(gross_area=-5e-5), "gives gross_area -5e-05; 0 … 0.01 m² or NaN"),
        (ContactMeasurement(gross_area=50.0), "gives gross_area 50.0; 0 … 0.01 m² or NaN"),
        (ContactMeasurement(gross_area="large"), "gives gross_area large; 0 … 0.01 m² or NaN"),
        (ContactMeasurement(real_area=-1.0), "gives real_area -1.0; 0 … 0.01 m² or NaN"),
        (ContactMeasurement(area_sd=-1e-6), "gives area_sd -1e-06; 0 … 0.01 m² or NaN"),
        (ContactMeasurement(flags="no contact"), "gives flags no contact; bits of AreaFlag"),
        (ContactMeasurement(hull=np.zeros((4, 3))), r"gives a hull of shape \(4, 3\)"),
    ],
)
def test_what_is_no_measurement_is_refused_by_the_name_of_the_sensor(
    found: Any, sentence: str
) -> None:
    """By what the node, the command and bags use."""
    image = np.zeros((4, 6), np.uint8)
    message = SimpleNamespace(
        data=image.tobytes(), height=4, width=6, step=6, encoding="mono8", is_bigendian=False
    )
    for measure in (
        lambda: measured(Given(found), image),
        lambda: measured(Given(found), image, learn=True),
        lambda: ImageAreas(Given(found), PixelBudget()).measure(message),
    ):
        with pytest.raises(SensorDefect, match=f"area sensor Given {sentence}"):
            measure()


def test_a_measurement_may_be_unknown_and_a_signal_unusable() -> None:
    unknown = ContactMeasurement(math.nan, math.nan, math.nan, hull=[(0.0, 0.0), (1e-3, 0.0)])
    assert measured(Given(unknown), np.zeros((4, 6))) is unknown
    with pytest.raises(NoLight, match="dark"):
        measured(Given(NoLight("dark")), np.zeros((4, 6)))


NEGATIVE = """
from finger_vision.area_sensor import AreaSensor, ContactMeasurement

class Negative(AreaSensor):
    def __init__(self, settings, calibration): self.learned = 0
    def measure(self, signal): return ContactMeasurement(gross_area=-5e-5)

class NotMade(Negative):
    def __init__(self, settings, calibration): raise OSError("no licence")
"""


def test_the_command_names_the_image_and_a_sensor_that_fails(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any, install_package: Callable
) -> None:
    names = {"negative": "negative:Negative", "not_made": "negative:NotMade"}
    install_package(tmp_path, {"negative": NEGATIVE}, {"finger_vision.area_sensor": names})
    monkeypatch.syspath_prepend(tmp_path)
    cv2.imwrite(str(tmp_path / "scan.png"), np.zeros((4, 6), np.uint8))
    for name, sentence in (
        ("negative", "scan.png: area sensor Negative gives gross_area -5e-05; 0 … 0.01 m²"),
        ("not_made", "area sensor 'not_made' cannot be made (OSError: no licence); correct it"),
    ):
        assert main(["area", "--area-sensor", name, str(tmp_path / "scan.png")]) == 2
        said = capsys.readouterr().err
        assert sentence in said and said.count("\n") == 1


def test_an_area_sensor_that_is_not_installed_is_refused(tmp_path: Path) -> None:
    result = run({}, "-m", "finger_vision.cli", "area", "x.png", "--area-sensor", "absent")
    assert result.returncode == 2
    assert "area sensor 'absent' is not installed; known are ftir" in result.stderr
    assert result.stderr.count("\n") == 1
