"""The arm's motion, mode by mode: from positions and targets to the next setpoint under every limit.

Every setpoint is for the instant at which the arm will be there: the capture time that is answered, and what commands
have lately taken to be in force. Targets and tests are asked for where they are at that instant.
"""

import math
from collections.abc import Mapping
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
    SAFETY_CODE_HALTED_UNSAFE,
    SAFETY_CODE_OK,
    SAFETY_CODE_SLOWED_FOR_LIMIT,
    SAFETY_CODE_SLOWED_FOR_SINGULARITY,
    ControlMode,
    SafetyCode,
)
from armsight.v1.description_pb2 import ArmDescription
from armsight.v1.joints_pb2 import JointPositions
from armsight_control import safety
from armsight_control.aiming import FREE_JOINTS, carried, free_of
from armsight_control.barrier import capsules_of
from armsight_control.bodies import BodyNames, Seen, body_names
from armsight_control.chain import Array, Chain, farthest
from armsight_control.correction import CORRECTION_TIME_S
from armsight_control.decision import Decision, holding
from armsight_control.description import Arm
from armsight_control.detour import Detour, Detours
from armsight_control.history import History
from armsight_control.kinematics import forward, links_of_report, points_and_columns
from armsight_control.modes import AIMING, Mode
from armsight_control.nullspace import least_moved
from armsight_control.pointing import Pointing
from armsight_control.positions import shoulder_of
from armsight_control.sight import Sight
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
    all_motion_of,
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
# An arm that is this near to its aim is on that aim's branch.
_SWITCHED_RAD = 0.1
# After a rest the arm may still be on its way to the last setpoint.
_SETTLED_NS = 300_000_000


@dataclass(frozen=True, slots=True)
class MotionOptions:
    """How the arm goes, beside its limits."""

    free_joints: str = "3"
    """Of `track` and `follow`: ``3`` keeps joint 2 at 0 as the report does, ``all`` uses it; other arms move all."""
    avoid_box: bool = False
    """Whether links keep away from the box that vision sees."""
    slow: float = 1.0
    """Share of the speed limits to keep to, above 0. What keeps off the box may use all of them."""
    standoff_m: float = DISTANCE_M
    """Of the tip from the sphere in `follow`."""
    correction_time_s: float = CORRECTION_TIME_S
    """In which the difference of tip seen and tip commanded is corrected."""


@dataclass(frozen=True, slots=True)
class Body:
    """The arm and what is derived from it once."""

    arm: Arm
    shoulder: Array
    """Where the part of the arm begins that moves in space, base frame."""
    paths: Mapping[ControlMode, Path]
    """Of the tests: those of this arm."""
    planner: Planner
    detours: Detours
    bodies: BodyNames
    sight: Sight


@dataclass(frozen=True, slots=True)
class Pointed:
    """What a mode with a target aims at, for the status; base frame."""

    target: Array
    reached: Array
    reachable: bool


@dataclass(frozen=True, slots=True)
class _Now:
    """One instant that is answered."""

    body: Body
    state: State
    """Of the setpoint in force."""
    step: Step
    effect_ns: int
    """When the arm will be at what is commanded now."""


@dataclass(frozen=True, slots=True)
class _Way:
    """Where to in this step."""

    goal: Goal
    detail: str = ""
    code: SafetyCode = SAFETY_CODE_OK
    slow: float = 1.0
    ends: bool = True
    """Whether the arm may come to rest at the goal."""
    near_rad: float = ARRIVED_RAD
    near_rad_s: float = ARRIVED_RAD


