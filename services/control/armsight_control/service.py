"""armsight-control on the bus: answers every `joints/positions` with a command, an estimate and a status."""

import gc
import sys
import threading
from time import monotonic

from armsight.bus import Received
from armsight.errors import ArmsightError
from armsight.service import EXIT_CONFIG, Context, run_service
from armsight.times import wall_ns
from armsight.topics import (
    CONTROL_STATUS,
    DESCRIPTION,
    FORWARD_KINEMATICS,
    JOINT_COMMAND,
    JOINT_POSITIONS,
    JOINTS_ACCEPTED,
    JOINTS_ESTIMATED,
    MODE,
    STOP_STATE,
    TARGET,
)
from armsight.v1.control_pb2 import (
    CONTROL_STATE_BLIND,
    CONTROL_STATE_WAITING,
    ControlStatus,
    ForwardKinematicsRequest,
    ForwardKinematicsResponse,
    SetModeRequest,
    SetModeResponse,
)
from armsight.v1.geometry_pb2 import Vector3
from armsight.v1.health_pb2 import HEALTH_STATUS_DEGRADED, HEALTH_STATUS_OK, HEALTH_STATUS_WAITING
from armsight.v1.joints_pb2 import JointPositions
from armsight_control.errors import ModeError
from armsight_control.kinematics import forward, jacobian
from armsight_control.latency import Latency
from armsight_control.loop import Answer, Loop
from armsight_control.modes import NAMES, Mode, mode_of
from armsight_control.setpoints import configuration
from armsight_control.settings import Settings, parser, settings_of

# Without positions for this long the status says so, and again as often.
QUIET_S = 0.25


class Service:
    """The loop on the bus: the only part of control that knows it."""

    def __init__(self, context: Context, settings: Settings) -> None:
        """Declares everything; positions are answered once :meth:`run` is called."""
        bus = context.bus
        self._context = context
        self._lock = threading.Lock()
        self._loop = Loop(settings.motion, settings.ik, settings.seed, bus.counters)
        self._loop.set_mode(Mode(NAMES[settings.mode]))
        self._latency = Latency()
        self._commands = bus.publisher(JOINT_COMMAND)
        self._estimates = bus.publisher(JOINTS_ESTIMATED)
        self._statuses = bus.publisher(CONTROL_STATUS)
        bus.subscriber(DESCRIPTION, on_message=lambda got: self._locked(self._loop.describe, got.message))
        bus.subscriber(JOINTS_ACCEPTED, on_message=lambda got: self._locked(self._loop.accept, got.message))
        bus.subscriber(STOP_STATE, on_message=lambda got: self._locked(self._loop.stop, got.message))
        bus.subscriber(TARGET, on_message=lambda got: self._locked(self._loop.aim, got.message))
        bus.presence(self._seen)
        bus.serve(MODE, self._set_mode)
        bus.serve(FORWARD_KINEMATICS, self._forward)
        self._positions = bus.subscriber(JOINT_POSITIONS)

    def run(self) -> None:
        """Answers positions until the service is asked to stop."""
        heard = monotonic()
        while not self._context.stop.is_set():
            received = self._positions.recv(QUIET_S)
            if received is None:
                self._report_quiet(monotonic() - heard)
                continue
            heard = received.received_s
            received_ns = wall_ns() - round((monotonic() - received.received_s) * 1e9)
            with self._lock:
                answer = self._loop.answer(received.message, monotonic() - received.received_s)
            if answer is not None:
                self._send(answer, received, received_ns)

    def _send(self, answer: Answer, received: Received[JointPositions], received_ns: int) -> None:
        for stages in (answer.command.stages, answer.status.stages):
            stages.control_received_ns = received_ns
            stages.control_sent_ns = wall_ns()
        self._commands.put(answer.command)
        self._latency.add(monotonic() - received.received_s)
        self._estimates.put(answer.estimated)
        self._statuses.put(answer.status)
        self._report(answer.status)

    def _report(self, status: ControlStatus) -> None:
        health = self._context.health
        for name, value in self._latency.gauges().items():
            health.gauge(name, value)
        if status.state == CONTROL_STATE_WAITING:
            health.report(HEALTH_STATUS_WAITING, status.detail)
        elif status.state == CONTROL_STATE_BLIND:
            health.report(HEALTH_STATUS_DEGRADED, status.detail)
        else:
            health.report(HEALTH_STATUS_OK)

    def _report_quiet(self, for_s: float) -> None:
        if self._loop.arm is None:
            detail = "no description of the arm yet: is sim running?"
        else:
            detail = f"no positions for {for_s:.0f} s: is vision running?"
        state = CONTROL_STATE_WAITING
        self._statuses.put(ControlStatus(mode=self._loop.mode, state=state, detail=detail))
        self._context.health.report(HEALTH_STATUS_WAITING, detail.replace(f"{for_s:.0f} s", "a while"))

    def _locked(self, take, message) -> None:  # type: ignore[no-untyped-def]
        with self._lock:
            take(message)

    def _seen(self, service: str, here: bool) -> None:
        if service == "sim" and here:
            self._locked(lambda _: self._loop.begin_anew(), None)

    def _set_mode(self, request: SetModeRequest) -> SetModeResponse:
        with self._lock:
            if request.mode:
                arm = self._loop.arm
                self._loop.set_mode(mode_of(request, None if arm is None else arm.chain))
            return SetModeResponse(mode=self._loop.mode)

    def _forward(self, request: ForwardKinematicsRequest) -> ForwardKinematicsResponse:
        arm = self._loop.arm
        if arm is None:
            raise ModeError("the arm's description has not arrived yet: is sim running?")
        q = configuration({joint.name: joint.position_rad for joint in request.joints}, arm.chain)
        tip = forward(arm.chain, q)
        return ForwardKinematicsResponse(
            tip=Vector3(x=tip[0], y=tip[1], z=tip[2]), jacobian=jacobian(arm.chain, q).ravel().tolist()
        )


def main() -> int:
    """The console script."""
    arguments = parser().parse_args()
    try:
        settings = settings_of(arguments)
    except ArmsightError as error:
        print(f"control: {error}", file=sys.stderr)
        return EXIT_CONFIG

    def body(context: Context) -> None:
        service = Service(context, settings)
        # what is there by now stays: collecting it again and again would only add to the slowest answers
        gc.freeze()
        service.run()

    return run_service("control", arguments, settings, body, shared_memory="off")


if __name__ == "__main__":
    sys.exit(main())
