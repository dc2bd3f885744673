"""What must hold of an arm's motion whatever happens to the processes and the network: held against a recording.

Everything is judged at capture times (simulated time), from what was put on the bus; only a stop, which has none, is
placed among them by when it came. What the recorder may not have heard (its way to the bus was gone) excuses a motion
without a command, and is told; it excuses neither limits nor speed.
"""

from bisect import bisect_left, bisect_right
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from armsight import topics
from armsight.times import NS_PER_S
from armsight.v1.health_pb2 import HEALTH_STATUS_OK
from armsight_operator.recording.timeline import Frame, Life, State, Timeline, lives

WATCHDOG_NS = 100_000_000
"""Without a fresh command to move for longer, the setpoint brakes."""
BRAKING_RAD_S2 = 20.0
"""How fast it brakes: what the contract promises, and sim keeps."""

# The joints hang on position actuators. Full speed to and fro, sideways and into a limit, gave 5.23 of 5 rad/s between
# two frames, 0.005 rad beyond a limit, and 0.05 rad/s within 0.17 s after the setpoint came to rest.
_OVERSHOOT_SPEED = 1.06
_OVERSHOOT_RAD = 0.01
_SETTLED_NS = 200_000_000
_SETTLED_RAD_S = 0.05

_SAME_RAD = 1e-9
_RECONNECT_NS = 200_000_000
"""Subscriptions come back one by one: so long after the clock is heard again, a command may still be missed."""
_OWN_BRANCH_RAD = 1.5
"""Estimates are right to a tenth of that; of a pose's twin some joint is half a turn away."""
_LOOKED_AGAIN_NS = 500_000_000
"""After a reset, until frames that show it have been answered."""
_SILENCE_NS = 1_500_000_000
"""Health comes every second: a longer pause is one that is seen."""


@dataclass(frozen=True, slots=True)
class Violation:
    """Something that must never be."""

    instant_ns: int
    key: str
    seen: str
    allowed: str

    def __str__(self) -> str:
        """One line for a person."""
        return f"{self.instant_ns / NS_PER_S:.3f} {self.key}: {self.seen}; allowed: {self.allowed}"


@dataclass(frozen=True, slots=True)
class Findings:
    """What came of a check."""

    violations: tuple[Violation, ...]
    lives: int
    """Processes of sim."""
    instants: int
    """At which the true angles were judged."""
    resets: int
    """Times that the arm was put elsewhere at rest, as `sim/reset` does."""
    deaf_s: float
    """Simulated seconds for which motion could not be held against commands: the recorder may have missed some."""


def check(timeline: Timeline) -> Findings:
    """Holds every invariant against everything that was recorded."""
    found: list[Violation] = list(_clock_goes_on(timeline.frames))
    every = lives(timeline)
    resets, deaf_ns = 0, 0
    for life in every:
        at = resets_of(timeline, life)
        resets += len(at)
        deaf = _deaf(timeline, life)
        deaf_ns += sum(end - begin for begin, end in deaf)
        found += _within_limits(timeline, life)
        found += _within_speed(timeline, life, at)
        found += _on_its_own_branch(timeline, life, at)
        found += _applied_in_order(life)
        found += _rests_without_commands(timeline, life, at, deaf)
        found += _rests_when_stopped(timeline, life, at)
    found.sort(key=lambda violation: violation.instant_ns)
    return Findings(tuple(found), len(every), sum(len(life.true) for life in every), resets, deaf_ns / NS_PER_S)


def health_showed(timeline: Timeline, service: str, begin_ns: int, end_ns: int) -> bool:
    """Whether a service's health showed a fault between two times of the recorder's clock.

    It does by another instance, by a status that is not OK, by a pause, or by having lost its router.
    """
    said = timeline.health.get(service, [])
    before = [each for each in said if each.log_ns < begin_ns][-1:]
    within = [each for each in said if begin_ns <= each.log_ns <= end_ns]
    known = before + within
    if len({each.instance for each in known}) > 1 or any(each.status != HEALTH_STATUS_OK for each in within):
        return True
    # what happened at the end is in the next word, which also ends a pause
    known += [each for each in said if each.log_ns > end_ns][:1]
    times = [*(each.log_ns for each in known), end_ns]
    return (
        not known
        or any(later - earlier > _SILENCE_NS for earlier, later in pairwise(times))
        or known[-1].router_lost > known[0].router_lost
    )


def braking_ns(timeline: Timeline) -> int:
    """The longest that braking may take: from the fastest joint's full speed."""
    return round(float(timeline.joints.max_speed.max()) / BRAKING_RAD_S2 * NS_PER_S)


