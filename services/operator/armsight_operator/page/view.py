"""What all viewers see: the scene and the panels, brought up to date from what was heard."""

import threading
import time
from collections.abc import Mapping

import numpy as np
import numpy.typing as npt
import viser

from armsight.v1.description_pb2 import ArmDescription
from armsight_operator.page.hand import SOURCE, Hand
from armsight_operator.page.nodes import (
    ArmNodes,
    CameraNodes,
    MarkerNodes,
    Target,
    Trace,
    light_scene,
    look_from,
)
from armsight_operator.page.panels import CameraPanel, HealthPanel, MovePanel, Plots, StopPanel
from armsight_operator.page.plots import STAGES, History
from armsight_operator.page.scene import CameraView, Point, Scene, scene_of
from armsight_operator.page.state import headline, rows
from armsight_operator.page.streams import Seen, sample_of
from armsight_operator.report.chain import Arm, arm_of

# Words and the trace change this often, plots half as often: faster than anybody reads.
_WORDS_PERIOD_S = 0.25
_PLOTS_PERIOD_S = 0.5
_SAMPLE_PERIOD_S = 0.1

# A viewer's hand is on the target or a slider this long after the last that was heard of it.
_HELD_S = 1.5

_TROUBLE_S = 8.0

_CAMERA_SIZE = 0.12
"""In units of the arm's reach."""


class _Every:
    """Whether it is time again."""

    def __init__(self, period_s: float) -> None:
        self._period_s = period_s
        self._due_s = 0.0

    def __call__(self, now_s: float) -> bool:
        if now_s < self._due_s:
            return False
        self._due_s = now_s + self._period_s
        return True


class _Drawn:
    """All nodes of one described arm."""

    def __init__(self, api: viser.SceneApi, description: ArmDescription, target: Target) -> None:
        self.scene: Scene = scene_of(description)
        self.arm: Arm = arm_of(description)
        self.estimated = ArmNodes(api, "/arm", self.scene)
        self.true = ArmNodes(api, "/true arm", self.scene, ghost=True)
        self.markers = MarkerNodes(api, "/markers", self.scene)
        self.trace = Trace(api, "/trace of the tip")
        self.target = target

    def remove(self) -> None:
        for part in (self.estimated, self.true, self.markers, self.trace, self.target):
            part.remove()


