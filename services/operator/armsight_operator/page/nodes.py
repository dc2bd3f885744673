"""The arm, its markers, the cameras, the target and the tip's trace as nodes of viser's scene.

Few triangles, and no shadows: browsers may draw without a GPU.
"""

import math
from collections import deque
from collections.abc import Callable, Mapping

import numpy as np
import viser

from armsight.v1.joints_pb2 import MARKER_STATUS_LOST, JointPositions, MarkerPosition
from armsight_operator import rotations
from armsight_operator.page.scene import Array, CameraView, Point, Rgb, Scene, ellipsoid

_SEGMENTS = 20
_SUBDIVISIONS = 2

_GHOST: Rgb = (120, 130, 145)
_GHOST_OPACITY = 0.3
# A little wider than what it lies around, or the two would flicker through each other.
_GHOST_SWELL = 1.25

_TRACE: Rgb = (40, 110, 220)
_TRACE_PX = 2.5
_TRACE_POINTS = 240
_TRACE_STEP_M = 0.01

_TARGET: Rgb = (225, 60, 50)
_CAMERA: Rgb = (110, 110, 120)
_UNSURE_OPACITY = 0.3

# Seen from between the report's two cameras, a little from above; in units of the arm's reach.
_EYE = (0.85, -1.05, 0.75)
_EYE_TARGET = (0.0, 0.0, 0.42)


class ArmNodes:
    """One arm as nested frames: only its joints' rotations change."""

    def __init__(self, api: viser.SceneApi, root: str, scene: Scene, *, ghost: bool = False) -> None:
        """Adds the nodes, at angle 0."""
        self._scene = scene
        self._root = api.add_frame(root, show_axes=False, wxyz=scene.base_wxyz, position=scene.base_position)
        self._joints: dict[str, viser.FrameHandle] = {}
        path = {"": root}
        parent = root
        for joint in scene.joints:
            parent = f"{parent}/{joint.name}"
            path[joint.name] = parent
            self._joints[joint.name] = api.add_frame(parent, show_axes=False, position=joint.origin)
        swell, opacity = (_GHOST_SWELL, _GHOST_OPACITY) if ghost else (1.0, None)
        for link in scene.links:
            if ghost and not link.joint:  # what does not move is where it is
                continue
            api.add_cylinder(
                f"{path[link.joint]}/{link.name}",
                radius=link.radius_m * swell,
                height=link.length_m,
                color=_GHOST if ghost else link.color,
                radial_segments=_SEGMENTS,
                opacity=opacity,
                cast_shadow=False,
                receive_shadow=False,
                wxyz=link.wxyz,
                position=link.centre,
            )

    def pose(self, angles: Mapping[str, float]) -> None:
        """Turns the joints, rad; those that are not given stay."""
        for joint in self._scene.joints:
            if joint.name in angles:
                self._joints[joint.name].wxyz = rotations.about(joint.axis, angles[joint.name])

    def show(self, *, visible: bool) -> None:
        """Shows or hides all of it."""
        if self._root.visible != visible:
            self._root.visible = visible

    def remove(self) -> None:
        """Takes all of it away."""
        self._root.remove()


class MarkerNodes:
    """What vision measures where: a sphere or a box each, and around it where it may be instead (95 %, to scale)."""

    def __init__(self, api: viser.SceneApi, root: str, scene: Scene) -> None:
        """Adds nothing yet: a marker appears when it is seen."""
        self._api = api
        self._root = root
        self._scene = scene
        self._frame = api.add_frame(root, show_axes=False)
        self._things: dict[str, viser.IcosphereHandle | viser.BoxHandle] = {}
        self._unsure: dict[str, viser.IcosphereHandle] = {}

    def update(self, positions: JointPositions | None) -> None:
        """Moves everything to where it is seen; hides what is not."""
        seen = {marker.name: marker for marker in positions.markers} if positions is not None else {}
        for name in {*seen, *self._things}:
            marker = seen.get(name)
            if marker is None or marker.status == MARKER_STATUS_LOST or not marker.HasField("position"):
                for nodes in (self._things, self._unsure):
                    if name in nodes:
                        nodes[name].visible = False
            elif name in self._scene.markers:
                self._place(name, marker)

    def _place(self, name: str, marker: MarkerPosition) -> None:
        position = (marker.position.x, marker.position.y, marker.position.z)
        kind = self._scene.markers[name]
        if name not in self._things:
            path = f"{self._root}/{name}"
            self._things[name] = (
                self._api.add_icosphere(
                    path, kind.radius_m, kind.color, subdivisions=_SUBDIVISIONS, cast_shadow=False, receive_shadow=False
                )
                if kind.radius_m > 0
                else self._api.add_box(path, kind.color, cast_shadow=False, receive_shadow=False)
            )
            self._unsure[name] = self._api.add_icosphere(
                f"{path} 95 %",
                1.0,
                kind.color,
                subdivisions=_SUBDIVISIONS,
                opacity=_UNSURE_OPACITY,
                cast_shadow=False,
                receive_shadow=False,
            )
        thing, unsure = self._things[name], self._unsure[name]
        thing.position, thing.visible = position, True
        if isinstance(thing, viser.BoxHandle) and marker.HasField("extent"):
            thing.dimensions = (marker.extent.x, marker.extent.y, marker.extent.z)
        around = ellipsoid(marker.covariance)
        unsure.visible = around is not None
        if around is not None:
            unsure.position, unsure.wxyz, unsure.scale = position, around.wxyz, around.semi_axes

    def remove(self) -> None:
        """Takes all of it away."""
        self._frame.remove()


