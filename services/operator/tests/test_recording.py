"""Recordings: every message with its schema, in files that can be read whatever happened to who wrote them."""

import errno
import json
import re
import resource
import signal
import subprocess
import sys
import textwrap
import threading
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import mcap.reader
import pytest
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from hypothesis import given, settings
from hypothesis import strategies as st

from armsight import topics
from armsight.bus import Sample
from armsight.errors import ConfigError
from armsight.topics import TOPICS
from armsight_operator.cli.app import main
from armsight_operator.recording.backlog import Arrival, Backlog
from armsight_operator.recording.info import info_of
from armsight_operator.recording.reader import Recording, topic_of
from armsight_operator.recording.recover import recover
from armsight_operator.recording.scene import ARM, MARKERS, MESSAGES, PREFIX, TRANSFORMS
from armsight_operator.recording.selection import select
from armsight_operator.recording.series import FullError, Limits, Series
from recorded import ARRIVES_NS, START_NS, arrivals, messages, record

LATCHED_KEYS = {"description", "camera/1/calibration", "camera/2/calibration"}


def payloads(recording: Recording) -> list[tuple[str, bytes]]:
    return [(entry.key, entry.payload) for entry in recording.entries() if not entry.converted]


def sent(instants: int) -> list[tuple[str, bytes]]:
    return [(topic.key_for(name or None), payload) for topic, name, _, payload in messages(instants)]


# what is written


def test_every_message_comes_back_as_it_was_in_order(tmp_path: Path) -> None:
    record(tmp_path / "run.mcap", 20)
    recording = Recording(tmp_path / "run.mcap")
    assert payloads(recording) == sent(20)
    assert not recording.troubles
    entry = next(entry for entry in recording.entries() if entry.key == "joints/positions")
    assert (entry.log_ns, entry.instant_ns) == (START_NS + ARRIVES_NS, START_NS)
    assert recording.notes["armsight"] == {"namespace": "robots/arm", "file": "1"}
    assert recording.notes["armsight end"] == {"why": "asked to stop"}


def test_schemas_alone_are_enough_to_decode_a_file(tmp_path: Path) -> None:
    record(tmp_path / "run.mcap", 3)
    seen = set()
    with (tmp_path / "run.mcap").open("rb") as file:
        for schema, channel, message in mcap.reader.make_reader(file, validate_crcs=True).iter_messages():
            assert schema is not None
            assert (schema.encoding, channel.message_encoding) == ("protobuf", "protobuf")
            pool = descriptor_pool.DescriptorPool()
            for described in descriptor_pb2.FileDescriptorSet.FromString(schema.data).file:
                pool.Add(described)  # each after what it imports, or this fails
            decoded = message_factory.GetMessageClass(pool.FindMessageTypeByName(schema.name))()
            decoded.ParseFromString(message.data)
            known = topic_of(channel.topic)
            if known is not None:
                ours = known.message.FromString(message.data)
                assert known.message.FromString(decoded.SerializeToString()) == ours
            assert channel.metadata["encoding"] == f"application/protobuf;{schema.name}"
            seen.add(channel.topic)
    assert {key for key, _ in sent(3)} <= seen


def test_index_finds_what_the_stream_finds(tmp_path: Path) -> None:
    record(tmp_path / "run.mcap", 20, flush_every=15)
    with (tmp_path / "run.mcap").open("rb") as file:
        reader = mcap.reader.make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        assert summary is not None
        assert summary.statistics is not None
        found = [(channel.topic, message.data) for _, channel, message in reader.iter_messages(log_time_order=False)]
    assert len(summary.chunk_indexes) > 3
    assert found == [(entry.key, entry.payload) for entry in Recording(tmp_path / "run.mcap").entries()]
    assert summary.statistics.message_count == len(found)


def test_three_d_panels_get_spheres_links_and_transforms(tmp_path: Path) -> None:
    record(tmp_path / "run.mcap", 3)
    by_key = {entry.key: entry for entry in Recording(tmp_path / "run.mcap").entries() if entry.converted}
    assert {key: entry.schema for key, entry in by_key.items()} == {
        ARM: "foxglove.SceneUpdate",
        MARKERS: "foxglove.SceneUpdate",
        TRANSFORMS: "foxglove.FrameTransforms",
    }
    from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms

    tree = {t.child_frame_id: t.parent_frame_id for t in by_key[TRANSFORMS].decode(FrameTransforms).transforms}
    assert tree == {"base": "world", "joint1": "base", "joint2": "joint1", "joint3": "joint2", "joint4": "joint3"}


