"""Which pictures of a board are worth calculating with: sharp ones that differ."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from armsight_operator.calibrate.board import Board, Corners, find_corners, sharpness
from armsight_operator.calibrate.frames import Frame, Picture
from armsight_operator.calibrate.lens import Array

MOST_VIEWS = 40
"""More tell little more, and cost time."""

_SHARP_ENOUGH = 0.5
"""Of the median picture's sharpness."""
_SAME = 0.02
"""Of the picture's diagonal: boards whose corners lie nearer to each other on average are one view."""


@dataclass(frozen=True, slots=True)
class View:
    """What one picture shows of the board."""

    name: str
    corners: Corners
    sharpness: float
    place: Array
    """4 x 2: where the corners of the whole board are, as shares of the picture's diagonal; seen or not."""


@dataclass(frozen=True, slots=True)
class Seen:
    """All views, and what they have in common."""

    width: int
    height: int
    views: tuple[View, ...]
    pictures: int
    """That were looked at."""
    sample: Picture
    """One of them, to draw over."""


def look(board: Board, pictures: Iterable[Frame]) -> Seen:
    """Finds the board in every picture; at least one picture."""
    views: list[View] = []
    count = 0
    sample: Picture | None = None
    for frame in pictures:
        count += 1
        sample = frame.rgb if sample is None else sample
        # of all three alike: a camera's own weights are not known
        grey = frame.rgb.mean(axis=2).round().astype(np.uint8)
        corners = find_corners(board, grey)
        if corners is None:
            continue
        sharp = sharpness(grey, corners)
        sample = frame.rgb if not views or sharp > max(view.sharpness for view in views) else sample
        views.append(View(frame.name, corners, sharp, _place(board, corners, np.hypot(*grey.shape))))
    assert sample is not None
    return Seen(sample.shape[1], sample.shape[0], tuple(views), count, sample)


def informative(views: Sequence[View], most: int = MOST_VIEWS) -> list[View]:
    """The sharp ones of these that differ the most, at most so many, in their order.

    Each next one is the one farthest from all that are chosen already, which bounds how alike any two are.
    """
    if not views:
        return []
    least = _SHARP_ENOUGH * float(np.median([view.sharpness for view in views]))
    sharp = [view for view in views if view.sharpness >= least]
    places = np.array([view.place for view in sharp])
    chosen = [int(np.argmax([len(view.corners.pixels) for view in sharp]))]
    distance = _apart(places, places[chosen[0]])
    while len(chosen) < min(most, len(sharp)):
        farthest = int(np.argmax(distance))
        if distance[farthest] < _SAME:
            break
        chosen.append(farthest)
        distance = np.minimum(distance, _apart(places, places[farthest]))
    return [sharp[index] for index in sorted(chosen)]


def _apart(places: Array, place: Array) -> Array:
    return np.asarray(np.linalg.norm(places - place, axis=2).mean(axis=1))


def _place(board: Board, corners: Corners, diagonal_px: float) -> Array:
    """By an affine map from board to picture: rough, and never at infinity."""
    count = len(corners.pixels)
    flat = np.column_stack([corners.on_board[:, :2], np.ones(count)])
    to_picture, *_ = np.linalg.lstsq(flat, corners.pixels, rcond=None)
    columns, rows = np.array(board.squares) * board.square_m
    ends = np.array([[0, 0, 1], [columns, 0, 1], [columns, rows, 1], [0, rows, 1]])
    return np.asarray(ends @ to_picture / diagonal_px)
