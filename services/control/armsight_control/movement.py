"""The arm's motion, mode by mode: from positions and targets to the next setpoint under every limit.

Every setpoint is for the instant at which the arm will be there: the capture time that is answered, and what commands
have lately taken to be in force. Targets and tests are asked for where they are at that instant.
"""

import math
from collections import deque
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from foxglove_schemas_protobuf.Point3InFrame_pb2 import Point3InFrame

from armsight.counters import Counters
from armsight.times import NS_PER_S
from armsight.v1.control_pb2 import (
    CONTROL_MODE_FOLLOW,
    CONTROL_MODE_HOLD,
    CONTROL_MODE_JOINTS,
    CONTROL_MODE_TEST_1,
    CONTROL_MODE_TEST_2,
    CONTROL_MODE_TEST_ALL,
    CONTROL_MODE_TRACK,
    CONTROL_STATE_HOLDING,
    CONTROL_STATE_MOVING,
    SAFETY_CODE_BODY_LOST,
    SAFETY_CODE_BRANCH_SWITCH,
    SAFETY_CODE_HALTED_FOR_BODY,
    SAFETY_CODE_HALTED_UNSAFE,
    SAFETY_CODE_OK,
    SAFETY_CODE_SLOWED_FOR_BODY,
    SAFETY_CODE_SLOWED_FOR_LIMIT,
    SAFETY_CODE_SLOWED_FOR_SINGULARITY,
    ControlMode,
    SafetyCode,
)
from armsight.v1.description_pb2 import ArmDescription
from armsight.v1.joints_pb2 import JointPositions
from armsight_control import safety
from armsight_control.aiming import FREE_JOINTS, carried
from armsight_control.barrier import Capsule, allowed, capsules_of, clearances
from armsight_control.bodies import BodyNames, Seen, body_names, seen, tip_by_markers
from armsight_control.chain import Array
from armsight_control.correction import Correction, corrected
from armsight_control.decision import Decision, holding
from armsight_control.description import Arm
from armsight_control.kinematics import forward, jacobian
from armsight_control.modes import Mode
from armsight_control.nullspace import smallest_singular_value
from armsight_control.pointing import Pointing
from armsight_control.positions import LastLinks
from armsight_control.solvers import Options, Problem, Solution
from armsight_control.standoff import DISTANCE_M, beside, side_of
from armsight_control.tracking import Moving, Target, Track, observed, predicted, target_of
from armsight_control.trajectory import (
    ARRIVED_RAD,
    Goal,
    MotionLimits,
    OnPath,
    Path,
    Planner,
    State,
    Step,
    all_motion,
    along,
    at_rest,
    part1_motion,
    part2_motion,
    resting,
)

# A target on `target` is exact; this is what rounding and its clock may be off by.
_TARGET_SIGMA_M = 1e-3
# A goal found by sight trembles: what is nearer and slower is there, half a millimetre at the tip.
_SEEN_RAD, _SEEN_RAD_S = 1e-4, 1e-3
# Bodies go on as they went for this long unseen (the arm hides the box for a third of its period, in parts).
_FORESEEN_S = 1.0
# After a rest the arm may still be on its way to the last setpoint.
_SETTLED_NS = 300_000_000
# Between any link's surface and the centre of the box; and what vision and the arm's response may be off by.
KEEP_M, _KEEP_MARGIN_M = 0.8, 0.1


@dataclass(frozen=True, slots=True)
class MotionOptions:
    """How the arm goes, beside its limits."""

    free_joints: str = "3"
    """Of `track` and `follow`: ``3`` keeps joint 2 at 0 as the report does, ``all`` uses it."""
    avoid_box: bool = False
    """Whether links keep away from the box that vision sees."""


@dataclass(frozen=True, slots=True)
class Body:
    """The arm and what is derived from it once."""

    arm: Arm
    last_links: LastLinks
    planner: Planner
    capsules: tuple[Capsule, ...]
    bodies: BodyNames


@dataclass(frozen=True, slots=True)
class Pointed:
    """What a mode with a target aims at, for the status; base frame."""

    target: Array
    reached: Array
    reachable: bool


@dataclass(frozen=True, slots=True)
class _Way:
    """Where to in this step."""

    goal: Goal
    detail: str = ""
    code: SafetyCode = SAFETY_CODE_OK
    slow: float = 1.0
    near_rad: float = ARRIVED_RAD
    near_rad_s: float = ARRIVED_RAD


