"""The checker of recordings is judged by streams made by hand: each promise broken once is told, and kept is not."""

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from foxglove_schemas_protobuf.JointState_pb2 import JointState
from foxglove_schemas_protobuf.JointStates_pb2 import JointStates
from google.protobuf.message import Message

from armsight import topics
from armsight.bus import Sample
from armsight.router_watch import ROUTER_LOST
from armsight.times import to_duration, to_timestamp
from armsight.topics import Topic
from armsight.v1.health_pb2 import HEALTH_STATUS_DEGRADED, HEALTH_STATUS_OK, Health, HealthStatus
from armsight.v1.joints_pb2 import JointCommand, JointSetpoint
from armsight.v1.safety_pb2 import StopState
from armsight.v1.sim_pb2 import Clock
from armsight_operator.cli.app import main
from armsight_operator.errors import NoDataError
from armsight_operator.recording.backlog import Arrival
from armsight_operator.recording.invariants import Findings, check, health_showed
from armsight_operator.recording.reader import Entry
from armsight_operator.recording.series import Limits, Series
from armsight_operator.recording.timeline import timeline_of
from fake_arm import NAMES, description

START_NS = 1_700_000_000_000_000_000
PERIOD_NS = 33_333_333
S = 1_000_000_000

Heard = tuple[Topic[Any], Entry, Any]


class Made:
    """A recording under construction; one sequence of numbers for each key."""

    def __init__(self) -> None:
        self.messages: list[Heard] = []
        self._sequence: dict[str, int] = {}
        described = description()
        for joint in described.joints:
            joint.max_speed_rad_s = 5.0
        self.add(topics.DESCRIPTION, described, START_NS)

    def add(self, topic: Topic[Any], message: Message, log_ns: int, name: str | None = None, lost: int = 0) -> None:
        key = topic.key_for(name)
        self._sequence[key] = self._sequence.get(key, 0) + 1 + lost
        payload = message.SerializeToString()
        entry = Entry(
            key, topic.message.DESCRIPTOR.full_name, payload, log_ns, log_ns, self._sequence[key], False, False
        )
        self.messages.append((topic, entry, message))

    def clock(self, frame: int, begin_ns: int = START_NS) -> None:
        at_ns = begin_ns + frame * PERIOD_NS
        message = Clock(capture_time=to_timestamp(at_ns), frame=frame, period=to_duration(PERIOD_NS / S))
        self.add(topics.CLOCK, message, at_ns)

    def state(self, topic: Topic[JointStates], angle: float, frame: int, begin_ns: int = START_NS) -> None:
        at_ns = begin_ns + frame * PERIOD_NS
        joints = [JointState(name=name, position=angle if name == "joint1" else 0.0) for name in NAMES]
        self.add(topic, JointStates(timestamp=to_timestamp(at_ns), joints=joints), at_ns)

    def command(self, angle: float, frame: int, *, hold: bool = False, begin_ns: int = START_NS, lost: int = 0) -> None:
        at_ns = begin_ns + frame * PERIOD_NS
        joints = [JointSetpoint(name=name, position_rad=angle if name == "joint1" else 0.0) for name in NAMES]
        message = JointCommand(answers=to_timestamp(at_ns), valid_for=to_duration(0.1), hold=hold, joints=joints)
        self.add(topics.JOINT_COMMAND, message, at_ns + 20_000_000, lost=lost)

    def move(
        self,
        angles: Sequence[float],
        *,
        accepted: Sequence[float] | None = None,
        commanded: Callable[[int], bool] = lambda _: True,
        begin_ns: int = START_NS,
        missing: Sequence[int] = (),
    ) -> None:
        """Joint 1 by frames, its setpoint (the same unless told), each commanded by the frame before."""
        setpoints = angles if accepted is None else accepted
        before = None
        for frame, (angle, setpoint) in enumerate(zip(angles, setpoints, strict=True)):
            if frame in missing:
                continue
            self.state(topics.JOINTS_TRUE, angle, frame, begin_ns)
            if setpoint != before:
                self.state(topics.JOINTS_ACCEPTED, setpoint, frame, begin_ns)
            before = setpoint
            self.clock(frame, begin_ns)
            if frame + 1 < len(angles) and commanded(frame):
                self.command(setpoints[frame + 1], frame, begin_ns=begin_ns)

    def found(self) -> Findings:
        return check(timeline_of(self.messages))


