"""The web page in a real browser on the running stack: what a person sees of it, and does with it."""

import os
from collections.abc import Iterator
from contextlib import closing, suppress
from pathlib import Path

import numpy as np
import pytest
from playwright.sync_api import Browser

from armsight import topics
from armsight.errors import RefusedError
from armsight_operator.page.hand import SOURCE
from armsight_operator.page.nodes import look_from
from armsight_operator.page.scene import scene_of
from armsight_operator.report.chain import arm_of
from armsight_operator.stack import PAGE, Stack
from browser import CHROMIUM, Viewer, chromium, until
from rig import SERVICES, Rig

pytestmark = [
    pytest.mark.browser,
    pytest.mark.skipif(CHROMIUM is None and "ARMSIGHT_CI" not in os.environ, reason="Chromium is not installed"),
]

POSE = (0.3, 0.0, 0.4, 0.5)


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Rig]:
    """One stack for all tests: few frames a second, as browsers draw on the same processors."""
    rig = Rig(Stack(out=tmp_path_factory.mktemp("stack"), target="none", mode="track", fps=15, page_port=0))
    rig.start_all()
    rig.start(PAGE)
    rig.wait_ready(120)  # with the solver loaded, as the mode asks for it
    yield rig
    rig.close()


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory, rig: Rig) -> Iterator[Browser]:
    del rig  # runs before, and longer
    with chromium(tmp_path_factory.mktemp("chromium")) as browser:
        yield browser


def url(rig: Rig) -> str:
    return f"http://127.0.0.1:{rig.stack.page_port}"


@pytest.fixture(scope="module")
def opened(rig: Rig, browser: Browser) -> Viewer:
    return Viewer(browser, url(rig))


@pytest.fixture
def viewer(rig: Rig, opened: Viewer) -> Viewer:
    """A window on the page; the arm rests, away from where its joints can't be told."""
    with suppress(RefusedError):  # it does not stop the arm
        rig.release_arm(SOURCE)
    rig.mode("hold")
    rig.reset(POSE)
    until(lambda: abs(rig.true_joints() - POSE).max() < 1e-3, opened, "the arm is in its pose")
    opened.wait_for_title("Holding still")
    return opened


def assert_pictures_are_live(rig: Rig, viewer: Viewer) -> None:
    # the browser is sent no picture that is the same as the last, as those of an arm at rest may be
    rig.mode("test-1")
    until(rig.moving, viewer, "the arm moves")
    first = viewer.pictures()
    assert len(first) == 2
    until(lambda: not set(first) & set(viewer.pictures()), viewer, "the pictures are live")


def test_page_shows_the_arm_its_pictures_and_its_health(rig: Rig, viewer: Viewer) -> None:
    for name in ("router", *SERVICES):
        # sim says so where browsers leave it too little of the processors
        until(lambda name=name: viewer.status(name) in ("ok", "degraded"), viewer, f"{name} is there")  # type: ignore[misc]
    until(lambda: len(viewer.pictures()) == 2, viewer, "both cameras have pictures")
    until(lambda: viewer.mode() == "hold", viewer, "the page shows the mode")
    for joint, angle in zip(("joint1", "joint2", "joint3", "joint4"), POSE, strict=True):
        near = pytest.approx(angle, abs=0.05)
        until(lambda joint=joint, near=near: viewer.slider(joint) == near, viewer, f"{joint} is shown")  # type: ignore[misc]
    assert_pictures_are_live(rig, viewer)
    assert viewer.errors == []


