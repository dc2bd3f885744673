"""Robot and operator on two machines, with a router on each and one cable between them: two network namespaces.

The edge has sim and vision, the center control and whoever operates. A second cable is for whoever watches what the
edge does while the first is cut.
"""

import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from network import NEEDS_ROOT, End, inside, lay_cable, namespace

from armsight import topics
from armsight.session import DEFAULT_NAMESPACE
from armsight_operator.certs.configuration import configurations
from armsight_operator.certs.folder import Folder
from armsight_operator.certs.layout import ROUTER
from armsight_operator.stack import Stack, free_port
from rig import SERVICES, Rig

EDGE = "edge"
CENTER_HOST, EDGE_HOST = "10.231.1.1", "10.231.2.2"
"""Ends of the two cables: the first's here, the second's there."""
CABLE, WATCH = "arm-cable", "arm-watch"
EDGE_NAMESPACE = "armsight-edge"
FRAME_BYTES = 800 * 800 * 3

pytestmark = NEEDS_ROOT


class Elsewhere(Stack):
    """Processes on the other machine, each of which the test reaches by the second cable."""

    @property
    def endpoint(self) -> str:
        return f"tls/{EDGE_HOST}:{self.port}"

    def zenoh_config(self, bearer: str) -> Path | None:
        return super().zenoh_config(EDGE if bearer == ROUTER else bearer)

    def command(self, name: str) -> list[str]:
        return [*inside(EDGE_NAMESPACE), *super().command(name)]


@pytest.fixture(scope="module")
def machines() -> Iterator[None]:
    """Two cables, with one end here and the other there."""
    with namespace(EDGE_NAMESPACE):
        for number, cable in enumerate((CABLE, WATCH), 1):
            lay_cable(End(cable, f"10.231.{number}.1"), End(cable, f"10.231.{number}.2", EDGE_NAMESPACE))
        yield


@pytest.fixture(scope="module")
def rigs(machines: None, tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Rig, Rig]]:
    """The center's and the edge's, the arm following its target."""
    del machines
    patch = pytest.MonkeyPatch()
    patch.setenv("ARMSIGHT_SHARED_MEMORY", "off")  # two machines have none in common, two namespaces do
    roles = {name: name for name in (ROUTER, *SERVICES, "operator")} | {EDGE: ROUTER}
    port = free_port()
    link = f"tls/{CENTER_HOST}:{port}"
    folder = Folder(tmp_path_factory.mktemp("certs"))
    folder.make(roles, ["127.0.0.1"], days=1, ca_days=1, more_hosts=[CENTER_HOST])
    folder.renew([EDGE], days=1, hosts=[EDGE_HOST])
    texts = configurations(roles, [link], [link], [DEFAULT_NAMESPACE], {EDGE: ("sim", "vision")})
    for name, text in texts.items():
        folder.write_configuration(name, text)
    out = tmp_path_factory.mktemp("stacks")
    center = Rig(Stack(out=out / "center", port=port, certificates=folder.path, extra={"router": ["--listen", link]}))
    edge = Rig(
        Elsewhere(
            out=out / "edge",
            port=free_port(),
            fps=15,
            certificates=folder.path,
            extra={"router": ["--connect", link]},
        )
    )
    try:
        # in an order in which the link has to be tried again
        for name in ("router", "sim", "vision"):
            edge.start(name)
        for name in ("router", "control"):
            center.start(name)
        # a broken TLS connection can end a process: docs/reliability.md
        with center.supervised(), edge.supervised():
            yield center, edge
    finally:
        center.close()
        edge.close()
        patch.undo()


@pytest.fixture
def following(rigs: tuple[Rig, Rig]) -> tuple[Rig, Rig]:
    """Both machines, the arm following its target by either's account."""
    for rig in rigs:
        rig.wait_until(rig.moving, 60, "the arm moves")
    return rigs


@contextmanager
def cut() -> Iterator[None]:
    """Pulls the cable between the routers."""
    here = End(CABLE, CENTER_HOST)
    here.unplug()
    try:
        yield
    finally:
        here.plug()


def bytes_on_the_cable() -> int:
    folder = Path("/sys/class/net") / CABLE / "statistics"
    return sum(int((folder / name).read_text(encoding="ascii")) for name in ("rx_bytes", "tx_bytes"))


def bytes_an_instant(rig: Rig, seconds: float) -> float:
    before = bytes_on_the_cable()
    rate_hz, answered = rig.answered_share(seconds)
    assert rate_hz > 2
    assert answered > 0.3, "the loop does not run over the cable"
    return (bytes_on_the_cable() - before) / (rate_hz * seconds)


def test_loop_runs_over_the_link_and_frames_stay_where_they_are_read(following: tuple[Rig, Rig]) -> None:
    center, edge = following
    silent = bytes_an_instant(edge, 3.0)
    # and when somebody at the center looks, they come: what was counted is what it is taken for
    frames: list[float] = []
    before = bytes_on_the_cable()
    looks = center.bus.subscriber(topics.CAMERA_IMAGE, "1", on_message=lambda got: frames.append(got.received_s))
    center.wait_until(lambda: len(frames) > 20, 20, "frames cross the link")
    looked = (bytes_on_the_cable() - before) / len(frames)
    looks.close()
    print(f"bytes on the cable for each instant: {silent:.0f}, with somebody looking {looked:.0f}")
    assert silent < FRAME_BYTES / 20
    assert looked > FRAME_BYTES


def test_rights_hold_over_the_link(following: tuple[Rig, Rig]) -> None:
    center, edge = following
    center.stop_arm("door")
    edge.wait_until(lambda: not edge.moving(), 3, "the arm holds")
    edge.release_arm("door")
    center.wait_until(center.moving, 20, "the arm moves again")
    center.mode("joints", (0.3, 0.0, 0.4, 0.2))
    center.wait_until(lambda: abs(edge.true_joints() - (0.3, 0.0, 0.4, 0.2)).max() < 0.005, 15, "the goal is reached")
    center.mode("track")


@pytest.mark.parametrize("seconds", [2.0, 15.0], ids=["shorter than the lease", "longer than the lease"])
def test_cut_link_holds_the_arm_and_it_goes_on_by_itself(following: tuple[Rig, Rig], seconds: float) -> None:
    center, edge = following
    with edge.recording_truth() as truth:
        with cut():
            edge.wait_until(lambda: not edge.moving(), 3, "the arm holds")
            began = time.monotonic()
            while time.monotonic() < began + seconds:
                edge.pause(0.2)
                assert not edge.moving()
        began = time.monotonic()
        edge.wait_until(edge.moving, 30, "the arm moves again")
        print(f"moves again {time.monotonic() - began:.1f} s after a cut of {seconds:g} s")
        center.wait_until(center.moving, 20, "the center sees it move")
    # invariant: no joint was ever faster than its limit
    truth.assert_speed_below(5.0)