class Movement:
    """State of the motion; nothing in here knows the bus or reads a clock."""

    PATHS: ClassVar[dict[ControlMode, Path]] = {
        CONTROL_MODE_TEST_1: part1_motion,
        CONTROL_MODE_TEST_2: part2_motion,
        CONTROL_MODE_TEST_ALL: all_motion,
    }

    def __init__(
        self, limits: MotionLimits, motion: MotionOptions, options: Options, seed: int, counters: Counters
    ) -> None:
        """Knows no arm yet, and rests."""
        self._limits, self._options, self._counters = limits, motion, counters
        self._free = FREE_JOINTS[motion.free_joints]
        self._body: Body | None = None
        self._mode = Mode(CONTROL_MODE_HOLD)
        self._pointing = Pointing(options, self._free, seed, counters)
        self._path = OnPath(0.0)
        self._switching = False
        self.pointed: Pointed | None = None
        self.clearance_m: float | None = None
        self._target: Target | None = None
        self._track: Track | None = None
        self._sphere: Track | None = None
        self._box: Track | None = None
        self._side: int | None = None
        self._standoff: Target | None = None
        self._state: State | None = None
        self._pace: safety.Pace | None = None
        self._sent: deque[tuple[int, State]] = deque(maxlen=8)
        self._expected: safety.Expected | None = None
        self._where = np.zeros(3)
        self._correction = Correction()
        self._now_ns = self._rested_ns = 0

    # --- what arrives

    @property
    def mode(self) -> ControlMode:
        """The mode in force."""
        return self._mode.mode

    @property
    def target(self) -> Target | None:
        """The newest target of `track`."""
        return self._target

    @property
    def correction(self) -> Array:
        """What is taken off the point aimed at, base frame, metres."""
        return self._correction.offset

    def describe(self, arm: Arm, last_links: LastLinks, message: ArmDescription) -> None:
        """Takes the arm; what was known of another one is forgotten."""
        planner = Planner(arm.chain, self._limits)
        self._body = Body(arm, last_links, planner, capsules_of(message, arm.chain), body_names(message))
        self._target = self._track = None
        self._pointing.forget()
        self.begin_anew()

    def set_mode(self, mode: Mode) -> None:
        """Takes a mode that was checked; a setpoint in motion goes on from its state."""
        self._mode = mode
        self._path = OnPath(mode.start_s)
        self._side = self._standoff = None
        self._switching = False
        self.pointed = self.clearance_m = None
        self._pointing.forget()

    def rest(self) -> None:
        """Nothing was commanded, or something else is in force: motion begins anew, from rest."""
        self._state = None
        self._pace = None
        self._sent.clear()
        self._rested_ns = self._now_ns
        self._path = self._path.left()

    def begin_anew(self) -> None:
        """Sim is another one than before: its time may begin anywhere."""
        self._now_ns = 0
        self._expected = None
        self._sphere = self._box = None
        self._correction = Correction()
        self.rest()

    def aim(self, message: Point3InFrame) -> None:
        """Takes a target.

        Raises:
            SolverError: another frame than `world` or `base`, or not finite.
        """
        if self._body is None:
            return
        target = target_of(message, self._body.arm)
        self._target = target
        self._track = observed(self._track, target.stamp_ns, target.position, _TARGET_SIGMA_M)
        if self._track.jumped:
            self._counters.add("target_jump")
            if self.mode == CONTROL_MODE_TRACK:
                self._pointing.forget()

    def problem(self, setpoint: Array) -> tuple[Target, Problem] | None:
        """What the solver is wanted for now."""
        target = {CONTROL_MODE_TRACK: self._target, CONTROL_MODE_FOLLOW: self._standoff}.get(self.mode)
        if self._body is None or target is None:
            return None
        problem = self._pointing.problem(self._body.arm.chain, target, setpoint)
        return None if problem is None else (target, problem)

    def solved(self, target: Target, solution: Solution) -> None:
        """Takes a solution for a target."""
        self._pointing.solved(target, solution)

    # --- one instant

    def look(self, message: JointPositions, setpoint: Array, step: Step) -> None:
        """Takes what vision saw, whether the arm may move now or not.

        Raises:
            PositionsError: the tip jumped as nobody told it to.
        """
        body, self._now_ns = self._body, step.capture_ns
        if body is None:
            return
        self._sphere = self._watched(self._sphere, message, body.bodies.sphere, step)
        self._box = self._watched(self._box, message, body.bodies.box, step)
        tip = tip_by_markers(message, body.last_links.along, body.last_links.length4, body.arm)
        if tip is None:
            return
        chain, commanded = body.arm.chain, self._commanded(setpoint, step.capture_ns)
        where = forward(chain, commanded.position)
        speed = 0.0 if self._expected is None else float(np.linalg.norm(where - self._where)) / step.dt_s
        self._where = where
        self._expected = safety.expect(self._expected, tip, where)
        safety.check_expected(self._expected)
        if self.mode in (CONTROL_MODE_TRACK, CONTROL_MODE_FOLLOW) and self._settled(step):
            self._correction = corrected(self._correction, tip, where, speed, step.dt_s)

    def move(self, setpoint: Array, step: Step, lead_s: float) -> Decision:
        """The next setpoint, or why there is none.

        Args:
            setpoint: in force.
            step: the instant that is answered.
            lead_s: from that instant to when the arm will be at what is commanded now.
        """
        body = self._body
        if body is None:
            return holding("no description of the arm yet")
        if self._state is None or not np.array_equal(self._state.position, setpoint):
            self.rest()
            self._state = at_rest(setpoint)
        state = self._state
        effect_ns = step.capture_ns + round(lead_s * NS_PER_S)
        way = self._way(body, state, step, effect_ns)
        if isinstance(way, Decision):
            if state.at_rest:
                return way
            # it comes to rest as gently as it moves
            stopped = body.planner.brake(state, step.dt_s).state
            return self._checked(body, state, stopped, step, effect_ns, replace(way, setpoint=stopped.position))
        stepped = body.planner.towards(state, way.goal, step.dt_s, way.slow)
        after, code, detail = stepped.state, way.code, way.detail
        if way.slow < 1.0:
            code = SAFETY_CODE_SLOWED_FOR_SINGULARITY
        if any(stepped.braked):
            code = SAFETY_CODE_SLOWED_FOR_LIMIT
        if self._options.avoid_box and body.bodies.box is not None:
            kept = self._kept_away(body, state, after, step, effect_ns)
            if isinstance(kept, Decision):
                stopped = body.planner.brake(state, step.dt_s).state
                if state.at_rest:
                    return kept
                return self._checked(body, state, stopped, step, effect_ns, replace(kept, setpoint=stopped.position))
            if kept is not None:
                after, code, detail = kept
        away, speed = (
            np.abs(body.arm.chain.clip(way.goal.position) - state.position).max(),
            np.abs(state.velocity).max(),
        )
        there = away <= way.near_rad and max(speed, float(np.abs(way.goal.velocity).max())) <= way.near_rad_s
        if there and code in (SAFETY_CODE_OK, SAFETY_CODE_BRANCH_SWITCH):
            return holding(detail or "at its goal")
        return self._checked(
            body, state, after, step, effect_ns, Decision(CONTROL_STATE_MOVING, detail, after.position, safety=code)
        )

    def _way(self, body: Body, state: State, step: Step, effect_ns: int) -> _Way | Decision:
        """Where to in this step, by the mode."""
        self.pointed = None
        if self.mode == CONTROL_MODE_JOINTS and self._mode.goal is not None:
            return _Way(resting(self._mode.goal))
        if self.mode in self.PATHS:
            goal, self._path = along(self.PATHS[self.mode], self._path, state, step)
            return _Way(goal, near_rad=-1.0)
        if self.mode == CONTROL_MODE_TRACK:
            if self._track is None:
                return holding("no target yet: publish one on `target`")
            return self._point(body, state, predicted(self._track, effect_ns, step.capture_ns), "the target", step.dt_s)
        if self.mode == CONTROL_MODE_FOLLOW:
            return self._beside_sphere(body, state, step, effect_ns)
        return holding("mode hold")

    def _beside_sphere(self, body: Body, state: State, step: Step, effect_ns: int) -> _Way | Decision:
        name = body.bodies.sphere
        if name is None:
            return holding("no sphere to follow in this scene: start sim with --target visible", "no_sphere")
        if self._sphere is None or step.capture_ns - self._sphere.stamp_ns > _FORESEEN_S * NS_PER_S:
            return holding(f"{name} is not seen by any camera", "sphere_lost", SAFETY_CODE_BODY_LOST)
        chain, shoulder = body.arm.chain, body.last_links.shoulder
        centre = predicted(self._sphere, effect_ns, step.capture_ns, _FORESEEN_S)

        def reachable(point: Array) -> bool:
            return carried(chain, self._free, point, state.position)[1]

        side = side_of(centre.position, shoulder, self._side, reachable)
        if self._side is not None and side != self._side:
            self._counters.add("side_switch")
        self._side = side
        point = beside(centre, shoulder, side)
        self._standoff = Target(step.capture_ns, point.position)
        return self._point(body, state, point, f"the point {DISTANCE_M:g} m from {name}", step.dt_s)

    def _point(self, body: Body, state: State, point: Moving, what: str, dt_s: float) -> _Way | Decision:
        chain = body.arm.chain
        found = self._pointing.aim(chain, Moving(point.position - self._correction.offset, point.velocity), dt_s)
        if found is None:
            return holding("the solver has no answer yet")
        aim, switched = found
        reached = aim.tip + self._correction.offset
        self.pointed = Pointed(point.position, reached, aim.reachable)
        missed = float(np.linalg.norm(reached - point.position))
        detail = "" if aim.reachable else f"{what} is out of reach by {missed:.2f} m: at the nearest point"
        far = bool(np.abs(aim.q - state.position).max() > 0.1)
        self._switching = switched or (self._switching and far)
        if self._switching:
            detail = f"{detail}; " * bool(detail) + "on its way to another branch"
        columns = list(self._free)

        def nearness(q: Array) -> float:
            return smallest_singular_value(jacobian(chain, q)[:, columns])

        return _Way(
            Goal(aim.q, aim.velocity),
            detail,
            SAFETY_CODE_BRANCH_SWITCH if self._switching else SAFETY_CODE_OK,
            safety.slow_for_singularity(nearness(state.position), lambda: nearness(aim.q)),
            _SEEN_RAD,
            _SEEN_RAD_S,
        )

    def _kept_away(
        self, body: Body, state: State, after: State, step: Step, effect_ns: int
    ) -> tuple[State, SafetyCode, str] | Decision | None:
        """The step that keeps the links away from the box, where it is another one than planned."""
        name = body.bodies.box
        if self._box is None or step.capture_ns - self._box.stamp_ns > _FORESEEN_S * NS_PER_S:
            self.clearance_m = None
            return holding(f"{name} is not seen by any camera", "box_lost", SAFETY_CODE_BODY_LOST)
        chain = body.arm.chain
        box = predicted(self._box, effect_ns, step.capture_ns, _FORESEEN_S)
        self.clearance_m = min(c.distance_m for c in clearances(chain, state.position, body.capsules, box.position))
        keep_m, most = KEEP_M + _KEEP_MARGIN_M, self._limits.speed(chain)
        kept = allowed(chain, state.position, body.capsules, box, keep_m, after.velocity, most)
        if not kept.slowed:
            return None
        if not kept.found:
            halted = body.planner.brake(state, step.dt_s).state
            return halted, SAFETY_CODE_HALTED_FOR_BODY, f"no motion keeps the links {KEEP_M:g} m from {name}"
        away = body.planner.at_speed(state, kept.velocity, step.dt_s).state
        return away, SAFETY_CODE_SLOWED_FOR_BODY, f"keeps {KEEP_M:g} m from {name}"

    def _arrived(self, body: Body, state: State, way: _Way) -> bool:
        away = float(np.abs(body.arm.chain.clip(way.goal.position) - state.position).max())
        speed = max(float(np.abs(state.velocity).max()), float(np.abs(way.goal.velocity).max()))
        return away <= way.near_rad and speed <= way.near_rad_s

    def _checked(
        self, body: Body, state: State, after: State, step: Step, effect_ns: int, decision: Decision
    ) -> Decision:
        """The last word: a setpoint that breaks a limit is not sent, whoever made it."""
        pace = self._pace or safety.Pace(np.zeros(body.arm.chain.count), 0.0)
        try:
            self._pace = safety.check_setpoint(
                body.arm.chain, self._limits, state.position, pace, after.position, step.dt_s
            )
        except safety.UnsafeError as error:
            return Decision(CONTROL_STATE_HOLDING, str(error), reason="unsafe", safety=SAFETY_CODE_HALTED_UNSAFE)
        self._state = after
        self._sent.append((effect_ns, after))
        return decision

    # --- what was commanded, and seen

    def _commanded(self, setpoint: Array, capture_ns: int) -> State:
        """Where the setpoint was at an instant."""
        for effect_ns, state in self._sent:
            early_s = (effect_ns - capture_ns) / NS_PER_S
            if early_s >= -1e-3:
                return State(state.before(min(early_s, 0.1)), state.velocity, state.acceleration)
        return self._sent[-1][1] if self._sent else at_rest(setpoint)

    def _settled(self, step: Step) -> bool:
        return step.capture_ns - self._rested_ns > _SETTLED_NS

    def _watched(self, track: Track | None, message: JointPositions, name: str | None, step: Step) -> Track | None:
        body = self._body
        found: Seen | None = None if body is None or name is None else seen(message, name, body.arm)
        if found is None:
            return track
        return observed(track, step.capture_ns, found.position, found.sigma_m / math.sqrt(3))
