"""A camera's lens from pictures of a board (Zhang's method, by OpenCV), and whether they determine it."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from armsight_operator.calibrate.errors import UndeterminedError
from armsight_operator.calibrate.lens import Array, Lens, project, reaches
from armsight_operator.calibrate.views import Seen, View, informative

NAMES = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3")
"""Of the parameters, in OpenCV's order."""

LEAST_VIEWS = 8
LEAST_CORNERS = 150
LEAST_TILT_RAD = np.radians(12)
"""Of some views against the picture's plane: without, a longer lens looks like a board farther away."""
LEAST_TILTED = 3
MOST_GAP = 0.3
"""Of half the picture's diagonal, from each of its corners to the next corner of a board."""
MOST_FOCAL_SIGMA = 0.005
"""Of the focal length."""
MOST_CENTRE_SIGMA = 0.005
"""Of the picture's diagonal."""
MOST_RMS_PX = 1.5

_CELLS = 10
"""Along each side, for the share that is covered."""
_SIGNIFICANT = 4.0
"""Standard deviations; a parameter that is less is left at zero."""
_OUTLIER = 3.0
"""Times the median view's error."""
_LEAST_OUTLIER_PX = 0.3
_ROUNDS = 4

_NO_TANGENTIAL = cv2.CALIB_ZERO_TANGENT_DIST
_NO_K3 = cv2.CALIB_FIX_K3


@dataclass(frozen=True, slots=True)
class Fitted:
    """One view with the lens that was found."""

    view: View
    residuals: Array
    """n x 2 pixels: where the corner is less where it should be."""
    tilt_rad: float
    """Of the board against the picture's plane."""

    @property
    def rms_px(self) -> float:
        """Of the distances."""
        return float(np.sqrt((self.residuals**2).sum(axis=1).mean()))


@dataclass(frozen=True, slots=True)
class Intrinsics:
    """A lens, and how well it is known."""

    lens: Lens
    sigma: Array
    """Standard deviations by :data:`NAMES`; 0 for what is held at zero."""
    fitted: tuple[Fitted, ...]
    rejected: tuple[str, ...]
    """Names of views that agree with no lens."""
    covered: float
    """Share of the picture's cells in which a corner was seen."""
    gap: float
    """Of half the diagonal: how far the picture's farthest corner is from what was seen."""

    @property
    def rms_px(self) -> float:
        """Of the distances of all corners."""
        return float(np.sqrt(np.concatenate([(each.residuals**2).sum(axis=1) for each in self.fitted]).mean()))

    def worst(self, count: int = 3) -> list[Fitted]:
        """Views with the largest errors, the worst first."""
        return sorted(self.fitted, key=lambda each: -each.rms_px)[:count]


def calibrate(seen: Seen) -> Intrinsics:
    """The lens.

    Raises:
        UndeterminedError: the pictures don't determine it; with everything that is missing.
    """
    views = informative(seen.views)
    corners = sum(len(view.corners.pixels) for view in views)
    if len(views) < LEAST_VIEWS or corners < LEAST_CORNERS:
        raise UndeterminedError(
            f"{len(views)} pictures of {seen.pictures} show the board sharply and differ, with {corners} corners; at "
            f"least {LEAST_VIEWS} and {LEAST_CORNERS} are needed: record the board at other places, distances and "
            "angles, held still (and check --board: its columns, rows and dictionary)"
        )
    found = _without_outliers(seen, views)
    if troubles := doubts(found):
        raise UndeterminedError("the pictures don't determine the lens: " + "; ".join(troubles))
    return found


def doubts(found: Intrinsics) -> list[str]:
    """Why a lens is not to be trusted, and what to record; nothing where it is."""
    lens, troubles = found.lens, []
    if len(found.fitted) < LEAST_VIEWS:
        troubles.append(
            f"only {len(found.fitted)} views agree with one lens, of {len(found.fitted) + len(found.rejected)}: hold "
            "the board flat and still, and check --board and --square-m"
        )
    tilted = sum(each.tilt_rad >= LEAST_TILT_RAD for each in found.fitted)
    if tilted < LEAST_TILTED:
        troubles.append(
            f"{tilted} views are tilted by {np.degrees(LEAST_TILT_RAD):.0f}° or more, and {LEAST_TILTED} are needed: "
            "focal length and distance can't be told apart; record the board turned by 20 to 40° to the left, "
            "right, up and down"
        )
    if found.gap > MOST_GAP:
        troubles.append(
            f"no corner was seen near a corner of the picture (the nearest {found.gap:.0%} of half the diagonal away, "
            f"{MOST_GAP:.0%} is the most): distortion would be guessed there; record the board in all four corners"
        )
    focal, centre = float((found.sigma[:2] / lens.focal).max()), float(found.sigma[2:4].max())
    if not focal <= MOST_FOCAL_SIGMA:
        troubles.append(
            f"the focal length is uncertain by {focal:.1%}, {MOST_FOCAL_SIGMA:.1%} is the most: record more views, "
            "tilted and near"
        )
    if not centre <= MOST_CENTRE_SIGMA * np.hypot(lens.width, lens.height):
        troubles.append(f"the principal point is uncertain by {centre:.1f} px: record more views, tilted and turned")
    if not found.rms_px <= MOST_RMS_PX:
        troubles.append(
            f"corners are {found.rms_px:.2f} px from where the lens puts them, {MOST_RMS_PX:g} is the most: a lens "
            "of another kind (fish-eye), or a board that is not flat or not as --board says"
        )
    if not reaches(lens):
        troubles.append("the distortion folds within the picture: record the board up to its edges")
    return troubles


