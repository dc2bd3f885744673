"""Instants as integers of nanoseconds of Unix time; protobuf timestamps only on the wire."""

import time

from google.protobuf.duration_pb2 import Duration
from google.protobuf.timestamp_pb2 import Timestamp

NS_PER_S = 1_000_000_000


def to_timestamp(ns: int) -> Timestamp:
    """Nanoseconds of Unix time as a protobuf Timestamp."""
    return Timestamp(seconds=ns // NS_PER_S, nanos=ns % NS_PER_S)


def from_timestamp(stamp: Timestamp) -> int:
    """A protobuf Timestamp as nanoseconds of Unix time."""
    return stamp.seconds * NS_PER_S + stamp.nanos


def to_duration(seconds: float) -> Duration:
    """Seconds as a protobuf Duration."""
    ns = round(seconds * NS_PER_S)
    sign = -1 if ns < 0 else 1
    return Duration(seconds=sign * (abs(ns) // NS_PER_S), nanos=sign * (abs(ns) % NS_PER_S))


def from_duration(duration: Duration) -> float:
    """A protobuf Duration as seconds."""
    return duration.seconds + duration.nanos / NS_PER_S


def wall_ns() -> int:
    """This machine's wall clock, in nanoseconds of Unix time."""
    return time.time_ns()
