"""Models of other arms: what is wrong is said, all at once, and what is right is described as MuJoCo has it."""

import json
import subprocess
import sys
from importlib import resources
from pathlib import Path

import mujoco
import numpy as np
import pytest

from armsight.errors import ConfigError
from armsight.v1.description_pb2 import ArmDescription
from armsight_sim import description
from armsight_sim.cameras import Cameras, Commission
from armsight_sim.conventions import findings
from armsight_sim.errors import ModelError
from armsight_sim.targets import TARGETS
from armsight_sim.tip_path import TipPath, check_target, targets_of
from armsight_sim.world import World, load_model

FIVE = Path(str(resources.files("armsight_sim"))) / "models" / "five.xml"
SEED = 8120


def model_with(before: str, after: str) -> mujoco.MjModel:
    text = FIVE.read_text()
    assert before in text
    return mujoco.MjModel.from_xml_string(text.replace(before, after))


def turned(axis: np.ndarray, angle: float) -> np.ndarray:
    matrix, quaternion = np.zeros(9), np.zeros(4)
    mujoco.mju_axisAngle2Quat(quaternion, axis, angle)
    mujoco.mju_quat2Mat(matrix, quaternion)
    return matrix.reshape(3, 3)


def points_world(arm: ArmDescription, q: np.ndarray) -> dict[str, np.ndarray]:
    """Markers and tip by the description alone."""
    rotation = np.zeros(9)
    base = arm.world_from_base
    mujoco.mju_quat2Mat(rotation, np.array([base.rotation.w, base.rotation.x, base.rotation.y, base.rotation.z]))
    turn, p = rotation.reshape(3, 3), np.array([base.translation.x, base.translation.y, base.translation.z])
    frames = {"": (turn, p)}
    for joint, angle in zip(arm.joints, q, strict=True):
        p = p + turn @ [joint.origin.x, joint.origin.y, joint.origin.z]
        turn = turn @ turned(np.array([joint.axis.x, joint.axis.y, joint.axis.z]), float(angle))
        frames[joint.name] = turn, p
    attached = {marker.name: marker.centre for marker in arm.markers} | {"(tip)": arm.tip}
    return {
        name: frames[at.joint][1] + frames[at.joint][0] @ [at.position.x, at.position.y, at.position.z]
        for name, at in attached.items()
    }


ODD = """
<mujoco model="odd">
  <compiler angle="radian" autolimits="true"/>
  <option gravity="0 0 0"><flag contact="disable"/></option>
  <size nuser_actuator="1"/>
  <worldbody>
    <body name="stand" pos="1 2 0.3" euler="0.2 0.1 0.4">
      <camera name="1" pos="3 0 1"/> <camera name="2" pos="0 3 1" resolution="320 200"/>
      <body name="a" pos="0 0 0.2" quat="0.9 0.1 0.3 0.3">
        <joint name="one" axis="0 1 1" pos="0.1 0 0.05" range="-1 1"/>
        <geom type="ellipsoid" size="0.1 0.1 0.3"/>
        <body name="spacer" pos="0.2 0.1 0" euler="0.3 0 0">
          <body name="b" pos="0 0 0.5" euler="0 0.5 0">
            <joint name="two" axis="1 0 0" pos="0 0.1 0" range="-1 2"/>
            <geom type="box" size="0.05 0.05 0.3"/>
            <site name="marker_red" pos="0.1 0.2 0.3" size="0.1" rgba="1 0 0 1"/>
            <body name="plate" pos="0.3 0 0" euler="0 0 0.7">
              <geom name="marker_blue" type="sphere" size="0.1" rgba="0 0 1 1" pos="0 0 0.2"/>
              <site name="tip" pos="0 0.1 0.4"/>
            </body>
          </body>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator>
    <position name="second" joint="two" kp="100" kv="10" user="2"/>
    <position name="first" joint="one" kp="100" kv="10" user="3"/>
  </actuator>
</mujoco>
"""


