from collections.abc import Iterator

import mujoco
import numpy as np
import numpy.typing as npt
import pytest

from armsight_sim.cameras import Cameras, Commission, Noise
from armsight_sim.world import World

SEED = 1729
FOCAL = 400 / np.tan(np.radians(40))
# right, down and forward of each camera, and where it stands
CAMERAS = {
    "1": ((18, 0, 6), (0, 1, 0), (0, 0, -1), (-1, 0, 0)),
    "2": ((0, -18, 6), (1, 0, 0), (0, 0, -1), (0, 1, 0)),
}


@pytest.fixture
def cameras(world: World) -> Iterator[Cameras]:
    cameras = Cameras(Commission(world.model, ["1", "2"], 800, 800, 4))
    yield cameras
    cameras.close()


def projected(camera: str, point: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Image coordinates, pixel centres at + 0.5: independent of the message's calibration."""
    eye, *axes = (np.array(part, dtype=float) for part in CAMERAS[camera])
    right, down, forward = (float((point - eye) @ axis) for axis in axes)
    return np.array([400 + FOCAL * right / forward, 400 + FOCAL * down / forward])


def test_sphere_is_drawn_where_it_projects_to_a_tenth_of_a_pixel(world: World, cameras: Cameras) -> None:
    # red, away from everything that could hide it from either camera
    world.reset(np.array([0.7, 0.0, 0.9, 0.9]))
    centre = world.data.geom("marker_red").xpos
    for name, image in zip(("1", "2"), cameras.draw(world.data), strict=True):
        red = (image[..., 0] > 60) & (image[..., 1] < 40) & (image[..., 2] < 40)
        rows, columns = np.nonzero(red)
        assert rows.size > 100
        # the link covers a little of it, and a sphere's image is no circle: half a pixel would be a slip of convention
        off = np.array([columns.mean() + 0.5, rows.mean() + 0.5]) - projected(name, centre)
        assert np.abs(off).max() < 0.45, f"camera {name}: {off}"


def test_spheres_are_drawn_as_large_as_they_are() -> None:
    random, radii = np.random.default_rng(SEED), []
    for turn in random.normal(size=(12, 4)):
        model = mujoco.MjModel.from_xml_string(
            f"""<mujoco><visual><global offwidth="1000" offheight="1000"/></visual><statistic extent="40"/>
            <worldbody><camera name="c" pos="0 0 40" fovy="0.8"/><light pos="0 0 30"/>
            <geom type="sphere" size="0.2" quat="{" ".join(map(str, turn))}" rgba="1 1 1 1"/></worldbody></mujoco>"""
        )
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        cameras = Cameras(Commission(model, ["c"], 1000, 1000, 0))
        lit = cameras.draw(data)[0].max(axis=2) > 0
        cameras.close()
        focal = 500 / np.tan(np.radians(0.4))
        radii.append(40 * np.sin(np.arctan(np.sqrt(lit.sum() / np.pi) / focal)))
    assert np.mean(radii) == pytest.approx(0.2, rel=4e-4), f"seed {SEED}"


def test_every_marker_is_seen_by_both_cameras_at_zero(world: World, cameras: Cameras) -> None:
    colors = {"green": (0, 1, 0), "yellow": (1, 1, 0), "blue": (0, 0, 1), "red": (1, 0, 0)}
    for image in cameras.draw(world.data):
        share = image / np.maximum(image.sum(axis=2, keepdims=True), 1)
        for name, color in colors.items():
            wanted = np.array(color) / sum(color)
            assert (np.abs(share - wanted).max(axis=2) < 0.1).sum() > 50, name


def test_emissive_markers_shine_evenly(world: World) -> None:
    world.reset(np.array([0.7, 0.0, 0.9, 0.9]))
    spreads = {}
    for emissive in (False, True):
        cameras = Cameras(Commission(world.model, ["1"], 800, 800, 0, emissive=emissive))
        image = cameras.draw(world.data)[0]
        cameras.close()
        red = (image[..., 0] > 60) & (image[..., 1] < 40) & (image[..., 2] < 40)
        assert red.sum() > 100
        spreads[emissive] = int(np.ptp(image[red][:, 0]))
    assert spreads[True] == 0
    assert spreads[False] > 50


def test_background_is_light_and_neutral(world: World, cameras: Cameras) -> None:
    for image in cameras.draw(world.data):
        corner = image[:100, :100].reshape(-1, 3).astype(int)
        assert corner.min() > 60
        assert np.ptp(corner, axis=1).max() <= 2


def test_noise_has_the_standard_deviation_asked_for_and_repeats() -> None:
    image = np.full((300, 300, 3), 128, dtype=np.uint8)
    first, again = (Noise(4.0, image.size, seed=3) for _ in range(2))
    noisy = first.add(image)
    assert np.std(noisy.astype(float)) == pytest.approx(4.0, rel=0.02)
    np.testing.assert_array_equal(noisy, again.add(image))
    assert (first.add(image) != noisy).any()
