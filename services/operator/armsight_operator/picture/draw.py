"""Camera frames side by side, with vision's outlines and names on them."""

from collections.abc import Sequence
from dataclasses import dataclass

from foxglove_schemas_protobuf.Color_pb2 import Color
from foxglove_schemas_protobuf.ImageAnnotations_pb2 import ImageAnnotations
from foxglove_schemas_protobuf.Point2_pb2 import Point2
from foxglove_schemas_protobuf.PointsAnnotation_pb2 import PointsAnnotation
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage
from PIL import Image, ImageDraw, ImageFont

_CAPTION_PX = 28
_FONT_PX = 15
_INK = (30, 30, 30)
_PAPER = (245, 245, 245)


@dataclass(frozen=True, slots=True)
class View:
    """One camera's frame and what vision says of it."""

    camera: str
    image: RawImage
    annotations: ImageAnnotations | None


def draw(views: Sequence[View], caption: str) -> Image.Image:
    """All views in a row over a caption.

    Raises:
        ValueError: a frame is not rgb8, or its data do not fill it.
    """
    pictures = [annotated(view) for view in views]
    width = sum(picture.width for picture in pictures)
    height = max(picture.height for picture in pictures)
    sheet = Image.new("RGB", (width, height + _CAPTION_PX), _PAPER)
    x = 0
    for picture in pictures:
        sheet.paste(picture, (x, 0))
        x += picture.width
    ImageDraw.Draw(sheet).text((8, height + 5), caption, fill=_INK, font=ImageFont.load_default(_FONT_PX))
    return sheet


def picture_of(camera: str, image: RawImage) -> Image.Image:
    """A frame's pixels.

    Raises:
        ValueError: the frame is not rgb8, or its data do not fill it.
    """
    if image.encoding != "rgb8" or image.step * image.height > len(image.data):
        raise ValueError(f"camera {camera} sends no complete rgb8 frames")
    return Image.frombuffer("RGB", (image.width, image.height), image.data, "raw", "RGB", image.step, 1).copy()


def annotated(view: View, width: int | None = None) -> Image.Image:
    """One view with outlines and names on it.

    Args:
        view: the frame, and what vision says of it.
        width: pixels of the picture; lines and letters keep their size (default: the frame's own).

    Raises:
        ValueError: the frame is not rgb8, or its data do not fill it.
    """
    picture = picture_of(view.camera, view.image)
    scale = 1.0
    if width is not None and width < picture.width:
        scale = width / picture.width
        picture = picture.resize((width, round(picture.height * scale)), Image.Resampling.BILINEAR, reducing_gap=2.0)
    pen = ImageDraw.Draw(picture, "RGBA")
    font = ImageFont.load_default(_FONT_PX)
    pen.text((8, 6), f"camera {view.camera}", fill=_INK, font=font)
    if view.annotations is None:
        return picture

    def at(point: Point2) -> tuple[float, float]:
        # annotations count pixel centres as integers, PIL pixel corners
        return (point.x + 0.5) * scale, (point.y + 0.5) * scale

    for circle in view.annotations.circles:
        (x, y), radius = at(circle.position), circle.diameter / 2 * scale
        box = (x - radius, y - radius, x + radius, y + radius)
        pen.ellipse(box, outline=_rgba(circle.outline_color), width=max(1, round(circle.thickness)))
    for points in view.annotations.points:
        pixels = [at(point) for point in points.points]
        if points.type == PointsAnnotation.LINE_LOOP:
            pen.line([*pixels, pixels[0]], fill=_rgba(points.outline_color), width=max(1, round(points.thickness)))
        elif points.type == PointsAnnotation.POINTS:
            half = points.thickness / 2 * scale
            for x, y in pixels:
                pen.ellipse((x - half, y - half, x + half, y + half), fill=_rgba(points.outline_color))
    for text in view.annotations.texts:
        x, y = text.position.x * scale + 6, text.position.y * scale - _FONT_PX / 2
        pen.rectangle(pen.textbbox((x, y), text.text, font=font), fill=_rgba(text.background_color))
        pen.text((x, y), text.text, fill=_rgba(text.text_color), font=font)
    return picture


def _rgba(color: Color) -> tuple[int, int, int, int]:
    red, green, blue, alpha = (min(255, max(0, round(255 * part))) for part in (color.r, color.g, color.b, color.a))
    return red, green, blue, alpha
