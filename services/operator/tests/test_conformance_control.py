"""`armsight conformance control`: one's own passes, each broken one fails the check meant for it."""

from collections.abc import Callable, Sequence

import numpy as np
import own_wrong
import pytest

from armsight import topics
from armsight.bus import Bus
from armsight.errors import ArmsightError
from armsight.times import from_timestamp, wall_ns
from armsight.v1.control_pb2 import (
    CONTROL_MODE_JOINTS,
    CONTROL_STATE_HOLDING,
    CONTROL_STATE_MOVING,
    IK_STATUS_CONVERGED,
    SAFETY_CODE_NOT_READY,
    SAFETY_CODE_OK,
    ControlStatus,
    ForwardKinematicsRequest,
    ForwardKinematicsResponse,
    SetModeRequest,
    SetModeResponse,
    SolveIkRequest,
    SolveIkResponse,
)
from armsight.v1.geometry_pb2 import Vector3
from armsight.v1.joints_pb2 import JointCommand, JointPositions
from armsight.v1.safety_pb2 import StopState
from armsight_operator.conformance import OccupiedError, Outcome, UnknownCheckError, run, suite_of
from armsight_operator.conformance.scene import twin
from conformance_runs import Own, Results, failed, results_of
from own_control import Array, OwnControl, Verdict

MakeBus = Callable[[], Bus]


class NoToken(own_wrong.NoToken, OwnControl):
    pass


class RareHealth(own_wrong.RareHealth, OwnControl):
    pass


class TakesAnyParameter(own_wrong.TakesAnyParameter, OwnControl):
    pass


class TakesAnyMode(OwnControl):
    def set_mode(self, request: SetModeRequest) -> SetModeResponse:
        try:
            return super().set_mode(request)
        except ArmsightError:
            return SetModeResponse(mode=request.mode)


class BelievesItsEyes(OwnControl):
    """Starts from what it sees, without waiting for sim."""

    def judged(self, message: JointPositions) -> Verdict:
        if self.q is None and self.arm is not None:
            self.q = np.zeros(len(self.arm.names))
            return CONTROL_STATE_MOVING, SAFETY_CODE_OK
        return super().judged(message)


class AnswersTwice(OwnControl):
    """A second answer to every instant, though nobody asked again."""

    def positions(self, message: JointPositions) -> None:
        new = from_timestamp(message.capture_time) > self.last_ns
        super().positions(message)
        if new and self.last is not None:
            self.send(self.last)


class SkipsInstants(OwnControl):
    """Thinks that one instant in eight need not be answered, once it moves."""

    def positions(self, message: JointPositions) -> None:
        self.count_all = getattr(self, "count_all", 0) + (self.mode == CONTROL_MODE_JOINTS)
        if self.count_all % 8 != 7:
            super().positions(message)


class NeverAgain(OwnControl):
    """Moves on when the same positions come again."""

    def positions(self, message: JointPositions) -> None:
        if from_timestamp(message.capture_time) == self.last_ns:
            self.last_ns, self.last = self.last_ns - 1, None
            if self.q is not None:
                self.q = self.q + 0.01
        super().positions(message)


class TooFast(OwnControl):
    def command(self, moving: bool) -> JointCommand:
        return self.setpoint(self.goal) if moving else super().command(moving)


class Incomplete(OwnControl):
    def setpoint(self, q: Array) -> JointCommand:
        command = super().setpoint(q)
        command.joints.pop()
        return command


class NotFinite(OwnControl):
    def setpoint(self, q: Array) -> JointCommand:
        return super().setpoint(q * float("nan"))


class DriftsInHold(OwnControl):
    def judged(self, message: JointPositions) -> Verdict:
        state, safety = super().judged(message)
        return (CONTROL_STATE_MOVING if state == CONTROL_STATE_HOLDING else state), safety

    def command(self, moving: bool) -> JointCommand:
        if moving and self.mode == 1 and self.q is not None:
            return self.setpoint(self.q * 1.01)
        return super().command(moving)


class TakesTheTwin(OwnControl):
    """Prefers small angles of joint 1, as all that see the arm alike may."""

    def command(self, moving: bool) -> JointCommand:
        if moving and self.q is not None and abs(self.q[0]) > 2.0:
            return self.setpoint(self.q + np.clip(twin(self.q) - self.q, -0.05, 0.05))
        return super().command(moving)


class IgnoresStop(OwnControl):
    def take_stop(self, message: StopState) -> None:
        del message


class MovesBlind(OwnControl):
    def enough(self, seen: dict[str, Vector3]) -> bool:
        return len(seen) >= 0


class CountsNothing(OwnControl):
    def count(self, code: str) -> None:
        if "LOST" not in code:
            super().count(code)


class BelievesAnything(OwnControl):
    def plausible(self, seen: dict[str, Vector3]) -> bool:
        return bool(np.isfinite([position.x for position in seen.values()]).all())


class TakesNoNumber(OwnControl):
    def plausible(self, seen: dict[str, Vector3]) -> bool:
        return not np.isfinite([position.x for position in seen.values()]).all() or super().plausible(seen)


