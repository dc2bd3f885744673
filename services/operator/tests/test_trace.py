"""Stamps to spans, statistics and pictures, without a bus; and the command on one."""

import json
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from test_cli import Command, command, saying

from armsight import topics
from armsight.bus import Bus, Sample
from armsight.times import to_timestamp
from armsight.v1.control_pb2 import ControlStatus
from armsight.v1.joints_pb2 import JointCommand, JointPositions, StageTimes
from armsight.v1.sim_pb2 import Clock
from armsight_operator.cli.app import main
from armsight_operator.recording.backlog import Arrival
from armsight_operator.recording.series import Limits, Series
from armsight_operator.trace import KEYS, STAGES, TOTAL, Frame, Joiner, Statistics
from armsight_operator.trace.chrome import chrome_trace
from armsight_operator.trace.show import bar, frame_as_json, frame_as_line, picture, summary_as_dict, summary_as_line
from recorded import record

__all__ = ["command"]

MS = 1_000_000
BEGAN = 1_800_000_000_000_000_000
# By hand, in ms after the clock was heard: drawn 4, frames there 5, measured 6.5, positions there 7, answered 9,
# heard 10
AT = {
    "frames_sent_ns": BEGAN + 4 * MS,
    "vision_received_ns": BEGAN + 5 * MS,
    "vision_sent_ns": BEGAN + 6 * MS + MS // 2,
    "control_received_ns": BEGAN + 7 * MS,
    "control_sent_ns": BEGAN + 9 * MS,
}
EXPECTED_MS = {
    "draw": 4.0,
    "frames": 1.0,
    "vision": 1.5,
    "positions": 0.5,
    "control": 2.0,
    "command": 1.0,
    "frame_to_command": 5.0,
}


def messages(capture_ns: int, late_ns: int = 0) -> list[tuple[object, int]]:
    """All that is said of one frame, with when it is heard; ``late_ns`` after the numbers above."""
    stamp = to_timestamp(capture_ns)
    stages = StageTimes(**{name: ns + late_ns for name, ns in AT.items()})
    to_vision = StageTimes(**{name: ns + late_ns for name, ns in AT.items() if not name.startswith("control")})
    return [
        (Clock(capture_time=stamp), BEGAN + late_ns),
        (JointPositions(capture_time=stamp, stages=to_vision), BEGAN + late_ns + 7 * MS),
        (JointCommand(answers=stamp, stages=stages), BEGAN + late_ns + 10 * MS),
        (ControlStatus(capture_time=stamp, stages=stages), BEGAN + late_ns + 11 * MS),
    ]


def joined(said: list[tuple[object, int]], joiner: Joiner | None = None) -> list[Frame]:
    joiner = joiner or Joiner()
    taken = [joiner.take(message, heard_ns) for message, heard_ns in said]  # type: ignore[arg-type]
    return [frame for frame in (*taken, joiner.rest()) if frame is not None]


def in_ms(frame: Frame) -> dict[str, float | None]:
    took = {stage.name: frame.seconds(stage) for stage in (*STAGES, TOTAL)}
    return {name: None if seconds is None else round(seconds * 1e3, 6) for name, seconds in took.items()}


def test_what_messages_tell_of_a_frame_becomes_its_stages() -> None:
    (frame,) = joined(messages(1))
    assert frame.capture_ns == 1
    assert in_ms(frame) == EXPECTED_MS


def test_stages_follow_one_another_without_a_gap() -> None:
    assert [stage.begin for stage in STAGES[1:]] == [stage.end for stage in STAGES[:-1]]


def test_messages_that_overtake_each_other_are_joined_all_the_same() -> None:
    clock, positions, command, status = messages(1)
    frames = joined([clock, status, positions, command, *messages(2, 33 * MS)])
    assert [frame.capture_ns for frame in frames] == [1, 2]
    assert [in_ms(frame) for frame in frames] == [EXPECTED_MS] * 2


def test_a_frame_that_is_answered_again_is_given_once_with_its_first_times() -> None:
    frames = joined([*messages(1), *messages(1, 500 * MS), *messages(2, 33 * MS), *messages(1, 900 * MS)])
    assert [frame.capture_ns for frame in frames] == [1, 2]
    assert in_ms(frames[0]) == EXPECTED_MS


def test_who_came_in_the_middle_of_a_frame_says_what_it_knows() -> None:
    (frame,) = joined(messages(1)[3:])
    assert in_ms(frame) == EXPECTED_MS | {"draw": None, "command": None}


