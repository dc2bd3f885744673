"""The board that a camera looks at: its corners in metres, how they are found in a picture, and the board to print."""

import re
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
from PIL import Image

from armsight.errors import ConfigError
from armsight_operator.calibrate.frames import Picture
from armsight_operator.calibrate.lens import Array

CHARUCO, CHECKERBOARD = "charuco", "checkerboard"
DICTIONARIES = {
    name.removeprefix("DICT_"): int(getattr(cv2.aruco, name))
    for name in sorted(dir(cv2.aruco))
    if name.startswith("DICT_")
}
"""OpenCV's, by name."""

_SHAPE = re.compile(rf"({CHARUCO}|{CHECKERBOARD}):(\d{{1,2}})x(\d{{1,2}})")
_LEAST_CORNERS = 6
"""Of one picture: fewer say little more than where the board is."""
_MOST_SQUARE_M = 100.0
_INCH_M = 0.0254
_MOST_PRINTED_PX = 20_000


@dataclass(frozen=True)
class Board:
    """A board by its numbers: columns and rows of squares (charuco), or of inner corners (checkerboard)."""

    kind: str
    columns: int
    rows: int
    square_m: float
    marker_m: float = 0.0
    """Side of the markers in the squares of a charuco board."""
    dictionary: str = "4X4_50"

    @cached_property
    def charuco(self) -> Any:
        """OpenCV's board of these numbers."""
        dictionary = cv2.aruco.getPredefinedDictionary(DICTIONARIES[self.dictionary])
        return cv2.aruco.CharucoBoard((self.columns, self.rows), self.square_m, self.marker_m, dictionary)

    @cached_property
    def finder(self) -> Any:
        """OpenCV's detector of that board."""
        return cv2.aruco.CharucoDetector(self.charuco)

    @property
    def squares(self) -> tuple[int, int]:
        """Columns and rows of squares."""
        return (self.columns, self.rows) if self.kind == CHARUCO else (self.columns + 1, self.rows + 1)


@dataclass(frozen=True, slots=True)
class Corners:
    """The board's corners that one picture shows."""

    on_board: Array
    """n x 3, metres, z = 0."""
    pixels: Array
    """n x 2."""


def parse_board(text: str, square_m: float, marker_m: float | None, dictionary: str) -> Board:
    """A board as a person names it: `charuco:7x5` or `checkerboard:9x6`.

    Raises:
        ConfigError: it is none, or its numbers make no board.
    """
    match = _SHAPE.fullmatch(text)
    if match is None:
        raise ConfigError(f"--board {text!r} is neither charuco:COLUMNSxROWS nor checkerboard:COLUMNSxROWS")
    kind, columns, rows = match[1], int(match[2]), int(match[3])
    if not 0 < square_m <= _MOST_SQUARE_M:
        raise ConfigError(
            f"--square-m {square_m:g} is not above 0 and up to {_MOST_SQUARE_M:g}: measure the printed squares, in "
            "metres"
        )
    if min(columns, rows) < 3:
        raise ConfigError(f"--board {text}: at least 3 columns and 3 rows are needed")
    if kind == CHECKERBOARD:
        return Board(kind, columns, rows, square_m)
    if marker_m is None or not 0 < marker_m < square_m:
        raise ConfigError(
            f"--marker-m must be given, above 0 and below --square-m {square_m:g}: a marker lies in a square"
        )
    if dictionary not in DICTIONARIES:
        raise ConfigError(f"--dictionary {dictionary!r} is none of {', '.join(DICTIONARIES)}")
    needed = columns * rows // 2
    known = len(cv2.aruco.getPredefinedDictionary(DICTIONARIES[dictionary]).bytesList)
    if needed > known:
        raise ConfigError(f"--board {text} has {needed} markers, --dictionary {dictionary} only {known}")
    return Board(kind, columns, rows, square_m, marker_m, dictionary)