def ramp(frames: int, step: float = 0.05, start: float = 0.0) -> list[float]:
    return [start + step * frame for frame in range(frames)]


def violations(made: Made) -> Iterator[str]:
    return map(str, made.found().violations)


@pytest.fixture
def made() -> Made:
    return Made()


def test_a_commanded_motion_within_all_limits_breaks_nothing(made: Made) -> None:
    made.move(ramp(30))
    assert made.found() == Findings((), lives=1, instants=30, resets=0, deaf_s=0.0)


@pytest.mark.parametrize("key", ["joints/true", "joints/accepted"])
def test_an_angle_beyond_its_limit_is_told(made: Made, key: str) -> None:
    inside, outside = ramp(20, start=2.15), ramp(20, start=2.24)
    assert max(inside) < np.pi < max(outside) - 0.01
    made.move(outside if key == "joints/true" else inside, accepted=inside if key == "joints/true" else outside)
    (told,) = violations(made)
    assert f"{key}: joint1 at 3.1900 rad; allowed: -3.1" in told


@pytest.mark.parametrize("key", ["joints/true", "joints/accepted"])
def test_a_jump_to_the_twin_is_told(made: Made, key: str) -> None:
    straight = ramp(20)
    swung = [angle - np.pi if frame >= 10 else angle for frame, angle in enumerate(straight)]
    made.move(swung if key == "joints/true" else straight, accepted=straight if key == "joints/true" else swung)
    (told,) = violations(made)
    assert f"{key}: joint1 by 3.09" in told


def test_an_estimate_of_the_twin_is_told_however_slowly_it_is_gone_to(made: Made) -> None:
    angles = ramp(40, 0.02)
    made.move(angles)
    for frame in range(40):
        made.state(topics.JOINTS_ESTIMATED, angles[frame] + 0.1 - (np.pi if frame == 25 else 0.0), frame)
    (violation,) = violations(made)
    assert "joints/estimated: joint1 at -2.5416 rad" in violation
    assert "true 0.5000 rad" in violation


def test_an_estimate_may_lag_behind_a_reset_for_a_moment(made: Made) -> None:
    angles = [0.0] * 20 + [2.5] * 60
    made.move(angles, commanded=lambda _: False)
    for frame in range(80):
        made.state(topics.JOINTS_ESTIMATED, angles[max(0, frame - 10)], frame)
    assert list(violations(made)) == []
    slow = Made()
    slow.move(angles, commanded=lambda _: False)
    for frame in range(80):
        slow.state(topics.JOINTS_ESTIMATED, angles[max(0, frame - 30)], frame)
    assert len(list(violations(slow))) == 14


def test_full_speed_is_allowed_and_a_tenth_more_is_not(made: Made) -> None:
    made.move(ramp(12, 5.0 * PERIOD_NS / S), accepted=ramp(12, 5.0 * PERIOD_NS / S))
    assert list(violations(made)) == []
    faster = Made()
    faster.move(ramp(12, 5.5 * PERIOD_NS / S), accepted=ramp(12, 5.0 * PERIOD_NS / S))
    assert len(list(violations(faster))) == 11


def test_a_command_that_is_applied_after_a_later_one_is_told(made: Made) -> None:
    made.move([*ramp(8), ramp(7)[-1], ramp(7)[-1]])
    # that was the command of frame 5; frame 7 asked for something else
    made.messages = [
        (topic, entry, message)
        for topic, entry, message in made.messages
        if not (topic is topics.JOINT_COMMAND and message.answers == to_timestamp(START_NS + 7 * PERIOD_NS))
        and not (topic is topics.JOINT_COMMAND and message.answers == to_timestamp(START_NS + 8 * PERIOD_NS))
    ]
    made.command(0.5, 7)
    told = list(violations(made))
    assert len(told) == 1
    assert "which was applied already" in told[0]


