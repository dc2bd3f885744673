"""Pictures of what the cameras see: annotated with what vision measures, or as they are."""

from armsight_operator.picture.draw import View, annotated, draw
from armsight_operator.picture.snapshot import Snapshot, take_snapshot, write_snapshot
from armsight_operator.picture.take import Views, take_views

__all__ = ["Snapshot", "View", "Views", "annotated", "draw", "take_snapshot", "take_views", "write_snapshot"]
