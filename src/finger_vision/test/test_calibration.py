# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Plate calibration against a camera with known lens, tilt and distance."""

from __future__ import annotations

import math
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np
import pytest

from finger_common.errors import InputError
from finger_vision.board import Board, find_board
from finger_vision.calibrate import calibrate_plate
from finger_vision.calibration import PlateCalibration
from finger_vision.cli import main

SIZE = (1280, 1024)
CAMERA = np.array([[4776.0, 0, 648.0], [0, 4776.0, 505.0], [0, 0, 1]])
DISTORTION = np.array([-0.12, 0.15, 0.0008, -0.0005, 0.0])
PLATE_POSE = (np.array([0.0, math.radians(15), 0.02]), np.array([0.0, 0.0, 0.15]))
CHECKERS = Board("checkerboard", 14, 11, 2e-3)
CHARUCO = Board("charuco", 12, 9, 2.4e-3, 1.8e-3)


def photograph(
    board: Board,
    rotation: np.ndarray,
    shift: np.ndarray,
    mirrored: bool = False,
    distortion: np.ndarray = DISTORTION,
    noise: float = 2.0,
) -> np.ndarray:
    """Image of the board, its centre `shift` (m) from the camera, turned by a rotation vector."""
    picture = board.draw(64)
    u, v = np.meshgrid(np.arange(SIZE[0], dtype=np.float64), np.arange(SIZE[1], dtype=np.float64))
    rays = cv2.undistortPoints(
        np.stack([u.ravel(), v.ravel()], axis=1).reshape(-1, 1, 2), CAMERA, distortion
    ).reshape(-1, 2)
    matrix, _ = cv2.Rodrigues(rotation)
    to_board = np.linalg.inv(np.column_stack([matrix[:, 0], matrix[:, 1], shift]))
    on_board = np.column_stack([rays, np.ones(len(rays))]) @ to_board.T
    on_board = on_board[:, :2] / on_board[:, 2:]
    if mirrored:
        on_board[:, 0] *= -1
    pixel = on_board / board.square * 64 + np.array(picture.shape[::-1]) / 2 - 0.5
    maps = pixel.astype(np.float32).reshape(SIZE[1], SIZE[0], 2)
    image = cv2.remap(
        cv2.GaussianBlur(picture, (0, 0), 1.0), maps, None, cv2.INTER_LINEAR, borderValue=200
    )
    rng = np.random.default_rng(int(abs(rotation[0]) * 1e6) + int(1e6 * shift[2]))
    return np.clip(
        cv2.GaussianBlur(image, (0, 0), 0.8) + rng.normal(0, noise, image.shape), 0, 255
    ).astype(np.uint8)


POSES = [
    (np.array(r), np.array(t))
    for r, t in [
        ((0.4, 0.0, 0.0), (0.0, 0.0, 0.155)),
        ((-0.4, 0.1, 0.1), (0.003, 0.002, 0.16)),
        ((0.0, 0.45, -0.1), (-0.003, 0.001, 0.158)),
        ((0.1, -0.45, 0.3), (0.002, -0.003, 0.165)),
        ((0.35, 0.35, 0.0), (0.0, 0.0, 0.16)),
        ((-0.3, -0.3, 1.5), (0.0, 0.001, 0.16)),
        ((0.05, 0.05, 0.0), (0.004, 0.004, 0.17)),
    ]
]


@lru_cache
def view_picture(board: Board, pose: int, mirrored: bool = False) -> np.ndarray:
    """Photograph of a pose of POSES, of the plate for -1."""
    rotation, shift = POSES[pose] if pose >= 0 else PLATE_POSE
    return photograph(board, rotation, shift, mirrored)


@lru_cache
def views_of(board: Board, mirrored: bool = False) -> tuple[list, list]:
    views = [find_board(view_picture(board, i, mirrored), board, str(i)) for i in range(len(POSES))]
    plate = find_board(view_picture(board, -1, mirrored), board, "plate")
    assert plate is not None
    found = [v for v in views if v is not None]
    assert len(found) >= 6
    return [*found, plate], [plate]


def true_plate_points() -> tuple[np.ndarray, np.ndarray]:
    """Points of the plate (m, axes of the pose) and their pixels."""
    x, y = np.meshgrid(np.linspace(-12e-3, 12e-3, 7), np.linspace(-9e-3, 9e-3, 7))
    points = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1)
    pixels, _ = cv2.projectPoints(points, *PLATE_POSE, CAMERA, DISTORTION)
    return points[:, :2], pixels.reshape(-1, 2)


def distances(points: np.ndarray) -> np.ndarray:
    return np.linalg.norm(points[:, None] - points[None], axis=2)


@pytest.fixture(scope="module", params=[CHECKERS, CHARUCO], ids=["checkerboard", "charuco"])
def calibrated(request):
    return calibrate_plate(*views_of(request.param))


