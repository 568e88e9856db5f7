# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Calibration boards: checkerboard and ChArUco, found in a grey image."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from finger_common.errors import InputError

DICTIONARY = "DICT_4X4_100"


@dataclass(frozen=True)
class Board:
    """A flat board of squares.

    kind: "checkerboard" or "charuco". columns, rows: squares, not inner corners. square: side, m.
    marker: side of a ChArUco marker, m. dictionary: of its markers, an OpenCV name.
    """

    kind: str
    columns: int
    rows: int
    square: float
    marker: float = 0.0
    dictionary: str = DICTIONARY

    def __post_init__(self) -> None:
        if self.kind not in ("checkerboard", "charuco"):
            raise InputError(f"board '{self.kind}' is not known; choose checkerboard or charuco")
        if not (3 <= self.columns <= 100 and 3 <= self.rows <= 100):
            raise InputError(
                f"board of {self.columns}×{self.rows} squares: 3 to 100 squares a side are needed"
            )
        if not 1e-5 < self.square < 1:
            raise InputError(f"square of {self.square:g} m: give the side in metres, as in 0.002")
        if self.kind == "checkerboard" and (self.marker or self.dictionary != DICTIONARY):
            raise InputError(
                "marker and dictionary are of a ChArUco board, a checkerboard has none; give "
                "--board charuco, or leave them out"
            )
        if self.kind == "charuco":
            if not 0 < self.marker < self.square:
                raise InputError(
                    f"marker of {self.marker:g} m does not fit a square of {self.square:g} m; "
                    "give its side in metres"
                )
            number = getattr(cv2.aruco, self.dictionary, None)
            if not (self.dictionary.startswith("DICT_") and isinstance(number, int)):
                raise InputError(
                    f"dictionary '{self.dictionary}' is not one of OpenCV's; use e.g. {DICTIONARY}"
                )
            has = len(cv2.aruco.getPredefinedDictionary(number).bytesList)
            if self.columns * self.rows // 2 > has:
                raise InputError(
                    f"a board of {self.columns}×{self.rows} squares has "
                    f"{self.columns * self.rows // 2} markers, {self.dictionary} has {has}; give "
                    "the board's own dictionary"
                )

    @property
    def corners(self) -> np.ndarray:
        """(n, 3) inner corners in the board's plane, m, row by row; z = 0."""
        x, y = np.meshgrid(np.arange(1, self.columns), np.arange(1, self.rows))
        flat = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1)
        return flat * self.square

    def charuco(self, legacy: bool = False) -> Any:
        """OpenCV's description of a ChArUco board; legacy: of OpenCV before 4.6, where boards with
        an even number of rows began with a marker."""
        markers = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, self.dictionary))
        size = self.columns, self.rows
        board = cv2.aruco.CharucoBoard(size, self.square, self.marker, markers)
        board.setLegacyPattern(legacy)
        return board

    def draw(self, pixels_per_square: int = 40) -> np.ndarray:
        """Picture (h, w) uint8 of the board, to print it or to render it."""
        size = (self.columns * pixels_per_square, self.rows * pixels_per_square)
        if self.kind == "charuco":
            return self.charuco().generateImage(size)
        x, y = np.meshgrid(np.arange(size[0]), np.arange(size[1]))
        dark = (x // pixels_per_square + y // pixels_per_square) % 2 == 0
        return np.where(dark, 0, 255).astype(np.uint8)


@dataclass(frozen=True)
class View:
    """A board found in an image.

    name: of the image. points, pixels: corners on the board (n, 3) m and in the image (n, 2) px.
    size: (width, height) of the image. mirrored: whether the image shows the board's printed side
    mirrored; None where the board looks the same in a mirror.
    """

    name: str
    points: np.ndarray
    pixels: np.ndarray
    size: tuple[int, int]
    mirrored: bool | None = None


def find_board(image: np.ndarray, board: Board, name: str = "image") -> View | None:
    """The board in an image (H, W) uint8, None when too little of it is visible.

    A mirrored view (by a mirror or a prism) is found too: a checkerboard as it is, since it is its
    own mirror image, a ChArUco board by flipping the image.
    """
    height, width = image.shape
    if board.kind == "checkerboard":
        pattern = (board.columns - 1, board.rows - 1)
        found, corners = cv2.findChessboardCornersSB(
            image, pattern, flags=cv2.CALIB_CB_ACCURACY | cv2.CALIB_CB_EXHAUSTIVE
        )
        if not found:
            return None
        return View(name, board.corners, np.asarray(corners, float).reshape(-1, 2), (width, height))
    patterns = (False, True) if board.rows % 2 == 0 else (False,)
    for legacy, mirrored in itertools.product(patterns, (False, True)):
        detector = cv2.aruco.CharucoDetector(board.charuco(legacy))
        looked_at = np.ascontiguousarray(image[:, ::-1]) if mirrored else image
        corners, ids, _, _ = detector.detectBoard(looked_at)
        if ids is not None and len(ids) >= 6:
            pixels = np.asarray(corners, float).reshape(-1, 2)
            if mirrored:
                pixels[:, 0] = width - 1 - pixels[:, 0]
            points = board.corners[np.asarray(ids).ravel()]
            if len(np.unique(points[:, 0])) > 1 and len(np.unique(points[:, 1])) > 1:
                return View(name, points, pixels, (width, height), mirrored)
    return None