def test_dragged_target_is_where_the_tip_arrives(rig: Rig, viewer: Viewer) -> None:
    description = rig.bus.subscriber(topics.DESCRIPTION).recv(5.0)
    assert description is not None
    scene, arm = scene_of(description.message), arm_of(description.message)
    look = (np.array(look_from(scene)[0]), np.array(look_from(scene)[1]))
    targets = rig.bus.subscriber(topics.TARGET)
    # the target waits at the tip, with an arrow upwards that is 0.14 of the arm's reach long
    tip = arm.to_world(arm.tip_at(rig.true_joints()))
    arrow = np.array([0.0, 0.0, 0.6 * 0.14 * scene.reach_m])
    down = np.array([0.0, 0.0, -0.7])  # within reach
    viewer.rest(3.0)
    viewer.drag(tip + arrow, tip + arrow + down, look)
    until(lambda: targets.latest is not None, viewer, "a target is published")
    viewer.rest(1.0)
    until(lambda: viewer.mode() == "track", viewer, "the page shows the mode")

    def wanted() -> np.ndarray:
        assert targets.latest is not None
        point = targets.latest.message.point
        return np.array([point.x, point.y, point.z])

    def error_m() -> float:
        return float(np.linalg.norm(arm.to_world(arm.tip_at(rig.true_joints())) - wanted()))

    assert np.abs(wanted() - tip - down).max() < 0.3, "it was dragged along its arrow"
    until(lambda: error_m() < 0.05, viewer, "the tip is at the target")
    assert viewer.errors == []


def test_stop_button_stops_the_arm_and_release_lets_it_go(rig: Rig, viewer: Viewer) -> None:
    rig.mode("test-1")
    until(rig.moving, viewer, "the arm moves")
    viewer.wait_for_title("Moving")
    viewer.press("STOP")
    until(lambda: not rig.moving(), viewer, "the arm holds")
    viewer.wait_for_title("STOPPED")
    assert "stopped on the page" in viewer.why()
    viewer.page.wait_for_timeout(1000)
    assert not rig.moving()
    viewer.press("Release")
    until(rig.moving, viewer, "the arm moves again")
    viewer.wait_for_title("Moving")


def test_killed_services_are_shown_as_missing_and_as_back(rig: Rig, viewer: Viewer) -> None:
    rig.kill("vision")
    viewer.wait_for_service("vision", "missing")
    assert "armsight-vision" in viewer.row("vision")
    rig.start("vision")
    viewer.wait_for_service("vision", "ok")
    rig.kill("router")
    viewer.wait_for_title("No connection")
    rig.start("router")
    viewer.wait_for_service("control", "ok")
    viewer.wait_for_title("Holding still")
    rig.wait_ready()
    assert_pictures_are_live(rig, viewer)


def test_two_viewers_see_the_same_and_either_may_act(rig: Rig, browser: Browser, viewer: Viewer) -> None:
    with closing(Viewer(browser, url(rig))) as other:
        viewer.choose_mode("test-all")
        until(rig.moving, viewer, "the arm moves")
        until(lambda: other.mode() == "test-all", other, "the other sees the mode")
        other.press("STOP")
        viewer.wait_for_title("STOPPED")
        viewer.press("Release")
        other.wait_for_title("Moving")
        other.set_slider("joint1", -0.5)
        until(lambda: abs(rig.true_joints()[0] + 0.5) < 0.02, viewer, "the joint follows the slider")
        until(lambda: viewer.mode() == "joints", viewer, "the first sees the mode")
        assert viewer.slider("joint1") == pytest.approx(-0.5, abs=0.01)
        assert other.errors == []
    viewer.choose_mode("hold")
    viewer.wait_for_title("Holding still")


def test_nobody_looks_and_nobody_listens(rig: Rig, opened: Viewer) -> None:
    annotations = rig.bus.publisher(topics.CAMERA_ANNOTATIONS, "1")
    until(annotations.has_subscribers, opened, "a viewer's page listens")
    browser = opened.page.context.browser
    opened.close()
    rig.wait_until(lambda: not annotations.has_subscribers(), 30, "the page listens no more")
    # and again for the next one
    assert browser is not None
    again = Viewer(browser, url(rig))
    until(annotations.has_subscribers, again, "a viewer's page listens")
    assert rig.seconds_to_stop(PAGE) < 2.0, "with a viewer, too"
    lines = Path(rig.stack.log_file(PAGE)).read_text(encoding="utf-8").splitlines()
    assert len([line for line in lines if "the router" not in line]) == 1, "nothing but its address is logged"
