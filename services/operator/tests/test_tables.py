"""What is made of recordings: tables, and the report."""

import csv
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from google.protobuf.message import Message

from armsight import topics
from armsight.bus import Sample
from armsight.times import to_timestamp
from armsight.topics import Topic
from armsight.v1.control_pb2 import (
    CONTROL_MODE_TEST_1,
    CONTROL_MODE_TRACK,
    CONTROL_STATE_MOVING,
    SAFETY_CODE_OK,
    ControlStatus,
)
from armsight.v1.health_pb2 import HEALTH_STATUS_DEGRADED, Health
from armsight.v1.joints_pb2 import JointCommand, JointSetpoint
from armsight_operator.cli.app import main
from armsight_operator.errors import NoDataError
from armsight_operator.recording.backlog import Arrival
from armsight_operator.recording.reader import Recording, topic_of
from armsight_operator.recording.series import Limits, Series
from armsight_operator.recording.tables import COLUMNS, export
from armsight_operator.report import from_recording
from armsight_operator.report.pages import to_html
from fake_arm import NAMES
from recorded import ARRIVES_NS, PERIOD_NS, START_NS, arrivals, record

Table = list[dict[str, str]]


def tables(path: Path, folder: Path) -> dict[str, Table]:
    counts = export(Recording(path), folder)
    found = {}
    for table in COLUMNS:
        with (folder / f"{table}.csv").open(encoding="utf-8", newline="") as file:
            found[table] = list(csv.DictReader(file))
    assert counts == {table: len(rows) for table, rows in found.items()}
    return found


def more(series: Series, topic: Topic[Any], message: Message, at_ns: int, name: str = "") -> None:
    series.write(Arrival(Sample(topic, name, message.SerializeToString(), b""), at_ns, 1))


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """Ten instants with a command, a status and a health beside each, mode test-1, then track."""
    series = Series(tmp_path / "run.mcap", Limits(), {})
    for number, arrival in enumerate(arrivals(10)):
        series.write(arrival)
        if arrival.sample.topic is not topics.JOINTS_TRUE:
            continue
        stamp = to_timestamp(arrival.at_ns - ARRIVES_NS)
        instant = (arrival.at_ns - ARRIVES_NS - START_NS) // PERIOD_NS
        command = JointCommand(answers=stamp, hold=instant == 0)
        command.valid_for.nanos = 100_000_000
        if instant:
            command.joints.extend(JointSetpoint(name=name, position_rad=0.5) for name in NAMES)
        more(series, topics.JOINT_COMMAND, command, arrival.at_ns)
        status = ControlStatus(
            capture_time=stamp,
            mode=CONTROL_MODE_TEST_1 if instant < 6 else CONTROL_MODE_TRACK,
            state=CONTROL_STATE_MOVING,
            safety=SAFETY_CODE_OK,
        )
        status.stages.frames_sent_ns, status.stages.control_sent_ns = 1_000_000, 6_000_000
        if instant >= 6:
            status.target.z = 10.0
            status.target_reachable = True
        more(series, topics.CONTROL_STATUS, status, arrival.at_ns)
        health = Health(service="vision", status=HEALTH_STATUS_DEGRADED, detail="dark | cold")
        health.counters["frames"] = number
        more(series, topics.HEALTH, health, arrival.at_ns, "vision")
    series.finish("", {})
    return tmp_path / "run.mcap"


def test_tables_have_what_the_messages_said(run: Path, tmp_path: Path) -> None:
    found = tables(run, tmp_path / "tables")
    joints = [row for row in found["joints"] if row["of"] == "true" and row["joint"] == "joint2"]
    assert [float(row["position_rad"]) for row in joints] == pytest.approx([0.1 * n for n in range(10)])
    assert [int(row["capture_ns"]) for row in joints] == [START_NS + n * PERIOD_NS for n in range(10)]
    assert int(joints[3]["log_ns"]) == int(joints[3]["capture_ns"]) + ARRIVES_NS
    assert {row["of"] for row in found["joints"]} == {"true", "estimated"}
    assert [float(row["x"]) for row in found["positions"]] == pytest.approx([0.01 * n for n in range(10)])
    assert {row["status"] for row in found["positions"]} == {"tracked"}
    assert found["command"][0]["hold"] == "1"
    assert found["command"][0]["joint"] == ""
    assert len(found["command"]) == 1 + 9 * 4
    assert float(found["command"][1]["valid_s"]) == pytest.approx(0.1)
    assert [row["mode"] for row in found["status"]] == ["test-1"] * 6 + ["track"] * 4
    assert [row["target_z"] for row in found["status"]] == [""] * 6 + ["10.0"] * 4
    assert {(row["service"], row["status"], row["kind"], row["name"]) for row in found["health"]} == {
        ("vision", "degraded", "counter", "frames")
    }


