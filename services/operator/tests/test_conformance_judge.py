"""What the suite takes for fulfilled and what not, without a bus; and the command around it."""

import json
import math
from collections.abc import Callable

import numpy as np
import pytest

from armsight import topics
from armsight.bus import Bus
from armsight.times import NS_PER_S, to_duration, to_timestamp
from armsight.v1.health_pb2 import HEALTH_STATUS_OK, Health
from armsight.v1.joints_pb2 import JointCommand, JointSetpoint, StageTimes
from armsight.v1.parameters_pb2 import Parameter, ParameterValue
from armsight_operator.cli.app import main
from armsight_operator.conformance import judge, scene, vision
from armsight_operator.conformance.check import UnfulfilledError
from armsight_operator.conformance.draw import Camera
from armsight_operator.conformance.scene import Ball, Scene
from own_control import OwnControl

NOW_S = 1.7e9
NAMES = ("a", "b")
LIMITS = np.array([(-1.0, 1.0), (-2.0, 2.0)])
STEP = np.array([0.1, 0.1])


def health(**changes: object) -> Health:
    fields: dict[str, object] = {
        "service": "control",
        "status": HEALTH_STATUS_OK,
        "instance": "one",
        "version": "1",
        "started": to_timestamp(round(NOW_S * NS_PER_S) - NS_PER_S),
        "now": to_timestamp(round(NOW_S * NS_PER_S)),
    }
    return Health(**fields | changes)  # type: ignore[arg-type]


def command(positions: dict[str, float], valid_s: float = 0.1) -> JointCommand:
    joints = [JointSetpoint(name=name, position_rad=angle) for name, angle in positions.items()]
    return JointCommand(valid_for=to_duration(valid_s), joints=joints)


def check(given: JointCommand) -> object:
    return judge.check_command(given, NAMES, LIMITS, np.zeros(2), STEP)


def test_health_as_it_should_be_is_taken() -> None:
    judge.check_health("control", [(0.0, health()), (1.0, health()), (1.1, health())], NOW_S)


@pytest.mark.parametrize(
    ("changes", "seen"),
    [
        ({"service": "sim"}, "service 'sim'"),
        ({"status": 0}, "no status"),
        ({"instance": ""}, "no instance"),
        ({"version": ""}, "no version"),
        ({"started": to_timestamp(0)}, "started at 0"),
        ({"now": to_timestamp(round((NOW_S + 60) * NS_PER_S))}, "60 s off"),
        ({"instance": "two"}, "2 instances"),
    ],
)
def test_health_without_a_field_is_not_taken(changes: dict[str, object], seen: str) -> None:
    with pytest.raises(UnfulfilledError, match=seen):
        judge.check_health("control", [(0.0, health()), (1.0, health(**changes))], NOW_S)


def test_health_that_comes_too_rarely_is_not_taken() -> None:
    with pytest.raises(UnfulfilledError, match=r"1\.9 s between"):
        judge.check_health("control", [(0.0, health()), (1.9, health())], NOW_S)


def test_a_command_within_all_limits_is_its_setpoint_in_the_order_of_the_joints() -> None:
    np.testing.assert_array_equal(check(command({"b": 0.1, "a": -0.1})), [-0.1, 0.1])
    assert check(JointCommand(hold=True)) is None


@pytest.mark.parametrize(
    ("given", "seen"),
    [
        (command({"a": 0.0}), "joints a"),
        (command({"a": 0.0, "b": 0.0, "c": 0.0}), "joints a, b, c"),
        (command({"a": math.nan, "b": 0.0}), "nan"),
        (command({"a": 1.1, "b": 0.0}), "a outside of its limits"),
        (command({"a": 0.0, "b": 0.11}), "b 0.110 rad from"),
        (command({"a": 0.0, "b": 0.0}, valid_s=0.0), "valid_for of 0 s"),
        (command({"a": 0.0, "b": 0.0}, valid_s=2.0), "valid_for of 2 s"),
    ],
)
def test_a_command_that_may_not_be_is_said_to_be_one(given: JointCommand, seen: str) -> None:
    with pytest.raises(UnfulfilledError, match=seen):
        check(given)


@pytest.mark.parametrize(
    ("answered", "seen"),
    [
        ([1, 2], "1 of 3 instants were not answered"),
        ([1, 2, 3, 4], "1 answers for a capture time that nobody had"),
        ([1, 2, 2, 3], "1 instants were answered twice"),
        ([1, 3, 2], "out of order"),
    ],
)
def test_every_instant_is_to_be_answered_once_and_in_order(answered: list[int], seen: str) -> None:
    judge.check_answers([1, 2, 3], [1, 2, 3])
    with pytest.raises(UnfulfilledError, match=seen):
        judge.check_answers([1, 2, 3], answered)


@pytest.mark.parametrize(
    ("covariance", "seen"),
    [
        (np.eye(2), "4 numbers"),
        (np.diag([1.0, 1.0, 0.0]), "eigenvalue 0"),
        (np.diag([1.0, 1.0, -1.0]), "eigenvalue -1"),
        (np.eye(3) + np.eye(3, k=1), "not symmetric"),
        (np.full((3, 3), np.nan), "not finite"),
    ],
)
def test_a_covariance_that_is_none_is_said_to_be_so(covariance: np.ndarray, seen: str) -> None:
    judge.check_covariance("red", np.diag([1.0, 2.0, 3.0]).ravel().tolist())
    with pytest.raises(UnfulfilledError, match=seen):
        judge.check_covariance("red", covariance.ravel().tolist())


