"""What flows over the bus, listened to only while somebody looks.

Without viewers there is no subscription, and no traffic.
"""

import threading
import time
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from foxglove_schemas_protobuf.JointStates_pb2 import JointStates

from armsight import topics
from armsight.bus import Bus, Received
from armsight.times import from_timestamp
from armsight.v1.control_pb2 import ControlStatus
from armsight.v1.joints_pb2 import JointPositions
from armsight_operator.monitor import Monitor, Snapshot
from armsight_operator.page.plots import Sample, stages_ms
from armsight_operator.report.chain import Arm

_FRESH_S = 1.0
"""Positions and truths that are older are not shown as of now."""
_TRUTHS = 64
"""Some two seconds: the estimate of an instant comes a few milliseconds after its truth."""


@dataclass(frozen=True, slots=True)
class Seen:
    """All that was heard, at one moment."""

    snapshot: Snapshot
    status: ControlStatus | None
    """Nothing while control is silent."""
    positions: JointPositions | None
    """Nothing while vision is silent."""
    true: Mapping[str, float]
    """Angles by joint, rad; empty where no simulation tells."""
    true_at_status: Mapping[str, float]
    """Of the instant that control's status is of."""


class Streams:
    """Subscriptions to everything but pictures, until :meth:`close`."""

    def __init__(self, bus: Bus) -> None:
        """Subscribes."""
        self._monitor = Monitor(bus)
        self._lock = threading.Lock()
        self._truths: deque[tuple[int, float, dict[str, float]]] = deque(maxlen=_TRUTHS)
        self._positions = bus.subscriber(topics.JOINT_POSITIONS)
        self._true = bus.subscriber(topics.JOINTS_TRUE, on_message=self._take_truth)

    def seen(self) -> Seen:
        """What is known now."""
        now = time.monotonic()
        status = self._monitor.status
        with self._lock:
            truths = list(self._truths)
        fresh = bool(truths) and now - truths[-1][1] < _FRESH_S
        positions = self._positions.latest
        instant = from_timestamp(status.capture_time) if status is not None else 0
        return Seen(
            snapshot=self._monitor.snapshot(),
            status=status,
            positions=positions.message if positions is not None and now - positions.received_s < _FRESH_S else None,
            true=truths[-1][2] if fresh else {},
            true_at_status=next((angles for stamp, _, angles in truths if stamp == instant), {}),
        )

    def close(self) -> None:
        """Stops listening."""
        self._monitor.close()
        self._positions.close()
        self._true.close()

    def _take_truth(self, received: Received[JointStates]) -> None:
        message = received.message
        angles = {joint.name: joint.position for joint in message.joints}
        with self._lock:
            self._truths.append((from_timestamp(message.timestamp), received.received_s, angles))


def sample_of(seen: Seen, arm: Arm, at_s: float) -> Sample:
    """What the plots keep of a moment."""
    estimated = seen.snapshot.joints
    true = seen.true_at_status
    error: float | None = None
    if seen.snapshot.tip is not None and set(arm.names) <= set(true):
        tip = arm.tip_at(np.array([true[name] for name in arm.names]))
        error = float(np.linalg.norm(tip - np.array(seen.snapshot.tip)))
    stages = stages_ms(seen.status.stages) if seen.status is not None else None
    return Sample(at_s, estimated, true, error, stages)
