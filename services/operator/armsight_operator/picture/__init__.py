"""An annotated picture of what the cameras see and vision measures."""

from armsight_operator.picture.draw import View, draw
from armsight_operator.picture.take import take_views

__all__ = ["View", "draw", "take_views"]
