"""The markers' colours from pictures, by the same cones of chromaticity in which vision looks for them.

A colour is compared with pixels as they come, channel by channel in proportion: what the camera does to brightness (its
gamma, its white balance) is the same for the picture that is learnt from and for those that are measured, and is not
undone. In a light that changes little, that is enough; brightness itself cancels.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from armsight.errors import ConfigError
from armsight_operator.calibrate.errors import UndeterminedError
from armsight_operator.calibrate.frames import Picture
from armsight_operator.calibrate.lens import Array

# What vision looks for (services/vision_cpp/src/classify.cpp): hues nearer than this it does not tell apart, a colour
# with less chroma in proportion to its brightness it takes for grey.
LEAST_HUE_DISTANCE_RAD = np.radians(12)
LEAST_SATURATION = 0.15
# And how far from a marker's colour a pixel may be.
_CHROMA_FLOOR = 14.0
_SATURATION_SHARE = 0.3
_HUE_HALF_WIDTH_RAD = np.radians(20)
_LEAST_AREA_PX = 12

_GREY = np.full(3, 1 / np.sqrt(3))
_FIRST, _SECOND = np.array([2.0, -1, -1]) / np.sqrt(6), np.array([0.0, 1, -1]) / np.sqrt(2)
_PATCH = 2
"""Pixels around a click that are looked at."""
_CLIPPED = 250
"""A channel as bright as this may have been brighter: such pixels have the wrong hue."""
_LEAST_LEARNT_PX = 20
_MOST_BACKGROUND = 0.25
"""Of a marker's own area."""
_OWN = 1.0
"""Parts this far from a marker's, in its own sizes, are its own, cut off by a link."""
_NEAR = 0.08
"""Of the picture's diagonal: how far from its expected place a marker is looked for."""
_LEAST_PICTURES = 3
_MOST_HUE_SPREAD_RAD = np.radians(8)
"""Of the colours that different pictures give one marker."""

Labels = npt.NDArray[np.intp]


@dataclass(frozen=True, slots=True)
class Learnt:
    """A marker's colour in one picture, and the pixels that it was learnt from."""

    colour: Array
    """Red, green and blue in proportion, the largest 1."""
    mask: npt.NDArray[np.bool_]


def hue_and_saturation(colour: Array) -> tuple[Array, Array]:
    """Direction around the grey axis in radians, and chroma divided by the sum of channels; of pixels a batch."""
    total = colour.sum(axis=-1)
    chroma = colour - total[..., None] / 3
    return np.arctan2(chroma @ _SECOND, chroma @ _FIRST), np.linalg.norm(chroma, axis=-1) / np.maximum(total, 1e-9)


def taken(picture: Picture, colours: Mapping[str, Array]) -> Labels:
    """Which marker takes each pixel: its number in the mapping, -1 for none."""
    result = np.full(picture.shape[:2], -1, dtype=np.intp)
    hues = [float(hue_and_saturation(colour)[0]) for colour in colours.values()]
    for number, colour in enumerate(colours.values()):
        others = [_between(hues[number], hue) / 2 for index, hue in enumerate(hues) if index != number]
        inside = _in_cone(picture, colour, min([_HUE_HALF_WIDTH_RAD, *others]), _SATURATION_SHARE)
        result[inside & (result < 0)] = number
    return result


