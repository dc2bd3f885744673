"""`armsight conformance sim`: one's own passes, each broken one fails the check meant for it."""

from collections.abc import Sequence

import numpy as np
import own_wrong
import pytest
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from google.protobuf.descriptor_pb2 import FileDescriptorSet

from armsight.times import from_timestamp, to_timestamp
from armsight.v1.description_pb2 import ArmDescription
from armsight.v1.joints_pb2 import JointCommand
from armsight.v1.safety_pb2 import StopRequest, StopResponse
from armsight.v1.sim_pb2 import Clock, ResetRequest, ResetResponse
from armsight_operator.conformance import suite_of
from armsight_operator.conformance.draw import Camera
from conformance_runs import Own, Results, failed, results_of
from own_control import Array
from own_sim import OwnSim


class NoToken(own_wrong.NoToken, OwnSim):
    pass


class RareHealth(own_wrong.RareHealth, OwnSim):
    pass


class TakesAnyParameter(own_wrong.TakesAnyParameter, OwnSim):
    pass


class LongAxis(OwnSim):
    def describe(self) -> ArmDescription:
        described = super().describe()
        described.joints[1].axis.y = 2.0
        return described


class MarkerOnNothing(OwnSim):
    def describe(self) -> ArmDescription:
        described = super().describe()
        described.markers[0].centre.joint = "elbow"
        return described


class OtherSize(OwnSim):
    def calibration(self, camera: Camera) -> CameraCalibration:
        calibration = super().calibration(camera)
        calibration.width = 64
        return calibration


class FramesApart(OwnSim):
    """Stamps each camera with a time of its own."""

    def say_frames(self) -> None:
        cameras, now_ns = self.cameras, self.now_ns
        for index, camera in enumerate(cameras):
            self.cameras, self.now_ns = [camera], now_ns + index
            super().say_frames()
        self.cameras, self.now_ns = cameras, now_ns


class ClockGoesBack(OwnSim):
    def say_clock(self, clock: Clock) -> None:
        super().say_clock(clock)
        clock.capture_time.CopyFrom(to_timestamp(from_timestamp(clock.capture_time) - 10**9))
        super().say_clock(clock)


class Lazy(OwnSim):
    """Goes half of the way."""

    def step(self) -> None:
        self.goal, goal = 0.5 * self.goal, self.goal
        super().step()
        self.goal = goal


class Races(OwnSim):
    def fastest(self) -> float:
        return 1000.0


class ObeysHolds(OwnSim):
    def held(self, command: JointCommand) -> None:
        if command.joints:
            self.goal = np.array([joint.position_rad for joint in command.joints])
            self.moved_ns = self.now_ns


class TakesOldCommands(OwnSim):
    def is_old(self, answers_ns: int, command: JointCommand) -> bool:
        return super().is_old(answers_ns, command) and command.hold


class TakesBeyondLimits(OwnSim):
    def bad_values(self, q: Array) -> str:
        return "" if np.isfinite(q).all() else super().bad_values(q)


class CountsNothing(OwnSim):
    def count(self, reason: str) -> None:
        pass


class NoWatchdog(OwnSim):
    def expired(self) -> bool:
        return False


class AnybodyReleases(OwnSim):
    def release(self, request: StopRequest) -> StopResponse:
        return self.changed(self.stopped_by - {request.source})


class StopsOnPaper(OwnSim):
    """Says that it is stopped, and moves."""

    def refusal(self, command: JointCommand) -> str:
        stopped_by, self.stopped_by = self.stopped_by, set()
        refused = super().refusal(command)
        self.stopped_by = stopped_by
        return refused

    def step(self) -> None:
        stopped_by, self.stopped_by = self.stopped_by, set()
        super().step()
        self.stopped_by = stopped_by


class ResetsNearby(OwnSim):
    """To another pose than was asked for."""

    def reset(self, request: ResetRequest) -> ResetResponse:
        if any(joint.position_rad for joint in request.joints):
            request.joints[-1].position_rad += 0.1
        return super().reset(request)


class DiesOfDirt(OwnSim):
    def step(self) -> None:
        if self.bus.counters.snapshot().get("malformed_joint_command"):
            self.q = self.q + 0.1
        super().step()


class NoSchema(OwnSim):
    def schema(self) -> FileDescriptorSet:
        return FileDescriptorSet()


BROKEN: dict[type[OwnSim], str] = {
    NoToken: "token",
    RareHealth: "health",
    TakesAnyParameter: "parameters",
    LongAxis: "description",
    MarkerOnNothing: "description",
    OtherSize: "cameras",
    ClockGoesBack: "clock",
    Lazy: "moves",
    Races: "speed",
    ObeysHolds: "hold",
    TakesOldCommands: "refuses",
    TakesBeyondLimits: "refuses",
    CountsNothing: "refuses",
    NoWatchdog: "watchdog",
    AnybodyReleases: "stop",
    StopsOnPaper: "stop",
    ResetsNearby: "reset",
    DiesOfDirt: "malformed",
    NoSchema: "schema",
}
OTHERS = ("token", "frames")
"""Beside the check that is meant."""


@pytest.fixture(scope="module")
def found() -> dict[Own, Results]:
    cases: dict[Own, Sequence[str]] = {own: (name, *OTHERS) for own, name in BROKEN.items()}
    return results_of("sim", cases | {OwnSim: (), FramesApart: ("frames",)})


def test_a_sim_of_ones_own_fulfils_everything(found: dict[Own, Results]) -> None:
    assert failed(found[OwnSim]) == set(), found[OwnSim]
    assert list(found[OwnSim]) == [check.name for check in suite_of("sim").checks]


def test_for_every_check_there_is_a_sim_that_fails_it() -> None:
    assert {*BROKEN.values(), "frames"} == {check.name for check in suite_of("sim").checks}


@pytest.mark.parametrize(("own", "name"), BROKEN.items(), ids=lambda each: getattr(each, "__name__", each))
def test_a_broken_sim_fails_the_check_meant_for_it(found: dict[Own, Results], own: type[OwnSim], name: str) -> None:
    assert failed(found[own]) == {name}, found[own]
    assert found[own][name].seen
    assert found[own][name].expected


def test_frames_with_times_of_their_own_are_found(found: dict[Own, Results]) -> None:
    assert "no frames of all cameras with one capture time" in found[FramesApart]["frames"].seen
