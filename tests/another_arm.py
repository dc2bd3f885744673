"""What tests of the second arm share: what its cameras, estimates and truth said at each instant of a stack with it."""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import numpy.typing as npt
from foxglove_schemas_protobuf.JointStates_pb2 import JointStates

import armsight_sim
from armsight import topics
from armsight.bus import Received
from armsight.times import NS_PER_S, from_timestamp
from armsight.v1.control_pb2 import ControlStatus
from armsight.v1.description_pb2 import ArmDescription
from armsight_operator.report.chain import Arm, arm_of
from rig import Rig

Vector = npt.NDArray[np.float64]

FIVE = Path(armsight_sim.__file__).parent / "models" / "five.xml"
JOINTS = ("yaw", "shoulder", "elbow", "twist", "wrist")


def described(rig: Rig) -> tuple[ArmDescription, Arm]:
    """The arm as sim describes it, and the kinematics that judge it: control's is another code."""
    subscriber = rig.bus.subscriber(topics.DESCRIPTION)
    rig.wait_until(lambda: subscriber.latest is not None, 20, "sim describes the arm")
    assert subscriber.latest is not None
    message = subscriber.latest.message
    subscriber.close()
    return message, arm_of(message)


@dataclass
class Heard:
    """What was said of each instant, by its capture time in ns."""

    true: dict[int, Vector] = field(default_factory=dict)
    estimated: dict[int, Vector] = field(default_factory=dict)
    statuses: dict[int, ControlStatus] = field(default_factory=dict)
    targets: dict[int, Vector] = field(default_factory=dict)

    def listen(self, rig: Rig) -> None:
        """From now on."""

        def joints(into: dict[int, Vector]) -> None:
            def keep(got: Received[JointStates]) -> None:
                if len(got.message.joints) == len(JOINTS):
                    angles = np.array([joint.position for joint in got.message.joints])
                    into[from_timestamp(got.message.timestamp)] = angles

            topic = topics.JOINTS_TRUE if into is self.true else topics.JOINTS_ESTIMATED
            rig.bus.subscriber(topic, keep=4000, on_message=keep)

        def status(got: Received[ControlStatus]) -> None:
            self.statuses[from_timestamp(got.message.capture_time)] = got.message

        joints(self.true)
        joints(self.estimated)
        rig.bus.subscriber(topics.CONTROL_STATUS, keep=4000, on_message=status)
        rig.bus.subscriber(
            topics.TARGET,
            keep=4000,
            on_message=lambda got: self.targets.__setitem__(
                from_timestamp(got.message.timestamp),
                np.array([got.message.point.x, got.message.point.y, got.message.point.z]),
            ),
        )

    def both(self) -> list[int]:
        """Instants of which truth and estimate are known, in order."""
        return sorted(set(self.true) & set(self.estimated))

    def errors(self, after_s: float = 0.0) -> Vector:
        """(instants, joints): estimated less true, radians, from some time after the first instant on."""
        stamps = self.both()
        late = [stamp for stamp in stamps if stamp - stamps[0] >= after_s * NS_PER_S]
        return np.array([self.estimated[stamp] - self.true[stamp] for stamp in late])

    def seconds(self) -> float:
        """Of simulated time, from the first instant to the last."""
        stamps = self.both()
        return (stamps[-1] - stamps[0]) / NS_PER_S if stamps else 0.0