def _without_outliers(seen: Seen, views: Sequence[View]) -> Intrinsics:
    kept, rejected = list(views), list[str]()
    for _ in range(_ROUNDS):
        found = replace(_fit(seen, kept), rejected=tuple(rejected))
        errors = np.array([each.rms_px for each in found.fitted])
        good = errors <= max(_OUTLIER * float(np.median(errors)), _LEAST_OUTLIER_PX)
        if good.all() or good.sum() < 3:
            break
        rejected += [view.name for view, keep in zip(kept, good, strict=True) if not keep]
        kept = [view for view, keep in zip(kept, good, strict=True) if keep]
    return found


def _fit(seen: Seen, views: Sequence[View]) -> Intrinsics:
    """With k1 and k2, and what else is significantly not zero."""
    found = _fit_with(seen, views, _NO_TANGENTIAL | _NO_K3)
    for more, parts in ((_NO_K3, (6, 7)), (0, (8,))):
        flags = more if found.sigma[6] > 0 or more else _NO_TANGENTIAL
        richer = _fit_with(seen, views, flags)
        value = richer.lens.distortion[[part - 4 for part in parts]]
        sigma = richer.sigma[list(parts)]
        if (np.abs(value) > _SIGNIFICANT * sigma).any() and richer.rms_px < found.rms_px and reaches(richer.lens):
            found = richer
    return found


def _fit_with(seen: Seen, views: Sequence[View], flags: int) -> Intrinsics:
    size = (seen.width, seen.height)
    on_board = [view.corners.on_board.astype(np.float32) for view in views]
    pixels = [view.corners.pixels.astype(np.float32) for view in views]
    start = np.array(
        [[max(size), 0, (size[0] - 1) / 2], [0, max(size), (size[1] - 1) / 2], [0, 0, 1]], dtype=np.float64
    )
    _, matrix, distortion, turns, shifts, sigma, _, _ = cv2.calibrateCameraExtended(
        on_board, pixels, size, start, np.zeros(5), flags=flags | cv2.CALIB_USE_INTRINSIC_GUESS
    )
    matrix, distortion = np.asarray(matrix, dtype=np.float64), np.ravel(distortion).astype(np.float64)[:5]
    lens = Lens(*size, np.array([matrix[0, 0], matrix[1, 1]]), np.array([matrix[0, 2], matrix[1, 2]]), distortion)
    fitted = []
    for view, turn, shift in zip(views, turns, shifts, strict=True):
        rotation = np.asarray(cv2.Rodrigues(turn)[0])
        expected, _ = project(lens, view.corners.on_board @ rotation.T + np.ravel(shift))
        tilt = float(np.arccos(np.clip(abs(rotation[2, 2]), 0.0, 1.0)))
        fitted.append(Fitted(view, view.corners.pixels - expected, tilt))
    every = np.concatenate([view.corners.pixels for view in views])
    return Intrinsics(
        lens, np.ravel(sigma).astype(np.float64)[:9], tuple(fitted), (), _covered(every, lens), _gap(every, lens)
    )


def _covered(pixels: Array, lens: Lens) -> float:
    cells = np.floor(pixels / (lens.width, lens.height) * _CELLS).clip(0, _CELLS - 1)
    return len(np.unique(cells, axis=0)) / _CELLS**2


def _gap(pixels: Array, lens: Lens) -> float:
    ends = np.array([[x, y] for x in (0, lens.width - 1) for y in (0, lens.height - 1)])
    nearest = np.linalg.norm(pixels[None] - ends[:, None], axis=2).min(axis=1)
    return float(nearest.max() / (np.hypot(lens.width, lens.height) / 2))