class Trace:
    """Where the tip was lately: a line of a fixed number of pieces."""

    def __init__(self, api: viser.SceneApi, name: str) -> None:
        """Adds a line that is not to be seen yet."""
        self._points: deque[Array] = deque(maxlen=_TRACE_POINTS + 1)
        self._line = api.add_line_segments(
            name,
            np.zeros((_TRACE_POINTS, 2, 3), np.float32),
            _TRACE,
            thickness=_TRACE_PX,
            thickness_units="screen",
            visible=False,
        )

    def add(self, tip_world: Array) -> None:
        """Goes on to a point; one too near to the last adds nothing."""
        if self._points and np.linalg.norm(tip_world - self._points[-1]) < _TRACE_STEP_M:
            return
        self._points.append(tip_world)

    def draw(self) -> None:
        """Shows what was added."""
        if len(self._points) < 2:
            return
        points = np.array(self._points, dtype=np.float32)
        points = np.concatenate([np.repeat(points[:1], _TRACE_POINTS + 1 - len(points), axis=0), points])
        self._line.points = np.stack([points[:-1], points[1:]], axis=1)
        self._line.visible = True

    def remove(self) -> None:
        """Takes the line away."""
        self._line.remove()


class Target:
    """The point for the tip: a ball with arrows that a viewer drags.

    Args:
        api: the scene.
        name: of the node.
        reach_m: of the arm, for the size.
        dragged: takes a viewer's point, world frame, metres: while it is dragged, and where it is let go.
        began: called when a viewer grabs it.
    """

    def __init__(
        self,
        api: viser.SceneApi,
        name: str,
        reach_m: float,
        dragged: Callable[[Point], None],
        began: Callable[[], None],
    ) -> None:
        """Adds the ball, hidden until it has a place."""
        self._dragged = dragged
        self._began = began
        self._controls = api.add_transform_controls(
            name,
            scale=0.14 * reach_m,
            line_width=3.5,
            disable_rotations=True,
            disable_sliders=True,
            depth_test=False,
            visible=False,
        )
        api.add_icosphere(
            f"{name}/ball",
            0.018 * reach_m,
            _TARGET,
            subdivisions=_SUBDIVISIONS,
            cast_shadow=False,
            receive_shadow=False,
        )
        api.add_label(f"{name}/label", "target: drag an arrow", position=(0, 0, -0.05 * reach_m), anchor="top-center")

        @self._controls.on_update
        async def _(event: viser.TransformControlsEvent) -> None:
            if event.phase == "start":
                self._began()
                return
            x, y, z = (float(part) for part in event.target.position)
            if all(map(math.isfinite, (x, y, z))):
                self._dragged((x, y, z))

    def place(self, point: Point) -> None:
        """Moves it where the arm goes already."""
        if math.dist(self._controls.position, point) > 1e-3:
            self._controls.position = point
        if not self._controls.visible:
            self._controls.visible = True

    def remove(self) -> None:
        """Takes it away."""
        self._controls.remove()


class CameraNodes:
    """The cameras as pyramids."""

    def __init__(self, api: viser.SceneApi, root: str) -> None:
        """Adds nothing yet."""
        self._api = api
        self._root = root
        self._drawn: dict[str, CameraView] = {}

    def update(self, views: Mapping[str, CameraView], size_m: float) -> None:
        """Draws cameras that are new or have moved."""
        for name, view in views.items():
            if self._drawn.get(name) == view:
                continue
            self._drawn[name] = view
            path = f"{self._root}/{name}"
            self._api.add_camera_frustum(
                path,
                fov=view.fov_y_rad,
                aspect=view.aspect,
                scale=size_m,
                color=_CAMERA,
                cast_shadow=False,
                receive_shadow=False,
                wxyz=view.wxyz,
                position=view.position,
            )
            self._api.add_label(f"{path}/label", f"camera {name}", anchor="bottom-center")


def light_scene(api: viser.SceneApi) -> None:
    """A light, calm room: z up, a floor of metres, no shadows."""
    api.set_up_direction("+z")
    api.configure_default_lights(cast_shadow=False)
    api.add_grid(
        "/floor",
        width=40.0,
        height=40.0,
        cell_size=1.0,
        section_size=5.0,
        cell_color=(232, 234, 238),
        section_color=(205, 210, 218),
        shadow_opacity=0.0,
    )


def look_from(scene: Scene) -> tuple[Point, Point]:
    """Where a viewer stands first, and what is in the middle, world frame."""
    x, y, z = scene.base_position
    eye = tuple(base + scene.reach_m * part for base, part in zip((x, y, z), _EYE, strict=True))
    middle = tuple(base + scene.reach_m * part for base, part in zip((x, y, z), _EYE_TARGET, strict=True))
    return (eye[0], eye[1], eye[2]), (middle[0], middle[1], middle[2])
