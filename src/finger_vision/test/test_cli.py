# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""`finger-vision area` and calibration from a bag."""

from __future__ import annotations

import csv
import os
from pathlib import Path

import cv2
import numpy as np
import pytest

from finger_sim.ftir import FtirRenderer, Scene
from finger_vision.cli import main
from finger_vision.images import images_of


@pytest.fixture(scope="module")
def pictures(tmp_path_factory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("pictures")
    renderer = FtirRenderer("natural", 21, Scene(latent=0.0))
    frames = {
        "empty": renderer.empty(),
        "small": renderer.render(2.5e-3),
        "large": renderer.render(5e-3),
    }
    paths = {}
    for name, frame in frames.items():
        paths[name] = folder / f"{name}.png"
        cv2.imwrite(str(paths[name]), frame)
    return paths


def test_csv_follows_its_contract(pictures, tmp_path: Path, capsys) -> None:
    out = tmp_path / "areas.csv"
    names = [str(pictures[n]) for n in ("empty", "small", "large")]
    assert main(["area", *names, "-o", str(out)]) == 0
    text = out.read_text()
    assert text.splitlines()[0] == "image,gross_area_mm2,real_area_mm2,flags"
    rows = list(csv.DictReader(text.splitlines()))
    assert [r["image"] for r in rows] == names
    assert float(rows[0]["gross_area_mm2"]) == 0.0
    assert "no_contact" in rows[0]["flags"].split("|")
    assert float(rows[1]["gross_area_mm2"]) == pytest.approx(np.pi * 2.5**2, rel=0.1)
    assert float(rows[2]["gross_area_mm2"]) == pytest.approx(np.pi * 5**2, rel=0.04)
    assert main(["area", *names]) == 0
    assert capsys.readouterr().out == text


def test_background_images_remove_a_flag(pictures, capsys) -> None:
    command = ["area", str(pictures["large"]), "--area-per-pixel", "9.86e-10"]
    assert main(command) == 0
    assert "no_background" in capsys.readouterr().out
    assert main([*command, "--background", str(pictures["empty"])]) == 0
    assert capsys.readouterr().out.splitlines()[1].endswith(",uncalibrated")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["absent.png"], "absent.png: no such image"),
        (["{large}", "--area-per-pixel", "nan"], "area per pixel"),
        (["{large}", "--area-per-pixel", "-1"], "area per pixel"),
        (["{large}", "--calibration", "absent.yaml"], "absent.yaml: no such plate calibration"),
        (["{large}", "{tiny}"], "tiny.png: image of 8×8"),
        (["{large}", "--background", "{half}"], "half.png has 640×512"),
        (["{large}", "--background", "{large}", "{half}"], "half.png: image of 640×512, the"),
    ],
)
def test_bad_input_ends_with_code_2_and_one_sentence(
    pictures, tmp_path: Path, capsys, arguments: list[str], words: str
) -> None:
    tiny = tmp_path / "tiny.png"
    cv2.imwrite(str(tiny), np.zeros((8, 8), np.uint8))
    half = tmp_path / "half.png"
    cv2.imwrite(str(half), np.full((512, 640), 190, np.uint8))
    filled = [a.format(large=pictures["large"], tiny=tiny, half=half) for a in arguments]
    out = tmp_path / "out.csv"
    assert main(["area", *filled, "-o", str(out)]) == 2
    error = capsys.readouterr().err
    assert words in error and error.count("\n") == 1
    assert not out.exists()


def test_a_file_name_that_is_no_text_is_written_as_far_as_it_is(pictures, tmp_path: Path) -> None:
    name, out = tmp_path / os.fsdecode(b"press_\xe4.png"), tmp_path / "out.csv"
    name.write_bytes(Path(pictures["small"]).read_bytes())
    assert main(["area", str(name), "-o", str(out)]) == 0
    (row,) = csv.DictReader(out.read_text().splitlines())
    assert row["image"].startswith(str(tmp_path / "press_"))
    assert float(row["gross_area_mm2"]) > 10


def test_an_image_is_not_replaced_by_its_areas(pictures, capsys) -> None:
    image = Path(pictures["large"])
    before = image.read_bytes()
    assert main(["area", str(image), "-o", str(image)]) == 2
    assert "is an input too" in capsys.readouterr().err and image.read_bytes() == before


def test_images_come_out_of_a_bag_lazily_and_spaced(tmp_path: Path, write_image_bag) -> None:
    path = tmp_path / "board.mcap"
    write_image_bag(path, (np.full((40, 50), i, np.uint8) for i in range(25)), 0.1)
    used = list(images_of(path, "image_raw", 1.0))
    assert [int(image[0, 0]) for _, image in used] == [0, 10, 20]
    assert used[1][0].endswith("at 101.000 s")
    board = ["--columns", "12", "--rows", "9", "--square", "0.002", "-o", str(tmp_path / "c.yaml")]
    assert main(["calibrate", str(path), "--on-plate", str(path), *board]) == 2


def test_images_of_several_sizes_are_measured_each_for_itself(
    pictures, tmp_path: Path, capsys
) -> None:
    part = tmp_path / "part.png"
    cv2.imwrite(str(part), cv2.imread(pictures["large"], 0)[100:924, 100:1180])
    assert main(["area", str(pictures["large"]), str(part)]) == 0
    whole, cut = csv.DictReader(capsys.readouterr().out.splitlines())
    assert float(cut["gross_area_mm2"]) == pytest.approx(float(whole["gross_area_mm2"]), rel=0.03)


@pytest.mark.parametrize("content", [b"", b"not a bag", b"\x89MCAP0\r\n" + bytes(50)])
def test_unreadable_bags_are_named(tmp_path: Path, capsys, content: bytes) -> None:
    path = tmp_path / "bad.mcap"
    path.write_bytes(content)
    board = ["--columns", "12", "--rows", "9", "--square", "0.002", "-o", str(tmp_path / "c.yaml")]
    assert main(["calibrate", "--on-plate", str(path), *board]) == 2
    error = capsys.readouterr().err
    assert "bad.mcap" in error and error.count("\n") == 1


@pytest.mark.parametrize("command", ["area", "calibrate"])
def test_help_shows_an_example(capsys, command: str) -> None:
    with pytest.raises(SystemExit) as ended:
        main([command, "--help"])
    assert ended.value.code == 0
    assert f"finger-vision {command}" in capsys.readouterr().out.split("example:")[1]