def test_transforms_put_the_tip_where_the_kinematics_do() -> None:
    import numpy as np
    from foxglove_schemas_protobuf.JointState_pb2 import JointState
    from foxglove_schemas_protobuf.JointStates_pb2 import JointStates

    from armsight_operator.recording.scene import Scene
    from armsight_operator.report.chain import arm_of
    from fake_arm import NAMES, description

    scene, arm = Scene(), arm_of(description())
    scene.convert(topics.DESCRIPTION, description())
    rng = np.random.default_rng(3)
    for _ in range(20):
        q = rng.uniform(-1.5, 1.5, 4)
        states = JointStates(joints=[JointState(name=n, position=a) for n, a in zip(NAMES, q, strict=True)])
        converted = scene.convert(topics.JOINTS_ESTIMATED, states)
        assert converted is not None
        point = np.asarray(arm.tip[1])
        for transform in reversed(converted.message.transforms):  # type: ignore[attr-defined]
            r, t = transform.rotation, transform.translation
            axis, w = np.array([r.x, r.y, r.z]), r.w
            point = point + 2 * np.cross(axis, np.cross(axis, point) + w * point) + np.array([t.x, t.y, t.z])
        np.testing.assert_allclose(point, arm.to_world(arm.tip_at(q)), atol=1e-9)


def test_true_and_accepted_joints_move_no_frames(tmp_path: Path) -> None:
    record(tmp_path / "run.mcap", 5)
    count = Counter(entry.key for entry in Recording(tmp_path / "run.mcap").entries())
    assert count[TRANSFORMS] == count["joints/estimated"] == 5


# several files


@pytest.mark.parametrize("limits", [Limits(seconds=0.3), Limits(bytes=40_000)], ids=["time", "size"])
def test_each_of_several_files_can_be_opened_alone(tmp_path: Path, limits: Limits) -> None:
    files = record(tmp_path / "run.mcap", 200, limits, flush_every=20).totals.files
    assert len(files) >= 3
    assert files == sorted(tmp_path.glob("run-*.mcap"))
    for file in files:
        alone = info_of(Recording(file))
        assert alone.complete
        assert LATCHED_KEYS | {ARM} <= set(alone.keys)
        first = next(iter(Recording(file).entries()))
        assert first.key == "description"
        assert alone.seconds < 4.0, "what is repeated came with the file, not long ago"
    if limits.bytes is not None:
        assert max(file.stat().st_size for file in files) < limits.bytes + 20_000, "its index may come on top"
    together = Recording(*files)
    assert payloads(together) == [(t.key_for(n or None), p) for t, n, _, p in messages(200)]
    assert info_of(together).lost == 0


