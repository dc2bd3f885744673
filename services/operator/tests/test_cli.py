"""The commands on a real bus, against something that answers as sim and control do."""

import json
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import pytest
from foxglove_schemas_protobuf.Point3InFrame_pb2 import Point3InFrame

from armsight import topics
from armsight.bus import Bus
from armsight.v1.control_pb2 import CONTROL_MODE_JOINTS, CONTROL_MODE_TEST_2, CONTROL_MODE_TRACK
from armsight_operator.cli.app import main
from armsight_operator.stack import free_port
from fake_arm import FakeArm

Command = Callable[..., tuple[int, str, str]]


@pytest.fixture
def command(endpoint: str, capsys: pytest.CaptureFixture[str]) -> Command:
    """Runs `armsight …` in this process: exit code, output, errors."""

    def run(*words: str) -> tuple[int, str, str]:
        try:
            main([*words, "--connect", endpoint])
        except SystemExit as ended:
            code = ended.code or 0
        captured = capsys.readouterr()
        return int(code), captured.out, captured.err

    return run


@contextmanager
def saying(say: Callable[[], None]) -> Iterator[None]:
    """Says something again and again meanwhile."""
    done = threading.Event()

    def run() -> None:
        while not done.wait(0.02):
            say()

    thread = threading.Thread(target=run)
    thread.start()
    yield
    done.set()
    thread.join()


def test_move_asks_for_one_angle_for_each_joint(command: Command, arm: FakeArm) -> None:
    code, out, _ = command("move", "0.5", "0", "0.8", "-0.4")
    assert code == 0
    assert "moving to (0.5, 0, 0.8, -0.4)" in out
    (asked,) = arm.modes
    assert asked.mode == CONTROL_MODE_JOINTS
    assert {j.name: j.position_rad for j in asked.joints} == {"joint1": 0.5, "joint2": 0, "joint3": 0.8, "joint4": -0.4}


def test_move_with_too_few_angles_is_a_mistake_of_the_command_line(command: Command, arm: FakeArm) -> None:
    code, _, error = command("move", "0.5", "0")
    assert code == 2
    assert "2 angles given; this arm has 4 joints" in error
    assert error.count("\n") == 1
    assert not arm.modes


def test_refusal_is_told_in_the_services_own_words(command: Command, arm: FakeArm) -> None:
    arm.refusal = "joint1 = 9 rad is outside of its limits"
    code, _, error = command("move", "9", "0", "0", "0")
    assert code == 1
    assert error == "armsight: joint1 = 9 rad is outside of its limits\n"


def test_target_is_published_and_followed(command: Command, arm: FakeArm, make_bus: Callable[[], Bus]) -> None:
    heard: list[Point3InFrame] = []
    make_bus().subscriber(topics.TARGET, on_message=lambda received: heard.append(received.message))
    code, out, _ = command("target", "3.0", "-1.0", "7.0", "--frame", "world", "--seconds", "0.5")
    assert code == 0
    assert "(3, -1, 7) m in the world frame" in out
    assert arm.modes[0].mode == CONTROL_MODE_TRACK
    assert len(heard) >= 3
    assert (heard[0].point.x, heard[0].point.y, heard[0].point.z, heard[0].frame_id) == (3.0, -1.0, 7.0, "world")


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (["target", "1", "2", "3", "--frame", "moon"], "neither base nor world"),
        (["target", "nan", "2", "3"], "finite"),
        (["mode", "dance"], "no mode 'dance'"),
        (["mode", "joints"], "armsight move"),
        (["topics", "rate", "joints/nothing"], "no key"),
        (["topics", "echo", "camera/{name}/pose"], "put a name"),
        (["target", "1", "2", "3", "--seconds", "nan"], "--seconds"),
        (["mode", "test-1", "--start", "-1"], "--start"),
        (["topics", "echo", "clock", "-n", "-1"], "--count"),
        (["topics", "rate", "clock", "--seconds", "inf"], "--seconds"),
        (["report", "--seed", "-1"], "--seed"),
        (["report", "--samples", "3"], "--samples"),
        (["nonsense"], "nonsense"),
    ],
)
def test_mistakes_of_the_command_line_end_with_one_line_and_code_2(
    command: Command, arm: FakeArm, words: list[str], reason: str
) -> None:
    code, _, error = command(*words)
    assert code == 2
    assert reason in error
    assert error.count("\n") == 1
    assert not arm.modes


def test_mode_is_set_and_shown(command: Command, arm: FakeArm) -> None:
    assert command("mode", "test-2", "--start", "8")[:2] == (0, "test-2\n")
    assert (arm.modes[0].mode, arm.modes[0].start_s) == (CONTROL_MODE_TEST_2, 8.0)
    assert command("mode")[:2] == (0, "test-2\n")


def test_reset_takes_a_pose_or_zero(command: Command, arm: FakeArm) -> None:
    assert command("reset")[:2] == (0, "reset to zero\n")
    assert command("reset", "-0.1", "0", "0.5", "0.5")[0] == 0
    assert not arm.resets[0].joints
    assert [joint.position_rad for joint in arm.resets[1].joints] == [-0.1, 0.0, 0.5, 0.5]


def test_stop_holds_until_its_own_source_releases(command: Command, arm: FakeArm) -> None:
    assert command("stop", "--source", "door")[0] == 0
    assert command("stop", "--source", "me")[0] == 0
    assert arm.stopped_by == ["door", "me"]
    assert "still stopped by door" in command("release", "--source", "me")[1]
    assert command("release", "--source", "door")[1] == "released\n"
    assert not arm.stopped_by


