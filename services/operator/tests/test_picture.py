import threading
from collections.abc import Callable

import numpy as np
import pytest
from foxglove_schemas_protobuf.CircleAnnotation_pb2 import CircleAnnotation
from foxglove_schemas_protobuf.Color_pb2 import Color
from foxglove_schemas_protobuf.ImageAnnotations_pb2 import ImageAnnotations
from foxglove_schemas_protobuf.Point2_pb2 import Point2
from foxglove_schemas_protobuf.PointsAnnotation_pb2 import PointsAnnotation
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage
from foxglove_schemas_protobuf.TextAnnotation_pb2 import TextAnnotation

from armsight import topics
from armsight.bus import Bus
from armsight.times import to_timestamp
from armsight_operator.errors import NoDataError
from armsight_operator.picture import View, draw, take_snapshot, take_views
from fake_arm import FakeArm

SIZE = 100
INSTANT = 1_700_000_000_000_000_000
GREY, MAGENTA = (120, 120, 120), (255, 0, 255)


def frame(instant_ns: int = INSTANT, padding: int = 8) -> RawImage:
    row = bytes(GREY) * SIZE + b"\xff" * padding
    step = 3 * SIZE + padding
    return RawImage(
        timestamp=to_timestamp(instant_ns), width=SIZE, height=SIZE, encoding="rgb8", step=step, data=row * SIZE
    )


def circle(u: float, v: float, instant_ns: int = INSTANT) -> ImageAnnotations:
    drawn = CircleAnnotation(
        timestamp=to_timestamp(instant_ns),
        position=Point2(x=u, y=v),
        diameter=40.0,
        thickness=2.0,
        outline_color=Color(r=1, g=0, b=1, a=1),
    )
    label = TextAnnotation(timestamp=drawn.timestamp, position=drawn.position, text="red", font_size=8.0)
    return ImageAnnotations(circles=[drawn], texts=[label])


def test_views_stand_side_by_side_over_a_caption() -> None:
    sheet = draw([View("1", frame(), None), View("2", frame(), None)], "moving")
    assert sheet.width == 2 * SIZE
    assert sheet.height > SIZE
    pixels = np.asarray(sheet)
    assert tuple(pixels[SIZE - 1, 0]) == tuple(pixels[SIZE - 1, -1]) == GREY
    assert np.unique(pixels[SIZE:], axis=0).shape[0] > 1, "the caption is empty"


def test_circles_lie_where_vision_saw_the_sphere() -> None:
    pixels = np.asarray(draw([View("1", frame(), circle(39.5, 59.5))], ""))[:SIZE]
    rows, columns = np.nonzero((pixels == MAGENTA).all(axis=2))
    # a pixel's centre has whole coordinates in annotations: pixel 39.5 is the border between columns 39 and 40
    assert columns.mean() == pytest.approx(39.5, abs=0.7)
    assert rows.mean() == pytest.approx(59.5, abs=0.7)
    assert columns.max() - columns.min() == pytest.approx(40, abs=2)


def test_outlines_close_and_points_are_dots() -> None:
    square = [Point2(x=x, y=y) for x, y in ((20, 20), (60, 20), (60, 60), (20, 60))]
    color = Color(r=1, g=0, b=1, a=1)
    loop = PointsAnnotation(type=PointsAnnotation.LINE_LOOP, points=square, outline_color=color, thickness=1.0)
    dot = PointsAnnotation(
        type=PointsAnnotation.POINTS, points=[Point2(x=80, y=80)], outline_color=color, thickness=3.0
    )
    drawn = (np.asarray(draw([View("1", frame(), ImageAnnotations(points=[loop, dot]))], ""))[:SIZE] == MAGENTA).all(2)
    for side in (drawn[20, 25:55], drawn[60, 25:55], drawn[25:55, 20], drawn[25:55, 60]):
        assert side.all()
    assert not drawn[25:55, 25:55].any()
    assert drawn[80, 80]


@pytest.mark.parametrize("broken", [RawImage(width=10, height=10, encoding="rgb8", step=30), RawImage(encoding="yuv")])
def test_incomplete_frames_are_refused(broken: RawImage) -> None:
    with pytest.raises(ValueError, match="camera 1 sends no complete rgb8 frames"):
        draw([View("1", broken, None)], "")


def test_views_of_one_instant_are_taken_together(arm: FakeArm, make_bus: Callable[[], Bus]) -> None:
    images = {name: arm.bus.publisher(topics.CAMERA_IMAGE, name) for name in ("1", "2")}
    notes = {name: arm.bus.publisher(topics.CAMERA_ANNOTATIONS, name) for name in ("1", "2")}
    heard = [0]

    def publish() -> None:
        heard[0] += 1
        instant = INSTANT + heard[0]
        for name in ("1", "2"):
            # camera 2's frames of every second instant are lost
            if name == "1" or heard[0] % 2 == 0:
                images[name].put(frame(instant))
            notes[name].put(circle(10, 10, instant))

    views = _take(publish, make_bus())
    assert [view.camera for view in views] == ["1", "2"]
    stamps = {(view.image.timestamp.seconds, view.image.timestamp.nanos) for view in views}
    assert len(stamps) == 1
    assert stamps.pop()[1] % 2 == INSTANT % 2


def test_a_snapshot_needs_every_frame_and_calibration(arm: FakeArm, make_bus: Callable[[], Bus]) -> None:
    del arm
    with pytest.raises(NoDataError, match="camera/1/calibration: is sim running"):
        take_snapshot(make_bus(), timeout_s=0.3)


def test_without_frames_it_says_who_is_missing(arm: FakeArm, make_bus: Callable[[], Bus]) -> None:
    del arm
    with pytest.raises(NoDataError, match="are sim and vision running"):
        take_views(make_bus(), timeout_s=0.5)


def test_without_a_description_it_says_that_sim_is_missing(make_bus: Callable[[], Bus]) -> None:
    with pytest.raises(NoDataError, match="is sim running"):
        take_views(make_bus(), timeout_s=0.3)


def _take(publish: Callable[[], None], bus: Bus) -> list[View]:
    done = threading.Event()

    def run() -> None:
        while not done.wait(0.02):
            publish()

    thread = threading.Thread(target=run)
    thread.start()
    try:
        return take_views(bus)
    finally:
        done.set()
        thread.join()
