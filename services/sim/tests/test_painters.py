import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import mujoco
import numpy as np
import pytest

from armsight.counters import Counters
from armsight_sim import painters as painters_module
from armsight_sim.cameras import Cameras, Commission, Image
from armsight_sim.errors import RenderError
from armsight_sim.painters import Painters
from armsight_sim.world import World

SEED = 60_221
BODIES_GROUP = 3

THREE_CAMERAS = """
<mujoco>
  <custom>
    <numeric name="target" data="0 0 1"/>
  </custom>
  <worldbody>
    <light pos="0 0 5"/>
    <geom type="plane" size="5 5 0.1" rgba="0.8 0.8 0.8 1"/>
    <body name="ball" mocap="true" pos="0 0 1"><geom type="sphere" size="0.4" rgba="1 0 0 1" group="3"/></body>
    <body name="arm" pos="0 0 0.5">
      <joint name="hinge" type="hinge" axis="0 1 0"/>
      <geom type="capsule" size="0.1 0.8" rgba="0 0 1 1"/>
      <camera name="riding" pos="0 -3 1" xyaxes="1 0 0 0 0.3 1" resolution="320 200"/>
    </body>
    <camera name="front" pos="0 -4 1" xyaxes="1 0 0 0 0.2 1" resolution="300 300"/>
    <camera name="side" pos="4 0 1" xyaxes="0 1 0 -0.2 0 1"/>
  </worldbody>
</mujoco>
"""


def the_same(ours: Sequence[Image], theirs: Sequence[Image]) -> bool:
    return [image.shape for image in ours] == [image.shape for image in theirs] and all(
        map(np.array_equal, ours, theirs)
    )


@pytest.fixture
def counters() -> Counters:
    return Counters()


@pytest.fixture
def wanted(world: World) -> Commission:
    return Commission(world.model, ["1", "2"], 200, 160, 4)


@pytest.fixture
def painters(wanted: Commission, counters: Counters) -> Iterator[Painters]:
    painters = Painters(wanted, 2, counters, threading.Event())
    yield painters
    painters.close()


def painted(painters: Painters, data: mujoco.MjData, wanted: Commission) -> list[Image]:
    images: list[Image] = [np.zeros((rows, columns, 3), np.uint8) for columns, rows in wanted.sizes]
    done = []
    painters.draw(data, images, lambda: done.append("meanwhile"))
    assert done == ["meanwhile"]
    return images


def pids() -> list[int]:
    """Of processes that this one started and that draw."""
    found = []
    for folder in Path("/proc").iterdir():
        if folder.name.isdigit():
            try:
                command = (folder / "cmdline").read_bytes().split(b"\0")
                parent = int((folder / "stat").read_text().rpartition(")")[2].split()[1])
            except OSError:  # it ended
                continue
            if parent == os.getpid() and b"armsight_sim.painter" in command:
                found.append(int(folder.name))
    return sorted(found)


def test_pictures_are_those_of_one_process_to_the_bit(world: World, wanted: Commission, painters: Painters) -> None:
    cameras = Cameras(wanted)
    random = np.random.default_rng(SEED)
    for ambient in (0.1, 0.7, 0.4):
        world.reset(random.uniform(world.limits[:, 0], world.limits[:, 1]))
        painters.light(ambient)
        cameras.light(ambient)
        assert the_same(painted(painters, world.data, wanted), cameras.draw(world.data)), f"seed {SEED}"
    cameras.close()


@pytest.mark.parametrize("count", [1, 2, 5])
def test_any_number_of_painters_shares_cameras_of_any_size(counters: Counters, count: int) -> None:
    model = mujoco.MjModel.from_xml_string(THREE_CAMERAS)
    data, wanted = (
        mujoco.MjData(model),
        Commission(model, ["front", "side", "riding"], 400, 240, 0, groups=[BODIES_GROUP]),
    )
    data.qpos[:], data.mocap_pos[0] = 0.6, (0.5, 0.2, 1.5)
    mujoco.mj_fwdPosition(model, data)
    cameras, painters = Cameras(wanted), Painters(wanted, count, counters, threading.Event())
    ours, theirs = painted(painters, data, wanted), cameras.draw(data)
    cameras.close()
    assert the_same(ours, theirs)
    assert len(pids()) == min(count, 3)
    painters.close()
    assert pids() == []
    assert any((image[..., 0] > image[..., 1] + 50).any() for image in theirs), "the body is drawn"


