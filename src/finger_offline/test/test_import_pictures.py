# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Videos and folders of images give areas."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from import_files import ABOUT, FRAMES, PIXEL, area_at, csv, load_start, picture

from finger_bag.cli import command
from finger_bag.reader import open_bag
from finger_bag.validate import validate
from finger_common.cli import run
from finger_common.errors import InputError
from finger_common.image_size import ALL_PIXELS, PixelBudget
from finger_offline.importing.pictures import frames_of
from finger_offline.importing.settings import ImportSettings
from finger_offline.importing.trial import import_trial
from finger_offline.process import process
from finger_offline.process_options import ProcessOptions
from finger_offline.trials import load_trials
from finger_vision.images import read_signal


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


def test_images_that_cannot_be_used_give_no_area_and_are_noted(
    files: dict[str, str], tmp_path: Path
) -> None:
    rng = np.random.default_rng(0)
    (tmp_path / "images").mkdir()
    for number, time in enumerate(np.arange(0.0, 4.0, 0.1)):
        image = picture(float(area_at(time)), rng)
        if number == 20:
            image[100:104] = 0
        cv2.imwrite(str(tmp_path / "images" / f"press{number:02d}.png"), image)
    files |= {"images": str(tmp_path / "images"), "area": ""}
    settings = ImportSettings(**files, frame_rate=10.0, area_per_pixel=PIXEL)
    result = import_trial(settings, tmp_path / "bag")
    assert len(result.areas) == 39
    assert any("1 images give no area (the image is incomplete" in n for n in result.notes)


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


def plate(area: float) -> np.ndarray:
    """A disc of an area (mm²) with ridges; 0.1 mm a pixel."""
    rows, columns = np.mgrid[:120, :160]
    inside = (rows - 60) ** 2 + (columns - 80) ** 2 < area * 100 / np.pi
    return np.where(inside, 120 + 90 * np.sin(rows * 0.8), 12).astype(np.uint8)
