import pytest

from armsight.times import NS_PER_S, to_duration, to_timestamp
from armsight.v1.joints_pb2 import JointCommand, JointSetpoint
from armsight_sim.commands import CommandGate, Verdict
from armsight_sim.world import World

NOW = 1_700_000_000 * NS_PER_S
FRAME = NS_PER_S // 30
ZERO = {"joint1": 0.0, "joint2": 0.0, "joint3": 0.0, "joint4": 0.0}


def command(
    answers_ns: int = NOW, joints: dict[str, float] | None = None, valid_s: float = 0.1, *, hold: bool = False
) -> JointCommand:
    named = ZERO if joints is None else joints
    return JointCommand(
        answers=to_timestamp(answers_ns),
        valid_for=to_duration(valid_s),
        hold=hold,
        joints=[JointSetpoint(name=name, position_rad=angle) for name, angle in named.items()],
    )


@pytest.fixture
def gate(world: World) -> CommandGate:
    return CommandGate(world)


def decide(gate: CommandGate, asked: JointCommand, now_ns: int = NOW, *, stopped: bool = False) -> tuple[Verdict, str]:
    decision = gate.decide(asked, now_ns, NOW, stopped=stopped)
    return decision.verdict, decision.reason


def test_fresh_command_moves(gate: CommandGate) -> None:
    decision = gate.decide(command(joints=ZERO | {"joint3": 0.5}), NOW + FRAME // 2, NOW, stopped=False)
    assert decision.verdict is Verdict.MOVE
    assert decision.goal is not None
    assert decision.goal.tolist() == [0.0, 0.0, 0.5, 0.0]


@pytest.mark.parametrize(
    ("reason", "asked"),
    [
        ("future", command(NOW + FRAME)),
        ("stale", command(NOW - NS_PER_S)),
        ("validity", command(valid_s=0.0)),
        ("validity", command(valid_s=-1.0)),
        ("validity", command(valid_s=3600.0)),
        ("joints", command(joints={})),
        ("joints", command(joints={"joint1": 0.0, "joint2": 0.0, "joint3": 0.0})),
        ("joints", command(joints=ZERO | {"elbow": 0.0})),
        ("not_finite", command(joints=ZERO | {"joint2": float("nan")})),
        ("not_finite", command(joints=ZERO | {"joint2": float("-inf")})),
        ("limits", command(joints=ZERO | {"joint2": 1.6})),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_what_must_not_move_the_arm_is_refused_by_reason(gate: CommandGate, reason: str, asked: JointCommand) -> None:
    assert decide(gate, asked) == (Verdict.REFUSE, reason)


def test_same_joint_twice_is_refused(gate: CommandGate) -> None:
    asked = command()
    asked.joints.append(JointSetpoint(name="joint1", position_rad=0.1))
    assert decide(gate, asked) == (Verdict.REFUSE, "joints")


def test_instants_are_answered_once_and_in_order(gate: CommandGate) -> None:
    assert decide(gate, command(NOW - FRAME))[0] is Verdict.MOVE
    assert decide(gate, command(NOW - FRAME)) == (Verdict.REFUSE, "duplicate")
    assert decide(gate, command(NOW))[0] is Verdict.MOVE
    assert decide(gate, command(NOW - FRAME)) == (Verdict.REFUSE, "out_of_order")


def test_hold_is_an_answer_without_motion(gate: CommandGate) -> None:
    assert decide(gate, command(joints={}, hold=True)) == (Verdict.HOLD, "")
    assert decide(gate, command()) == (Verdict.REFUSE, "duplicate")


def test_stopped_arm_takes_no_motion_but_holds(gate: CommandGate) -> None:
    assert decide(gate, command(NOW - FRAME), stopped=True) == (Verdict.REFUSE, "stopped")
    assert decide(gate, command(hold=True), stopped=True) == (Verdict.HOLD, "")


def test_answers_to_what_was_seen_before_a_reset_are_refused(gate: CommandGate) -> None:
    gate.refuse_before(NOW)
    assert decide(gate, command(NOW - FRAME)) == (Verdict.REFUSE, "before_reset")
    assert decide(gate, command(NOW))[0] is Verdict.MOVE


@pytest.mark.parametrize(("ahead_ns", "reason"), [(0, ""), (-1, ""), (1, "future")])
def test_frames_of_external_cameras_may_be_of_any_instant_up_to_now(world: World, ahead_ns: int, reason: str) -> None:
    now = NOW + FRAME // 2  # later than the simulation's own last frame
    gate = CommandGate(world, external_cameras=True)
    assert decide(gate, command(now + ahead_ns), now)[1] == reason