def test_frames_that_nobody_answers_are_forgotten() -> None:
    joiner = Joiner(keep=8)
    for capture_ns in range(1000):
        joiner.take(Clock(capture_time=to_timestamp(capture_ns)), BEGAN)
    assert len(joiner._frames) == 8
    assert [frame.capture_ns for frame in joined(messages(5000), joiner)] == [5000]


def test_a_stage_that_ends_before_it_begins_is_counted_and_not_shown() -> None:
    ahead = Frame(1, AT | {"control_received_ns": AT["vision_sent_ns"] - MS})
    statistics = Statistics()
    statistics.add(ahead)
    assert in_ms(ahead)["positions"] is None
    assert statistics.contradicted == 1
    assert "clocks" in summary_as_line(statistics)
    sane = Statistics()
    sane.add(Frame(1, AT))
    assert sane.contradicted == 0
    assert "clocks" not in summary_as_line(sane)


def test_a_listener_that_hears_late_says_nothing_against_the_clocks() -> None:
    late = Frame(1, {"clock_heard_ns": BEGAN + 50 * MS, "frames_sent_ns": BEGAN})
    statistics = Statistics()
    statistics.add(late)
    assert in_ms(late)["draw"] is None
    assert statistics.contradicted == 0


def test_statistics_are_of_the_newest_frames() -> None:
    statistics = Statistics(window=100)
    for late in (500, *range(1, 101)):  # the first is out of the window
        statistics.add(Frame(late, {"frames_sent_ns": BEGAN, "control_sent_ns": BEGAN + late * MS}))
    total = statistics.summary(TOTAL)
    assert (total.frames, statistics.frames) == (100, 101)
    assert (total.p50_s, total.p99_s, total.last_s) == pytest.approx((0.051, 0.100, 0.100))
    assert statistics.summary(STAGES[2]).p50_s is None


def test_trace_events_are_what_perfetto_reads() -> None:
    told = json.loads(chrome_trace([Frame(1, AT), Frame(2, {name: ns + 33 * MS for name, ns in AT.items()})]))
    rows = {event["tid"]: event["args"]["name"] for event in told["traceEvents"] if event["name"] == "thread_name"}
    spans = [event for event in told["traceEvents"] if event["ph"] == "X"]
    assert len(spans) == 2 * 4  # neither the clock nor the command was heard
    first = spans[:4]
    assert [rows[span["tid"]] for span in first] == ["bus", "vision", "bus", "control"]
    assert [span["ts"] for span in first] == [0.0, 1000.0, 2500.0, 3000.0]
    assert [span["dur"] for span in first] == pytest.approx([1000.0, 1500.0, 500.0, 2000.0])
    assert spans[4]["ts"] - first[0]["ts"] == pytest.approx(33_000.0)


def test_a_frame_is_a_line_or_an_object() -> None:
    (frame,) = joined(messages(1))
    assert json.loads(frame_as_json(frame))["ms"] == EXPECTED_MS
    assert "vision 1.50" in frame_as_line(frame)


def test_the_picture_has_a_row_and_a_bar_for_each_stage() -> None:
    from rich.console import Console

    statistics = Statistics()
    for frame in joined(messages(1)):
        statistics.add(frame)
    console = Console(width=110, record=True, file=None, quiet=True)
    with console.capture() as captured:
        console.quiet = False
        console.print(picture(statistics))
    lines = captured.get().splitlines()
    assert [line.split()[0] for line in lines[1:8]] == list(EXPECTED_MS)
    marks = {line.split()[0]: line.count("█") for line in lines[1:8]}
    assert marks["draw"] == 0
    assert marks["control"] > marks["positions"] > 0
    assert marks["frame_to_command"] == max(marks.values())
    assert all(len(line) <= 110 for line in lines)


@pytest.mark.parametrize(
    ("begin", "end", "drawn"), [(0.0, 1.0, "████"), (0.5, 0.75, "  █"), (0.5, 0.5, "  █"), (1.0, 1.2, "   █")]
)
def test_a_bar_stays_within_its_place(begin: float, end: float, drawn: str) -> None:
    assert bar(begin, end, 4) == drawn