def test_lens_and_plate_are_recovered(calibrated) -> None:
    calibration = calibrated.calibration
    assert calibration.reprojection_error < 0.3
    assert calibration.camera_matrix[0, 0] == pytest.approx(CAMERA[0, 0], rel=0.01)
    points, pixels = true_plate_points()
    seen = calibration.to_plate(pixels, *SIZE)
    # Distances on the plate, whatever the frame: within 20 µm over 30 mm.
    assert np.abs(distances(seen) - distances(points)).max() < 20e-6
    true_area = np.prod(np.ptp(points, axis=0))
    corners = seen[[0, 6, 48, 42]].astype(np.float32) * 1e3
    assert cv2.contourArea(corners) * 1e-6 == pytest.approx(true_area, rel=2e-3)


def test_plate_frame_has_its_origin_on_the_axis_x_right_y_down(calibrated) -> None:
    calibration = calibrated.calibration
    centre = calibration.camera_matrix[:2, 2]
    axis, right, below = calibration.to_plate(centre + np.array([[0, 0], [10, 0], [0, 10]]), *SIZE)
    assert np.abs(axis).max() < 5e-6
    assert right[0] > 0 and abs(right[1]) < 0.02 * right[0]
    assert below[1] > 0


def test_file_round_trip_keeps_everything(calibrated, tmp_path: Path) -> None:
    calibration = calibrated.calibration
    path = tmp_path / "plate.yaml"
    calibration.save(path)
    again = PlateCalibration.load(path)
    for name in (
        "area_per_pixel",
        "image_size",
        "reprojection_error",
        "plate_error",
        "camera_name",
        "date",
    ):
        assert getattr(again, name) == getattr(calibration, name)
    for name in ("plate_from_pixel", "camera_matrix", "distortion"):
        np.testing.assert_array_equal(getattr(again, name), getattr(calibration, name))


def test_pixels_to_plate_and_back(calibrated) -> None:
    calibration = calibrated.calibration
    _, pixels = true_plate_points()
    back = calibration.to_pixels(calibration.to_plate(pixels, *SIZE), *SIZE)
    assert np.abs(back - pixels).max() < 0.02


def test_area_per_pixel_is_that_of_a_pixel_on_the_optical_axis(calibrated) -> None:
    calibration = calibrated.calibration
    x, y = np.rint(calibration.camera_matrix[:2, 2]).astype(int)
    areas = calibration.pixel_areas(*SIZE)
    assert areas[y, x] == pytest.approx(calibration.area_per_pixel, rel=2e-3)
    # The side of a square of the board on the plate, counted in such pixels.
    pixels, *_ = cv2.projectPoints(
        np.array([[0.0, 0, 0], [2e-3, 0, 0], [0, 2e-3, 0]]), *PLATE_POSE, CAMERA, DISTORTION
    )
    origin, right, below = pixels.reshape(3, 2)
    sides = np.array([right - origin, below - origin])
    square = abs(np.linalg.det(sides)) * calibration.area_per_pixel
    assert square == pytest.approx(4e-6, rel=2e-2)


@pytest.mark.parametrize(
    ("board", "mirrored"),
    [
        pytest.param(CHARUCO, False, id="charuco", marks=pytest.mark.slow),
        pytest.param(CHARUCO, True, id="charuco, mirrored"),
        pytest.param(CHECKERS, False, id="checkerboard", marks=pytest.mark.slow),
        pytest.param(CHECKERS, True, id="checkerboard, mirrored"),
    ],
)
def test_plate_frame_is_right_handed_also_in_a_mirrored_picture(board: Board, mirrored) -> None:
    """The printed side lies on the glass and is seen through it: x right, y down and z away from
    the camera are right-handed on it. In a mirror what is right appears on the left."""
    given = mirrored and board is CHECKERS  # which looks the same in a mirror
    report = calibrate_plate(*views_of(board, mirrored=mirrored), mirrored=given)
    calibration = report.calibration
    points, pixels = true_plate_points()
    if mirrored:
        points = points * (-1, 1)
    seen = calibration.to_plate(pixels, *SIZE)
    assert np.abs(distances(seen) - distances(points)).max() < 20e-6
    turn = np.linalg.lstsq(points - points.mean(axis=0), seen - seen.mean(axis=0), rcond=None)[0]
    assert np.linalg.det(turn) == pytest.approx(1.0, abs=5e-3)
    # x stays right in the picture.
    middle = calibration.camera_matrix[:2, 2]
    axis, right = calibration.to_plate(middle + np.array([[0, 0], [10, 0]]), *SIZE)
    assert right[0] - axis[0] > 50 * abs(right[1] - axis[1])
    again = PlateCalibration.from_yaml(calibration.to_yaml(), "plate.yaml")
    assert calibration.mirrored is again.mirrored is mirrored