def resets_of(timeline: Timeline, life: Life) -> list[int]:
    """Instants at which the arm was elsewhere than speed lets it come to, at rest and on its setpoint.

    No motion ends so: an arm that is driven there is fast when it passes, or is not there yet.
    """
    instants = [state.instant_ns for state in life.true]
    period_s = life.period_ns / NS_PER_S
    found = []
    for before, after in pairwise(life.accepted):
        index = bisect_left(instants, after.instant_ns)
        if index + 1 >= len(instants) or instants[index] != after.instant_ns:
            continue
        here, later = life.true[index], life.true[index + 1]
        # after a rest the setpoint was said long ago: then the arm itself tells
        jumps = _excess(timeline, before, after, 2 * life.period_ns) > 0.0 or (
            index > 0 and _excess(timeline, life.true[index - 1], here, 0, _OVERSHOOT_SPEED) > 0.0
        )
        settled = float(np.abs(here.angles - after.angles).max()) < _OVERSHOOT_RAD
        stays = float(np.abs(later.angles - here.angles).max()) < float(timeline.joints.max_speed.max()) * period_s
        if jumps and settled and stays:
            found.append(after.instant_ns)
    return found


def _clock_goes_on(frames: list[Frame]) -> Iterator[Violation]:
    for before, after in pairwise(frames):
        if after.instant_ns <= before.instant_ns:
            seen = f"the instant {after.instant_ns} after {before.instant_ns}"
            yield Violation(after.instant_ns, topics.CLOCK.key, seen, "capture times that only grow, over restarts too")


def _within_limits(timeline: Timeline, life: Life) -> Iterator[Violation]:
    for key, states, beyond in (
        (topics.JOINTS_TRUE.key, life.true, _OVERSHOOT_RAD),
        (topics.JOINTS_ACCEPTED.key, life.accepted, _SAME_RAD),
    ):
        for state in states:
            for index, name in enumerate(timeline.joints.names):
                lower, upper = timeline.joints.lower[index] - beyond, timeline.joints.upper[index] + beyond
                if not lower <= state.angles[index] <= upper:
                    allowed = f"{lower:.4f} to {upper:.4f} rad"
                    yield Violation(state.instant_ns, key, f"{name} at {state.angles[index]:.4f} rad", allowed)


def _within_speed(timeline: Timeline, life: Life, resets: list[int]) -> Iterator[Violation]:
    # joints/accepted is ahead of the setpoint by no more than it moves in one period, at either end
    for key, states, ahead_ns, share in (
        (topics.JOINTS_TRUE.key, life.true, 0, _OVERSHOOT_SPEED),
        (topics.JOINTS_ACCEPTED.key, life.accepted, 2 * life.period_ns, 1.0),
    ):
        for before, after in pairwise(states):
            if any(before.instant_ns < at <= after.instant_ns for at in resets):
                continue
            more = _excess(timeline, before, after, ahead_ns, share)
            if more > 0.0:
                moved, seconds = np.abs(after.angles - before.angles), (after.instant_ns - before.instant_ns) / NS_PER_S
                name = timeline.joints.names[int(moved.argmax())]
                seen = f"{name} by {moved.max():.4f} rad in {seconds:.4f} s"
                yield Violation(after.instant_ns, key, seen, f"{moved.max() - more:.4f} rad at full speed")


def _on_its_own_branch(timeline: Timeline, life: Life, resets: list[int]) -> Iterator[Violation]:
    """Who takes the arm for its twin moves it the long way round, however slowly."""
    true = {state.instant_ns: state.angles for state in life.true}
    for state in life.estimated:
        here = true.get(state.instant_ns)
        if here is None or any(at - life.period_ns <= state.instant_ns < at + _LOOKED_AGAIN_NS for at in resets):
            continue
        off = np.abs(state.angles - here)
        index = int(off.argmax())
        if off[index] > _OWN_BRANCH_RAD:
            seen = f"{timeline.joints.names[index]} at {state.angles[index]:.4f} rad"
            allowed = f"within {_OWN_BRANCH_RAD:g} rad of the true {here[index]:.4f} rad"
            yield Violation(state.instant_ns, topics.JOINTS_ESTIMATED.key, seen, allowed)


def _applied_in_order(life: Life) -> Iterator[Violation]:
    """Where the setpoint in force is a command's, to the last bit, that command was fresh and newer than the last."""
    by_goal: dict[bytes, list[int]] = {}
    valid: dict[int, int] = {}
    for command in life.commands:
        if command.goal is not None:
            by_goal.setdefault(command.goal.tobytes(), []).append(command.answers_ns)
            valid[command.answers_ns] = command.valid_ns
    in_force_ns = 0
    for state in life.accepted:
        asked = sorted(at for at in by_goal.get(state.angles.tobytes(), []) if at <= state.instant_ns)
        if not asked:
            continue
        newest = asked[-1]
        key, seen = topics.JOINTS_ACCEPTED.key, f"the command that answers {newest}"
        if newest < in_force_ns:
            yield Violation(state.instant_ns, key, seen, f"none before {in_force_ns}, which was applied already")
        # reached by the next frame, or on the way until the watchdog brakes
        last_ns = newest + valid[newest] + WATCHDOG_NS + life.period_ns
        if state.instant_ns > last_ns:
            age_s = (state.instant_ns - newest) / NS_PER_S
            yield Violation(state.instant_ns, key, f"{seen}, {age_s:.3f} s old", f"in force until {last_ns}")
        in_force_ns = max(in_force_ns, next((at for at in asked if at >= in_force_ns), in_force_ns))


