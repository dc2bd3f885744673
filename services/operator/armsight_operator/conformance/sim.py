"""Checks of a sim: control and vision are played by commands at the suite's will; its arm is moved."""

import threading
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.JointStates_pb2 import JointStates
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage
from google.protobuf.empty_pb2 import Empty

from armsight import topics
from armsight.bus import Bus, Received
from armsight.errors import NoReplyError, RefusedError
from armsight.times import NS_PER_S, from_duration, from_timestamp, to_duration, to_timestamp
from armsight.v1.description_pb2 import ArmDescription
from armsight.v1.joints_pb2 import JointCommand, JointSetpoint
from armsight.v1.safety_pb2 import STOP_ACTION_RELEASE, STOP_ACTION_STOP, StopRequest, StopState
from armsight.v1.sim_pb2 import CLOCK_MODE_UNSPECIFIED, Clock, ResetRequest
from armsight_operator.conformance import judge
from armsight_operator.conformance.check import Check, UnfulfilledError, require
from armsight_operator.conformance.judge import Array
from armsight_operator.conformance.station import ANSWER_S, DIRT, Station, of_every_service, refused

_SILENCE_S = 10.0
"""In lockstep a sim that waits sends its frames again, though not at once."""

_VALID_S = 0.5
"""Of commands; a busy machine may take a while from frame to command."""

_REST_S = 1.5
"""Simulated: braking and the swing of an arm that holds are over."""

_STEP_RAD = 0.02
_GOAL_RAD = 0.3
_NEAR_RAD = 0.02
_STILL_RAD = 1e-3
_OVERSHOOT = 1.1
"""An arm may overshoot its setpoint's own speed by so much."""

_SOURCE = "conformance"


@dataclass(frozen=True, slots=True)
class _Frame:
    """What is kept of a camera's frame."""

    width: int
    height: int
    step: int
    size: int
    encoding: str
    frame_id: str