def test_a_command_that_is_in_force_longer_than_it_may_be_is_told(made: Made) -> None:
    # asked for once, at frame 2, and reached at frame 12; others that are on their way keep the arm moving
    made.move(ramp(13), commanded=lambda _: False)
    made.command(ramp(13)[12], 2)
    for frame in range(12):
        made.command(1.5, frame)
    (told,) = violations(made)
    assert "0.333 s old" in told


def test_motion_goes_on_for_watchdog_and_braking_and_no_longer(made: Made) -> None:
    # the last command answers frame 9: valid for 0.1 s, watchdog 0.1 s, braking 0.25 s, and a frame
    braked = [*ramp(23), *[ramp(23)[-1]] * 20]
    made.move(braked, commanded=lambda frame: frame <= 9)
    assert list(violations(made)) == []
    longer = Made()
    longer.move(ramp(40), commanded=lambda frame: frame <= 9)
    told = list(violations(longer))
    assert {text.split()[1] for text in told} == {"joints/true:", "joints/accepted:"}
    assert all("no fresh command" in text for text in told)


def test_holds_do_not_keep_the_arm_moving(made: Made) -> None:
    made.move(ramp(40), commanded=lambda frame: frame <= 9)
    for frame in range(10, 39):
        made.command(0.0, frame, hold=True)
    assert any("no fresh command" in text for text in violations(made))


def test_commands_to_a_sim_that_is_gone_move_no_new_one(made: Made) -> None:
    made.move(ramp(30))
    made.move(ramp(30), begin_ns=START_NS + 5 * S, commanded=lambda _: False)
    found = made.found()
    assert found.lives == 2
    assert found.violations
    assert all(each.instant_ns >= START_NS + 5 * S for each in found.violations)


def test_a_sim_that_begins_anew_at_its_start_pose_breaks_nothing(made: Made) -> None:
    made.move(ramp(30))
    made.move(ramp(30), begin_ns=START_NS + 5 * S)
    assert list(violations(made)) == []


def test_capture_times_that_go_back_are_told(made: Made) -> None:
    made.move(ramp(10))
    made.clock(4)
    (told,) = violations(made)
    assert told.startswith("1700000000.133 clock:")


@pytest.mark.parametrize(("brakes_for", "breaks"), [(8, False), (20, True)])
def test_motion_ends_with_braking_after_a_stop(made: Made, brakes_for: int, breaks: bool) -> None:
    at = 10
    angles = [*ramp(at + brakes_for), *[ramp(at + brakes_for)[-1]] * 20]
    made.move(angles)
    index = next(i for i, (topic, entry, _) in enumerate(made.messages) if entry.log_ns > START_NS + at * PERIOD_NS)
    made.add(topics.STOP_STATE, StopState(stopped=True), START_NS + at * PERIOD_NS + 1)
    made.messages.insert(index, made.messages.pop())
    told = list(violations(made))
    assert bool(told) is breaks
    assert all("the arm is stopped" in text for text in told)


def test_a_released_arm_may_move(made: Made) -> None:
    made.move([*[0.0] * 30, *ramp(20)])
    made.add(topics.STOP_STATE, StopState(stopped=True), START_NS + 2 * PERIOD_NS + 1)
    made.add(topics.STOP_STATE, StopState(stopped=False), START_NS + 28 * PERIOD_NS + 1)
    assert list(violations(made)) == []


def test_what_the_recorder_could_not_hear_is_excused_and_told(made: Made) -> None:
    made.move(ramp(40), commanded=lambda frame: frame <= 2 or frame >= 25, missing=range(5, 26))
    found = made.found()
    assert found.violations == ()
    assert found.deaf_s == pytest.approx(22 * PERIOD_NS / S + 0.2, abs=0.01)


