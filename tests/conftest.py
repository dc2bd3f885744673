from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from armsight_operator.stack import Stack
from armsight_sim.gl import choose_gl
from rig import Rig, started

choose_gl()  # before a test imports mujoco

MakeRig = Callable[..., Rig]


@pytest.fixture
def make_rig(tmp_path: Path) -> Iterator[MakeRig]:
    """Makes stacks on private ports; nothing of them is started yet, and nothing of them is left."""
    rigs: list[Rig] = []

    def make(**options: object) -> Rig:
        rig = Rig(Stack(out=tmp_path / f"stack{len(rigs)}", **options))  # type: ignore[arg-type]
        rigs.append(rig)
        return rig

    yield make
    for rig in rigs:
        rig.close()


@pytest.fixture
def empty(make_rig: MakeRig) -> Rig:
    """A stack of which no process runs."""
    return make_rig(target="none", mode="hold")


@pytest.fixture
def tracking(make_rig: MakeRig) -> Rig:
    """The arm follows the default target."""
    rig = make_rig(target="default", mode="track")
    rig.start_all()
    rig.wait_ready()
    return rig


@pytest.fixture(scope="module")
def shared(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Rig]:
    """One stack for all tests of a module that leave it well."""
    with started(Stack(out=tmp_path_factory.mktemp("stack"), target="none", mode="hold")) as rig:
        yield rig


@pytest.fixture
def running(shared: Rig) -> Rig:
    """A running stack with the arm at rest at zero."""
    shared.wait_ready()
    shared.mode("hold")
    shared.reset((0.0, 0.0, 0.0, 0.0))
    shared.wait_until(lambda: abs(shared.true_joints()).max() < 1e-3 and not shared.moving(), 5, "the arm is at zero")
    return shared


@pytest.fixture
def holding(shared: Rig) -> Rig:
    """A running stack that holds a pose away from zero."""
    shared.wait_ready()
    shared.mode("hold")
    pose = (0.3, 0.0, 0.4, 0.2)
    shared.reset(pose)
    shared.wait_until(
        lambda: abs(shared.true_joints() - pose).max() < 1e-3 and not shared.moving(), 5, "the arm is there"
    )
    return shared