class GoesBackInTime(OwnControl):
    def is_old(self, capture_ns: int) -> bool:
        return capture_ns == 0


class TellsNoStatus(OwnControl):
    def tell(self, status: ControlStatus) -> None:
        if self.mode == 1 or status.safety not in (SAFETY_CODE_OK, SAFETY_CODE_NOT_READY):
            super().tell(status)
        elif self.arm is not None:
            status.stages.control_received_ns = wall_ns() + 10**9
            super().tell(status)


class OtherKinematics(OwnControl):
    def forward_kinematics(self, request: ForwardKinematicsRequest) -> ForwardKinematicsResponse:
        answer = super().forward_kinematics(request)
        answer.tip.z += 0.5  # in the world frame instead of the base frame
        return answer


class AlwaysConverges(OwnControl):
    def solve_ik(self, request: SolveIkRequest) -> SolveIkResponse:
        answer = super().solve_ik(request)
        answer.status = IK_STATUS_CONVERGED
        return answer


class DiesOfDirt(OwnControl):
    """Answers nothing more once bytes came that it can't read."""

    def positions(self, message: JointPositions) -> None:
        if not self.bus.counters.snapshot().get("malformed_joint_positions"):
            super().positions(message)


BROKEN: dict[type[OwnControl], str] = {
    NoToken: "token",
    RareHealth: "health",
    TakesAnyParameter: "parameters",
    TakesAnyMode: "modes",
    BelievesItsEyes: "waits-for-setpoint",
    AnswersTwice: "answers",
    NeverAgain: "repeated",
    DriftsInHold: "mode-hold",
    TakesTheTwin: "never-the-twin",
    IgnoresStop: "stop",
    MovesBlind: "lost-markers",
    CountsNothing: "lost-markers",
    BelievesAnything: "implausible",
    TakesNoNumber: "not-finite",
    GoesBackInTime: "stale",
    DiesOfDirt: "malformed",
    TellsNoStatus: "status",
    OtherKinematics: "forward-kinematics",
    AlwaysConverges: "solve-ik",
}


FOUND_ON_THE_WAY: dict[type[OwnControl], str] = {
    TooFast: "rad from the accepted",
    Incomplete: "joints joint1",
    NotFinite: "nan",
}
OTHERS = ("modes", "mode-joints", "forward-kinematics")
"""Beside the check that is meant: what is broken is broken there alone."""


@pytest.fixture(scope="module")
def found() -> dict[Own, Results]:
    cases: dict[Own, Sequence[str]] = {OwnControl: ()}
    cases |= {own: (name, *OTHERS) for own, name in BROKEN.items()}
    cases |= dict.fromkeys(FOUND_ON_THE_WAY, OTHERS)
    return results_of("control", cases | {SkipsInstants: ("answers",)})


def test_a_control_of_ones_own_fulfils_everything(found: dict[Own, Results]) -> None:
    assert failed(found[OwnControl]) == set(), found[OwnControl]
    assert list(found[OwnControl]) == [check.name for check in suite_of("control").checks]


def test_for_every_check_there_is_a_control_that_fails_it() -> None:
    assert {*BROKEN.values(), "mode-joints"} == {check.name for check in suite_of("control").checks}


@pytest.mark.parametrize(("own", "name"), BROKEN.items(), ids=lambda each: getattr(each, "__name__", each))
def test_a_broken_control_fails_the_check_meant_for_it(
    found: dict[Own, Results], own: type[OwnControl], name: str
) -> None:
    assert failed(found[own]) == {name}, found[own]
    assert found[own][name].seen
    assert found[own][name].expected


@pytest.mark.parametrize(("own", "seen"), FOUND_ON_THE_WAY.items())
def test_commands_that_may_not_be_are_found_on_the_way(
    found: dict[Own, Results], own: type[OwnControl], seen: str
) -> None:
    assert failed(found[own]) == {"mode-joints"}
    assert seen in found[own]["mode-joints"].seen


def test_an_instant_without_an_answer_is_found(found: dict[Own, Results]) -> None:
    assert "no joints/command for positions" in found[SkipsInstants]["answers"].seen


def test_nobody_is_told_at_once_and_nothing_is_asked(make_bus: MakeBus) -> None:
    found = list(run(make_bus(), suite_of("control")))
    assert found[0].outcome is Outcome.FAILED
    assert "is it running?" in found[0].seen
    assert {result.outcome for result in found[1:]} == {Outcome.NOT_APPLICABLE}


def test_who_is_there_is_not_played(make_bus: MakeBus) -> None:
    bus = make_bus()
    token = bus.session.liveliness().declare_token(topics.HEALTH.key_for("sim"))
    with pytest.raises(OccupiedError, match="sim already there"):
        list(run(make_bus(), suite_of("control")))
    token.undeclare()  # type: ignore[no-untyped-call]


def test_a_check_that_there_is_not_is_named(make_bus: MakeBus) -> None:
    with pytest.raises(UnknownCheckError, match="no check 'spin' of control; there are token"):
        list(run(make_bus(), suite_of("control"), ["spin"]))
