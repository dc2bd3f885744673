"""armsight-control on the bus: answers every `joints/positions` with a command, an estimate and a status.

In real time inverse kinematics is solved beside the loop and a frame is answered with the newest solution there is; in
lockstep the answer waits for the solution of the present target, so that runs repeat.
"""

import gc
import logging
import sys
import threading
from collections.abc import Mapping
from time import monotonic

from armsight.bus import Received
from armsight.errors import ArmsightError
from armsight.parameters import Value
from armsight.service import EXIT_CONFIG, Context, run_service
from armsight.times import from_timestamp, wall_ns
from armsight.topics import (
    CLOCK,
    CONTROL_STATUS,
    DESCRIPTION,
    FORWARD_KINEMATICS,
    JOINT_COMMAND,
    JOINT_POSITIONS,
    JOINTS_ACCEPTED,
    JOINTS_ESTIMATED,
    MODE,
    SOLVE_IK,
    STOP_STATE,
    TARGET,
)
from armsight.v1.control_pb2 import (
    CONTROL_STATE_BLIND,
    CONTROL_STATE_WAITING,
    ControlStatus,
)
from armsight.v1.health_pb2 import HEALTH_STATUS_DEGRADED, HEALTH_STATUS_OK, HEALTH_STATUS_WAITING
from armsight.v1.joints_pb2 import JointPositions
from armsight.v1.sim_pb2 import CLOCK_MODE_LOCKSTEP
from armsight_control.answer import Answer
from armsight_control.latency import Latency
from armsight_control.loop import Loop
from armsight_control.modes import AIMING, NAMES, Mode
from armsight_control.pursuit import Pursuit
from armsight_control.queries import Queries
from armsight_control.settings import Settings, parser, settings_of
from armsight_control.solvers import check_applies
from armsight_control.tuning import tunables, tuned

log = logging.getLogger(__name__)

# Without positions for this long the status says so, and again as often.
QUIET_S = 0.25

# The processors are the command's until it is where it goes: on two of them what control does next kept it waiting for
# 0.5 ms.
_COMMAND_LEAVES_S = 0.0005