class View:
    """The page, for all viewers together.

    Args:
        server: viser's.
        title: stands at the top.
    """

    def __init__(self, server: viser.ViserServer, title: str) -> None:
        """Lays out what does not depend on the arm; :meth:`give_hand` comes next."""
        self._server = server
        self._hand: Hand | None = None
        self._drawn: _Drawn | None = None
        self._mode = ""
        self._touched_s = {"target": -_HELD_S, "sliders": -_HELD_S}
        self._sliders_lead = False
        """They say where the joints are to be; else they show where those are."""
        self._trouble = ("", 0.0)
        self._trouble_lock = threading.Lock()
        self._history = History()
        self._words, self._plots_due = _Every(_WORDS_PERIOD_S), _Every(_PLOTS_PERIOD_S)
        self._sample_due = _Every(_SAMPLE_PERIOD_S)
        gui = server.gui
        gui.configure_theme(show_logo=False, show_share_button=False, control_width="large")
        gui.set_panel_label(title)
        light_scene(server.scene)
        self._cameras = CameraNodes(server.scene, "/cameras")
        self._pictures = CameraPanel(gui)
        self._stop = StopPanel(gui, lambda: self._with_hand().stop(), lambda: self._with_hand().release())
        self._move = MovePanel(gui, self._choose, self._set_joints)
        self._health = HealthPanel(gui)
        self._plots = Plots(gui, self._pictures.tab)
        gui.main_panel.dock_right()
        gui.main_panel.set_width(360)

    def give_hand(self, hand: Hand) -> None:
        """Whom viewers' wishes go to."""
        self._hand = hand

    def say(self, trouble: str) -> None:
        """Shows for a while what went wrong; empty: nothing does."""
        with self._trouble_lock:
            self._trouble = (trouble, time.monotonic() + _TROUBLE_S)

    def arrange(self, description: ArmDescription) -> None:
        """Draws the arm that sim describes, in the place of another."""
        if self._drawn is not None:
            self._drawn.remove()
        scene = scene_of(description)
        target = Target(self._server.scene, "/target", scene.reach_m, self._dragged, lambda: self._touch("target"))
        self._drawn = _Drawn(self._server.scene, description, target)
        self._move.arrange(scene.joints)
        self._plots.arrange(tuple(joint.name for joint in scene.joints))
        self._history = History()
        eye, middle = look_from(scene)
        camera = self._server.initial_camera
        camera.position, camera.look_at = eye, middle
        for client in self._server.get_clients().values():
            client.camera.position, client.camera.look_at = eye, middle

    def show_cameras(self, views: Mapping[str, CameraView]) -> None:
        """Draws where the cameras stand."""
        if self._drawn is not None:
            self._cameras.update(views, _CAMERA_SIZE * self._drawn.scene.reach_m)

    def show_picture(self, camera: str, pixels: npt.NDArray[np.uint8]) -> None:
        """A camera's newest picture."""
        self._pictures.show(camera, pixels)

    def update(self, seen: Seen, *, connected: bool) -> None:
        """Brings everything up to date."""
        now = time.monotonic()
        self._mode = seen.snapshot.mode
        if self._drawn is not None:
            with self._server.atomic():
                self._pose(self._drawn, seen, now)
            if self._sample_due(now):
                self._history.add(sample_of(seen, self._drawn.arm, now))
        if self._words(now):
            self._say_words(seen, connected=connected)
            if self._drawn is not None:
                self._drawn.trace.draw()
        if self._plots_due(now):
            self._plots.update(self._history)

    def _pose(self, drawn: _Drawn, seen: Seen, now: float) -> None:
        snapshot = seen.snapshot
        drawn.estimated.pose(snapshot.joints)
        drawn.true.pose(seen.true)
        drawn.true.show(visible=bool(seen.true))
        drawn.markers.update(seen.positions)
        if snapshot.tip is not None:
            drawn.trace.add(drawn.arm.to_world(np.array(snapshot.tip)))
            if now - self._touched_s["target"] > _HELD_S:
                x, y, z = drawn.arm.to_world(np.array(snapshot.target or snapshot.tip))
                drawn.target.place((float(x), float(y), float(z)))

    def _say_words(self, seen: Seen, *, connected: bool) -> None:
        snapshot = seen.snapshot
        with self._trouble_lock:
            trouble, until = self._trouble
        self._stop.update(
            headline(snapshot, connected=connected, own_source=SOURCE),
            trouble if time.monotonic() < until else "",
            may_release=SOURCE in snapshot.stopped_by,
        )
        self._health.update(rows(snapshot, connected=connected, without=(SOURCE,)), self._speed(seen))
        self._move.show_mode(snapshot.mode)
        held = time.monotonic() - self._touched_s["sliders"] < _HELD_S
        if not held and snapshot.mode != "joints":
            self._sliders_lead = False
        if not held and not self._sliders_lead:
            self._move.show_angles(snapshot.joints)

    def _speed(self, seen: Seen) -> str:
        snapshot = seen.snapshot
        if snapshot.latency_p50_ms is None:
            return ""
        parts = [f"{snapshot.rate_hz:.0f} answers a second, {snapshot.latency_p50_ms:.1f} ms from frame to command"]
        if (medians := self._history.stage_medians_ms()) is not None:
            parts.append(", ".join(f"{name} {ms:.1f}" for name, ms in zip(STAGES, medians, strict=True)))
        return ": ".join(parts)

    def _dragged(self, point: Point) -> None:
        self._touch("target")
        self._with_hand().target(point, follow=self._mode != "track")

    def _choose(self, mode: str) -> None:
        self._with_hand().mode(mode)

    def _set_joints(self, angles: Mapping[str, float]) -> None:
        self._touch("sliders")
        self._sliders_lead = True
        self._with_hand().joints(angles)

    def _touch(self, what: str) -> None:
        self._touched_s[what] = time.monotonic()

    def _with_hand(self) -> Hand:
        assert self._hand is not None
        return self._hand
