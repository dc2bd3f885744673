"""Sim's physics and control's loop in one process, without bus and pixels: vision is as exact as asked for."""

from collections.abc import Callable
from dataclasses import dataclass, field

import mujoco
import numpy as np
import numpy.typing as npt
from foxglove_schemas_protobuf.JointState_pb2 import JointState
from foxglove_schemas_protobuf.JointStates_pb2 import JointStates
from foxglove_schemas_protobuf.Point3InFrame_pb2 import Point3InFrame

from armsight.counters import Counters
from armsight.times import to_timestamp
from armsight.v1.control_pb2 import ControlStatus
from armsight.v1.joints_pb2 import MARKER_STATUS_LOST, MARKER_STATUS_TRACKED, JointPositions, MarkerPosition
from armsight.v1.safety_pb2 import StopSource, StopState
from armsight_control.estimators import all_joints
from armsight_control.loop import Loop
from armsight_control.modes import NAMES, Mode
from armsight_control.movement import MotionOptions
from armsight_control.solvers import Options, solve
from armsight_control.trajectory import MotionLimits
from armsight_sim.clock import Instants
from armsight_sim.description import describe_arm
from armsight_sim.motion import Motion
from armsight_sim.targets import TARGETS, visible_box
from armsight_sim.world import World, load_model, longer_links

Vector = npt.NDArray[np.float64]

START_NS = 1_700_000_000_000_000_000
FPS = 30
BASE = np.array([0.0, 0.0, 0.5])
MARKERS = ("green", "yellow", "blue", "red")
BODIES = ("target_sphere", "target_box")


@dataclass
class Moment:
    """One instant, as it was when the frames were taken."""

    t: float
    tip: Vector
    """True, base frame."""
    q: Vector
    in_force: Vector
    """The setpoint that sim says is, when the frames were taken."""
    dt_s: float
    """Since the last instant that was answered."""
    command: Vector | None
    status: ControlStatus
    clearance_m: float
    """True, of the links' surfaces to the centre of the box."""


@dataclass
class Bench:
    """Sim and control in lockstep."""

    mode: str
    target: str = "none"
    pose: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0)
    model_error: float = 0.0
    sigma_m: float = 0.0
    motion: MotionOptions = field(default_factory=MotionOptions)
    limits: MotionLimits = field(default_factory=MotionLimits)
    lost: Callable[[float, str], bool] = lambda _t, _name: False
    mistaken: Callable[[float], bool] = lambda _t: False
    """Whether vision takes the box for the sphere."""
    seed: int = 0
    stopped: bool = False
    estimator: str = all_joints.NAME

    def __post_init__(self) -> None:
        self.described = load_model()
        self.world = World(longer_links(self.described, self.model_error), 1 / FPS)
        self.sim = Motion(self.world, Instants(START_NS, FPS), np.array(self.pose))
        self.counters = Counters()
        self.rng = np.random.default_rng(self.seed)
        self.moments: list[Moment] = []
        self.restart()

    def restart(self) -> None:
        """A new control, which knows nothing of what was before."""
        self.loop = Loop(self.limits, self.motion, Options(), 0, self.counters, self.estimator)
        self.loop.describe(describe_arm(self.described, with_bodies=True))
        self.loop.set_mode(Mode(NAMES[self.mode]))
        self.answered_frame = self.sim.frame - 1

    def skip(self, frames: int) -> None:
        """Frames that control never sees."""
        for _ in range(frames):
            self.sim.next_frame()

    def reset(self, pose: Vector) -> None:
        """Sim's reset, seen from the next frame on."""
        self.sim.reset(pose)
        self.sim.next_frame()

    def stop(self) -> None:
        """A button's stop, as sim and control get to know of it."""
        self.stopped = True
        self.sim.halt()
        self.loop.stop(StopState(stopped=True, sources=[StopSource(name="page", stopped=True)]))

    def release(self) -> None:
        """And its release."""
        self.stopped = False
        self.loop.stop(StopState())

    @property
    def t(self) -> float:
        return self.sim.frame / FPS

    def run(self, seconds: float) -> list[Moment]:
        begun = len(self.moments)
        for _ in range(round(seconds * FPS)):
            self.step()
        return self.moments[begun:]

    def step(self) -> Moment:
        t, stamp = self.t, to_timestamp(self.sim.capture_ns)
        self.world.data.mocap_pos[:] = [TARGETS["visible"][1](t), visible_box(t)]
        mujoco.mj_kinematics(self.world.model, self.world.data)
        names = self.world.joint_names
        in_force, dt_s = self.sim.accepted.copy(), (self.sim.frame - self.answered_frame) / FPS
        accepted = [JointState(name=n, position=q) for n, q in zip(names, in_force, strict=True)]
        self.loop.accept(JointStates(timestamp=stamp, joints=accepted))
        if self.target != "none":
            frame, point = TARGETS[self.target]
            message = Point3InFrame(timestamp=stamp, frame_id=frame)
            message.point.x, message.point.y, message.point.z = point(t)
            self.loop.aim(message)
        wanted = self.loop.problem()
        if wanted is not None:
            self.loop.solved(wanted[0], solve("closed-form", wanted[1]))
        answer = self.loop.answer(self.look(t), 0.001)
        assert answer is not None
        decision = self.sim.command(answer.command, stopped=self.stopped)
        assert self.stopped or decision.verdict.value != "refuse", decision
        command = None if answer.command.hold else np.array([joint.position_rad for joint in answer.command.joints])
        moment = Moment(t, self.tip(), self.world.angles(), in_force, dt_s, command, answer.status, self.clearance())
        self.moments.append(moment)
        self.answered_frame = self.sim.frame
        self.sim.next_frame()
        return moment

    def look(self, t: float) -> JointPositions:
        message = JointPositions(capture_time=to_timestamp(self.sim.capture_ns))
        for name in (*MARKERS, *BODIES):
            geom = f"marker_{name}" if name in MARKERS else name
            if name == "target_sphere" and self.mistaken(t):
                geom = "target_box"
            place = self.world.data.geom(geom).xpos + self.rng.normal(0.0, self.sigma_m, 3)
            marker = MarkerPosition(name=name, status=MARKER_STATUS_TRACKED)
            if self.lost(t, name):
                marker.status = MARKER_STATUS_LOST
            marker.position.x, marker.position.y, marker.position.z = place
            marker.covariance.extend((np.eye(3) * max(self.sigma_m, 1e-3) ** 2).ravel().tolist())
            message.markers.append(marker)
        return message

    def tip(self) -> Vector:
        return np.asarray(self.world.data.site("tip").xpos - BASE)

    def clearance(self) -> float:
        return clearance_of(self.world.data, self.t)


def clearance_of(data: mujoco.MjData, t: float) -> float:
    """Of the links' surfaces to the centre of the box, by the true pose."""
    box = np.array(visible_box(t))
    places = [data.body("link3").xpos, data.body("link4").xpos, data.site("tip").xpos]
    return min(
        segment_distance(places[0], places[1], box) - 0.2,
        segment_distance(places[1], places[2], box) - 0.1,
    )


def segment_distance(start: Vector, end: Vector, point: Vector) -> float:
    """By brute force over the segment's points: a millimetre of 3 m."""
    shares = np.linspace(0.0, 1.0, 3001)[:, None]
    return float(np.linalg.norm(start + shares * (end - start) - point, axis=1).min())


def rms(errors: list[float] | Vector) -> float:
    return float(np.sqrt(np.mean(np.square(errors))))