class Movement:
    """State of the motion; nothing in here knows the bus or reads a clock."""

    PATHS: ClassVar[dict[ControlMode, Path]] = {  # of the report's arm
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
        self._pointing = Pointing(limits, options, self._free, seed, counters)
        self._path = OnPath(0.0)
        self._switching = False
        self.pointed: Pointed | None = None
        self.clearance_m: float | None = None
        self._target: Target | None = None
        self._track: Track | None = None
        self._side: int | None = None
        self._standoff: Target | None = None
        self._state: State | None = None
        self._pace: safety.Pace | None = None
        self._history = History()
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
        return np.zeros(3) if self._body is None else self._body.sight.correction

    def describe(self, arm: Arm, message: ArmDescription) -> None:
        """Takes the arm; what was known of another one is forgotten."""
        self._let_move(arm.chain)
        own = links_of_report(arm.chain) is not None
        paths = self.PATHS if own else {CONTROL_MODE_TEST_ALL: all_motion_of(arm.chain.limits)}
        planner = Planner(arm.chain, self._limits)
        detours = Detours(arm.chain, self._limits, planner, capsules_of(message, arm.chain))
        names = body_names(message)
        sight = Sight(arm, names, self._counters)
        self._body = Body(arm, shoulder_of(arm.chain), paths, planner, detours, names, sight)
        self._target = self._track = None
        self.begin_anew()

    def set_mode(self, mode: Mode) -> None:
        """Takes a mode that was checked; a setpoint in motion goes on from its state."""
        self._mode = mode
        self._path = OnPath(mode.start_s)
        self._side = self._standoff = None
        self._switching = False
        self.pointed = self.clearance_m = None
        self._pointing.forget()

    def tune(self, options: MotionOptions) -> None:
        """Takes another way to go, from the next instant on; a setpoint in motion goes on from its state."""
        before, self._options = self._options, options
        if self._body is not None and options.free_joints != before.free_joints:
            self._let_move(self._body.arm.chain)

    def _let_move(self, chain: Chain) -> None:
        """The joints that may move for a target: the branch is chosen anew."""
        self._free = free_of(chain, self._options.free_joints)
        self._pointing.move(self._free)

    def rest(self) -> None:
        """Nothing was commanded, or something else is in force: motion begins anew, from rest."""
        self._state = None
        self._pace = None
        self._history.forget()
        self._rested_ns = self._now_ns
        self._path = self._path.left()

    def begin_anew(self) -> None:
        """Sim is another one than before: its time may begin anywhere."""
        self._now_ns = 0
        body = self._body
        if body is not None:
            self._body = replace(body, sight=Sight(body.arm, body.bodies, self._counters))
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

    def unsolved(self, why: str) -> None:
        """Takes why a solver has no solution for a target."""
        self._pointing.refusal = why

    # --- one instant

    def look(self, message: JointPositions, tip: Seen | None, setpoint: Array, step: Step) -> None:
        """Takes what vision saw, as it came, and the tip as it shows it, whether the arm may move now or not.

        Raises:
            PositionsError: the tip jumped as nobody told it to.
        """
        body, self._now_ns = self._body, step.capture_ns
        if body is None:
            return
        commanded = forward(body.arm.chain, self._history.at(step.capture_ns, setpoint))
        learns = self.mode in AIMING and step.capture_ns - self._rested_ns > _SETTLED_NS
        learn_s = self._options.correction_time_s if learns else None
        body.sight.look(message, tip, commanded, step, learn_s)

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
        state = self._state
        if state is None or (state.position is not setpoint and not np.array_equal(state.position, setpoint)):
            self.rest()
            self._state = state = at_rest(setpoint)
        now = _Now(body, state, step, step.capture_ns + round(lead_s * NS_PER_S))
        way = self._way(now)
        if isinstance(way, Decision):
            return self._come_to_rest(now, way)
        stepped = body.planner.towards(now.state, way.goal, step.dt_s, way.slow * self._options.slow)
        detour = self._detour(now, stepped.state)
        if isinstance(detour, Decision):
            return self._come_to_rest(now, detour)
        if detour is not None:
            return self._send(now, detour.after, Decision(CONTROL_STATE_MOVING, detour.detail, safety=detour.code))
        if self._arrived(now, way):
            return holding(way.detail or "at its goal")
        code = way.code
        if way.slow < 1.0:
            code = SAFETY_CODE_SLOWED_FOR_SINGULARITY
        if any(stepped.braked):
            code = SAFETY_CODE_SLOWED_FOR_LIMIT
        return self._send(now, stepped.state, Decision(CONTROL_STATE_MOVING, way.detail, safety=code))

    def _come_to_rest(self, now: _Now, why: Decision) -> Decision:
        """As gently as it moves."""
        return (
            why if now.state.at_rest else self._send(now, now.body.planner.brake(now.state, now.step.dt_s).state, why)
        )

    def _way(self, now: _Now) -> _Way | Decision:
        """Where to in this step, by the mode."""
        self.pointed = None
        if self.mode == CONTROL_MODE_JOINTS and self._mode.goal is not None:
            return _Way(resting(self._mode.goal))
        if self.mode in self.PATHS:
            path = now.body.paths.get(self.mode)
            if path is None:
                return holding("this test is a motion of the report's arm, not of this one: take test-all", "no_path")
            goal, self._path = along(path, self._path, now.state, now.step)
            return _Way(goal, ends=False)
        if self.mode == CONTROL_MODE_TRACK:
            if self._track is None:
                return holding("no target yet: publish one on `target`")
            return self._point(now, predicted(self._track, now.effect_ns, now.step.capture_ns), "the target")
        if self.mode == CONTROL_MODE_FOLLOW:
            return self._beside_sphere(now)
        return holding("mode hold")

    def _beside_sphere(self, now: _Now) -> _Way | Decision:
        name = now.body.bodies.sphere
        if name is None:
            return holding("no sphere to follow in this scene: start sim with --target visible", "no_sphere")
        centre = now.body.sight.sphere(now.step, now.effect_ns)
        if centre is None:
            return holding(f"{name} is not seen by any camera", "sphere_lost", SAFETY_CODE_BODY_LOST)
        chain, shoulder = now.body.arm.chain, now.body.shoulder

        def missed_m(point: Array) -> float:
            return carried(chain, self._free, point, now.state.position)[1]

        distance_m = self._options.standoff_m
        side = side_of(centre.position, shoulder, distance_m, self._side, missed_m)
        if self._side is not None and side != self._side:
            self._counters.add("side_switch")
        self._side = side
        point = beside(centre, shoulder, distance_m, side)
        self._standoff = Target(now.step.capture_ns, point.position)
        return self._point(now, point, f"the point {distance_m:g} m from {name}")

    def _point(self, now: _Now, point: Moving, what: str) -> _Way | Decision:
        chain, present = now.body.arm.chain, now.state.position
        correction, most_m = self.correction, safety.SINGULAR_FROM_M * chain.scale
        found = self._pointing.aim(chain, Moving(point.position - correction, point.velocity), now.step.dt_s)
        if found is None:
            return holding(self._pointing.refusal or "the solver has no answer yet")
        aim, switched = found
        reached = aim.tip + correction
        self.pointed = Pointed(point.position, reached, aim.reachable)
        missed = math.dist(reached, point.position)
        detail = "" if aim.reachable else f"{what} is out of reach by {missed:.2f} m: at the nearest point"
        self._switching = switched or (self._switching and farthest(aim.q, present) > _SWITCHED_RAD)
        if self._switching:
            detail = f"{detail}; " * bool(detail) + "on its way to another branch"

        def nearness(q: Array) -> float:
            ((_, columns),) = points_and_columns(chain, q, [chain.tip])
            return least_moved([columns[i] for i in self._free], most_m)

        return _Way(
            Goal(aim.q, aim.velocity),
            detail,
            SAFETY_CODE_BRANCH_SWITCH if self._switching else SAFETY_CODE_OK,
            safety.slow_for_singularity(nearness(present), lambda: nearness(aim.q), chain.scale),
            near_rad=_SEEN_RAD,
            near_rad_s=_SEEN_RAD_S,
        )

    def _detour(self, now: _Now, planned: State) -> Detour | Decision | None:
        """The step that keeps the links away from the box, where it is another one than planned."""
        name = now.body.bodies.box
        if not self._options.avoid_box or name is None:
            return None
        box = now.body.sight.box(now.step, now.effect_ns)
        if box is None:
            self.clearance_m = None
            return holding(f"{name} is not seen by any camera", "box_lost", SAFETY_CODE_BODY_LOST)
        self.clearance_m = now.body.detours.clearance_m(now.state, box)
        return now.body.detours.around(box, now.state, planned, now.step.dt_s)

    def _arrived(self, now: _Now, way: _Way) -> bool:
        if not way.ends or farthest(now.body.arm.chain.clip(way.goal.position), now.state.position) > way.near_rad:
            return False
        return all(abs(rate) <= way.near_rad_s for each in (now.state, way.goal) for rate in each.velocity.tolist())

    def _send(self, now: _Now, after: State, decision: Decision) -> Decision:
        """The last word: a setpoint that breaks a limit is not sent, whoever made it."""
        chain = now.body.arm.chain
        pace = self._pace or safety.Pace(np.zeros(chain.count), 0.0)
        try:
            self._pace = safety.check_setpoint(
                chain, self._limits, now.state.position, pace, after.position, now.step.dt_s
            )
        except safety.UnsafeError as error:
            return Decision(CONTROL_STATE_HOLDING, str(error), reason="unsafe", safety=SAFETY_CODE_HALTED_UNSAFE)
        self._state = after
        self._history.remember(now.effect_ns, after)
        return replace(decision, setpoint=after.position)
