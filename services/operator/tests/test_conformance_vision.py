"""`armsight conformance vision`: one's own passes, each broken one fails the check meant for it."""

from collections.abc import Sequence

import numpy as np
import own_wrong
import pytest
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage

from armsight.times import to_timestamp
from armsight.v1.description_pb2 import Marker
from armsight.v1.joints_pb2 import MARKER_STATUS_TRACKED, JointPositions, MarkerPosition
from armsight_operator.conformance import suite_of
from conformance_runs import Own, Results, failed, results_of
from own_vision import OwnVision


class NoToken(own_wrong.NoToken, OwnVision):
    pass


class RareHealth(own_wrong.RareHealth, OwnVision):
    pass


class TakesAnyParameter(own_wrong.TakesAnyParameter, OwnVision):
    pass


class AnswersTwice(OwnVision):
    def send(self, found: JointPositions) -> None:
        super().send(found)
        super().send(found)


class StampsItsOwnTime(OwnVision):
    """A capture time of its own beside each that is right."""

    def send(self, found: JointPositions) -> None:
        super().send(found)
        found.capture_time.nanos = (found.capture_time.nanos + 7) % 1_000_000_000
        super().send(found)


class TwoPixelsOff(OwnVision):
    """0.05 m and more."""

    def seen(self, marker: Marker, image: RawImage) -> tuple[float, float] | None:
        found = super().seen(marker, image)
        return None if found is None else (found[0] + 2.0, found[1])


class InTheBaseFrame(OwnVision):
    def send(self, found: JointPositions) -> None:
        for marker in found.markers:
            marker.position.z -= 0.5
        super().send(found)


class NoCovariance(OwnVision):
    def send(self, found: JointPositions) -> None:
        for marker in found.markers:
            del marker.covariance[:]
            marker.covariance.extend(np.diag([1e-4, 1e-4, 0.0]).ravel())
        super().send(found)


class PixelsFromTheCorner(OwnVision):
    """Counts from the other corner."""

    def send(self, found: JointPositions) -> None:
        for marker in found.markers:
            for each in marker.observations:
                each.v_px = 479 - each.v_px
        super().send(found)


class GuessesTheHidden(OwnVision):
    def lost(self, told: MarkerPosition, capture_ns: int) -> MarkerPosition:
        found = super().lost(told, capture_ns)
        found.status = MARKER_STATUS_TRACKED
        return found


class SureWithOneEye(OwnVision):
    """Claims to know from one view what it does not."""

    def marker(self, marker: Marker, frames: dict[str, RawImage], capture_ns: int) -> MarkerPosition:
        found = super().marker(marker, frames, capture_ns)
        if len(frames) == 2 and len(found.observations) == 1:
            found.status = MARKER_STATUS_TRACKED
        return found


class NeedsBothEyes(OwnVision):
    def complete(self, since_s: float, frames: dict[str, RawImage]) -> bool:
        return since_s > 0 and len(frames) == 2


class LearnsFromRepetition(OwnVision):
    """An instant again is one more to it."""

    def instant(self, capture_ns: int, frames: dict[str, RawImage]) -> None:
        self.again = capture_ns == getattr(self, "before_ns", 0)
        self.before_ns = capture_ns
        super().instant(capture_ns, frames)

    def send(self, found: JointPositions) -> None:
        for marker in found.markers:
            marker.position.x += 0.01 * self.again
        super().send(found)


class DiesOfDirt(OwnVision):
    def instant(self, capture_ns: int, frames: dict[str, RawImage]) -> None:
        if not self.bus.counters.snapshot().get("malformed_camera_image"):
            super().instant(capture_ns, frames)


class DiesOfAFrame(OwnVision):
    def instant(self, capture_ns: int, frames: dict[str, RawImage]) -> None:
        if not self.bus.counters.snapshot().get("image_refused"):
            super().instant(capture_ns, frames)


class CountsNoFrame(OwnVision):
    def usable(self, camera: str, image: RawImage) -> bool:
        if super().usable(camera, image):
            return True
        image.timestamp.CopyFrom(to_timestamp(0))
        self.bus.counters = type(self.bus.counters)()
        return False


class StampsBackwards(OwnVision):
    def send(self, found: JointPositions) -> None:
        found.stages.vision_sent_ns = found.stages.vision_received_ns - 10**9
        super().send(found)


class NoAnnotations(OwnVision):
    def annotate(self) -> None:
        pass


BROKEN: dict[type[OwnVision], str] = {
    NoToken: "token",
    RareHealth: "health",
    TakesAnyParameter: "parameters",
    AnswersTwice: "answers",
    StampsItsOwnTime: "answers",
    TwoPixelsOff: "accurate",
    InTheBaseFrame: "accurate",
    NoCovariance: "covariance",
    PixelsFromTheCorner: "observations",
    GuessesTheHidden: "hidden",
    SureWithOneEye: "one-view",
    NeedsBothEyes: "one-camera",
    LearnsFromRepetition: "repeated",
    DiesOfDirt: "malformed",
    DiesOfAFrame: "refused-frames",
    CountsNoFrame: "refused-frames",
    StampsBackwards: "stages",
    NoAnnotations: "annotations",
}
OTHERS = ("token", "answers")
"""Beside the check that is meant, and before those that some do not survive."""


@pytest.fixture(scope="module")
def found() -> dict[Own, Results]:
    cases: dict[Own, Sequence[str]] = {own: (name, *OTHERS) for own, name in BROKEN.items()}
    return results_of("vision", cases | {OwnVision: ()}, at_a_time=4)


def test_a_vision_of_ones_own_fulfils_everything(found: dict[Own, Results]) -> None:
    assert failed(found[OwnVision]) == set(), found[OwnVision]
    assert list(found[OwnVision]) == [check.name for check in suite_of("vision").checks]


def test_for_every_check_there_is_a_vision_that_fails_it() -> None:
    assert set(BROKEN.values()) == {check.name for check in suite_of("vision").checks}


@pytest.mark.parametrize(("own", "name"), BROKEN.items(), ids=lambda each: getattr(each, "__name__", each))
def test_a_broken_vision_fails_the_check_meant_for_it(
    found: dict[Own, Results], own: type[OwnVision], name: str
) -> None:
    assert failed(found[own]) == {name}, found[own]
    assert found[own][name].seen
    assert found[own][name].expected
