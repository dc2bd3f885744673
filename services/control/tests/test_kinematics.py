import math
import subprocess
import sys
from dataclasses import replace
from itertools import pairwise

import mujoco
import numpy as np
import pytest
import torch

from armsight_control import torch_kinematics
from armsight_control.chain import Array, Chain, Point
from armsight_control.description import Arm
from armsight_control.errors import JointCountError, UnsupportedArmError
from armsight_control.folded import fold
from armsight_control.kinematics import (
    Links,
    denavit_hartenberg,
    denavit_hartenberg_product,
    directions,
    forward,
    frames,
    jacobian,
    links_of,
    position,
    report_forward,
    report_jacobian,
)

LINKS = Links(4.0, 3.2, 2.8)


def mujoco_model(chain: Chain) -> mujoco.MjModel:
    """The same chain, built by MuJoCo's own means."""
    body = f'<site name="tip" pos="{" ".join(map(repr, chain.tip.position.tolist()))}"/>'
    for i in reversed(range(chain.count)):
        origin, axis = (" ".join(map(repr, values.tolist())) for values in (chain.origins[i], chain.axes[i]))
        inertial = '<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>'
        body = f'<body pos="{origin}">{inertial}<joint axis="{axis}"/>{body}</body>'
    return mujoco.MjModel.from_xml_string(f"<mujoco><worldbody>{body}</worldbody></mujoco>")


def random_chain(rng: np.random.Generator, count: int) -> Chain:
    axes = rng.normal(size=(count, 3))
    return Chain(
        names=tuple(f"j{i}" for i in range(count)),
        origins=rng.normal(size=(count, 3)),
        axes=axes / np.linalg.norm(axes, axis=1, keepdims=True),
        limits=np.tile([-math.pi, math.pi], (count, 1)),
        max_speed=np.ones(count),
        tip=Point(count - 1, rng.normal(size=3)),
    )


@pytest.mark.parametrize("joints", [0, 5, 6, 7], ids=["the report's arm", "five", "six", "seven joints anywhere"])
def test_forward_kinematics_and_jacobian_equal_mujocos(joints: int, arm: Arm, rng: np.random.Generator) -> None:
    chain = random_chain(rng, joints) if joints else arm.chain
    model = mujoco_model(chain)
    data = mujoco.MjData(model)
    for q in rng.uniform(-math.pi, math.pi, size=(200, chain.count)):
        data.qpos[:] = q
        mujoco.mj_forward(model, data)
        by_mujoco = np.zeros((3, chain.count))
        mujoco.mj_jacSite(model, data, by_mujoco, None, 0)
        np.testing.assert_allclose(forward(chain, q), data.site_xpos[0], atol=1e-9)
        np.testing.assert_allclose(jacobian(chain, q), by_mujoco, atol=1e-9)
        rotations, origins = frames(chain, q)
        np.testing.assert_allclose(rotations[1:], data.xmat[1:].reshape(-1, 3, 3), atol=1e-9)
        np.testing.assert_allclose(origins[1:], data.xpos[1:], atol=1e-9)
        tips, slopes = torch_kinematics.tip_and_jacobian(chain, torch.tensor(q))
        np.testing.assert_allclose(tips.numpy(), data.site_xpos[0], atol=1e-9)
        np.testing.assert_allclose(slopes.numpy(), by_mujoco, atol=1e-9)


def test_jacobian_of_every_marker_is_the_derivative_of_its_position(arm: Arm, rng: np.random.Generator) -> None:
    step = 1e-6
    for q in rng.uniform(-1.5, 1.5, size=(50, 4)):
        for point in arm.markers.values():
            ahead = position(arm.chain, q + step * np.eye(4), point)
            behind = position(arm.chain, q - step * np.eye(4), point)
            np.testing.assert_allclose(jacobian(arm.chain, q, point), (ahead - behind).T / (2 * step), atol=1e-7)


def test_a_batch_gives_what_single_configurations_give(arm: Arm, rng: np.random.Generator) -> None:
    batch = rng.uniform(-1.5, 1.5, size=(5, 7, 4))
    tips, slopes = forward(arm.chain, batch), jacobian(arm.chain, batch)
    assert tips.shape == (5, 7, 3)
    np.testing.assert_allclose(tips[3, 2], forward(arm.chain, batch[3, 2]), atol=1e-14)
    np.testing.assert_allclose(slopes[3, 2], jacobian(arm.chain, batch[3, 2]), atol=1e-14)


@pytest.mark.parametrize(("dtype", "within"), [(torch.float64, 1e-12), (torch.float32, 2e-5)])
def test_torch_gives_what_numpy_gives_in_either_precision(
    dtype: torch.dtype, within: float, arm: Arm, rng: np.random.Generator
) -> None:
    parallel = random_chain(rng, 5)
    parallel.axes[2], parallel.axes[3] = parallel.axes[1], -parallel.axes[1]
    for chain in (arm.chain, parallel, *(random_chain(rng, count) for count in (1, 2, 7))):
        q = rng.uniform(-math.pi, math.pi, size=(3, 8, chain.count))
        tips, slopes = torch_kinematics.tip_and_jacobian(chain, torch.tensor(q, dtype=dtype))
        assert tips.dtype == slopes.dtype == dtype
        np.testing.assert_allclose(tips.numpy(), forward(chain, q), atol=within)
        np.testing.assert_allclose(slopes.numpy(), jacobian(chain, q), atol=within)