def test_boards_that_contradict_one_another_about_the_mirror_are_refused() -> None:
    views, _ = views_of(CHARUCO)
    _, mirrored = views_of(CHARUCO, mirrored=True)
    with pytest.raises(InputError, match=r"plate shows the board mirrored, .* printed side"):
        calibrate_plate(views[:-1], mirrored)
    with pytest.raises(InputError, match=r"as it is printed, .* leave out --mirrored"):
        calibrate_plate(*views_of(CHARUCO), mirrored=True)


@pytest.mark.parametrize(
    ("board", "mirrored", "options", "words"),
    [
        (CHARUCO, False, [], "the picture is not mirrored"),
        (CHARUCO, True, [], "y of the plate points up"),
        (CHECKERS, True, ["--mirrored"], "y of the plate points up"),
        (CHECKERS, True, [], "which a checkerboard does not tell: give --mirrored"),
    ],
)
def test_command_says_whether_the_picture_is_mirrored(
    tmp_path: Path, capsys, board: Board, mirrored: bool, options: list[str], words: str
) -> None:
    picture, out = tmp_path / "flat.png", tmp_path / "plate.yaml"
    cv2.imwrite(str(picture), photograph(board, *PLATE_POSE, mirrored, distortion=np.zeros(5)))
    arguments = ["calibrate", "--no-lens", "--on-plate", str(picture), "--board", board.kind]
    for name in ("columns", "rows", "square", "marker"):
        arguments += [f"--{name}", str(getattr(board, name))]
    assert main([*arguments, "-o", str(out), *options]) == 0
    assert words in capsys.readouterr().out
    assert PlateCalibration.load(out).mirrored is ("up" in words)


def test_homography_alone_serves_a_lens_without_distortion() -> None:
    board = CHECKERS
    plate = find_board(photograph(board, *PLATE_POSE, distortion=np.zeros(5)), board)
    report = calibrate_plate([], [plate], lens=False)
    points, _ = true_plate_points()
    flat = np.column_stack([points, np.zeros(len(points))])
    pixels = cv2.projectPoints(flat, *PLATE_POSE, CAMERA, np.zeros(5))[0].reshape(-1, 2)
    seen = report.calibration.to_plate(pixels, *SIZE)
    assert np.abs(distances(seen) - distances(points)).max() < 20e-6


@pytest.mark.parametrize("lens", [True, False])
def test_a_board_that_shows_little_of_the_plate_is_refused(lens: bool) -> None:
    """3 by 3 of its corners are 1 % of the image, however much the tilted views cover."""
    views, (plate,) = views_of(CHECKERS)
    near = np.argsort(np.abs(plate.points - plate.points.mean(axis=0)).max(axis=1))
    little = type(plate)("plate", plate.points[near[:9]], plate.pixels[near[:9]], SIZE)
    with pytest.raises(InputError, match=r"on the plate cover 1 % .* --on-plate"):
        calibrate_plate([*views[:-1], little] if lens else [], [little], lens=lens)


def test_poor_sets_are_refused_with_the_reason() -> None:
    plate = find_board(view_picture(CHECKERS, -1), CHECKERS, "plate")
    with pytest.raises(InputError, match="found in 1 views, 6"):
        calibrate_plate([plate], [plate])
    with pytest.raises(InputError, match="no view shows the board lying on the plate"):
        calibrate_plate([plate] * 8, [])
    with pytest.raises(InputError, match=r"tilt|angle|focal"):
        calibrate_plate([plate] * 8, [plate])
    views, plates = views_of(CHECKERS)
    spoilt = [
        type(v)(
            v.name,
            v.points,
            v.pixels + (30 * np.sin(v.pixels[:, ::-1] / 90) if i == 2 else 0),
            v.size,
        )
        for i, v in enumerate(views)
    ]
    with pytest.raises(InputError, match="first of all 2"):
        calibrate_plate(spoilt, plates)
    small = type(plate)("small", plate.points, plate.pixels, (640, 480))
    with pytest.raises(InputError, match="640×480"):
        calibrate_plate([*views, small], plates)


def test_command_calibrates_from_files(tmp_path: Path, capsys) -> None:
    for i in range(len(POSES)):
        cv2.imwrite(str(tmp_path / f"view_{i}.png"), view_picture(CHARUCO, i))
    cv2.imwrite(str(tmp_path / "flat.png"), view_picture(CHARUCO, -1))
    cv2.imwrite(str(tmp_path / "nothing.png"), np.full(SIZE[::-1], 128, np.uint8))
    views = [str(p) for p in sorted(tmp_path.glob("view_*.png"))]
    board = "--board charuco --columns 12 --rows 9 --square 0.0024 --marker 0.0018".split()
    out = tmp_path / "plate.yaml"
    arguments = ["calibrate", *views, str(tmp_path / "nothing.png"), *board, "-o", str(out)]
    assert main([*arguments, "--on-plate", str(tmp_path / "flat.png")]) == 0
    assert "nothing.png: board not found" in capsys.readouterr().err
    loaded = PlateCalibration.load(out)
    pitch = PLATE_POSE[1][2] / CAMERA[0, 0]
    assert loaded.area_per_pixel == pytest.approx(pitch**2, rel=0.1)
    assert main([*arguments, "--on-plate", str(tmp_path / "nothing.png")]) == 2
    assert "no view shows the board lying on the plate" in capsys.readouterr().err