def learn_at(picture: Picture, column: int, row: int) -> Learnt:
    """The colour of what is at a place, from all pixels of it.

    Raises:
        UndeterminedError: there is nothing of a colour of its own there.
    """
    rows, columns = picture.shape[:2]
    if not (0 <= column < columns and 0 <= row < rows):
        raise ConfigError(f"{column},{row} is outside of the picture of {columns} x {rows}")
    around = np.s_[max(row - _PATCH, 0) : row + _PATCH + 1, max(column - _PATCH, 0) : column + _PATCH + 1]
    seed = np.median(picture[around].reshape(-1, 3), axis=0)
    saturation = float(hue_and_saturation(seed)[1])
    if saturation < LEAST_SATURATION or seed.max() - seed.min() < _CHROMA_FLOOR:
        raise UndeterminedError(
            f"what is at {column},{row} is grey or dark (red {seed[0]:.0f}, green {seed[1]:.0f}, blue "
            f"{seed[2]:.0f}): name a place within the marker, and light it"
        )
    inside = _in_cone(picture, seed, _HUE_HALF_WIDTH_RAD, 0.5)
    _, labels = cv2.connectedComponents(inside.astype(np.uint8))
    areas = np.bincount(labels[around].ravel())
    areas[0] = 0  # of what is not of this colour, such as a highlight just there
    if not areas.any():
        raise UndeterminedError(f"what is at {column},{row} is of no one colour: name a place within the marker")
    return _learn(picture, np.asarray(labels == areas.argmax()))


def learn_near(
    picture: Picture, expected: Mapping[str, tuple[float, float]], radius_px: Mapping[str, float]
) -> dict[str, Learnt]:
    """Colours of what is where markers are expected: each coloured patch is of the marker that is nearest.

    Args:
        picture: what the camera saw.
        expected: column and row by marker.
        radius_px: of each marker's disc.
    """
    hue, saturation = hue_and_saturation(picture.astype(np.float64))
    spread = picture.max(axis=2).astype(int) - picture.min(axis=2)
    coloured = (saturation >= LEAST_SATURATION) & (spread >= _CHROMA_FLOOR)
    count, labels, stats, middles = cv2.connectedComponentsWithStats(coloured.astype(np.uint8))
    reach = _NEAR * float(np.hypot(*picture.shape[:2]))
    pairs = sorted(
        (float(np.hypot(*(np.subtract(middles[label], place)))), label, name)
        for label in range(1, count)
        for name, place in expected.items()
        if 0.3 < stats[label, cv2.CC_STAT_AREA] / (np.pi * radius_px[name] ** 2) < 2.0
        and stats[label, cv2.CC_STAT_AREA] >= _LEAST_LEARNT_PX
    )
    found: dict[str, Learnt] = {}
    given: set[int] = set()
    for distance, label, name in pairs:
        if distance > reach or label in given or name in found:
            continue
        mask = labels == label
        if float(np.abs(np.mean(np.exp(1j * hue[mask])))) < np.cos(_HUE_HALF_WIDTH_RAD):
            continue  # two markers that touch
        given.add(label)
        found[name] = _learn(picture, mask)
    return found


def agreed(by_picture: Mapping[str, Sequence[Learnt]], wanted: Sequence[str]) -> dict[str, Array]:
    """One colour for each marker from many pictures.

    Raises:
        UndeterminedError: one was seen too seldom, or has another colour in every picture.
    """
    result, troubles = {}, []
    for name in wanted:
        learnt = by_picture.get(name, ())
        if len(learnt) < _LEAST_PICTURES:
            troubles.append(
                f"{name} was found near its place in {len(learnt)} pictures, {_LEAST_PICTURES} are needed: is the "
                "camera where the file says, and are the angles known? Else name its place with --at"
            )
            continue
        colours = np.array([each.colour for each in learnt])
        middle = np.median(colours, axis=0)
        spread = float(np.median(np.abs(_between(hue_and_saturation(colours)[0], hue_and_saturation(middle)[0]))))
        if spread > _MOST_HUE_SPREAD_RAD:
            troubles.append(
                f"{name} has hues {np.degrees(spread):.0f}° apart in different pictures: others were taken for it; "
                "name its place with --at"
            )
        result[name] = middle / middle.max()
    if troubles:
        raise UndeterminedError("; ".join(troubles))
    return result