class Service:
    """The loop on the bus: the only part of control that knows it."""

    def __init__(self, context: Context, settings: Settings) -> None:
        """Declares everything; positions are answered once :meth:`run` is called."""
        bus = context.bus
        self._context = context
        self._lock = threading.Lock()
        motion, way, ik = settings.motion, settings.way, settings.ik
        self._loop = Loop(motion, way, ik, settings.seed, bus.counters, settings.estimator)
        self._loop.set_mode(Mode(NAMES[settings.mode]))
        self._pursuit = Pursuit(self._loop, self._lock, settings.solver)
        self._queries = Queries(self._loop, self._lock, self._pursuit.solvers, settings)
        self._latency = Latency()
        self._commands = bus.publisher(JOINT_COMMAND)
        self._estimates = bus.publisher(JOINTS_ESTIMATED)
        self._statuses = bus.publisher(CONTROL_STATUS)
        bus.subscriber(DESCRIPTION, on_message=lambda got: self._locked(self._loop.describe, got.message))
        bus.subscriber(JOINTS_ACCEPTED, on_message=lambda got: self._locked(self._loop.accept, got.message))
        bus.subscriber(STOP_STATE, on_message=lambda got: self._locked(self._loop.stop, got.message))
        bus.subscriber(TARGET, on_message=lambda got: self._locked(self._loop.aim, got.message))
        # sim puts it before the frames: who holds positions finds the time of their frames here, and no earlier one
        self._clock = bus.newest(CLOCK)
        context.tunables.declare(tunables(settings), self._tune)
        bus.presence(self._seen)
        bus.serve(MODE, self._queries.mode)
        bus.serve(FORWARD_KINEMATICS, self._queries.forward_kinematics)
        bus.serve(SOLVE_IK, self._queries.solve_ik)
        self._positions = bus.subscriber(JOINT_POSITIONS)

    def run(self) -> None:
        """Answers positions until the service is asked to stop."""
        heard = monotonic()
        while not self._context.stop.is_set():
            received = self._positions.recv(QUIET_S)
            clock = self._clock.get()
            if received is None:
                self._report_quiet(monotonic() - heard)
                continue
            heard = monotonic()
            age_s = heard - received.received_s
            received_ns = wall_ns() - round(age_s * 1e9)
            lockstep = clock is not None and clock.mode == CLOCK_MODE_LOCKSTEP
            if lockstep:
                self._pursuit.catch_up(received.message, self._context.stop)
            # in lockstep the arm stands until it is answered: positions don't age
            now_ns = None if clock is None else from_timestamp(clock.capture_time)
            self._answer(received, 0.0 if lockstep else age_s, now_ns, received_ns)
            if not lockstep:
                self._pursuit.go_on()

    def close(self) -> None:
        """Ends the solver's process."""
        self._pursuit.solvers.close()

    def _answer(self, received: Received[JointPositions], age_s: float, now_ns: int | None, received_ns: int) -> None:
        try:
            with self._lock:
                answer = self._loop.answer(received.message, age_s, now_ns)
            if answer is not None:
                self._send(answer, received, received_ns)
        except Exception:  # one message that nobody thought of must not end control: sim's watchdog holds the arm
            self._context.bus.counters.add("failed_joint_positions")
            log.exception("answering positions failed")

    def _send(self, answer: Answer, received: Received[JointPositions], received_ns: int) -> None:
        stages = answer.command.stages
        stages.control_received_ns, stages.control_sent_ns = received_ns, wall_ns()
        self._commands.put(answer.command)
        self._latency.add(monotonic() - received.received_s)
        self._context.stop.wait(_COMMAND_LEAVES_S)
        answer.status.stages.CopyFrom(stages)
        self._estimates.put(answer.estimated)
        self._statuses.put(answer.status)
        self._report(answer.status)

    def _report(self, status: ControlStatus) -> None:
        health, solver = self._context.health, self._pursuit.solvers
        for name, value in (self._latency.gauges() | self._pursuit.gauges()).items():
            health.gauge(name, value)
        if status.state == CONTROL_STATE_WAITING:
            health.report(HEALTH_STATUS_WAITING, status.detail)
        elif status.state == CONTROL_STATE_BLIND:
            health.report(HEALTH_STATUS_DEGRADED, status.detail)
        elif solver.trouble:
            health.report(HEALTH_STATUS_DEGRADED, solver.trouble)
        elif status.mode in AIMING and self._pursuit.refusal:
            health.report(HEALTH_STATUS_DEGRADED, self._pursuit.refusal)
        elif status.mode in AIMING and solver.loading:
            health.report(HEALTH_STATUS_WAITING, "solver loading")
        else:
            health.report(HEALTH_STATUS_OK, "solver loading" if solver.loading else solver.note)

    def _report_quiet(self, for_s: float) -> None:
        if self._loop.arm is None:
            detail = "no description of the arm yet: is sim running?"
        else:
            detail = "no positions: is vision running?"
        # an arm that was seen before and is not now may be moving: say blind
        seen = self._loop.answered
        state = CONTROL_STATE_BLIND if seen else CONTROL_STATE_WAITING
        quiet = ControlStatus(mode=self._loop.mode, state=state, detail=f"{detail} (for {for_s:.1f} s)")
        self._statuses.put(quiet)
        self._context.health.report(HEALTH_STATUS_DEGRADED if seen else HEALTH_STATUS_WAITING, detail)

    def _locked(self, take, message) -> None:  # type: ignore[no-untyped-def]
        with self._lock:
            take(message)

    def _tune(self, values: Mapping[str, Value]) -> None:
        settings = tuned(self._queries.settings, values)
        with self._lock:
            arm = self._loop.arm
            if arm is not None and settings.solver != self._queries.settings.solver:
                check_applies(settings.solver, arm.chain)
            self._loop.tune(settings.way, settings.estimator)
        self._pursuit.solve_with(settings.solver)
        self._queries.settings = settings

    def _seen(self, service: str, here: bool) -> None:
        if service == "sim" and here:
            self._locked(lambda _: self._loop.begin_anew(), None)


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
        try:
            service.run()
        finally:
            service.close()

    return run_service("control", arguments, settings, body, shared_memory="off")


if __name__ == "__main__":
    sys.exit(main())