def test_emissive_markers_are_painted_so(world: World, counters: Counters) -> None:
    wanted = Commission(world.model, ["1"], 200, 200, 0, emissive=True)
    cameras, painters = Cameras(wanted), Painters(wanted, 1, counters, threading.Event())
    ours, theirs = painted(painters, world.data, wanted), cameras.draw(world.data)
    cameras.close()
    assert the_same(ours, theirs)
    painters.close()


def test_painter_that_dies_is_replaced(
    world: World, wanted: Commission, painters: Painters, counters: Counters
) -> None:
    before = painted(painters, world.data, wanted)
    first, second = pids()
    os.kill(second, signal.SIGKILL)
    assert the_same(painted(painters, world.data, wanted), before)
    assert counters.snapshot()["painters_replaced"] == 1
    assert first in pids()
    assert second not in pids()
    assert len(pids()) == 2


def test_painter_that_hangs_is_replaced(
    world: World, wanted: Commission, painters: Painters, counters: Counters, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = painted(painters, world.data, wanted)
    monkeypatch.setattr(painters_module, "_LONGEST_DRAWING_S", 1.0)
    os.kill(pids()[0], signal.SIGSTOP)
    assert the_same(painted(painters, world.data, wanted), before)
    assert counters.snapshot()["painters_replaced"] == 1


def test_nobody_is_waited_for_once_it_is_to_stop(world: World, counters: Counters) -> None:
    stop = threading.Event()
    wanted = Commission(world.model, ["1"], 64, 64, 0)
    painters = Painters(wanted, 1, counters, stop)
    os.kill(pids()[0], signal.SIGSTOP)
    stop.set()
    began = time.monotonic()
    with pytest.raises(RenderError, match="stop"):
        painted(painters, world.data, wanted)
    painters.close()
    assert time.monotonic() - began < 1.0
    assert counters.snapshot() == {}


def test_what_opengl_says_is_told(wanted: Commission, counters: Counters, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MUJOCO_GL", "egl")
    monkeypatch.setenv("PYOPENGL_PLATFORM", "egl")
    monkeypatch.setenv("__EGL_VENDOR_LIBRARY_FILENAMES", "/dev/null")  # no OpenGL to be found
    with pytest.raises(RenderError, match=r"did not start: .*EGL"):
        Painters(wanted, 2, counters, threading.Event())
    assert pids() == []


def test_painters_end_with_whom_they_paint_for(tmp_path: Path) -> None:
    program = tmp_path / "paints.py"
    program.write_text(
        "from armsight_sim.gl import choose_gl; choose_gl()\n"
        "import threading, time\n"
        "from armsight.counters import Counters\n"
        "from armsight_sim.cameras import Commission\n"
        "from armsight_sim.painters import Painters\n"
        "from armsight_sim.world import load_model\n"
        "wanted = Commission(load_model(), ['1', '2'], 64, 64, 0)\n"
        "painters = Painters(wanted, 2, Counters(), threading.Event())\n"
        "print(*(each._process.pid for each in painters._painters), flush=True)\n"
        "time.sleep(60)\n"
    )
    with subprocess.Popen([sys.executable, str(program)], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        started = [int(pid) for pid in process.stdout.readline().split()]
        process.kill()
    until = time.monotonic() + 5
    while any(Path(f"/proc/{pid}").exists() for pid in started) and time.monotonic() < until:
        time.sleep(0.02)
    assert len(started) == 2
    assert not [pid for pid in started if Path(f"/proc/{pid}").exists()]