def check_apart(colours: Mapping[str, Array]) -> None:
    """Refuses colours that vision could not tell from each other, or from grey.

    Raises:
        UndeterminedError: with all such.
    """
    names = list(colours)
    hues = {name: float(hue_and_saturation(colours[name])[0]) for name in names}
    saturations = {name: float(hue_and_saturation(colours[name])[1]) for name in names}
    troubles = [
        f"{name} is nearly grey (saturation {saturation:.2f}, more than {LEAST_SATURATION} is needed)"
        for name, saturation in saturations.items()
        if saturation <= LEAST_SATURATION
    ]
    for index, name in enumerate(names):
        for other in names[index + 1 :]:
            distance = float(_between(hues[name], hues[other]))
            if distance < LEAST_HUE_DISTANCE_RAD:
                troubles.append(
                    f"{name} and {other} are {np.degrees(distance):.0f}° of hue apart, "
                    f"{np.degrees(LEAST_HUE_DISTANCE_RAD):.0f}° is the least (30° is better)"
                )
    if troubles:
        raise UndeterminedError("; ".join(troubles) + ": give the markers other colours, or light them otherwise")


def check_background(picture: Picture, colours: Mapping[str, Array], own: Mapping[str, npt.NDArray[np.bool_]]) -> None:
    """Refuses colours that something else in the picture has as well.

    Args:
        picture: what the camera saw.
        colours: of all markers.
        own: pixels of those whose place is known.

    Raises:
        UndeterminedError: with what is where.
    """
    troubles = []
    owner = taken(picture, colours)
    for number, name in enumerate(colours):
        if name not in own:
            continue
        rows, columns = np.nonzero(own[name])
        size = max(np.ptp(rows), np.ptp(columns)) + 1
        low, high = (
            (columns.min() - _OWN * size, rows.min() - _OWN * size),
            (columns.max() + _OWN * size, rows.max() + _OWN * size),
        )
        count, _, stats, middles = cv2.connectedComponentsWithStats((owner == number).astype(np.uint8))
        for label in range(1, count):
            area, (x, y) = int(stats[label, cv2.CC_STAT_AREA]), middles[label]
            is_own = low[0] <= x <= high[0] and low[1] <= y <= high[1]
            if not is_own and area >= max(_LEAST_AREA_PX, _MOST_BACKGROUND * len(rows)):
                troubles.append(
                    f"{area} pixels around column {x:.0f}, row {y:.0f} have the colour of {name} ({len(rows)})"
                )
    if troubles:
        raise UndeterminedError("; ".join(troubles) + ": cover them, or give the marker another colour")


def _learn(picture: Picture, mask: npt.NDArray[np.bool_]) -> Learnt:
    inner = np.asarray(cv2.erode(mask.astype(np.uint8), np.ones((3, 3), np.uint8))).astype(bool)
    pixels = picture[inner if inner.sum() >= _LEAST_LEARNT_PX else mask].astype(np.float64)
    unclipped = pixels[pixels.max(axis=1) < _CLIPPED]
    pixels = unclipped if len(unclipped) >= _LEAST_LEARNT_PX else pixels
    if len(pixels) < _LEAST_LEARNT_PX:
        raise UndeterminedError(
            f"only {len(pixels)} pixels of one colour, {_LEAST_LEARNT_PX} are needed: take a picture from nearer"
        )
    colour = pixels.sum(axis=0)
    return Learnt(colour / colour.max(), mask)


def _in_cone(picture: Picture, colour: Array, half_width: float, saturation_share: float) -> npt.NDArray[np.bool_]:
    """As vision's ColorCone: by planes through black, so that brightness cancels."""
    total = float(colour.sum())
    chroma = colour - total / 3
    direction = chroma / np.linalg.norm(chroma)
    saturation = float(np.linalg.norm(chroma)) / total
    across = np.cross(_GREY, direction)
    sine, cosine = np.sin(half_width), np.cos(half_width)
    pixels = picture.astype(np.float64)
    return np.asarray(
        (pixels @ direction >= _CHROMA_FLOOR)
        & (pixels @ (direction - saturation_share * saturation) >= 0)
        & (pixels @ (sine * direction + cosine * across) >= 0)
        & (pixels @ (sine * direction - cosine * across) >= 0)
    )


def _between(a: Array | float, b: Array | float) -> Array:
    return np.asarray(np.abs(np.angle(np.exp(1j * (np.asarray(a) - np.asarray(b))))))