def test_tables_of_an_unfinished_recording_go_to_its_end(
    run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run.write_bytes(run.read_bytes()[:-100])
    with pytest.raises(SystemExit) as ended:
        main(["export", str(run), "--csv", str(tmp_path / "tables")])
    assert not ended.value.code
    said = capsys.readouterr().out
    assert "status.csv 10 rows" in said
    assert "nobody finished it" in said


def test_report_measures_each_motion_of_a_recording(run: Path) -> None:
    recorded = from_recording.measure(Recording(run))
    assert [(m.mode, m.frames) for m in recorded.motions] == [("test-1", 6), ("track", 4)]
    first, second = recorded.motions
    assert first.part is not None
    assert first.part.symbols == ("nu", "phi", "psi")
    assert np.abs(first.part.error).max() == 0.0
    assert first.part.time_s[-1] == pytest.approx(5 * PERIOD_NS / 1e9)
    assert second.begin_s == pytest.approx(6 * PERIOD_NS / 1e9)
    assert second.part is not None
    assert second.part.symbols == ("theta", "nu", "phi", "psi")
    assert first.tip_distance_m.size == 0
    assert second.tip_distance_m.size == 4
    assert recorded.latencies_ms.tolist() == [5.0] * 10


def test_report_of_a_recording_is_one_page_with_everything_in_it(run: Path, tmp_path: Path) -> None:
    out = tmp_path / "report"
    with pytest.raises(SystemExit) as ended:
        main(["report", "--from", str(run), "--out", str(out)])
    assert not ended.value.code
    page = (out / "report.html").read_text(encoding="utf-8")
    links = re.findall(r'(?:src|href)="([^"]*)"', page)
    assert len(links) == 5, "angles and errors of both motions, and the tip of one"
    assert all(link.startswith("data:image/png;base64,") for link in links)
    assert "<h2>test-1" in page
    assert "<td>10 × dark | cold</td>" in page
    figures = json.loads((out / "summary.json").read_text(encoding="utf-8"))
    assert figures["motions"][0]["joints"]["rms"] == {"nu": 0.0, "phi": 0.0, "psi": 0.0}
    assert figures["complete"]


def test_report_without_truth_tells_what_it_can(tmp_path: Path, run: Path) -> None:
    series = Series(tmp_path / "real.mcap", Limits(), {})
    for entry in Recording(run).entries():
        topic = None if entry.converted else topic_of(entry.key)
        if topic is not None and topic is not topics.JOINTS_TRUE:
            sample = Sample(topic, topic.name_in(entry.key), entry.payload, b"")
            series.write(Arrival(sample, entry.log_ns, entry.sequence))
    series.finish("", {})
    recorded = from_recording.measure(Recording(tmp_path / "real.mcap"))
    assert [motion.part for motion in recorded.motions] == [None, None]
    assert recorded.motions[1].tip_distance_m.size == 4
    assert "No truth was recorded" in from_recording.to_markdown(recorded)


def test_report_of_a_recording_without_status_says_what_to_record(tmp_path: Path) -> None:
    record(tmp_path / "run.mcap", 3)
    with pytest.raises(NoDataError, match=r"no control/status in .*record it as well"):
        from_recording.measure(Recording(tmp_path / "run.mcap"))


def test_page_shows_no_markup_of_others(tmp_path: Path) -> None:
    assert "<script>" not in to_html("| a |\n|---|\n| <script>alert(1)</script> |\n", tmp_path)