def test_what_was_lost_does_not_excuse_a_jump(made: Made) -> None:
    angles = ramp(40)
    angles[10:] = [angle - 3.0 for angle in angles[10:]]
    made.move(angles, accepted=ramp(40), missing=range(5, 10))
    assert [text.split()[1] for text in violations(made)] == ["joints/true:"]


def test_a_reset_at_rest_is_counted_and_breaks_nothing(made: Made) -> None:
    made.move([*ramp(10), *[2.0] * 10], commanded=lambda frame: frame < 9)
    found = made.found()
    assert (found.violations, found.resets) == ((), 1)


def test_a_reset_after_a_long_rest_is_one_too(made: Made) -> None:
    made.move([0.0] * 40 + [2.0] * 10, commanded=lambda _: False)
    found = made.found()
    assert (found.violations, found.resets) == ((), 1)


def said(made: Made, instance: str, status: HealthStatus, *seconds: float) -> None:
    for at in seconds:
        message = Health(service="vision", instance=instance, status=status)
        made.add(topics.HEALTH, message, START_NS + round(at * S), "vision")


@pytest.mark.parametrize(
    ("before", "after", "shows"),
    [
        (("a", HEALTH_STATUS_OK, (0, 1, 2)), ("a", HEALTH_STATUS_OK, (3, 4, 5)), False),
        (("a", HEALTH_STATUS_OK, (0, 1, 2)), ("b", HEALTH_STATUS_OK, (3, 4, 5)), True),
        (("a", HEALTH_STATUS_OK, (0, 1, 2)), ("a", HEALTH_STATUS_DEGRADED, (3, 4, 5)), True),
        (("a", HEALTH_STATUS_OK, (0, 1, 2)), ("a", HEALTH_STATUS_OK, (4, 5)), True),
        (("a", HEALTH_STATUS_OK, (0, 1, 2)), ("a", HEALTH_STATUS_OK, ()), True),
    ],
    ids=["nothing", "another instance", "another status", "a pause", "no word again"],
)
def test_health_shows_a_fault_by_instance_status_or_pause(
    made: Made, before: tuple[str, HealthStatus, tuple[int, ...]], after: Any, shows: bool
) -> None:
    made.move(ramp(3))
    said(made, before[0], before[1], *before[2])
    said(made, after[0], after[1], *after[2])
    begin_ns = START_NS + round(2.2 * S)
    assert health_showed(timeline_of(made.messages), "vision", begin_ns, START_NS + 5 * S) is shows


@pytest.mark.parametrize("lost", [0, 1])
def test_health_shows_that_the_router_was_lost(made: Made, lost: int) -> None:
    made.move(ramp(3))
    for at in range(6):
        counters = {ROUTER_LOST: lost} if at > 3 else {}
        message = Health(service="vision", instance="a", status=HEALTH_STATUS_OK, counters=counters)
        made.add(topics.HEALTH, message, START_NS + at * S, "vision")
    begin_ns = START_NS + round(2.2 * S)
    assert health_showed(timeline_of(made.messages), "vision", begin_ns, begin_ns + S) is bool(lost)


def test_a_recording_without_a_description_is_refused_in_one_sentence(made: Made) -> None:
    with pytest.raises(NoDataError, match="no description"):
        timeline_of(made.messages[1:])


@pytest.mark.parametrize("breaks", [False, True])
def test_command_tells_each_violation_and_exits_with_1(
    made: Made, tmp_path: Path, capsys: pytest.CaptureFixture[str], breaks: bool
) -> None:
    made.move(ramp(40), commanded=lambda frame: not breaks or frame <= 9)
    series = Series(tmp_path / "run.mcap", Limits(), {})
    for topic, entry, _ in made.messages:
        series.write(Arrival(Sample(topic, "", entry.payload, b""), entry.log_ns, entry.sequence))
    series.finish("asked to stop", {})
    with pytest.raises(SystemExit) as ended:
        main(["recording", "check", str(tmp_path / "run.mcap")])
    out = capsys.readouterr().out
    assert (ended.value.code or 0) == (1 if breaks else 0)
    assert ("no fresh command" in out) is breaks
    assert "violations in 40 instants of 1 runs of sim" in out
