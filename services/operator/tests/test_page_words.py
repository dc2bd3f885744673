"""What the page draws and says, from messages alone: no bus, no browser."""

import dataclasses
import math

import numpy as np
import pytest
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform

from armsight.v1.description_pb2 import Color, LinkShape
from armsight.v1.geometry_pb2 import Vector3
from armsight.v1.joints_pb2 import StageTimes
from armsight_operator.monitor import ServiceState, Snapshot
from armsight_operator.page.plots import WINDOW_S, History, Sample, known, stages_ms
from armsight_operator.page.scene import camera_view, ellipsoid, scene_of, srgb
from armsight_operator.page.state import headline, length, rows
from armsight_operator.rotations import Wxyz, about
from fake_arm import description


def rotated(wxyz: Wxyz, vector: np.ndarray) -> np.ndarray:
    w, axis = wxyz[0], np.array(wxyz[1:])
    return np.asarray(vector + 2 * np.cross(axis, np.cross(axis, vector) + w * vector))


def snapshot(**changes: object) -> Snapshot:
    well = Snapshot(
        services=tuple(ServiceState(name, "ok", "") for name in ("sim", "vision", "control")),
        mode="track",
        state="moving",
        detail="",
        joints={},
        tip=(0.0, 0.0, 1.0),
        target=(0.0, 0.0, 1.02),
        rate_hz=30.0,
        latency_p50_ms=5.0,
        latency_p99_ms=9.0,
        stopped_by=(),
    )
    return dataclasses.replace(well, **changes)  # type: ignore[arg-type]


def missing(name: str) -> tuple[ServiceState, ...]:
    return tuple(
        dataclasses.replace(service, status="missing", detail="not heard of") if service.name == name else service
        for service in snapshot().services
    )


# the scene


@pytest.mark.parametrize("end", [(1, 0, 0), (0, -2, 0), (0, 0, 3), (0, 0, -1), (1, 2, -2)])
def test_a_link_lies_between_its_ends(end: tuple[float, float, float]) -> None:
    described = description()
    described.links.append(
        LinkShape(name="rod", joint="joint2", start=Vector3(x=0.1), end=Vector3(x=0.1 + end[0], y=end[1], z=end[2]))
    )
    (link,) = scene_of(described).links
    half = rotated(link.wxyz, np.array([0, 0, link.length_m / 2]))
    assert np.array(link.centre) - half == pytest.approx(np.array([0.1, 0, 0]), abs=1e-9)
    assert np.array(link.centre) + half == pytest.approx(np.array([0.1, 0, 0]) + end, abs=1e-9)


def test_a_joint_turns_about_its_axis() -> None:
    assert rotated(about((0, 0, 1), math.pi / 2), np.array([1.0, 0, 0])) == pytest.approx(np.array([0, 1, 0]))


def test_reach_is_that_of_the_arm_stretched_out() -> None:
    assert scene_of(description()).reach_m == pytest.approx(4.0 + 3.2 + 2.8)


def test_ellipsoid_holds_95_percent_of_positions() -> None:
    rng = np.random.default_rng(7)
    root = rng.normal(size=(3, 3))
    covariance = root @ root.T
    around = ellipsoid(covariance.ravel().tolist())
    assert around is not None
    axes = np.stack([rotated(around.wxyz, axis) for axis in np.eye(3)])
    points = rng.multivariate_normal(np.zeros(3), covariance, 20000)
    inside = (((points @ axes.T) / around.semi_axes) ** 2).sum(axis=1) <= 1
    assert inside.mean() == pytest.approx(0.95, abs=0.005)


@pytest.mark.parametrize("bad", [[], [1.0] * 8, [math.nan] * 9, [math.inf] * 9])
def test_what_is_no_covariance_has_no_ellipsoid(bad: list[float]) -> None:
    assert ellipsoid(bad) is None


def test_colours_are_brighter_on_screens_than_in_linear_light() -> None:
    assert srgb(Color(red=0.0, green=0.2140, blue=7.0)) == (0, 127, 255)


def test_a_camera_sees_as_wide_as_its_focal_length_says() -> None:
    calibration = CameraCalibration(width=800, height=400, K=[200, 0, 400, 0, 200, 200, 0, 0, 1])
    pose = FrameTransform()
    pose.translation.x, pose.rotation.w = 3.0, 1.0
    view = camera_view(calibration, pose)
    assert view is not None
    assert (view.fov_y_rad, view.aspect) == pytest.approx((math.pi / 2, 2.0))
    assert (view.position, view.wxyz) == ((3.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0))
    assert camera_view(CameraCalibration(width=800, height=400), pose) is None