@pytest.mark.parametrize("model", [load_model(FIVE), mujoco.MjModel.from_xml_string(ODD)], ids=["five", "odd"])
def test_description_puts_markers_and_tip_where_mujoco_does(model: mujoco.MjModel) -> None:
    arm, data, rng = description.describe_arm(model), mujoco.MjData(model), np.random.default_rng(SEED)
    for _ in range(20):
        data.qpos[:] = rng.uniform(*model.jnt_range.T)
        mujoco.mj_kinematics(model, data)
        found = points_world(arm, data.qpos)
        assert set(found) >= {"(tip)"}
        for name, place in found.items():
            if name == "(tip)":
                expected = data.site("tip").xpos
            elif name == "red":  # a site
                expected = data.site("marker_red").xpos
            else:
                expected = data.geom(f"marker_{name}").xpos
            np.testing.assert_allclose(place, expected, atol=1e-12, err_msg=name)


def test_actuators_in_another_order_drive_their_own_joints() -> None:
    world = World(mujoco.MjModel.from_xml_string(ODD), 1 / 30)
    np.testing.assert_array_equal(world.max_speed, (3, 2))
    for _ in range(3000):
        world.step(np.array([0.5, -0.7]), np.zeros(2))
    np.testing.assert_allclose(world.angles(), (0.5, -0.7), atol=1e-3)


def test_both_arms_of_the_repository_have_nothing_to_mend() -> None:
    assert not findings(load_model())
    assert not findings(load_model(FIVE))


