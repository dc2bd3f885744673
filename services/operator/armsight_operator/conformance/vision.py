"""Checks of a vision: sim is played by frames of the suite's own drawing, one instant after the other is answered."""

import time

import numpy as np
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage

from armsight import topics
from armsight.bus import Bus
from armsight.images import encode_rgb8, encode_sent
from armsight.times import from_timestamp, to_timestamp, wall_ns
from armsight.v1.joints_pb2 import (
    MARKER_STATUS_LOST,
    MARKER_STATUS_ONE_VIEW,
    MARKER_STATUS_PARTLY_OCCLUDED,
    MARKER_STATUS_TRACKED,
    JointPositions,
    MarkerPosition,
    MarkerStatus,
)
from armsight.v1.sim_pb2 import CLOCK_MODE_LOCKSTEP, Clock
from armsight_operator.conformance import judge, scene
from armsight_operator.conformance.check import Check, UnfulfilledError, require
from armsight_operator.conformance.draw import Camera
from armsight_operator.conformance.scene import PERIOD_NS, Array, Ball, Scene
from armsight_operator.conformance.station import ANSWER_S, DIRT, Station, drained, of_every_service, of_instant

TOLERANCE_M = 0.03
"""Of a marker that both cameras see whole; half a pixel is 0.02 m here."""

_READY_S = 10.0
_QUIET_S = 0.3
_TAKEN_S = 0.05
_LISTENERS_S = 1.5
"""A vision may ask only now and then who listens."""

_CAMERAS = (
    Camera("1", np.array([14.0, 0.0, 5.0]), np.array([0.0, 0.0, 4.5]), 640, 480, 1.1),
    Camera("2", np.array([0.0, -13.0, 5.5]), np.array([0.0, 0.0, 4.5]), 480, 400, 1.2),
)
_BOTH_SEEN = (MARKER_STATUS_TRACKED, MARKER_STATUS_PARTLY_OCCLUDED)
_POSES = (
    np.array([0.0, 0.0, 0.7, 0.6]),
    np.array([0.05, 0.02, 0.74, 0.63]),
    np.array([0.1, 0.05, 0.78, 0.66]),
)
_WRONG_SIZES = ((0, 0, 0), (640, 480, 100), (64, 48, 64 * 48 * 3))
"""Columns, rows, bytes: nothing, too few, another size than was calibrated."""


