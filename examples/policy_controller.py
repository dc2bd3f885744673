"""A control of one's own, by a learned policy: no estimator, no inverse kinematics, no trajectory.

python examples/policy_controller.py policy.pt --connect tcp/127.0.0.1:7447
"""

import argparse

import numpy as np
import torch
from foxglove_schemas_protobuf.JointStates_pb2 import JointStates
from foxglove_schemas_protobuf.Point3InFrame_pb2 import Point3InFrame
from train_policy import Policy

from armsight import topics
from armsight.service import Context, add_service_arguments, run_service
from armsight.times import to_duration
from armsight.v1.health_pb2 import HEALTH_STATUS_OK
from armsight.v1.joints_pb2 import MARKER_STATUS_LOST, JointCommand, JointPositions
from armsight_control import Arm, arm_of

GAIN, FASTEST_RAD = 0.1, 0.02  # of what is missing, and of any joint: in one frame


def goal(policy: Policy, arm: Arm, accepted: JointStates, seen: JointPositions, target: Point3InFrame) -> list[float]:
    """Where the joints are to go; nowhere while a marker of the tip's link is lost."""
    points = {
        m.name: [m.position.x, m.position.y, m.position.z] for m in seen.markers if m.status != MARKER_STATUS_LOST
    }
    if not {"blue", "red"} <= set(points):
        return []
    low, high = (arm.markers[name].position for name in ("blue", "red"))  # the tip is on the line through them
    share = np.linalg.norm(arm.chain.tip.position - low) / np.linalg.norm(high - low)
    aim = np.array([target.point.x, target.point.y, target.point.z])
    aim = arm.world_to_base(aim) if target.frame_id == "world" else aim
    tip = arm.world_to_base(np.array(points["blue"]) * (1 - share) + np.array(points["red"]) * share)
    at = {joint.name: joint.position for joint in accepted.joints}
    q = np.array([at[name] for name in arm.chain.names])
    with torch.no_grad():
        motion = GAIN * policy(torch.tensor(q).float(), torch.tensor(aim - tip).float()).double().numpy()
    angles: list[float] = arm.chain.clip(q + np.clip(motion, -FASTEST_RAD, FASTEST_RAD)).tolist()
    return angles


def body(context: Context, policy: Policy) -> None:
    """Answers all positions: by a motion where there is a goal, else by a hold."""
    hear, commands = context.bus.subscriber, context.bus.publisher(topics.JOINT_COMMAND)
    described, accepted, target = hear(topics.DESCRIPTION), hear(topics.JOINTS_ACCEPTED), hear(topics.TARGET)
    positions = hear(topics.JOINT_POSITIONS)
    context.health.report(HEALTH_STATUS_OK)
    while not context.stop.is_set():
        if not (got := positions.recv(0.1)):
            continue
        command = JointCommand(answers=got.message.capture_time, valid_for=to_duration(0.1), hold=True)
        if described.latest and accepted.latest and target.latest:
            arm = arm_of(described.latest.message)
            angles = goal(policy, arm, accepted.latest.message, got.message, target.latest.message)
            command.hold = not angles
            for name, angle in zip(arm.chain.names, angles, strict=False):
                command.joints.add(name=name, position_rad=angle)
        commands.put(command)


if __name__ == "__main__":
    add_service_arguments(parser := argparse.ArgumentParser())
    parser.add_argument("weights", help="from train_policy.py")
    given = parser.parse_args()
    policy = Policy.read(given.weights)
    raise SystemExit(run_service("control", given, {}, lambda context: body(context, policy)))
