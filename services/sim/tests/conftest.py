import pytest

from armsight_sim.gl import choose_gl

choose_gl()  # before anything imports mujoco

from armsight_sim.world import World, load_model  # noqa: E402


@pytest.fixture
def world() -> World:
    return World(load_model(), 1 / 30)