class Frames:
    """Sim beside the vision that is judged: an arm whose every pose is known."""

    def __init__(self, bus: Bus) -> None:
        """Describes arm and cameras."""
        self.station = Station(bus, "vision", ("sim",))
        self._bus = bus
        self.scene = Scene(scene.description(cameras=tuple(camera.name for camera in _CAMERAS)))
        self._capture_ns = wall_ns()
        self._description = bus.publisher(topics.DESCRIPTION)
        self._calibrations = {each.name: bus.publisher(topics.CAMERA_CALIBRATION, each.name) for each in _CAMERAS}
        self._poses = {each.name: bus.publisher(topics.CAMERA_POSE, each.name) for each in _CAMERAS}
        self._images = {each.name: bus.publisher(topics.CAMERA_IMAGE, each.name, block=True) for each in _CAMERAS}
        self._clock = bus.publisher(topics.CLOCK)
        self._positions = bus.subscriber(topics.JOINT_POSITIONS, keep=1000)
        self._ready = False
        self._drawn: dict[tuple[str, tuple[tuple[str, bytes], ...]], bytes] = {}
        self._describe()

    def close(self) -> None:
        """Takes sim away."""
        self.station.close()

    def settle(self) -> None:
        """Nothing need be waited for: the first frames are."""

    # --- what the suite does

    def frame(self, balls: list[Ball], cameras: tuple[str, ...] = ("1", "2")) -> JointPositions:
        """One instant: frames out, positions in."""
        self._capture_ns += PERIOD_NS
        self.show(balls, cameras)
        return self.answer()

    def show(self, balls: list[Ball], cameras: tuple[str, ...] = ("1", "2")) -> None:
        """Draws and puts the frames of the present instant."""
        drawn = [
            encode_rgb8(self._drawn_by(camera, balls), camera.width, camera.height, camera.frame_id, self._capture_ns)
            for camera in _CAMERAS
            if camera.name in cameras
        ]
        self._clock.put(Clock(capture_time=to_timestamp(self._capture_ns), mode=CLOCK_MODE_LOCKSTEP))
        for name, encoded in zip(cameras, drawn, strict=True):
            self._images[name].put_bytes(encoded, encode_sent(wall_ns()))

    def _drawn_by(self, camera: Camera, balls: list[Ball]) -> bytes:
        key = camera.name, tuple((ball.name, ball.centre.tobytes()) for ball in balls)
        if key not in self._drawn:
            self._drawn[key] = camera.draw(balls).tobytes()
        return self._drawn[key]

    def answer(self, timeout_s: float = ANSWER_S) -> JointPositions:
        """Positions of the present instant."""
        found = of_instant(self._positions, self._capture_ns, timeout_s)
        if found is None:
            raise UnfulfilledError(
                f"no joints/positions for frames within {timeout_s:g} s", "positions of every instant"
            )
        return found

    def begin(self) -> None:
        """Waits until the first frames are answered: description and cameras take a moment to arrive.

        Raises:
            UnfulfilledError: they are not.
        """
        if self._ready:
            return
        until = time.monotonic() + _READY_S
        while True:
            self._capture_ns += PERIOD_NS
            self.show(self.scene.balls(_POSES[0]))
            try:
                self.answer(0.5)
            except UnfulfilledError:
                if time.monotonic() > until:
                    raise UnfulfilledError(
                        f"no joints/positions for frames within {_READY_S:g} s",
                        "positions, once description, calibration and pose are there",
                    ) from None
            else:
                self._ready = True
                return

    def _describe(self) -> None:
        for camera in _CAMERAS:
            self._calibrations[camera.name].put(camera.calibration(self._capture_ns))
            self._poses[camera.name].put(camera.pose(self._capture_ns))
        self._description.put(self.scene.described)

    def _settled(self, q: Array) -> JointPositions:
        """The same pose for some frames: nothing is left of what was before."""
        self.begin()
        for _ in range(3):
            self.frame(self.scene.balls(q))
        return self.frame(self.scene.balls(q))

    # --- checks

    def answers(self) -> None:
        """Every instant is answered once, in order, with its capture time."""
        self.begin()
        drained(self._positions, _QUIET_S)
        asked, answered = [], []
        for index in range(12):
            asked.append(self._capture_ns + PERIOD_NS)
            found = self.frame(self.scene.balls(_POSES[index % 2]))
            answered.append(from_timestamp(found.capture_time))
        answered += [from_timestamp(each.capture_time) for each in drained(self._positions, _QUIET_S)]
        judge.check_answers(asked, answered)

    def accurate(self) -> None:
        """Positions where the markers are."""
        self.begin()
        for q in _POSES:
            balls = self.scene.balls(q)
            markers = _by_name(self._settled(q))
            judge.check_names("markers", markers, [ball.name for ball in balls])
            for ball in balls:
                marker = markers[ball.name]
                require(marker.status in _BOTH_SEEN, f"{ball.name} is {_status(marker)}", "seen by two cameras")
                judge.check_near(ball.name, _position(marker), ball.centre, TOLERANCE_M, "m")

    def covariances(self) -> None:
        """Covariances are some."""
        for name, marker in _by_name(self._settled(_POSES[0])).items():
            if marker.HasField("position"):
                judge.check_covariance(name, marker.covariance)

    def observations(self) -> None:
        """What each camera saw, in pixels."""
        balls = {ball.name: ball for ball in self.scene.balls(_POSES[1])}
        for name, marker in _by_name(self._settled(_POSES[1])).items():
            seen_by = [each.camera for each in marker.observations]
            judge.check_names(f"cameras that saw {name}:", seen_by, [camera.name for camera in _CAMERAS])
            for each in marker.observations:
                camera = next(camera for camera in _CAMERAS if camera.name == each.camera)
                projected = camera.pixel(camera.in_optical_frame(balls[name].centre))
                where = f"{name} in the image of camera {each.camera} at"
                judge.check_near(where, np.array([each.u_px, each.v_px]), projected, 1.5, "px")

    def hidden(self) -> None:
        """A marker that no camera sees is lost, and nowhere else."""
        balls = self.scene.balls(_POSES[0])
        self._settled(_POSES[0])
        red = next(ball for ball in balls if ball.name == "red")
        cover = Ball("cover", red.centre, 1.5 * red.radius_m, (0.0, 0.0, 0.0))
        for _ in range(6):
            found = _by_name(self.frame([*balls, cover]))["red"]
        require(found.status == MARKER_STATUS_LOST, f"red, which no camera sees, is {_status(found)}", "LOST")
        aged = found.age.seconds + found.age.nanos / 1e9
        seen = f"age of {aged:.3f} s after 6 frames"
        require(not found.HasField("position") or aged >= 5 * PERIOD_NS / 1e9, seen, "the time since it was seen")

    def one_view(self) -> None:
        """A marker that one camera sees is said to be seen by one."""
        balls = self.scene.balls(_POSES[0])
        self._settled(_POSES[0])
        red = next(ball for ball in balls if ball.name == "red")
        away = _CAMERAS[0].position - red.centre
        cover = Ball("cover", red.centre + 1.0 * away / np.linalg.norm(away), 1.6 * red.radius_m, (0.0, 0.0, 0.0))
        for _ in range(3):
            found = _by_name(self.frame([*balls, cover]))["red"]
        self._must_be_one_view("red, which one camera sees,", found, red)

    def one_camera(self) -> None:
        """Frames of one camera alone are answered, too."""
        balls = self.scene.balls(_POSES[0])
        self._settled(_POSES[0])
        found = _by_name(self.frame(balls, ("1",)))
        for ball in balls:
            self._must_be_one_view(f"{ball.name}, with frames of one camera,", found[ball.name], ball)
        self._settled(_POSES[0])

    def _must_be_one_view(self, what: str, found: MarkerPosition, ball: Ball) -> None:
        says = f"{what} is {_status(found)}"
        require(found.status in (MARKER_STATUS_ONE_VIEW, MARKER_STATUS_LOST), says, "ONE_VIEW or LOST")
        if found.status == MARKER_STATUS_ONE_VIEW:
            judge.check_covariance(ball.name, found.covariance)
            off = _position(found) - ball.centre
            covariance = np.reshape(np.array(found.covariance), (3, 3))
            sigmas = float(np.sqrt(off @ np.linalg.solve(covariance + 1e-4 * np.eye(3), off)))
            seen = f"{what} is {np.linalg.norm(off):.2f} m off, {sigmas:.0f} standard deviations by its covariance"
            require(sigmas < 6, seen, "a covariance that says how far off it may be")

    def repeated(self) -> None:
        """Frames that are sent again get the same answer."""
        self._settled(_POSES[0])
        balls = self.scene.balls(_POSES[1])
        first = self.frame(balls)
        self.show(balls)
        again = self.answer()
        judge.check_names("markers", _by_name(again), _by_name(first))
        for name, marker in _by_name(again).items():
            before = _by_name(first)[name]
            same = marker.status == before.status
            require(same, f"{name} is {_status(marker)}, and was {_status(before)}", "the same answer")
            judge.check_near(f"{name}, frames sent again,", _position(marker), _position(before), 1e-6, "m")

    def malformed(self) -> None:
        """Bytes that are no message are counted, and end nothing."""
        self._settled(_POSES[0])
        before = self.station.health()
        camera = _CAMERAS[0]
        publishers = (
            self._description,
            self._calibrations[camera.name],
            self._poses[camera.name],
            self._images[camera.name],
        )
        for publisher in publishers:
            for dirt in DIRT:
                publisher.put_bytes(dirt)
                time.sleep(_TAKEN_S)
        self._describe()
        self.station.must_count(before, len(publishers), "malformed messages on the keys that it reads")
        self._must_go_on("malformed bytes")

    def refused_frames(self) -> None:
        """Frames that can't be are counted, and end nothing."""
        self._settled(_POSES[0])
        before = self.station.health()
        for width, height, size in _WRONG_SIZES:
            self._put(width=width, height=height, encoding="rgb8", step=3 * width, data=bytes(size))
        self._put(width=640, height=480, encoding="32FC1", step=640 * 3, data=bytes(640 * 480 * 3))
        self._put(width=640, height=480, encoding="rgb8", step=7, data=bytes(640 * 480 * 3))
        self._put(width=2**32 - 1, height=2**32 - 1, encoding="rgb8", step=2**32 - 1, data=bytes(99))
        self.station.must_count(before, 6, "frames of 0 x 0, too few bytes, wrong sizes, encodings and steps")
        self._must_go_on("frames that can't be used")

    def stages(self) -> None:
        """Stamps of the stages so far."""
        self._settled(_POSES[0])
        found = self.frame(self.scene.balls(_POSES[1]))
        judge.check_stages(found.stages, "frames_sent", "vision_received", "vision_sent")

    def annotations(self) -> None:
        """Annotations are made for those who look, and nobody else."""
        self._settled(_POSES[0])
        # that none are made where nobody listens can't be heard from here
        subscriber = self._bus.subscriber(topics.CAMERA_ANNOTATIONS, "*", keep=100)
        time.sleep(_LISTENERS_S)
        for _ in range(3):
            self.frame(self.scene.balls(_POSES[0]))
        time.sleep(_QUIET_S)
        found = drained(subscriber, _QUIET_S)
        subscriber.close()
        require(bool(found), "no camera/*/annotations though somebody listens", "annotations of each frame")

    def _put(self, **fields: object) -> None:
        self._capture_ns += PERIOD_NS
        camera = _CAMERAS[0]
        image = RawImage(timestamp=to_timestamp(self._capture_ns), frame_id=camera.frame_id, **fields)  # type: ignore[arg-type]
        self._images[camera.name].put(image)
        time.sleep(_TAKEN_S)

    def _must_go_on(self, after: str) -> None:
        balls = self.scene.balls(_POSES[0])
        for _ in range(5):
            self._capture_ns += PERIOD_NS
            self.show(balls)
            try:
                markers = _by_name(self.answer(1.0))
            except UnfulfilledError:
                continue
            if all(marker.status in _BOTH_SEEN for marker in markers.values()):
                return
        raise UnfulfilledError(f"no positions from both cameras after {after}", "that it goes on")