# the words


def test_moving_arm_says_how_far_the_tip_is_from_its_target() -> None:
    said = headline(snapshot(), connected=True, own_source="page")
    assert (said.level, said.title, said.why) == ("good", "Moving", "tip 20 mm from its target")


def test_stop_says_by_whom_and_why_and_how_another_lets_go() -> None:
    stopped = snapshot(
        state="stopped", stopped_by=("page", "door"), stop_reasons={"page": "stopped on the page", "door": "open"}
    )
    said = headline(stopped, connected=True, own_source="page")
    assert (said.level, said.title) == ("stopped", "STOPPED")
    assert said.why == "by page (stopped on the page), by door (open); to let go: `armsight release --source door`"


def test_the_worst_is_said_first() -> None:
    worst = snapshot(services=missing("sim"), stopped_by=("door",), mode="")
    assert headline(worst, connected=False, own_source="page").title == "No connection"
    assert headline(worst, connected=True, own_source="page").title == "No arm"
    assert headline(snapshot(mode="", state=""), connected=True, own_source="page").title == "No control"
    blind = headline(snapshot(state="blind", detail="no positions"), connected=True, own_source="page")
    assert (blind.level, blind.why) == ("warning", "no positions")


def test_a_missing_service_says_how_it_is_started() -> None:
    by_name = {row.name: row for row in rows(snapshot(services=missing("vision")), connected=True)}
    assert list(by_name) == ["router", "sim", "vision", "control"]
    assert by_name["vision"].status == "missing"
    assert "`armsight-vision`" in by_name["vision"].text
    assert by_name["sim"].status == by_name["router"].status == "ok"
    (router, *_) = rows(snapshot(), connected=False)
    assert (router.name, router.status) == ("router", "missing")


def test_rate_and_refusals_stand_beside_a_service() -> None:
    busy = ServiceState(
        "sim", "ok", "", {"command_refused_stale": 2, "malformed_target": 1, "frames": 9}, {"rate_hz": 29.7}
    )
    (_, row) = rows(snapshot(services=(busy,)), connected=True)
    assert row.text == "30 Hz, 3 refused or malformed"


def test_the_page_does_not_list_itself() -> None:
    with_page = (*snapshot().services, ServiceState("page", "ok", ""))
    assert "page" not in [row.name for row in rows(snapshot(services=with_page), connected=True, without=("page",))]


def test_lengths_are_millimetres_up_to_a_metre() -> None:
    assert (length(0.0123), length(1.234)) == ("12 mm", "1.23 m")


# the plots


def sample(at_s: float, estimated: float, true: float | None = None) -> Sample:
    return Sample(at_s, {"a": estimated}, {} if true is None else {"a": true}, None if true is None else 0.002, None)


def test_history_forgets_what_is_older_than_its_window() -> None:
    history = History()
    for at_s in (0.0, 1.0, WINDOW_S + 0.5):
        history.add(sample(at_s, at_s))
    assert history.times().tolist() == [1.0 - WINDOW_S - 0.5, 0.0]


def test_unknown_values_leave_gaps() -> None:
    history = History()
    history.add(sample(0.0, 0.1, 0.2))
    history.add(sample(1.0, 0.3))
    estimated, true = history.angles(("a",))
    assert estimated.tolist() == [0.1, 0.3]
    assert (true[0], math.isnan(true[1])) == (0.2, True)
    assert history.tip_error_mm()[0] == pytest.approx(2.0)
    assert math.isnan(history.tip_error_mm()[1])
    assert history.stage_medians_ms() is None
    assert [column.tolist() for column in known(history.times(), [estimated, true])] == [[-1.0], [0.1], [0.2]]


def test_without_a_truth_the_estimate_is_the_only_line() -> None:
    history = History()
    history.add(sample(0.0, 0.1))
    history.add(sample(1.0, 0.3))
    assert [column.tolist() for column in history.angles(("a",))] == [[0.1, 0.3], [0.1, 0.3]]


def test_stages_are_the_times_between_what_was_passed() -> None:
    ns = 1_000_000
    times = StageTimes(
        frames_sent_ns=ns,
        vision_received_ns=3 * ns,
        vision_sent_ns=4 * ns,
        control_received_ns=8 * ns,
        control_sent_ns=9 * ns,
    )
    assert stages_ms(times) == (2.0, 1.0, 4.0, 1.0)
    times.vision_sent_ns = 0
    assert stages_ms(times) is None