def _rests_without_commands(
    timeline: Timeline, life: Life, resets: list[int], deaf: list[tuple[int, int]]
) -> Iterator[Violation]:
    moves = sorted((command.answers_ns, command.valid_ns) for command in life.commands if command.goal is not None)
    answers = [at for at, _ in moves]
    until = np.maximum.accumulate([at + valid for at, valid in moves]) if moves else np.array([], dtype=np.int64)
    longest_ns = max((valid for _, valid in moves), default=0) + WATCHDOG_NS + braking_ns(timeline)

    def rests_from(instant_ns: int) -> int:
        count = bisect_left(answers, instant_ns)
        fresh_ns = int(until[count - 1]) + WATCHDOG_NS if count else life.begin_ns
        return fresh_ns + braking_ns(timeline) + life.period_ns

    def unheard(instant_ns: int) -> bool:
        from_ns = instant_ns - longest_ns - 2 * life.period_ns - _SETTLED_NS
        return any(begin < instant_ns and end > from_ns for begin, end in deaf)

    yield from _moved_after(life, resets, rests_from, unheard, "rest: no fresh command")


def _rests_when_stopped(timeline: Timeline, life: Life, resets: list[int]) -> Iterator[Violation]:
    spans = _stopped(timeline, life)

    def rests_from(instant_ns: int) -> int:
        begin_ns = next((begin for begin, end in spans if begin <= instant_ns <= end), None)
        return 2**63 if begin_ns is None else begin_ns + braking_ns(timeline) + life.period_ns

    yield from _moved_after(life, resets, rests_from, lambda _: False, "rest: the arm is stopped")


def _moved_after(
    life: Life,
    resets: list[int],
    rests_from: Callable[[int], int],
    excused: Callable[[int], bool],
    allowed: str,
) -> Iterator[Violation]:
    for before, after in pairwise(life.accepted):
        at = after.instant_ns
        if at in resets or (after.angles == before.angles).all():
            continue
        if at > rests_from(at) and not excused(at):
            moved = float(np.abs(after.angles - before.angles).max())
            yield Violation(at, topics.JOINTS_ACCEPTED.key, f"moved by {moved:.5f} rad", allowed)
    for before, after in pairwise(life.true):
        at, seconds = after.instant_ns, (after.instant_ns - before.instant_ns) / NS_PER_S
        if any(before.instant_ns < reset <= at + _SETTLED_NS and at - reset < _SETTLED_NS for reset in resets):
            continue
        speed = float(np.abs(after.angles - before.angles).max()) / seconds
        if speed > _SETTLED_RAD_S and before.instant_ns > rests_from(at) + _SETTLED_NS and not excused(at):
            yield Violation(at, topics.JOINTS_TRUE.key, f"{speed:.3f} rad/s", allowed)


def _stopped(timeline: Timeline, life: Life) -> list[tuple[int, int]]:
    """Instants between which a stop was certainly in force; a frame may have been on its way when it was told."""
    heard = [frame.log_ns for frame in life.frames]
    spans: list[tuple[int, int]] = []
    begin_ns: int | None = None
    for stop in timeline.stops:
        if not heard or not heard[0] - NS_PER_S <= stop.log_ns <= heard[-1]:
            continue
        index = bisect_left(heard, stop.log_ns)
        if stop.stopped and begin_ns is None:
            begin_ns = life.frames[index].instant_ns + life.period_ns
        elif not stop.stopped and begin_ns is not None:
            spans.append((begin_ns, life.frames[max(0, index - 1)].instant_ns - life.period_ns))
            begin_ns = None
    if begin_ns is not None:
        spans.append((begin_ns, life.frames[-1].instant_ns))
    return spans


def _deaf(timeline: Timeline, life: Life) -> list[tuple[int, int]]:
    """Instants between which commands may have been missed: where frames of the clock are missing, or commands are."""
    found = [
        (before.instant_ns, after.instant_ns + _RECONNECT_NS)
        for before, after in pairwise(life.frames)
        if after.number > before.number + 1
    ]
    if life.frames and life.frames[0].number > 1:
        # the recording begins in the middle of it: what moves the arm then was commanded before
        first_ns = life.frames[0].instant_ns
        found.append((first_ns - 2 * life.period_ns, first_ns + _RECONNECT_NS))
    heard = [frame.log_ns for frame in life.frames]
    for begin_ns, end_ns in timeline.deaf_ns:
        first, last = bisect_left(heard, begin_ns), bisect_right(heard, end_ns)
        if first < len(heard) and last > 0:
            found.append((life.frames[max(0, first - 1)].instant_ns, life.frames[last - 1].instant_ns + life.period_ns))
    return found


def _excess(timeline: Timeline, before: State, after: State, ahead_ns: int, share: float = 1.0) -> float:
    """How much further some joint moved than its speed allows, rad; not positive where none did."""
    seconds = (after.instant_ns - before.instant_ns + ahead_ns) / NS_PER_S
    allowed = share * timeline.joints.max_speed * seconds + _SAME_RAD
    return float((np.abs(after.angles - before.angles) - allowed).max())