def _by_name(positions: JointPositions) -> dict[str, MarkerPosition]:
    found = {marker.name: marker for marker in positions.markers}
    require(len(found) == len(positions.markers), "a marker that is told twice", "each once")
    return found


def _position(marker: MarkerPosition) -> Array:
    return np.array([marker.position.x, marker.position.y, marker.position.z])


def _status(marker: MarkerPosition) -> str:
    return MarkerStatus.Name(marker.status).removeprefix("MARKER_STATUS_")


_POSITIONS, _MARKER, _VISION = "messages.md#jointpositions", "messages.md#markerposition", "own-part.md#vision"
_STATUS = "messages.md#markerstatus"

CHECKS: tuple[Check[Frames], ...] = (
    *of_every_service("Vision"),
    Check(
        "answers",
        "The frames of every instant are answered by one joints/positions of its capture time, in order.",
        _POSITIONS,
        Frames.answers,
    ),
    Check(
        "accurate",
        f"Markers that two cameras see are within {100 * TOLERANCE_M:g} cm of where they are, in the world frame.",
        _VISION,
        Frames.accurate,
    ),
    Check("covariance", "Each position has a covariance, symmetric and positive.", _MARKER, Frames.covariances),
    Check(
        "observations",
        "What each camera saw is told in its pixels, whole numbers being their centres.",
        "messages.md#cameraobservation",
        Frames.observations,
    ),
    Check("hidden", "A marker that no camera sees is LOST, with its age.", _STATUS, Frames.hidden),
    Check(
        "one-view",
        "A marker that one camera sees is ONE_VIEW, with a covariance that says so, or LOST.",
        _STATUS,
        Frames.one_view,
    ),
    Check(
        "one-camera",
        "Where frames of one camera come alone, the instant is answered by what that one saw.",
        _VISION,
        Frames.one_camera,
    ),
    Check("repeated", "Frames that are sent again get the same answer.", _VISION, Frames.repeated),
    Check(
        "malformed",
        "Bytes that are no message are counted and harm nothing.",
        "own-part.md#every-part",
        Frames.malformed,
    ),
    Check(
        "refused-frames",
        "Frames of wrong sizes, encodings or steps, or with too few bytes, are counted and harm nothing.",
        _VISION,
        Frames.refused_frames,
    ),
    Check(
        "stages", "Positions tell the times of the stages so far, in order.", "messages.md#stagetimes", Frames.stages
    ),
    Check(
        "annotations",
        "Annotations of each camera come where somebody listens to them.",
        "keys.md",
        Frames.annotations,
    ),
)