def test_a_file_that_is_there_is_kept_unless_told_otherwise(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    record(path, 2)
    before = path.read_bytes()
    with pytest.raises(ConfigError, match="--overwrite"):
        Series(path, Limits(), {})
    assert path.read_bytes() == before
    Series(path, Limits(), {}, overwrite=True).finish("", {})
    assert path.read_bytes() != before


def test_in_a_folder_files_are_named_by_the_time(tmp_path: Path) -> None:
    record(tmp_path, 2)
    (file,) = tmp_path.iterdir()
    assert file.name.startswith("armsight-20")
    assert info_of(Recording(file)).complete


# what a crash leaves


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    path = tmp_path_factory.mktemp("whole") / "run.mcap"
    record(path, 30, flush_every=10)
    return path.read_bytes()


@pytest.fixture(scope="module")
def scratch(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("scratch") / "run.mcap"


@settings(max_examples=400, deadline=None)
@given(share=st.floats(0, 1))
def test_what_is_left_of_a_cut_file_is_read_to_its_end_and_said_to_be_cut(
    whole: bytes, scratch: Path, share: float
) -> None:
    size = min(len(whole) - 1, int(share * len(whole)))
    scratch.write_bytes(whole[:size])
    recording = Recording(scratch)
    found = payloads(recording)
    assert found == sent(30)[: len(found)]
    assert recording.troubles[scratch]
    # a chunk is ten messages: no more than that is missing of what the bytes held
    assert len(found) >= share * len(sent(30)) * 0.5 - 25


@pytest.mark.parametrize("missing", range(1, 60))
def test_a_file_that_lacks_its_last_bytes_has_all_its_messages(whole: bytes, scratch: Path, missing: int) -> None:
    scratch.write_bytes(whole[:-missing])
    recording = Recording(scratch)
    assert payloads(recording) == sent(30)
    assert recording.troubles


@settings(max_examples=400, deadline=None)
@given(data=st.data())
def test_damaged_bytes_never_crash_and_never_give_another_message(whole: bytes, scratch: Path, data: Any) -> None:
    damaged = bytearray(whole)
    for _ in range(data.draw(st.integers(1, 4))):
        damaged[data.draw(st.integers(8, len(whole) - 1))] = data.draw(st.integers(0, 255))
    scratch.write_bytes(damaged)
    recording = Recording(scratch)
    found = payloads(recording)
    expected = dict.fromkeys(sent(30))
    assert all(one in expected for one in found), "a message that nobody sent"
    if found != sent(30):
        assert recording.troubles or len(found) < len(sent(30))


@pytest.mark.parametrize("content", [b"", b"\x89MC", b"\x89MCAP0\r\n"], ids=["empty", "half a magic", "magic alone"])
def test_a_file_with_nothing_in_it_is_unfinished(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "run.mcap"
    path.write_bytes(content)
    info = info_of(Recording(path))
    assert not info.complete
    assert info.messages == 0


def test_other_files_are_refused_in_one_sentence(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    path.write_text("armsight", encoding="ascii")
    with pytest.raises(ConfigError, match="is no MCAP file"):
        Recording(path)
    with pytest.raises(ConfigError, match="can't read"):
        Recording(tmp_path / "none.mcap")


def test_recovered_file_is_whole_and_has_the_same_messages(tmp_path: Path, whole: bytes) -> None:
    cut, out = tmp_path / "cut.mcap", tmp_path / "out.mcap"
    cut.write_bytes(whole[: len(whole) * 2 // 3])
    before = Recording(cut)
    count = recover(before, out)
    after = Recording(out)
    assert payloads(after) == payloads(before)
    assert count == len(payloads(after)) > 50
    assert [e.log_ns for e in after.entries()] == [e.log_ns for e in before.entries()]
    assert info_of(after).complete


KILLED = """
import sys
from pathlib import Path
sys.path.insert(0, {tests!r})
from recorded import arrivals
from armsight_operator.recording.series import Limits, Series
series = Series(Path(sys.argv[1]), Limits(), {{}})
for number, arrival in enumerate(arrivals(10_000)):
    series.write(arrival)
    if number % 100 == 0:
        series.flush()
        print(number, flush=True)
"""


def test_a_killed_writer_leaves_what_it_had_flushed(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    code = KILLED.format(tests=str(Path(__file__).parent))
    with subprocess.Popen([sys.executable, "-c", code, str(path)], stdout=subprocess.PIPE, text=True) as writer:
        assert writer.stdout is not None
        flushed = [int(line) for _, line in zip(range(20), writer.stdout, strict=False)][-1]
        writer.send_signal(signal.SIGKILL)
    recording = Recording(path)
    found = payloads(recording)
    assert len(found) > flushed >= 1900
    assert found == sent(10_000)[: len(found)]
    assert "nobody finished it" in recording.troubles[path]


# a full disk


@pytest.fixture
def at_most() -> Iterator[Callable[[int], None]]:
    """Lets no file grow beyond a size, as a full disk would."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    yield lambda size: resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    resource.setrlimit(resource.RLIMIT_FSIZE, before)


@pytest.mark.parametrize("sets_aside", [True, False], ids=["with room set aside", "without"])
def test_a_full_disk_ends_the_file_and_not_its_readability(
    tmp_path: Path, at_most: Callable[[int], None], monkeypatch: pytest.MonkeyPatch, sets_aside: bool
) -> None:
    path = tmp_path / "run.mcap"
    series = Series(path, Limits(), {})

    def allocate(output: Any, until: int) -> None:
        if not sets_aside:
            raise OSError(errno.EOPNOTSUPP, "not on this file system")
        if until > 400_000:  # the limit that stands for a full disk here does not hold for room that is set aside
            raise OSError(errno.ENOSPC, "No space left on device")
        output._set_aside = until

    monkeypatch.setattr("armsight_operator.recording.mcap_file._Output._allocate", allocate)
    at_most(400_000)

    def write_until_full() -> None:
        for number, arrival in enumerate(arrivals(100_000)):
            series.write(arrival)
            if number % 50 == 0:
                series.flush()

    with pytest.raises(FullError, match=r"readable.*free some space"):
        write_until_full()
    assert path.stat().st_size <= 400_000
    recording = Recording(path)
    info = info_of(recording)
    assert info.messages > 1000
    assert info.complete is sets_aside
    assert payloads(recording) == sent(3000)[: info.messages]


def test_nothing_is_kept_of_the_room_that_was_set_aside(tmp_path: Path) -> None:
    record(tmp_path / "run.mcap", 5)
    found = (tmp_path / "run.mcap").stat()
    assert found.st_blocks * 512 < found.st_size + (64 << 10)


def test_a_folder_that_can_not_be_written_to_is_said(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="can't write to"):
        Series(tmp_path / "none" / "run.mcap", Limits(), {})


# what waits, and what is lost


def sample(size: int, topic: Any = topics.CAMERA_IMAGE) -> Sample:
    return Sample(topic, "1" if "{name}" in topic.key else "", bytes(size), b"")


def test_backlog_keeps_to_its_bound_and_counts_what_it_lost() -> None:
    backlog = Backlog(1000)
    kept = [backlog.put(sample(300)) for _ in range(5)]
    assert kept == [True, True, True, False, False]
    assert backlog.lost == {"camera/1/image": 2}
    taken = [backlog.take(0) for _ in range(4)]
    assert [arrival.sequence for arrival in taken if arrival] == [1, 2, 3]
    assert backlog.put(sample(300))
    last = backlog.take(0)
    assert last is not None
    assert last.sequence == 6, "what was lost has a number: a gap tells of it"


def test_pixels_take_no_place_from_what_is_said_about_them() -> None:
    backlog = Backlog(1000)
    while backlog.put(sample(300)):
        pass
    assert backlog.put(sample(200, topics.JOINT_POSITIONS))


def test_a_frame_larger_than_the_backlog_is_recorded_all_the_same() -> None:
    backlog = Backlog(10)
    assert backlog.put(sample(1000))
    assert not backlog.put(sample(1000))


def test_in_lockstep_frames_wait_for_room_and_no_longer_than_their_patience() -> None:
    backlog = Backlog(1000)
    while backlog.put(sample(300)):
        pass
    lost = sum(backlog.lost.values())
    timer = threading.Timer(0.2, backlog.take, (0.0,))
    timer.start()
    assert backlog.put(sample(300), 10.0), "somebody took one meanwhile"
    assert not backlog.put(sample(300), 0.1), "nobody does"
    assert sum(backlog.lost.values()) == lost + 1


def test_times_never_run_backwards_though_the_clock_does() -> None:
    ticks = iter([10, 20, 5, 30])
    backlog = Backlog(1000, lambda: next(ticks))
    for _ in range(4):
        backlog.put(sample(1))
    taken = [backlog.take(0) for _ in range(4)]
    assert [arrival.at_ns for arrival in taken if arrival] == [10, 20, 20, 30]


def test_lost_messages_show_in_the_file_by_their_numbers(tmp_path: Path) -> None:
    series = Series(tmp_path / "run.mcap", Limits(), {})
    for arrival in arrivals(20):
        if arrival.sample.key != "camera/2/image" or arrival.sequence not in (5, 6, 11):
            series.write(arrival)
    series.finish("", {"camera/2/image": 3})
    info = info_of(Recording(tmp_path / "run.mcap"))
    assert {name: key.lost for name, key in info.keys.items() if key.lost} == {"camera/2/image": 3}
    assert info.notes["armsight end"]["lost camera/2/image"] == "3"


def test_malformed_messages_are_counted_and_left_out(tmp_path: Path) -> None:
    from armsight.counters import Counters

    counters = Counters()
    series = Series(tmp_path / "run.mcap", Limits(), {}, counters=counters)
    bad = Sample(topics.JOINT_POSITIONS, "", b"\xff\xff", b"")
    assert series.write(Arrival(bad, START_NS, 1)) is None
    series.finish("", {})
    assert counters.snapshot() == {"malformed_joint_positions": 1}
    assert info_of(Recording(tmp_path / "run.mcap")).messages == 0


# which keys


@pytest.mark.parametrize(
    ("wanted", "unwanted", "meant"),
    [
        ("camera/1/image", "", {"camera_image": ["1"]}),
        ("camera/1/*", "**/image", {"camera_calibration": ["1"], "camera_pose": ["1"], "camera_annotations": ["1"]}),
        ("joints/t* clock", "", None),
        ("joints/* clock", "joints/t* joints/c*", None),
        ("joints/* clock", "joints/true", {name: [None] for name in (
            "joint_positions", "joints_estimated", "joint_command", "joints_accepted", "clock")}),
        ("camera/1/image camera/2/image", "", {"camera_image": ["1", "2"]}),
        ("camera/*/image camera/1/image", "", {"camera_image": ["*"]}),
    ],
)  # fmt: skip
def test_patterns_subscribe_to_what_they_mean(wanted: str, unwanted: str, meant: dict[str, Any] | None) -> None:
    if meant is None:  # a star is a whole chunk
        with pytest.raises(ConfigError):
            select(wanted.split(), unwanted.split())
        return
    found: dict[str, list[str | None]] = {}
    for topic, name in select(wanted.split(), unwanted.split()).topics():
        found.setdefault(topic.name, []).append(name)
    assert found == meant


def test_no_pattern_means_every_key() -> None:
    assert [topic for topic, _ in select().topics()] == list(TOPICS)


@pytest.mark.parametrize("pattern", ["jonts/*", "a//b", "camera/1", ""])
def test_patterns_that_no_key_fits_are_refused(pattern: str) -> None:
    with pytest.raises(ConfigError):
        select([pattern])


def test_recorded_keys_are_found_in_the_table() -> None:
    for topic in TOPICS:
        assert topic_of(topic.key.replace("{name}", "x1")) is topic
    assert topic_of(f"{PREFIX}arm") is None


# the layout for Foxglove and Lichtblick


def test_layout_shows_keys_that_there_are() -> None:
    layout = json.loads((Path(__file__).parents[3] / "docs" / "foxglove-layout.json").read_text(encoding="utf-8"))

    def placed(node: Any) -> list[str]:
        return [node] if isinstance(node, str) else placed(node["first"]) + placed(node["second"])

    def strings(node: Any) -> Iterator[str]:
        if isinstance(node, dict):
            for name, value in node.items():
                yield name
                yield from strings(value)
        elif isinstance(node, list):
            for value in node:
                yield from strings(value)
        elif isinstance(node, str):
            yield node

    assert sorted(placed(layout["layout"])) == sorted(layout["configById"])
    paths = [text for text in strings(layout["configById"]) if re.match(r"[a-z]+/[a-z0-9/]+", text)]
    assert len(paths) > 20
    for path in paths:
        key, *fields = re.sub(r"\[:\]|\{[^}]*\}", "", path).split(".")
        topic = topic_of(key)
        descriptor: Any = (MESSAGES[key] if topic is None else topic.message).DESCRIPTOR
        for name in fields:
            assert name in descriptor.fields_by_name, path
            descriptor = descriptor.fields_by_name[name].message_type


# the command line


def test_info_tells_what_is_there_and_what_is_wrong(
    tmp_path: Path, whole: bytes, capsys: pytest.CaptureFixture[str]
) -> None:
    good, bad = tmp_path / "good.mcap", tmp_path / "bad.mcap"
    good.write_bytes(whole)
    bad.write_bytes(whole[:-100])
    with pytest.raises(SystemExit) as ended:
        main(["recording", "info", str(good)])
    assert not ended.value.code
    said = capsys.readouterr().out
    assert "joints/positions" in said
    assert "30.0 Hz" in said
    assert f"{good}: whole" in said
    with pytest.raises(SystemExit) as ended:
        main(["recording", "info", str(bad)])
    assert ended.value.code == 1
    assert "nobody finished it" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["joints/true"], "does not end with .mcap"),
        ([], "no file named"),
        (["run.mcap", "jonts/true"], "no key 'jonts/true'"),
        (["run.mcap", "--compression", "gzip"], "is none of zstd"),
    ],
)
def test_record_says_what_it_can_not_use(words: list[str], said: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["record", *words])
    assert ended.value.code == 2
    assert said in capsys.readouterr().err


def test_command_line_starts_without_what_only_recordings_need() -> None:
    code = textwrap.dedent("""
        import sys
        from armsight_operator.cli import app
        heavy = {"mcap", "zstandard", "lz4", "foxglove", "google.protobuf", "zenoh", "numpy"} & set(sys.modules)
        assert not heavy, heavy
    """)
    subprocess.run([sys.executable, "-c", code], check=True, timeout=30)
