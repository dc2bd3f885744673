"""Pictures of what was found: residuals, much enlarged, over what the camera saw, and the pixels of each colour."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt
from PIL import Image, ImageDraw, ImageFont

from armsight.errors import ConfigError
from armsight_operator.calibrate.frames import Picture
from armsight_operator.calibrate.lens import Array

_LONGEST_PX = 20.0
"""Of the 95th percentile of residuals, as it is drawn."""
_INK, _PAPER = (220, 30, 90), (245, 245, 245)
_DOT = (20, 120, 220)
_FONT_PX = 15


def residuals(picture: Picture, pixels: Array, off: Array, title: str) -> Image.Image:
    """A pale picture with a dot at every measured point and a line along its residual.

    Args:
        picture: what the camera saw.
        pixels: n x 2, integer values are pixel centres.
        off: n x 2 pixels, measured less expected.
        title: written into the corner, with how much lines are enlarged.
    """
    size = float(np.percentile(np.linalg.norm(off, axis=1), 95)) if len(off) else 1.0
    times = max(1, round(_LONGEST_PX / max(size, 1e-3)))
    pale = Image.blend(Image.fromarray(picture), Image.new("RGB", picture.shape[1::-1], _PAPER), 0.5)
    pen = ImageDraw.Draw(pale)
    for (x, y), (dx, dy) in zip(pixels + 0.5, off * times, strict=True):
        pen.line((x, y, x + dx, y + dy), fill=_INK, width=1)
        pen.ellipse((x - 1.5, y - 1.5, x + 1.5, y + 1.5), fill=_DOT)
    text = f"{title}, residuals x {times}"
    font = ImageFont.load_default(_FONT_PX)
    pen.rectangle(pen.textbbox((8, 6), text, font=font), fill=_PAPER)
    pen.text((8, 6), text, fill=(30, 30, 30), font=font)
    return pale


def colours(picture: Picture, taken: npt.NDArray[np.intp], paint: Mapping[str, Array]) -> Image.Image:
    """The picture in grey, and in colour what each marker takes.

    Args:
        picture: what the camera saw.
        taken: rows x columns: number of the marker that takes the pixel, -1 for none.
        paint: each marker's colour, in the order of these numbers.
    """
    grey = np.repeat(picture.mean(axis=2, keepdims=True) * 0.5 + 90, 3, axis=2)
    for number, colour in enumerate(paint.values()):
        grey[taken == number] = 255 * colour / max(float(colour.max()), 1e-6)
    image = Image.fromarray(grey.clip(0, 255).astype(np.uint8))
    pen, font = ImageDraw.Draw(image), ImageFont.load_default(_FONT_PX)
    for number, name in enumerate(paint):
        rows, columns = np.nonzero(taken == number)
        if rows.size:
            pen.text((float(columns.max()) + 4, float(np.median(rows)) - 8), name, fill=(20, 20, 20), font=font)
    return image


def write(images: Sequence[Image.Image], path: Path) -> None:
    """Side by side.

    Raises:
        ConfigError: it can't be written.
    """
    sheet = Image.new("RGB", (sum(image.width for image in images), max(image.height for image in images)), _PAPER)
    x = 0
    for image in images:
        sheet.paste(image, (x, 0))
        x += image.width
    try:
        sheet.save(path)
    except (OSError, ValueError) as error:
        raise ConfigError(f"{path} can't be written: {error}") from error