class Commander:
    """Control and vision beside the sim that is judged: each instant is answered with what a check wants."""

    def __init__(self, bus: Bus) -> None:
        """Listens."""
        self._bus = bus
        self._arrived = threading.Condition()
        self._frames: dict[int, dict[str, _Frame]] = {}
        self._truths: dict[int, JointStates] = {}
        self._clocks: list[Clock] = []
        self._now_ns = 0
        self._described = bus.subscriber(topics.DESCRIPTION)
        self._calibrations = bus.subscriber(topics.CAMERA_CALIBRATION, "*", keep=64)
        self._poses = bus.subscriber(topics.CAMERA_POSE, "*", keep=64)
        self._accepted = bus.subscriber(topics.JOINTS_ACCEPTED)
        self._stop = bus.subscriber(topics.STOP_STATE)
        bus.subscriber(topics.CAMERA_IMAGE, "*", keep=16, on_message=self._take_image)
        bus.subscriber(topics.JOINTS_TRUE, keep=16, on_message=self._take_truth)
        bus.subscriber(topics.CLOCK, keep=16, on_message=self._take_clock)
        self._commands = bus.publisher(topics.JOINT_COMMAND)
        # said last: a sim in lockstep sends its frames again to who has come
        self.station = Station(bus, "sim", ("vision", "control"))

    def close(self) -> None:
        """Takes control and vision away."""
        self.station.close()

    def settle(self) -> None:
        """Nothing need be waited for: the first frames are."""

    # --- what the suite does

    @property
    def description(self) -> ArmDescription:
        """As sim describes the arm."""
        self.station.until(lambda: self._described.latest is not None, ANSWER_S, "no description", "one, latched")
        assert self._described.latest is not None
        return self._described.latest.message

    @property
    def names(self) -> list[str]:
        """Of all joints."""
        return [joint.name for joint in self.description.joints]

    @property
    def clock(self) -> Clock:
        """The newest."""
        if not self._clocks:
            self.step()
        self.station.until(lambda: bool(self._clocks), ANSWER_S, "nothing on clock", "one of each instant")
        return self._clocks[-1]

    def instant(self) -> int:
        """Waits for frames that are newer than those answered last; their capture time."""
        cameras = set(self.description.cameras)
        with self._arrived:

            def newest() -> int:
                whole = [ns for ns, frames in self._frames.items() if cameras <= set(frames)]
                return max((ns for ns in whole if ns > self._now_ns), default=0)

            if not self._arrived.wait_for(lambda: newest() > 0, _SILENCE_S):
                seen = f"no frames of all cameras with one capture time for {_SILENCE_S:g} s"
                raise UnfulfilledError(seen, "frames of every instant; in lockstep of the next once one was answered")
            self._now_ns = newest()
            for old in [ns for ns in self._frames if ns < self._now_ns - 2 * NS_PER_S]:
                del self._frames[old]
        return self._now_ns

    def step(self, command: JointCommand | None = None) -> int:
        """Answers the newest instant, by a hold where nothing else is given, and waits for the next one."""
        if self._now_ns == 0:
            self.instant()
        self._put(JointCommand(hold=True) if command is None else command)
        return self.instant()

    def wrong(self, command: JointCommand) -> None:
        """Puts a command that must be refused, and a hold: the instant may not count as answered."""
        self._put(command)
        self.step()

    def _put(self, command: JointCommand) -> None:
        """Puts a command; what it leaves open answers the newest instant."""
        if not command.HasField("answers"):
            command.answers.CopyFrom(to_timestamp(self._now_ns))
        if not command.HasField("valid_for"):
            command.valid_for.CopyFrom(to_duration(_VALID_S))
        self._commands.put(command)

    def to(self, q: Array) -> JointCommand:
        """A command to a configuration, rad."""
        pairs = zip(self.names, q, strict=True)
        return JointCommand(joints=[JointSetpoint(name=name, position_rad=angle) for name, angle in pairs])

    def hold_for(self, simulated_s: float) -> None:
        """Holds for a while of simulated time."""
        until_ns = self._now_ns + round(simulated_s * NS_PER_S)
        while self._now_ns < until_ns:
            self.step()

    def truth(self) -> Array:
        """True angles at the newest instant, rad."""
        with self._arrived:
            if not self._arrived.wait_for(lambda: self._now_ns in self._truths, ANSWER_S):
                raise UnfulfilledError("no joints/true of an instant", "the true angles of each")
            return self._angles(self._truths[self._now_ns], "joints/true has")

    def accepted(self) -> Array:
        """The setpoint that sim says is in force, rad."""
        self.station.until(lambda: self._accepted.latest is not None, ANSWER_S, "no joints/accepted", "one, latched")
        assert self._accepted.latest is not None
        return self._angles(self._accepted.latest.message, "joints/accepted has")

    def reset(self, q: Array) -> None:
        """The arm is at rest at a pose."""
        if self._now_ns == 0:
            self.instant()
        joints = list(self.to(q).joints)
        try:
            first_ns = from_timestamp(self._bus.query(topics.RESET, ResetRequest(joints=joints)).capture_time)
        except (NoReplyError, RefusedError) as error:
            raise UnfulfilledError(str(error), "that sim/reset takes a pose within the limits") from error
        for _ in range(100):
            if self.step() >= first_ns:
                return
        raise UnfulfilledError("100 instants, and none that shows the pose", "the capture time that was answered")

    def _angles(self, states: JointStates, what: str) -> Array:
        given = {joint.name: joint.position for joint in states.joints}
        judge.check_names(what, given, self.names)
        return np.array([given[name] for name in self.names])

    def _take_image(self, received: Received[RawImage]) -> None:
        image = received.message
        frame = _Frame(image.width, image.height, image.step, len(image.data), image.encoding, image.frame_id)
        with self._arrived:
            self._frames.setdefault(from_timestamp(image.timestamp), {})[received.name] = frame
            self._arrived.notify_all()

    def _take_truth(self, received: Received[JointStates]) -> None:
        with self._arrived:
            self._truths[from_timestamp(received.message.timestamp)] = received.message
            self._arrived.notify_all()

    def _take_clock(self, received: Received[Clock]) -> None:
        with self._arrived:
            self._clocks.append(received.message)
            self._arrived.notify_all()

    # --- checks

    def described(self) -> None:
        """The description fits together."""
        judge.check_description(self.description)

    def cameras(self) -> None:
        """Calibration and pose of each camera."""
        calibrations: dict[str, CameraCalibration] = {}
        poses: dict[str, FrameTransform] = {}
        until = time.monotonic() + ANSWER_S
        names = set(self.description.cameras)
        while not (names <= set(calibrations) and names <= set(poses)) and time.monotonic() < until:
            if (calibration := self._calibrations.recv(0.1)) is not None:
                calibrations[calibration.name] = calibration.message
            if (pose := self._poses.recv(0.1)) is not None:
                poses[pose.name] = pose.message
        judge.check_names("latched calibrations of", calibrations, names)
        judge.check_names("latched poses of", poses, names)
        for name in names:
            judge.check_calibration(name, calibrations[name])
            judge.check_pose(name, poses[name])
        self.step()
        for name, frame in self._frames[self._now_ns].items():
            size = calibrations[name].width, calibrations[name].height
            seen = f"a frame of {frame.width} x {frame.height} of camera {name}"
            require((frame.width, frame.height) == size, seen, f"{size[0]} x {size[1]}, as it is calibrated")
            require(frame.frame_id == poses[name].child_frame_id, f"frame {frame.frame_id!r}", "the frame of its pose")

    def frames(self) -> None:
        """Frames of an instant have one capture time."""
        for _ in range(5):
            now = self.step()
            for name, frame in self._frames[now].items():
                seen = f"camera {name}: {frame.size} bytes, {frame.height} rows of {frame.step}, {frame.encoding}"
                require(0 < frame.step * frame.height <= frame.size, seen, "all rows")
                require(frame.encoding in ("rgb8", "bgr8", "rgba8", "bgra8"), seen, "rgb8, bgr8, rgba8 or bgra8")
                require(frame.step >= frame.width * (3 if "a" not in frame.encoding else 4), seen, "whole rows")

    def clocks(self) -> None:
        """The clock goes on, with the frames."""
        _ = self.clock
        first = len(self._clocks)
        instants = {self.step() for _ in range(8)}

        def without() -> set[int]:
            return instants - {from_timestamp(clock.capture_time) for clock in self._clocks}

        with self._arrived:  # a clock may be heard after its frames
            self._arrived.wait_for(lambda: not without(), ANSWER_S)
            heard, missing = self._clocks[first:], without()
        judge.check_monotonic("clock", [from_timestamp(clock.capture_time) for clock in heard])
        judge.check_monotonic("frame", [clock.frame * NS_PER_S for clock in heard])
        require(not missing, f"{len(missing)} of {len(instants)} instants without a clock", "the time of the frames")
        for clock in heard:
            require(clock.mode != CLOCK_MODE_UNSPECIFIED, "no mode", "REALTIME or LOCKSTEP")
            require(from_duration(clock.period) > 0, "no period", "the time between two frames")

    def moves(self) -> None:
        """A valid command moves the arm, within speed."""
        start, goal = self._start(), self._start() + self._signs() * _GOAL_RAD
        self.reset(start)
        self._go_within_speed(start + (goal - start) * min(1.0, step * _STEP_RAD / _GOAL_RAD) for step in range(1, 40))
        judge.check_near("after commands to a goal the arm is at", self.truth(), goal, _NEAR_RAD, "rad")
        judge.check_near("joints/accepted", self.accepted(), goal, 1e-3, "rad")

    def is_fast_at_most(self) -> None:
        """A command far away is approached within speed."""
        start = self._start()
        self.reset(start)
        self._go_within_speed([start + self._signs() * 0.6] * 10, " on its way to a goal at once")

    def holds(self) -> None:
        """A hold moves nothing, whatever joints it names."""
        self.reset(self._start())
        for _ in range(10):
            command = self.to(self._start() + self._signs() * _GOAL_RAD)
            command.hold = True
            self.step(command)
        judge.check_near("after holds the arm is at", self.truth(), self._start(), _STILL_RAD, "rad")

    def refuses(self) -> None:
        """Commands that may not be move nothing, and are counted."""
        start = self._start()
        self.reset(start)
        self.hold_for(0.1)
        before = self.station.health()
        near = start + self._signs() * 0.05
        not_finite = near.copy()
        not_finite[0] = float("nan")
        beyond = near.copy()
        beyond[-1] = self.description.joints[-1].upper_rad + 0.5
        unknown = self.to(near)
        unknown.joints[0].name = "conformance_no_such_joint"
        missing = self.to(near)
        missing.joints.pop()
        wrong: dict[str, Callable[[], JointCommand]] = {
            "a command with NaN": lambda: self.to(not_finite),
            "a command beyond a limit": lambda: self.to(beyond),
            "a command with an unknown joint": lambda: unknown,
            "a command without one of the joints": lambda: missing,
            "a stale command": lambda: self._answering(near, -5.0),
            "a command out of order": lambda: self._answering(near, -1e-3 - from_duration(self.clock.period)),
            "a command that answers an instant to come": lambda: self._answering(near, 60.0),
        }
        for what, command in wrong.items():
            self.wrong(command())
            self.hold_for(0.1)
            judge.check_near(f"joints/accepted after {what}", self.accepted(), start, 1e-6, "rad")
            judge.check_near(f"after {what} the arm is at", self.truth(), start, _STILL_RAD, "rad")
        self.station.must_count(before, len(wrong), "commands that may not be")

    def watchdog(self) -> None:
        """Without commands the arm comes to rest."""
        start = self._start()
        self.reset(start)
        # an arm that goes on is there in a third of a second
        far = start + self._signs() * 1.4
        limits = self._limits()
        far = np.clip(far, 0.95 * limits[:, 0], 0.95 * limits[:, 1])
        self.step(self.to(far))
        self.hold_for(_REST_S)
        there = float(np.abs(self.truth() - far).min())
        require(there > 0.1, "the arm went on to its goal after one command", "rest 0.1 s after the last command")
        at_rest = self.truth()
        self.hold_for(0.2)
        judge.check_near("1.5 s after the last command the arm is at", self.truth(), at_rest, _STILL_RAD, "rad")

    def stops(self) -> None:
        """A stop holds until its source releases it."""
        start = self._start()
        self.reset(start)
        goal = start + self._signs() * _GOAL_RAD
        state = self._asked_to_stop()
        try:
            require(state.stopped, "not stopped by safety/stop", "stopped")
            stopped = lambda: self._stop.latest is not None and self._stop.latest.message.stopped  # noqa: E731
            self.station.until(stopped, ANSWER_S, "safety/stop does not say stopped", "the state, latched")
            for _ in range(10):
                self.step(self.to(goal))
            judge.check_near("while it is stopped the arm is at", self.truth(), start, _STILL_RAD, "rad")
            release = StopRequest(action=STOP_ACTION_RELEASE, source=_SOURCE)
            with refused("RELEASE on safety/stop, which viewers may ask,"):
                self._bus.query(topics.STOP, release, timeout_s=ANSWER_S)
            with refused("a release by who has not stopped"):
                other = StopRequest(action=STOP_ACTION_RELEASE, source=f"{_SOURCE}-other")
                self._bus.query(topics.RELEASE, other, timeout_s=ANSWER_S)
        finally:
            state = self._bus.query(
                topics.RELEASE, StopRequest(action=STOP_ACTION_RELEASE, source=_SOURCE), timeout_s=ANSWER_S
            ).state
        named = [source.name for source in state.sources if source.stopped and source.name == _SOURCE]
        require(not named, "stopped still by who has released it", "released")
        with refused("a stop by nobody"):
            self._bus.query(topics.STOP, StopRequest(action=STOP_ACTION_STOP), timeout_s=ANSWER_S)
        for step in range(1, 12):
            self.step(self.to(start + self._signs() * 0.01 * step))
        moved = float(np.abs(self.truth() - start).max())
        require(moved > 0.03, f"{moved:.3f} rad moved after the release", "motion as commanded")

    def resets(self) -> None:
        """A reset puts the arm at a pose, which is the accepted setpoint then."""
        pose = self._start() + self._signs() * 0.4
        before_ns = self._now_ns or self.instant()
        self.reset(pose)
        judge.check_monotonic("time by a reset", [before_ns, self._now_ns])
        judge.check_near("after sim/reset the arm is at", self.truth(), pose, _STILL_RAD, "rad")
        judge.check_near("joints/accepted after sim/reset", self.accepted(), pose, 1e-6, "rad")
        self.hold_for(0.3)
        judge.check_near("0.3 s after sim/reset the arm is at", self.truth(), pose, _STILL_RAD, "rad")
        unknown = ResetRequest(joints=[JointSetpoint(name="conformance_no_such_joint")])
        with refused("an unknown joint on sim/reset"):
            self._bus.query(topics.RESET, unknown, timeout_s=ANSWER_S)
        self.reset(self._start())

    def malformed(self) -> None:
        """Bytes that are no message are counted, and harm nothing."""
        self.reset(self._start())
        before = self.station.health()
        for dirt in DIRT[1:]:
            self._commands.put_bytes(dirt)
        for key in (topics.RESET.key, topics.STOP.key, topics.RELEASE.key):
            self.station.malformed_query(key)
        self.station.must_count(before, len(DIRT[1:]), "malformed messages on joints/command")
        self.hold_for(0.1)
        judge.check_near("after malformed bytes the arm is at", self.truth(), self._start(), _STILL_RAD, "rad")

    def schema(self) -> None:
        """What the messages are made of."""
        try:
            found = self._bus.query(topics.SCHEMA, Empty(), timeout_s=ANSWER_S)
        except (NoReplyError, RefusedError) as error:
            raise UnfulfilledError(str(error), "an answer on schema") from error
        messages = {f"{file.package}.{message.name}" for file in found.file for message in file.message_type}
        missing = sorted({topic.message.DESCRIPTOR.full_name for topic in topics.TOPICS} - messages)
        require(not missing, f"no {', '.join(missing)} in schema", "every message of the contract")

    # --- what checks have in common

    def _go_within_speed(self, way: Iterable[Array], where: str = "") -> None:
        """A command an instant, and none of them moves a joint faster than it may."""
        before, before_ns = self.truth(), self._now_ns
        fastest = np.array([joint.max_speed_rad_s for joint in self.description.joints])
        for q in way:
            self.step(self.to(q))
            now, elapsed_s = self.truth(), (self._now_ns - before_ns) / NS_PER_S
            speeds = np.abs(now - before) / elapsed_s
            at = int(np.argmax(speeds / fastest))
            seen = f"{self.names[at]} at {speeds[at]:.2f} rad/s{where}"
            require(speeds[at] <= _OVERSHOOT * fastest[at], seen, f"at most {fastest[at]:g}")
            before, before_ns = now, self._now_ns

    def _limits(self) -> Array:
        return np.array([(joint.lower_rad, joint.upper_rad) for joint in self.description.joints])

    def _start(self) -> Array:
        """The middle of each joint's way."""
        return np.asarray(self._limits().mean(axis=1))

    def _signs(self) -> Array:
        """Each joint goes as far as its own way allows, of a radian."""
        half = (self._limits()[:, 1] - self._limits()[:, 0]) / 2
        return np.asarray(np.minimum(1.0, half))

    def _answering(self, q: Array, ahead_s: float) -> JointCommand:
        command = self.to(q)
        command.answers.CopyFrom(to_timestamp(self._now_ns + round(ahead_s * NS_PER_S)))
        return command

    def _asked_to_stop(self) -> StopState:
        request = StopRequest(action=STOP_ACTION_STOP, source=_SOURCE, reason="armsight conformance")
        try:
            return self._bus.query(topics.STOP, request, timeout_s=ANSWER_S).state
        except (NoReplyError, RefusedError) as error:
            raise UnfulfilledError(str(error), "that safety/stop stops") from error