def test_the_command_ends_after_so_many_frames(command: Command, make_bus: Callable[[], Bus], tmp_path: Path) -> None:
    bus, number = make_bus(), iter(range(1, 1000))
    publishers = [
        bus.publisher(topic)
        for topic in (topics.CLOCK, topics.JOINT_POSITIONS, topics.JOINT_COMMAND, topics.CONTROL_STATUS)
    ]

    def say() -> None:
        capture = next(number)
        for publisher, (message, _) in zip(publishers, messages(capture, capture * 33 * MS), strict=True):
            publisher.put(message)

    file = tmp_path / "frames.json"
    with saying(say):
        code, out, errors = command("trace", "--frames", "5", "--json", "--chrome", str(file))
    assert code == 0, errors
    lines = [json.loads(line) for line in out.splitlines()]
    assert len(lines) == 6
    assert lines[-1]["summary"]["frames"] == 5
    stamped = {name: ms for name, ms in EXPECTED_MS.items() if name not in ("draw", "command")}
    assert all(lines[3]["ms"][name] == ms for name, ms in stamped.items())
    spans = [event for event in json.loads(file.read_text())["traceEvents"] if event["ph"] == "X"]
    assert len(spans) >= 5 * 4
    assert summary_as_dict(Statistics())["frames"] == 0


def record_trace(path: Path, frames: int) -> None:
    series = Series(path, Limits(), {})
    for number in range(1, frames + 1):
        for message, heard_ns in messages(number, number * 33 * MS):
            topic = next(topic for topic in KEYS if topic.message is type(message))
            sample = Sample(topic, "", message.SerializeToString(), b"")  # type: ignore[attr-defined]
            series.write(Arrival(sample, heard_ns, number))
    series.finish("asked to stop", {})


def trace_of(*words: str) -> int:
    with pytest.raises(SystemExit) as ended:
        main(["trace", *words])
    return int(ended.value.code or 0)


def test_a_recording_tells_the_same_as_the_bus_did(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    file, events = tmp_path / "run.mcap", tmp_path / "frames.json"
    record_trace(file, 20)
    assert trace_of("--from", str(file), "--json", "--chrome", str(events)) == 0
    *frames, last = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [frame["capture_time_ns"] for frame in frames] == list(range(1, 21))
    assert all(frame["ms"] == EXPECTED_MS for frame in frames)
    assert last["summary"]["frames"] == 20
    assert sum(event["ph"] == "X" for event in json.loads(events.read_text())["traceEvents"]) == 20 * 6
    assert trace_of("--from", str(file), "--frames", "3", "--json") == 0
    assert len(capsys.readouterr().out.splitlines()) == 4


def test_a_recording_that_breaks_off_tells_what_it_has(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    file = tmp_path / "run.mcap"
    record(file)  # of a run without control
    assert trace_of("--from", str(file)) == 1
    assert "no frame that was answered" in capsys.readouterr().err
    record_trace(tmp_path / "other.mcap", 20)
    (tmp_path / "other.mcap").write_bytes((tmp_path / "other.mcap").read_bytes()[:-100])
    assert trace_of("--from", str(tmp_path / "other.mcap")) == 0
    said = capsys.readouterr()
    assert said.out.splitlines()[-1].startswith("20 frames")
    assert "other.mcap: " in said.err


def test_sigterm_ends_it_with_what_was_seen(endpoint: str, make_bus: Callable[[], Bus]) -> None:
    bus, number = make_bus(), iter(range(1, 100_000))
    status = bus.publisher(topics.CONTROL_STATUS)
    words = [sys.executable, "-c", "from armsight_operator.cli.app import main; main()", "trace", "--connect", endpoint]
    with saying(lambda: status.put(ControlStatus(capture_time=to_timestamp(next(number)), stages=StageTimes(**AT)))):
        process = subprocess.Popen(words, stdout=subprocess.PIPE, text=True)
        assert process.stdout is not None
        assert "frame_to_command 5.00" in process.stdout.readline()
        began = time.monotonic()
        process.terminate()
        out, _ = process.communicate(timeout=10)
        assert time.monotonic() - began < 2.0
    assert process.returncode == 0
    assert "frames, p50 in ms" in out.splitlines()[-1]


def test_silence_and_a_file_that_cannot_be_written_are_said(
    command: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("armsight_operator.cli.trace._SILENCE_S", 0.3)
    code, out, error = command("trace", "--frames", "1")
    assert (code, out) == (1, "")
    assert "no frame was answered" in error
    code, _, error = command("trace", "--chrome", str(tmp_path / "nowhere" / "x.json"))
    assert code == 2
    assert "can't write" in error


def test_help_of_trace_is_short(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["trace", "--help"])
    assert "Example: armsight trace" in capsys.readouterr().out