def find_corners(board: Board, grey: npt.NDArray[np.uint8]) -> Corners | None:
    """The corners that a picture shows; none where it shows too few to be of use."""
    if board.kind == CHECKERBOARD:
        found, pixels = cv2.findChessboardCornersSB(grey, (board.columns, board.rows), flags=cv2.CALIB_CB_ACCURACY)
        if not found:
            return None
        rows, columns = np.divmod(np.arange(board.columns * board.rows), board.columns)
        places = np.stack([columns, rows, np.zeros(columns.size)], axis=1) * board.square_m
        return Corners(places, np.asarray(pixels, dtype=np.float64).reshape(-1, 2))
    pixels, ids, _, _ = board.finder.detectBoard(grey)
    if ids is None or len(ids) < _LEAST_CORNERS:
        return None
    places = np.asarray(board.charuco.getChessboardCorners(), dtype=np.float64)[np.ravel(ids)]
    if np.linalg.matrix_rank(places[:, :2] - places[:, :2].mean(axis=0), tol=1e-6) < 2:
        return None  # one row: tells nothing of the plane
    return Corners(places, np.asarray(pixels, dtype=np.float64).reshape(-1, 2))


def sharpness(grey: npt.NDArray[np.uint8], corners: Corners) -> float:
    """How steep the edges are where the board is, as a share of its contrast: what motion and defocus take."""
    low = np.maximum(corners.pixels.min(axis=0).astype(int) - 2, 0)
    high = corners.pixels.max(axis=0).astype(int) + 3
    part = grey[low[1] : high[1], low[0] : high[0]].astype(np.float64)
    if min(part.shape) < 3:
        return 0.0
    steep = np.hypot(np.diff(part, axis=0)[:, :-1], np.diff(part, axis=1)[:-1])
    contrast = np.percentile(part, 95) - np.percentile(part, 5)
    return float(np.percentile(steep, 98) / max(contrast, 1.0))


def draw_board(board: Board, square_px: int) -> Picture:
    """The board in black and white with a white margin of half a square."""
    columns, rows = board.squares
    size = columns * square_px, rows * square_px
    if board.kind == CHARUCO:
        drawn = np.asarray(board.charuco.generateImage(size, marginSize=0, borderBits=1))
    else:
        across, down = np.meshgrid(np.arange(size[0]) // square_px, np.arange(size[1]) // square_px)
        drawn = np.where((across + down) % 2 == 0, 0, 255).astype(np.uint8)
    return np.pad(drawn, square_px // 2, constant_values=255)


def write_board(board: Board, path: Path, dpi: int) -> tuple[float, float]:
    """Writes the board for a printer, in its true size.

    Returns:
        Width and height of the picture in metres.

    Raises:
        ConfigError: it can't be written, or is too large for it.
    """
    square_px = round(board.square_m / _INCH_M * dpi)
    if not 8 <= square_px * max(board.squares) <= _MOST_PRINTED_PX or square_px < 8:
        raise ConfigError(
            f"squares of {board.square_m:g} m at {dpi} dpi make no picture that can be printed: change --dpi"
        )
    exact_dpi = square_px * _INCH_M / board.square_m  # whole pixels for a square, and still its size
    try:
        drawn = Image.fromarray(draw_board(board, square_px))
    except cv2.error as error:
        raise ConfigError(
            f"markers of {board.marker_m:g} m at {dpi} dpi have not enough pixels to be drawn: change --dpi, or take "
            "larger ones"
        ) from error
    try:
        if path.suffix.lower() == ".pdf":
            drawn.save(path, resolution=exact_dpi)
        else:
            drawn.save(path, dpi=(exact_dpi, exact_dpi))
    except (OSError, ValueError) as error:
        raise ConfigError(f"{path} can't be written: {error}; it may end with .png or .pdf") from error
    return drawn.width / exact_dpi * _INCH_M, drawn.height / exact_dpi * _INCH_M
