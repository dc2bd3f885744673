from itertools import pairwise

from hypothesis import given, settings
from hypothesis import strategies as st

from armsight_camera.pairing import Instant, Pairing

SKEW, PATIENCE = 10, 60
MS = st.integers(0, 400)
CAMERAS = st.integers(1, 4)


@st.composite
def arrivals(draw: st.DrawFn, most_delay: int = 80) -> tuple[list[str], list[tuple[str, int, int]]]:
    """Cameras, and frames (camera, time, when it arrives), in the order in which they arrive."""
    cameras = [str(n) for n in range(1, draw(CAMERAS) + 1)]
    frames = []
    for camera in cameras:
        arrives = 0
        for time in sorted(draw(st.sets(MS, max_size=12))):
            arrives = max(arrives, time + draw(st.integers(0, most_delay)))
            frames.append((camera, time, arrives))
    return cameras, sorted(frames, key=lambda frame: frame[2])


Out = list[Instant[tuple[str, int]]]


def played(cameras: list[str], frames: list[tuple[str, int, int]]) -> tuple[Out, list[tuple[str, int]]]:
    """The instants, and the frames that were refused; taken as often as there is something new, and at the end."""
    pairing: Pairing[tuple[str, int]] = Pairing(cameras, SKEW, PATIENCE)
    out: Out = []
    refused = []
    for camera, time, now in frames:
        while instant := pairing.take(now):
            out.append(instant)
        if not pairing.add(camera, time, (camera, time)):
            refused.append((camera, time))
        while instant := pairing.take(now):
            out.append(instant)
    while instant := pairing.take(10_000):
        out.append(instant)
    assert pairing.due_ns() is None
    return out, refused


@settings(deadline=None)
@given(arrivals())
def test_every_frame_goes_out_once_or_is_refused(case: tuple[list[str], list[tuple[str, int, int]]]) -> None:
    out, refused = played(*case)
    sent = [frame for instant in out for frame in instant.frames.values()]
    assert sorted(sent + refused) == sorted((camera, time) for camera, time, _ in case[1])


@settings(deadline=None)
@given(arrivals())
def test_times_only_go_up_and_are_those_of_the_first_frame(
    case: tuple[list[str], list[tuple[str, int, int]]],
) -> None:
    out, _ = played(*case)
    assert all(before.time_ns < after.time_ns for before, after in pairwise(out))
    for instant in out:
        times = [time for _, time in instant.frames.values()]
        assert instant.time_ns == min(times)
        assert instant.skew_ns == max(times) - min(times) <= SKEW
        assert all(camera == frame[0] for camera, frame in instant.frames.items())


@settings(deadline=None)
@given(arrivals())
def test_frames_of_a_camera_stay_in_order(case: tuple[list[str], list[tuple[str, int, int]]]) -> None:
    out, _ = played(*case)
    for camera in case[0]:
        times = [instant.frames[camera][1] for instant in out if camera in instant.frames]
        assert times == sorted(times)


@settings(deadline=None)
@given(arrivals(most_delay=PATIENCE - SKEW - 1))
def test_frame_that_came_in_time_is_never_left_out_of_an_instant_it_belongs_to(
    case: tuple[list[str], list[tuple[str, int, int]]],
) -> None:
    out, refused = played(*case)
    assert not refused
    for before, after in pairwise(out):
        others = [time for camera, time in after.frames.values() if camera not in before.frames]
        assert all(time - before.time_ns > SKEW for time in others)


@settings(deadline=None)
@given(st.sets(MS, max_size=7), st.sets(MS, max_size=7))
def test_two_cameras_make_as_many_pairs_as_there_can_be(first: set[int], second: set[int]) -> None:
    frames = sorted([("1", time, time) for time in first] + [("2", time, time) for time in second], key=lambda f: f[2])
    out, refused = played(["1", "2"], frames)
    assert not refused
    assert sum(len(instant.frames) == 2 for instant in out) == most_pairs(sorted(first), sorted(second))


def most_pairs(first: list[int], second: list[int]) -> int:
    """Slow and plain: the longest common subsequence, of frames that are close enough."""
    best = [[0] * (len(second) + 1) for _ in range(len(first) + 1)]
    for i, a in enumerate(first):
        for j, b in enumerate(second):
            best[i + 1][j + 1] = max(best[i][j + 1], best[i + 1][j], best[i][j] + (abs(a - b) <= SKEW))
    return best[-1][-1]


def test_pair_goes_out_when_the_second_frame_comes() -> None:
    pairing: Pairing[str] = Pairing(["1", "2"], SKEW, PATIENCE)
    pairing.add("1", 100, "a")
    assert pairing.take(101) is None
    pairing.add("2", 107, "b")
    assert pairing.take(108) == Instant(100, 7, {"1": "a", "2": "b"})


def test_frame_goes_out_alone_as_soon_as_the_others_next_one_is_too_late_for_it() -> None:
    pairing: Pairing[str] = Pairing(["1", "2"], SKEW, PATIENCE)
    pairing.add("1", 100, "a")
    pairing.add("2", 111, "b")
    assert pairing.take(112) == Instant(100, 0, {"1": "a"})
    assert pairing.take(112) is None


def test_silent_camera_is_waited_for_until_the_patience_ends() -> None:
    pairing: Pairing[str] = Pairing(["1", "2"], SKEW, PATIENCE)
    pairing.add("1", 100, "a")
    assert pairing.due_ns() == 160
    assert pairing.take(159) is None
    assert pairing.take(160) == Instant(100, 0, {"1": "a"})


def test_absent_camera_is_not_waited_for_and_is_again_when_it_is_back() -> None:
    pairing: Pairing[str] = Pairing(["1", "2"], SKEW, PATIENCE)
    pairing.present("2", False)
    pairing.add("1", 100, "a")
    assert pairing.take(100) == Instant(100, 0, {"1": "a"})
    pairing.present("2", True)
    pairing.add("1", 133, "b")
    assert pairing.take(134) is None


def test_frame_of_an_instant_that_is_out_is_refused() -> None:
    pairing: Pairing[str] = Pairing(["1", "2"], SKEW, PATIENCE)
    pairing.add("1", 100, "a")
    assert pairing.take(160) is not None
    assert not pairing.add("2", 99, "b")
    assert not pairing.add("1", 100, "again")
    assert pairing.add("2", 101, "c")