def test_status_is_well_only_when_all_services_are(command: Command, arm: FakeArm) -> None:
    code, out, _ = command("status", "--json")
    assert code == 1
    assert [service["status"] for service in json.loads(out)["services"]] == ["missing"] * 3

    def say() -> None:
        for name in ("sim", "vision", "control"):
            arm.say_health(name)
        arm.say_status()

    with saying(say):
        code, out, _ = command("status", "--json")
        told = json.loads(out)
        assert (code, told["ready"], told["mode"]) == (0, True, "track")
        assert told["error_m"] == pytest.approx(0.5)
        code, out, _ = command("status")
    assert code == 0
    assert all(word in out for word in ("sim", "vision", "control", "30.0 Hz", "track", "joint4 +0.100"))


def test_topics_are_listed_with_message_and_publisher(command: Command, capsys: pytest.CaptureFixture[str]) -> None:
    del command
    with pytest.raises(SystemExit) as ended:
        main(["topics", "list"])
    out = capsys.readouterr().out
    assert not ended.value.code
    lines = {line.split()[0]: line for line in out.splitlines()[1:]}
    assert set(lines) == {topic.key for topic in topics.TOPICS}
    assert "armsight.v1.JointCommand" in lines["joints/command"]
    assert "control" in lines["joints/command"]


def test_echo_prints_a_json_object_a_line(command: Command, arm: FakeArm) -> None:
    with saying(arm.say_status):
        code, out, _ = command("topics", "echo", "control/status", "-n", "3")
    assert code == 0
    told = [json.loads(line) for line in out.splitlines()]
    assert [status["mode"] for status in told] == ["CONTROL_MODE_TRACK"] * 3


def test_rate_counts_what_comes(command: Command, arm: FakeArm) -> None:
    with saying(arm.say_status):
        code, out, _ = command("topics", "rate", "control/status", "--seconds", "1")
    assert code == 0
    assert 20 < float(out.split()[0]) < 60


def test_silence_is_an_error_that_names_the_publisher(command: Command) -> None:
    code, _, error = command("topics", "rate", "joints/positions", "--seconds", "0.2")
    assert code == 1
    assert "vision" in error


def test_without_a_router_every_command_ends_soon_and_says_so(capsys: pytest.CaptureFixture[str]) -> None:
    began = time.monotonic()
    with pytest.raises(SystemExit) as ended:
        main(["status", "--connect", f"tcp/127.0.0.1:{free_port()}"])
    assert ended.value.code == 1
    assert time.monotonic() - began < 6.0
    error = capsys.readouterr().err
    assert "no router answers" in error
    assert "armsight up" in error


def test_an_endpoint_that_is_none_is_a_mistake_of_the_command_line(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["status", "--connect", "nowhere"])
    assert ended.value.code == 2
    assert "nowhere" in capsys.readouterr().err


def test_params_are_listed_with_their_bounds_and_who_is_silent_is_named(command: Command, arm: FakeArm) -> None:
    del arm
    code, out, err = command("params", "list")
    assert code == 1
    assert "sim and vision did not answer" in err
    assert [line.split()[:3] for line in out.splitlines()[1:]] == [
        ["control", "speed", "0.3"],
        ["control", "steps", "10"],
        ["control", "avoid_box", "false"],
        ["control", "solver", "torch"],
    ]
    assert "0.01 to 0.5" in out
    assert "1 to 100 steps" in out
    assert "torch, closed-form" in out
    code, out, _ = command("params", "list", "control", "--json")
    assert code == 0
    assert json.loads(out)["control"] == {"speed": 0.3, "steps": 10, "avoid_box": False, "solver": "torch"}


def test_params_are_set_all_together_and_read_back(command: Command, arm: FakeArm) -> None:
    del arm
    code, out, _ = command("params", "set", "control", "speed=0.1", "avoid_box=true", "solver=closed-form", "steps=7")
    assert code == 0
    assert out.splitlines() == ["speed = 0.1", "avoid_box = true", "solver = closed-form", "steps = 7"]
    code, out, _ = command("params", "get", "control", "avoid_box")
    assert (code, out) == (0, "true\n")

    code, _, err = command("params", "set", "control", "steps=8", "speed=0.9")
    assert code == 1
    assert "speed is a number within 0.01 to 0.5, not 0.9" in err
    assert command("params", "get", "control", "steps")[1] == "7\n", "one that is refused leaves the others"


def test_params_that_cannot_be_meant_are_refused_before_anything_is_set(command: Command, arm: FakeArm) -> None:
    del arm
    for words, text in (
        (("speed",), "expected NAME=VALUE, not 'speed'"),
        (("speed=1", "speed=2"), "speed is given twice"),
        (("speed=fast",), "speed is a number, not 'fast'"),
        (("steps=1.5",), "steps is a whole number, not '1.5'"),
        (("avoid_box=yes",), "avoid_box is true or false, not 'yes'"),
        (("colour=red",), "control has no parameter 'colour': see `armsight params list control`"),
    ):
        code, _, err = command("params", "set", "control", *words)
        assert code == 2
        assert text in err
    code, _, err = command("params", "get", "*", "speed")
    assert code == 2
    assert "'*' is not the name of a service" in err


def test_programs_get_json_of_topics(command: Command, arm: FakeArm, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["topics", "list", "--json"])
    listed = {one["key"]: one for one in json.loads(capsys.readouterr().out)}
    assert listed["joints/command"]["publishers"] == ["control"]
    assert listed["joints/command"]["message"] == "armsight.v1.JointCommand"
    with saying(arm.say_status):
        code, out, _ = command("topics", "rate", "control/status", "--seconds", "1", "--json")
    told = json.loads(out)
    assert (code, told["key"]) == (0, "control/status")
    assert told["messages"] == told["rate_hz"]
    assert told["mean_bytes"] > 10
