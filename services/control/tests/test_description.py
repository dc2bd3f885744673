import math

import numpy as np
import pytest

from armsight.v1.description_pb2 import ArmDescription
from armsight_control.description import arm_of
from armsight_control.errors import DescriptionError


def test_the_arm_has_what_its_description_says(description: ArmDescription) -> None:
    arm = arm_of(description)
    assert arm.chain.names == ("joint1", "joint2", "joint3", "joint4")
    assert set(arm.markers) == {"green", "yellow", "blue", "red"}
    np.testing.assert_array_equal(arm.world_to_base(np.array([1.0, 2.0, 3.0])), [1.0, 2.0, 2.5])


def test_a_turned_base_turns_world_into_base(description: ArmDescription) -> None:
    rotation = description.world_from_base.rotation
    rotation.z, rotation.w = math.sin(math.pi / 4), math.cos(math.pi / 4)
    np.testing.assert_allclose(arm_of(description).world_to_base(np.array([0.0, 1.0, 0.5])), [1, 0, 0], atol=1e-15)


def test_descriptions_that_are_no_chain_are_refused_with_a_reason(description: ArmDescription) -> None:
    def refused(expected: str, change: object) -> None:
        broken = ArmDescription()
        broken.CopyFrom(description)
        change(broken)  # type: ignore[operator]
        with pytest.raises(DescriptionError, match=expected):
            arm_of(broken)

    refused("not named one by one", lambda d: d.ClearField("joints"))
    refused("not named one by one", lambda d: setattr(d.joints[1], "name", "joint1"))
    refused("lower < upper", lambda d: setattr(d.joints[0], "lower_rad", 4.0))
    refused("lower < upper", lambda d: setattr(d.joints[0], "upper_rad", math.nan))
    refused("max_speed", lambda d: setattr(d.joints[2], "max_speed_rad_s", 0.0))
    refused("unit vector", lambda d: setattr(d.joints[2].axis, "x", 2.0))
    refused("finite metres", lambda d: setattr(d.joints[2].origin, "x", math.inf))
    refused("this arm has joint1", lambda d: setattr(d.markers[0].centre, "joint", "elbow"))
    refused("unit quaternion", lambda d: setattr(d.world_from_base.rotation, "w", math.nan))