_SIM = "own-part.md#sim"

CHECKS: tuple[Check[Commander], ...] = (
    *of_every_service("Sim"),
    Check(
        "description",
        "The description is of a serial chain: names once, unit axes, limits, markers and tip on its joints, cameras.",
        "messages.md#armdescription",
        Commander.described,
    ),
    Check(
        "cameras",
        "Calibration and pose of each camera are latched, and fit its frames.",
        "keys.md",
        Commander.cameras,
    ),
    Check(
        "frames",
        "The frames of an instant have one capture time, and all their rows.",
        _SIM,
        Commander.frames,
    ),
    Check("clock", "clock tells each instant, and only goes on.", "messages.md#clock", Commander.clocks),
    Check(
        "moves",
        "Valid commands bring the arm to their goal, which joints/accepted tells, within the joints' speed.",
        "messages.md#jointcommand",
        Commander.moves,
    ),
    Check("speed", "A goal far away is approached within the joints' speed.", _SIM, Commander.is_fast_at_most),
    Check("hold", "A hold moves nothing.", "messages.md#jointcommand", Commander.holds),
    Check(
        "refuses",
        "Commands that are stale, out of order, not finite, beyond limits or of other joints are refused and counted.",
        _SIM,
        Commander.refuses,
    ),
    Check(
        "watchdog",
        "0.1 s of simulated time after the last command the arm decelerates and holds.",
        _SIM,
        Commander.watchdog,
    ),
    Check(
        "stop",
        "A stop holds until its own source releases it on safety/release.",
        "messages.md#stoprequest",
        Commander.stops,
    ),
    Check(
        "reset",
        "A reset puts the arm at rest at a pose, which becomes the accepted setpoint.",
        "messages.md#resetrequest",
        Commander.resets,
    ),
    Check(
        "malformed",
        "Bytes that are no message are counted, refused where they are a question, and harm nothing.",
        "own-part.md#every-part",
        Commander.malformed,
    ),
    Check("schema", "schema answers with every message of the contract.", "keys.md", Commander.schema),
)
