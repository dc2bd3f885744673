"""What viewers want reaches sim and control, the newest wish of several, and what goes wrong is told."""

import math
import time
from collections.abc import Callable, Iterator

import pytest
from foxglove_schemas_protobuf.Point3InFrame_pb2 import Point3InFrame

from armsight import topics
from armsight.bus import Bus, Subscriber
from armsight.v1.control_pb2 import CONTROL_MODE_FOLLOW, CONTROL_MODE_JOINTS, CONTROL_MODE_TRACK
from armsight_operator.page.hand import SOURCE, Hand
from fake_arm import FakeArm


@pytest.fixture
def said() -> list[str]:
    return []


@pytest.fixture
def hand(make_bus: Callable[[], Bus], arm: FakeArm, said: list[str]) -> Iterator[Hand]:
    del arm  # which answers
    hand = Hand(make_bus(), said.append)
    yield hand
    hand.close()


@pytest.fixture
def targets(make_bus: Callable[[], Bus]) -> Subscriber[Point3InFrame]:
    return make_bus().subscriber(topics.TARGET, keep=100)


def await_true(condition: Callable[[], bool], what: str) -> None:
    until = time.monotonic() + 5.0
    while not condition():
        assert time.monotonic() < until, what
        time.sleep(0.01)


def test_stop_and_release_are_the_pages_own(hand: Hand, arm: FakeArm, said: list[str]) -> None:
    arm.stopped_by = ["door"]
    hand.stop()
    assert arm.stopped_by == ["door", SOURCE]
    hand.release()
    assert arm.stopped_by == ["door"]
    assert said[-1] == "still stopped by door"


def test_a_stop_that_nobody_confirms_says_so(make_bus: Callable[[], Bus], said: list[str]) -> None:
    hand = Hand(make_bus(), said.append)  # no sim
    hand.stop()
    assert "NOT confirmed" in said[-1]
    hand.close()


def test_mode_and_angles_are_asked_for(hand: Hand, arm: FakeArm) -> None:
    hand.mode("follow")
    await_true(lambda: len(arm.modes) == 1, "the mode is set")
    hand.joints({"joint1": 0.5, "joint2": -0.1})
    await_true(lambda: len(arm.modes) == 2, "the angles are set")
    assert [request.mode for request in arm.modes] == [CONTROL_MODE_FOLLOW, CONTROL_MODE_JOINTS]
    assert {joint.name: joint.position_rad for joint in arm.modes[1].joints} == {"joint1": 0.5, "joint2": -0.1}


def test_of_many_wishes_the_newest_is_granted(hand: Hand, arm: FakeArm) -> None:
    for step in range(200):
        hand.joints({"joint1": step / 200})
    await_true(lambda: bool(arm.modes) and arm.modes[-1].joints[0].position_rad == 199 / 200, "the last one is set")
    assert len(arm.modes) < 200


def test_refusal_is_told_in_controls_own_words(hand: Hand, arm: FakeArm, said: list[str]) -> None:
    arm.refusal = "joint1 at 9 rad is beyond its limit"
    hand.joints({"joint1": 9.0})
    await_true(lambda: said == [arm.refusal], "the refusal is told")


def test_target_is_followed_and_repeated_for_a_while(
    hand: Hand, arm: FakeArm, targets: Subscriber[Point3InFrame]
) -> None:
    await_true(lambda: hand._targets.has_subscribers(), "the target has a reader")
    hand.target((1.0, 2.0, 3.0), follow=True)
    first = targets.recv(5.0)
    assert first is not None
    assert [request.mode for request in arm.modes] == [CONTROL_MODE_TRACK]
    assert (first.message.frame_id, first.message.point.z) == ("world", 3.0)
    assert targets.recv(5.0) is not None, "it is said again"
    hand.target((1.0, 2.0, 4.0), follow=False)
    await_true(lambda: (got := targets.latest) is not None and got.message.point.z == 4.0, "the newer one is said")
    assert len(arm.modes) == 1


def test_a_chosen_mode_ends_the_target(hand: Hand, arm: FakeArm, targets: Subscriber[Point3InFrame]) -> None:
    await_true(lambda: hand._targets.has_subscribers(), "the target has a reader")
    hand.target((1.0, 2.0, 3.0), follow=False)
    assert targets.recv(5.0) is not None
    hand.mode("hold")
    await_true(lambda: len(arm.modes) == 1, "the mode is set")
    time.sleep(0.15)  # one that was on its way
    targets.clear()
    assert targets.recv(0.5) is None


def test_a_target_that_is_none_is_not_published(hand: Hand, said: list[str]) -> None:
    hand.target((math.nan, 0.0, 0.0), follow=False)
    await_true(lambda: bool(said), "it is told")
    assert "finite" in said[0]