def test_a_folded_chain_moves_its_free_joints_and_keeps_the_others(rng: np.random.Generator) -> None:
    chain = random_chain(rng, 6)
    free, held = (1, 2, 5), (0.3, -0.7, 1.1)
    folded = fold(chain, free, held)
    q = rng.uniform(-math.pi, math.pi, size=(50, 6))
    q[:, [0, 3, 4]] = held
    u = torch.tensor(q[:, free] + folded.offsets)
    turns = torch_kinematics.sines(u.unbind(-1))
    tip, _ = torch_kinematics.tip_and_columns(turns, torch_kinematics.links_of(folded, torch.float64))
    np.testing.assert_allclose(torch.stack(tip, dim=-1).numpy(), folded.to_first(forward(chain, q)), atol=1e-12)
    slopes = np.linalg.norm(jacobian(chain, q), axis=1)[:, free]
    np.testing.assert_allclose(folded.tips(q[:, free]), forward(chain, q), atol=1e-12)
    assert (slopes <= folded.levers + 1e-12).all(), "no joint moves the tip faster than its lever says"
    assert (slopes.max(axis=0) > 0.1 * folded.levers).all()


def test_chains_are_equal_where_their_values_are(rng: np.random.Generator) -> None:
    chain = random_chain(rng, 3)
    again = replace(chain, origins=chain.origins.copy())
    other = replace(chain, origins=chain.origins + 1e-9)
    assert chain == again
    assert hash(chain) == hash(again)
    assert chain != other
    assert {chain: "here"}[again] == "here"


def test_a_wrong_number_of_angles_is_refused(arm: Arm) -> None:
    with pytest.raises(JointCountError, match="3 angles for an arm of 4 joints"):
        forward(arm.chain, np.zeros(3))
    with pytest.raises(JointCountError, match="5 angles for an arm of 4 joints"):
        torch_kinematics.forward(arm.chain, torch.zeros(2, 5))


def with_joint2_at_0(q: Array) -> Array:
    return np.insert(q, 1, 0.0, axis=-1)


def test_the_reports_closed_form_is_the_chain_with_joint_2_at_0(arm: Arm, rng: np.random.Generator) -> None:
    q = rng.uniform(-math.pi, math.pi, size=(1000, 3))
    full = with_joint2_at_0(q)
    np.testing.assert_allclose(report_forward(LINKS, q), forward(arm.chain, full), atol=1e-13)
    np.testing.assert_allclose(report_jacobian(LINKS, q), jacobian(arm.chain, full)[..., [0, 2, 3]], atol=1e-13)


def test_the_reports_table_of_measured_poses_agrees_to_its_rounding() -> None:
    # theta, phi, psi and the K that the report prints for them
    rows = np.array([[2.3, 0.4, -0.2, 2.10, 1.13, 9.47], [-0.7, 1.2, 0.3, -2.89, -4.72, 6.13]])
    np.testing.assert_allclose(report_forward(LINKS, rows[:, :3]), rows[:, 3:], atol=0.0051)


def test_the_denavit_hartenberg_product_is_the_closed_form(arm: Arm, rng: np.random.Generator) -> None:
    table = denavit_hartenberg(LINKS)
    for q in rng.uniform(-math.pi, math.pi, size=(500, 3)):
        tip = denavit_hartenberg_product(table, with_joint2_at_0(q))[:3, 3]
        np.testing.assert_allclose(tip, report_forward(LINKS, q), atol=1e-12)
    for q in rng.uniform(-math.pi, math.pi, size=(500, 4)):
        product = denavit_hartenberg_product(table, q)
        np.testing.assert_allclose(product[:3, 3], forward(arm.chain, q), atol=1e-12)
        np.testing.assert_allclose(product[:3, 0], directions(q)[1], atol=1e-12)


def test_directions_are_those_of_the_chains_links(arm: Arm, rng: np.random.Generator) -> None:
    q = rng.uniform(-math.pi, math.pi, size=(100, 4))
    r3, r4 = directions(q)
    _, origins = frames(arm.chain, q)
    np.testing.assert_allclose(origins[:, 4] - origins[:, 3], 3.2 * r3, atol=1e-12)
    np.testing.assert_allclose(forward(arm.chain, q) - origins[:, 4], 2.8 * r4, atol=1e-12)


def test_the_twin_puts_every_marker_in_the_same_place(arm: Arm, rng: np.random.Generator) -> None:
    q = rng.uniform(-1.5, 1.5, size=(100, 4))
    twin = np.array([math.pi, 0, 0, 0]) + q * [1, -1, -1, -1]
    for point in arm.markers.values():
        np.testing.assert_allclose(position(arm.chain, q, point), position(arm.chain, twin, point), atol=1e-12)


def test_lengths_come_from_the_description(arm: Arm) -> None:
    assert links_of(arm.chain) == LINKS


def test_a_chain_of_another_shape_is_refused_with_what_is_expected(rng: np.random.Generator) -> None:
    with pytest.raises(UnsupportedArmError, match="four joints about z, y, x and y"):
        links_of(random_chain(rng, 4))


def test_the_tables_rows_join_by_common_normals() -> None:
    # what makes it a Denavit-Hartenberg table: each next axis meets this frame's x-axis at a right angle
    table = denavit_hartenberg(LINKS)
    products = [denavit_hartenberg_product(table[:i], np.full(i, 0.3)) for i in range(len(table) + 1)]
    for before, after in pairwise(products):
        assert abs(before[:3, 2] @ after[:3, 0]) < 1e-12


def test_the_packages_own_example_runs_without_the_bus_and_without_torch() -> None:
    code = (
        "import sys, doctest, armsight_control as control\n"
        "print(doctest.testmod(control).failed, 'torch' in sys.modules, 'zenoh' in sys.modules)"
    )
    printed = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert printed.split() == ["0", "False", "False"]
