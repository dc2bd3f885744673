"""Camera frames side by side, with vision's outlines and names on them."""

from collections.abc import Sequence
from dataclasses import dataclass

from foxglove_schemas_protobuf.Color_pb2 import Color
from foxglove_schemas_protobuf.ImageAnnotations_pb2 import ImageAnnotations
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
    pictures = [_annotated(view) for view in views]
    width = sum(picture.width for picture in pictures)
    height = max(picture.height for picture in pictures)
    sheet = Image.new("RGB", (width, height + _CAPTION_PX), _PAPER)
    x = 0
    for picture in pictures:
        sheet.paste(picture, (x, 0))
        x += picture.width
    ImageDraw.Draw(sheet).text((8, height + 5), caption, fill=_INK, font=ImageFont.load_default(_FONT_PX))
    return sheet


def _annotated(view: View) -> Image.Image:
    message = view.image
    if message.encoding != "rgb8" or message.step * message.height > len(message.data):
        raise ValueError(f"camera {view.camera} sends no complete rgb8 frames")
    size = (message.width, message.height)
    picture = Image.frombuffer("RGB", size, message.data, "raw", "RGB", message.step, 1).copy()
    pen = ImageDraw.Draw(picture, "RGBA")
    font = ImageFont.load_default(_FONT_PX)
    pen.text((8, 6), f"camera {view.camera}", fill=_INK, font=font)
    if view.annotations is None:
        return picture
    for circle in view.annotations.circles:
        # annotations count pixel centres as integers, PIL pixel corners
        x, y, radius = circle.position.x + 0.5, circle.position.y + 0.5, circle.diameter / 2
        box = (x - radius, y - radius, x + radius, y + radius)
        pen.ellipse(box, outline=_rgba(circle.outline_color), width=max(1, round(circle.thickness)))
        pen.line((x - 4, y, x + 4, y), fill=_rgba(circle.outline_color))
        pen.line((x, y - 4, x, y + 4), fill=_rgba(circle.outline_color))
    for text in view.annotations.texts:
        at = (text.position.x + 6, text.position.y - _FONT_PX / 2)
        pen.rectangle(pen.textbbox(at, text.text, font=font), fill=_rgba(text.background_color))
        pen.text(at, text.text, fill=_rgba(text.text_color), font=font)
    return picture


def _rgba(color: Color) -> tuple[int, int, int, int]:
    red, green, blue, alpha = (min(255, max(0, round(255 * part))) for part in (color.r, color.g, color.b, color.a))
    return red, green, blue, alpha