def test_stages_are_set_and_in_order() -> None:
    judge.check_stages(StageTimes(frames_sent_ns=1, vision_received_ns=2), "frames_sent", "vision_received")
    for times in ((0, 2), (3, 2)):
        stages = StageTimes(frames_sent_ns=times[0], vision_received_ns=times[1])
        with pytest.raises(UnfulfilledError):
            judge.check_stages(stages, "frames_sent", "vision_received")


def test_beyond_every_bound_there_is_a_value() -> None:
    number = Parameter(name="n", value=ParameterValue(number=1.0), least=0.0, most=2.0)
    assert judge.beyond(number) == ParameterValue(number=3.0)
    whole = Parameter(name="n", value=ParameterValue(whole=1), least=0.0, most=2.0)
    assert judge.beyond(whole) == ParameterValue(whole=3)
    assert judge.beyond(Parameter(name="n", value=ParameterValue(flag=True))) is None


def test_a_parameter_out_of_its_own_bounds_is_found() -> None:
    with pytest.raises(UnfulfilledError, match="n = 3, within 0 to 2"):
        judge.check_parameter(
            Parameter(name="n", description="d", value=ParameterValue(number=3.0), least=0.0, most=2.0)
        )


def test_the_twin_looks_the_same_and_is_another_pose() -> None:
    shown, q = Scene(scene.description()), np.array([0.4, 0.2, 0.5, 0.6])
    other = scene.twin(q)
    assert np.abs(other - q).max() > 1.0
    for ball, same in zip(shown.balls(q), shown.balls(other), strict=True):
        np.testing.assert_allclose(ball.centre, same.centre, atol=1e-9)


@pytest.mark.parametrize("camera", vision._CAMERAS, ids=lambda camera: camera.name)
def test_a_drawn_sphere_is_where_its_outline_is_by_the_camera(camera: Camera) -> None:
    ball = Ball("red", np.array([0.5, -0.4, 5.0]), 0.5, (1.0, 0.0, 0.0))
    cover = Ball("cover", ball.centre, 0.6, (0.0, 0.0, 0.0))
    image = camera.draw([ball]).astype(float)
    rows, columns = np.nonzero(image[..., 0] - image[..., 1] > 40)
    at = camera.rotation.T @ (ball.centre - camera.position)
    middle = np.array([camera.width - 1, camera.height - 1]) / 2
    expected = camera.focal_px * at[:2] / at[2] + middle
    # a sphere's outline is an ellipse whose middle is a little outside of its centre's image
    np.testing.assert_allclose([columns.mean(), rows.mean()], expected, atol=0.3)
    radius_px = math.sqrt(len(rows) / math.pi)
    assert radius_px == pytest.approx(camera.focal_px * 0.5 / at[2], rel=0.05)
    assert not (camera.draw([ball, cover])[..., 0] > camera.draw([cover])[..., 0].max()).any(), "it shows through"


# --- the command


def ended(capsys: pytest.CaptureFixture[str], *words: str) -> tuple[int, str, str]:
    with pytest.raises(SystemExit) as end:
        main(["conformance", *words])
    out, err = capsys.readouterr()
    return int(end.value.code or 0), out, err


def test_checks_are_listed_without_a_bus(capsys: pytest.CaptureFixture[str]) -> None:
    code, out, _ = ended(capsys, "sim", "--list")
    assert code == 0
    assert [line.split()[0] for line in out.splitlines()][:2] == ["token", "health"]
    code, out, _ = ended(capsys, "sim", "--list", "--only", "watchdog", "--json")
    assert code == 0
    assert json.loads(out)["check"] == "watchdog"


@pytest.mark.parametrize(
    ("words", "text"), [(["camera"], "'camera' is not one of"), (["sim", "--only", "spin"], "no check 'spin' of sim")]
)
def test_what_can_not_be_asked_for_ends_with_2(capsys: pytest.CaptureFixture[str], words: list[str], text: str) -> None:
    code, _, err = ended(capsys, *words)
    assert code == 2
    assert text in err


def test_lines_in_a_pipe_and_exit_codes(
    make_bus: Callable[[], Bus], endpoint: str, capsys: pytest.CaptureFixture[str]
) -> None:
    where = ("--connect", endpoint)
    code, out, _ = ended(capsys, "control", "--only", "token", *where)
    assert code == 1
    assert "nothing of control for 4 s: is it running?" in out
    own = OwnControl(make_bus())
    code, out, _ = ended(capsys, "control", "--only", "token", "--only", "mode-hold", *where)
    assert out.splitlines() == [
        "passed         token",
        "passed         mode-hold",
        "control: 2 passed, of 2 checks",
    ]
    assert code == 0
    own.plausible = lambda _: False  # type: ignore[method-assign, assignment]
    code, out, _ = ended(capsys, "control", "--only", "mode-joints", "--json", *where)
    assert code == 1
    (found,) = json.loads(out)["checks"]
    assert (found["check"], found["outcome"], found["where"]) == ("mode-joints", "failed", "messages.md#controlmode")
    assert found["expected"]


def test_who_would_be_played_is_not_to_be_there(
    make_bus: Callable[[], Bus], endpoint: str, capsys: pytest.CaptureFixture[str]
) -> None:
    bus = make_bus()
    token = bus.session.liveliness().declare_token(topics.HEALTH.key_for("sim"))
    code, _, err = ended(capsys, "vision", "--connect", endpoint)
    assert code == 2
    assert "sim already there: the suite plays sim itself; stop sim" in err
    token.undeclare()  # type: ignore[no-untyped-call]