@pytest.mark.parametrize(
    ("before", "after", "said"),
    [
        ('<site name="tip" pos="0 0 1.6" size="0.01"/>', "", "there is no tip"),
        (' user="2.5"', "", "shoulder has no speed"),
        ('<position name="wrist" joint="wrist" kp="5000" kv="300" forcerange="-1000 1000"/>', "", "wrist has no act"),
        ('class="marker" pos="0 0 2.2"', 'class="marker" type="capsule" fromto="0 0 0 0 0 1"', "no sphere"),
        ('rgba="0.5 0 1 1"', 'rgba="1 0.05 0.5 1"', "marker_rose and marker_violet differ"),
        ('rgba="0.5 1 0 1"', 'rgba="0.8 0.9 0.8 1"', "marker_lime is grey"),
        ('<camera name="west"', '<camera name="far west"', "camera far west has no name"),
        ('resolution="720 600"', 'resolution="4000 600"', "resolution of camera west"),
        ('name="twist" axis="0 0 1"', 'name="twist" type="slide" axis="0 0 1"', "twist is no hinge"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_said_and_refused(before: str, after: str, said: str) -> None:
    text = FIVE.read_text()
    assert before in text
    model = mujoco.MjModel.from_xml_string(text.replace(before, after))
    found = [finding.what for finding in findings(model) if finding.breaks]
    assert any(said in what for what in found), found
    with pytest.raises(ModelError, match=said):
        World(model, 1 / 30)


def test_all_that_is_wrong_is_said_at_once() -> None:
    text = FIVE.read_text().replace(' user="2.5"', "").replace('<site name="tip" pos="0 0 1.6" size="0.01"/>', "")
    found = [finding.what for finding in findings(mujoco.MjModel.from_xml_string(text))]
    assert found[:2] == ["shoulder has no speed", "there is no tip"]


def test_a_joint_that_no_marker_tells_is_a_warning() -> None:
    model = model_with('pos="1.25 0 0.3" size="0.33"', 'pos="0 0 0.3" size="0.33"')
    for name in ("azure", "violet", "rose"):
        assert model.geom(f"marker_{name}").pos[0] == 0
    assert not [finding for finding in findings(model) if finding.breaks]
    lonely = FIVE.read_text()
    for name in ("azure", "violet", "rose", "orange"):
        lonely = lonely.replace(f'name="marker_{name}"', f'name="{name}"')
    said = [finding.what for finding in findings(mujoco.MjModel.from_xml_string(lonely))]
    assert "no marker tells the angle of elbow, twist, wrist" in said
    assert any("not on a line" in what for what in said)


def test_pictures_have_the_size_that_the_model_says() -> None:
    model = load_model(FIVE)
    world = World(model, 1 / 30)
    cameras = Cameras(Commission(model, ["east", "north", "west"], 640, 480, 0))
    try:
        assert [image.shape for image in cameras.draw(world.data)] == [(800, 800, 3), (768, 1024, 3), (600, 720, 3)]
    finally:
        cameras.close()


def test_default_target_of_another_arm_is_a_way_of_its_own_tip_within_the_limits() -> None:
    model = load_model(FIVE)
    frame, point = targets_of(model)["default"]
    assert frame == "base"
    assert isinstance(point, TipPath)
    limits = model.jnt_range
    room = np.ptp(limits, axis=1) / 20
    for t in np.linspace(0, point.period_s, 50):
        q = point.angles(point.centre, float(t))
        assert (q > limits[:, 0] + room).all()
        assert (q < limits[:, 1] - room).all()
    np.testing.assert_allclose(point(0.0), point(point.period_s), atol=1e-9)
    ways = np.array([point(t) for t in np.arange(0, point.period_s, 0.05)])
    assert np.ptp(ways, axis=0).max() > 0.3
    assert np.linalg.norm(np.diff(ways, axis=0), axis=1).max() / 0.05 < 1.5, "faster than sight is corrected"
    assert targets_of(load_model()) is TARGETS, "the first arm's are its own"


def test_a_target_that_the_model_has_no_bodies_for_is_refused() -> None:
    check_target(load_model(), "visible")
    check_target(load_model(FIVE), "default")
    with pytest.raises(ConfigError, match="no bodies target_sphere and target_box"):
        check_target(load_model(FIVE), "visible")


URDF = """
<robot name="carried">
  <mujoco><compiler discardvisual="false" fusestatic="false"/></mujoco>
  <link name="base_link"/>
  <link name="arm"><inertial><mass value="1"/>
    <inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial>
    <visual name="link_arm"><geometry><cylinder radius="0.05" length="0.5"/></geometry></visual></link>
  <link name="marker_red"><visual><geometry><sphere radius="0.08"/></geometry>
    <material name="red"><color rgba="1 0 0 1"/></material></visual></link>
  <link name="tip"/>
  <joint name="turn" type="revolute"><parent link="base_link"/><child link="arm"/><origin xyz="0 0 1" rpy="0.3 0 0"/>
    <axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="10" velocity="2"/></joint>
  <joint name="f1" type="fixed"><parent link="arm"/><child link="marker_red"/><origin xyz="0 0 0.5"/></joint>
  <joint name="f2" type="fixed"><parent link="arm"/><child link="tip"/><origin xyz="0 0 0.6"/></joint>
</robot>
"""
AROUND = """
<mujoco model="around">
  <option gravity="0 0 0"/> <size nuser_actuator="1"/>
  <asset><model name="carried" file="carried.urdf"/></asset>
  <worldbody>
    <camera name="1" pos="3 0 1" xyaxes="0 1 0 0 0 1"/> <camera name="2" pos="0 -3 1" xyaxes="1 0 0 0 0 1"/>
    <frame pos="0.5 0 0"><attach model="carried" body="base_link" prefix=""/></frame>
  </worldbody>
  <actuator><position joint="turn" kp="100" kv="20" user="2"/></actuator>
</mujoco>
"""


def test_a_urdf_is_carried_as_far_as_it_says_and_completed_around_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)  # where MuJoCo logs that a prefix is empty
    (tmp_path / "carried.urdf").write_text(URDF)
    (tmp_path / "around.xml").write_text(AROUND)
    wrong = [finding.what for finding in findings(load_model(tmp_path / "carried.urdf")) if finding.breaks]
    assert wrong == ["turn has no speed", "turn has no actuator", "there are no cameras"]
    arm = description.describe_arm(load_model(tmp_path / "around.xml"))
    assert [(joint.name, joint.lower_rad, joint.max_speed_rad_s) for joint in arm.joints] == [("turn", -1, 2)]
    assert [(marker.name, marker.centre.joint) for marker in arm.markers] == [("red", "turn")]
    assert [link.name for link in arm.links] == ["arm"]
    assert (arm.world_from_base.translation.x, arm.world_from_base.translation.z) == (0.5, 1)


def test_asked_as_a_program_it_answers_in_json(tmp_path: Path) -> None:
    def asked(file: Path) -> dict[str, object]:
        command = [sys.executable, "-m", "armsight_sim.describe", str(file)]
        said: dict[str, object] = json.loads(
            subprocess.run(command, capture_output=True, check=True, timeout=60).stdout
        )
        return said

    good = asked(FIVE)
    assert good["findings"] == []
    assert good["resolutions"] == {"east": [800, 800], "north": [1024, 768], "west": [720, 600]}
    assert "no model" in str(asked(tmp_path / "nothing.xml")["unreadable"])
    (tmp_path / "broken.xml").write_text("<mujoco><worldbody>")
    assert "can't read" in str(asked(tmp_path / "broken.xml")["unreadable"])
