"""What sim and control say and answer, without either: for the operator's commands on a real bus."""

import math
import time

from armsight import topics
from armsight.bus import Bus
from armsight.errors import ArmsightError
from armsight.parameters import Tunable
from armsight.service import serve_parameters
from armsight.times import to_timestamp
from armsight.v1.control_pb2 import (
    CONTROL_MODE_HOLD,
    CONTROL_MODE_TRACK,
    CONTROL_STATE_MOVING,
    ControlStatus,
    JointEstimate,
    SetModeRequest,
    SetModeResponse,
)
from armsight.v1.description_pb2 import ArmDescription, Attachment, Joint, Marker
from armsight.v1.geometry_pb2 import Quaternion, Transform, Vector3
from armsight.v1.health_pb2 import HEALTH_STATUS_OK, Health, HealthStatus
from armsight.v1.safety_pb2 import (
    STOP_ACTION_STOP,
    StopRequest,
    StopResponse,
    StopSource,
    StopState,
)
from armsight.v1.sim_pb2 import ResetRequest, ResetResponse

NAMES = ("joint1", "joint2", "joint3", "joint4")
_JOINTS = (
    ((0, 0, 0), (0, 0, 1), math.pi),
    ((0, 0, 4.0), (0, 1, 0), math.pi / 2),
    ((0, 0, 0), (1, 0, 0), math.pi / 2),
    ((0, 0, 3.2), (0, 1, 0), math.pi / 2),
)
TUNABLES = (
    Tunable("speed", "share of the joints' speed", 0.3, "", 0.01, 0.5),
    Tunable("steps", "of a descent", 10, "steps", 1, 100),
    Tunable("avoid_box", "keep off the box", False),
    Tunable("solver", "of inverse kinematics", "torch", choices=("torch", "closed-form")),
)
_MARKERS = (("green", 0, 0.35), ("yellow", 1, 0.30), ("blue", 3, 0.20), ("red", 3, 2.95))


def _vector(x: float, y: float, z: float) -> Vector3:
    return Vector3(x=x, y=y, z=z)


def description() -> ArmDescription:
    """The arm of the report."""
    return ArmDescription(
        name="arm",
        world_from_base=Transform(translation=_vector(0, 0, 0.5), rotation=Quaternion(w=1)),
        joints=[
            Joint(name=name, origin=_vector(*at), axis=_vector(*axis), lower_rad=-limit, upper_rad=limit)
            for name, (at, axis, limit) in zip(NAMES, _JOINTS, strict=True)
        ],
        markers=[
            Marker(name=name, centre=Attachment(joint=NAMES[joint], position=_vector(0, 0, z)), radius_m=0.3)
            for name, joint, z in _MARKERS
        ],
        tip=Attachment(joint=NAMES[3], position=_vector(0, 0, 2.8)),
        cameras=["1", "2"],
    )


class FakeArm:
    """Publishes and answers as sim and control do; keeps what it was asked."""

    def __init__(self, bus: Bus) -> None:
        self.bus = bus
        self.modes: list[SetModeRequest] = []
        self.resets: list[ResetRequest] = []
        self.stopped_by: list[str] = []
        self.refusal = ""
        self._mode = CONTROL_MODE_HOLD
        bus.publisher(topics.DESCRIPTION).put(description())
        self._stop = bus.publisher(topics.STOP_STATE)
        self._health = {name: bus.publisher(topics.HEALTH, name) for name in ("sim", "vision", "control")}
        self._status = bus.publisher(topics.CONTROL_STATUS)
        bus.serve(topics.MODE, self._set_mode)
        bus.serve(topics.RESET, self._reset)
        bus.serve(topics.STOP, self._set_stop)
        bus.serve(topics.RELEASE, self._set_stop)
        serve_parameters("control", bus, {}).declare(TUNABLES, lambda _: None)

    def wait_for_listeners(self) -> None:
        """Until somebody hears of health and status: what is said before is lost."""
        until = time.monotonic() + 5.0
        heard = [publisher.has_subscribers for publisher in self._health.values()] + [self._status.has_subscribers]
        while not all(is_heard() for is_heard in heard):
            assert time.monotonic() < until, "nobody listens"
            time.sleep(0.01)

    def say_health(self, name: str, status: HealthStatus = HEALTH_STATUS_OK, detail: str = "") -> None:
        health = Health(
            service=name, status=status, detail=detail, counters={"refused_stale": 3}, gauges={"rate_hz": 30.0}
        )
        self._health[name].put(health)

    def say_status(self, latency_ms: float = 8.0) -> None:
        status = ControlStatus(
            capture_time=to_timestamp(time.time_ns()),
            mode=CONTROL_MODE_TRACK,
            state=CONTROL_STATE_MOVING,
            joints=[JointEstimate(name=name, position_rad=0.1) for name in NAMES],
            tip=_vector(1.0, 2.0, 3.0),
            target=_vector(1.0, 2.0, 3.5),
        )
        status.stages.frames_sent_ns = 1_000_000_000
        status.stages.control_sent_ns = 1_000_000_000 + round(latency_ms * 1e6)
        self._status.put(status)

    def _set_mode(self, request: SetModeRequest) -> SetModeResponse:
        self.modes.append(request)
        if self.refusal:
            raise ArmsightError(self.refusal)
        self._mode = request.mode or self._mode
        return SetModeResponse(mode=self._mode)

    def _reset(self, request: ResetRequest) -> ResetResponse:
        self.resets.append(request)
        return ResetResponse()

    def _set_stop(self, request: StopRequest) -> StopResponse:
        others = [name for name in self.stopped_by if name != request.source]
        self.stopped_by = [*others, request.source] if request.action == STOP_ACTION_STOP else others
        state = StopState(
            stopped=bool(self.stopped_by), sources=[StopSource(name=name, stopped=True) for name in self.stopped_by]
        )
        self._stop.put(state)
        return StopResponse(state=state)