def test_command_gives_the_same_calibration_from_bags(tmp_path: Path, write_image_bag) -> None:
    views = [view_picture(CHARUCO, i) for i in range(len(POSES))]
    flat = view_picture(CHARUCO, -1)
    # Ten frames a second; the first of each second shows a view, the others none.
    blank = np.full(SIZE[::-1], 128, np.uint8)
    write_image_bag(
        tmp_path / "views.mcap", (v for view in views for v in (view, *[blank] * 9)), 0.1
    )
    write_image_bag(tmp_path / "flat.mcap", [flat], 0.1)
    for i, view in enumerate(views):
        cv2.imwrite(str(tmp_path / f"view_{i}.png"), view)
    cv2.imwrite(str(tmp_path / "flat.png"), flat)
    board = "--board charuco --columns 12 --rows 9 --square 0.0024 --marker 0.0018".split()
    files = [str(tmp_path / f"view_{i}.png") for i in range(len(views))]
    bag, plate = str(tmp_path / "views.mcap"), str(tmp_path / "flat.mcap")
    from_bag, from_files = tmp_path / "bag.yaml", tmp_path / "files.yaml"
    assert main(["calibrate", bag, *board, "-o", str(from_bag), "--on-plate", plate]) == 0
    flat_file = str(tmp_path / "flat.png")
    assert main(["calibrate", *files, *board, "-o", str(from_files), "--on-plate", flat_file]) == 0
    a, b = PlateCalibration.load(from_bag), PlateCalibration.load(from_files)
    assert a.area_per_pixel == pytest.approx(b.area_per_pixel, rel=1e-9)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("area_per_pixel: 1.0e-9\nversion: 7\n", "version 7"),
        ("version: 1\n", "'area_per_pixel' is missing"),
        ("area_per_pixel: -1\n", "above 0"),
        ("area_per_pixel: 1.0e-9\nplate_homography: {rows: 3, cols: 3, data: [1, 2]}\n", "3×3"),
        ("area_per_pixel: 1.0e-9\nimage_width: nan\nimage_height: 4\n", "image_width"),
        (
            "area_per_pixel: 1.0e-9\n"
            "plate_homography: {rows: 3, cols: 3, data: [1,0,0,0,1,0,0,0,1]}\n",
            "image_width",
        ),
        ("- 1\n- 2\n", "key: value"),
    ],
)
def test_bad_calibration_files_are_refused(tmp_path: Path, text: str, words: str) -> None:
    path = tmp_path / "bad.yaml"
    path.write_text(text)
    with pytest.raises(InputError, match=words) as caught:
        PlateCalibration.load(path)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize("mirrored", [False, True])
def test_boards_printed_with_an_older_opencv_are_found(mirrored: bool) -> None:
    """Those with an even number of rows begin with a marker."""
    board = Board("charuco", 10, 8, 0.003, 0.0022)
    picture = board.charuco(legacy=True).generateImage((600, 480))
    picture = cv2.copyMakeBorder(picture, 60, 60, 60, 60, cv2.BORDER_CONSTANT, value=255)
    view = find_board(np.ascontiguousarray(picture[:, ::-1]) if mirrored else picture, board)
    assert view is not None and len(view.points) == 9 * 7
    homography, _ = cv2.findHomography(view.points[:, :2], view.pixels)
    back = cv2.perspectiveTransform(view.points[None, :, :2], homography)[0]
    assert np.abs(back - view.pixels).max() < 0.3


@pytest.mark.parametrize(
    ("columns", "dictionary", "words"),
    [(10, "Board", "not one of OpenCV's"), (40, "DICT_4X4_100", "has 160 markers, .* has 100")],
)
def test_dictionaries_that_do_not_serve_the_board_are_refused(
    columns: int, dictionary: str, words: str
) -> None:
    with pytest.raises(InputError, match=words):
        Board("charuco", columns, 8, 0.003, 0.0022, dictionary)


def test_markers_of_a_board_that_has_none_are_refused() -> None:
    """Else a ChArUco board, whose kind was forgotten, would be looked for as a checkerboard."""
    with pytest.raises(InputError, match="a checkerboard has none; give --board charuco"):
        Board("checkerboard", 10, 8, 0.003, 0.0022)
