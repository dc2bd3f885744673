"""The arithmetic of tools/scaling.py, by hand; and that docs/scaling.md says what was measured."""

import runpy
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

TOOL = Path(__file__).parents[1] / "tools" / "scaling.py"
FRAME_MB_S = 800 * 800 * 3 * 30 / 1e6


@pytest.fixture(scope="module")
def tool() -> dict[str, Any]:
    # under a name of its own: dataclasses look up the module that they are of
    return runpy.run_path(str(TOOL), run_name="scaling")


@pytest.fixture
def one(tool: dict[str, Any]) -> Any:
    """Figures with which the arithmetic is easy: a robot takes half a core, a tenth of it control."""
    return tool["Measured"](
        vision_cores=0.1,
        router_cores=0.05,
        camera_cores=0.25,
        control_cores=0.1,
        vision_mb=10.0,
        router_mb=30.0,
        control_mb=300.0,
        link_kb_s=100.0,
        status_kb_s=20.0,
    )


def plan(tool: dict[str, Any], one: Any, **assumed: Any) -> Any:
    return tool["plan"](one, tool["Assumptions"](**assumed))


def test_cells_hold_as_many_robots_as_may_keep_their_cores_busy(tool: dict[str, Any], one: Any) -> None:
    planned = plan(tool, one, robots=1000, cores=16, used=0.5)
    assert planned.robots_a_cell == 16
    assert planned.cells == 63  # the last one is not full
    assert planned.cell_cores == pytest.approx(8.0)
    assert planned.cell_mb == pytest.approx(30 + 16 * (10 + 300 + 6 * 2**20 / 1e6))


def test_routers_at_the_center_form_a_tree(tool: dict[str, Any], one: Any) -> None:
    few = plan(tool, one, robots=160)
    assert (few.cells, few.routers, few.links) == (10, 11, 10)
    many = plan(tool, one, robots=1000, links=50)
    assert (many.routers, many.links) == (63 + 2 + 1, 65)
    deep = plan(tool, one, robots=1000, links=4)
    assert (deep.routers, deep.links) == (63 + 16 + 4 + 1, 83)
    assert deep.center_cores == pytest.approx(3 * plan(tool, one, robots=1000, links=100).center_cores)


def test_control_at_the_center_takes_its_cores_and_memory_there_and_its_bytes_over_the_link(
    tool: dict[str, Any], one: Any
) -> None:
    here = plan(tool, one, control="cell", links=100)
    there = plan(tool, one, control="center", links=100)
    assert there.robots_a_cell == 20
    assert there.center_cores - here.center_cores == pytest.approx(1000 * 0.1)
    assert there.center_mb - here.center_mb == pytest.approx(1000 * 300)
    assert here.center_mb_s == pytest.approx(1000 * 0.020)
    assert there.center_mb_s == pytest.approx(1000 * 0.100)
    assert there.link_mb_s == pytest.approx(20 * 0.100)


def test_frames_stay_in_the_cell_unless_somebody_looks(tool: dict[str, Any], one: Any) -> None:
    planned = plan(tool, one)
    assert planned.frames_mb_s == pytest.approx(16 * 2 * FRAME_MB_S)
    looked = plan(tool, one, video=0.25)
    assert looked.center_mb_s - planned.center_mb_s == pytest.approx(250 * FRAME_MB_S)


def test_half_the_rate_takes_half_of_everything_but_memory(tool: dict[str, Any], one: Any) -> None:
    planned, slower = plan(tool, one, robots=8), plan(tool, one, robots=8, rate_hz=15.0)
    assert slower.robots_a_cell == planned.robots_a_cell == 8
    for name in ("cell_cores", "center_cores", "frames_mb_s", "link_mb_s", "center_mb_s"):
        assert getattr(slower, name) == pytest.approx(getattr(planned, name) / 2), name
    assert slower.cell_mb == planned.cell_mb


def test_what_makes_no_plan_is_refused(tool: dict[str, Any], one: Any) -> None:
    for wrong in ({"robots": 0}, {"used": 0.0}, {"used": 1.5}, {"video": -0.1}, {"links": 1}, {"rate_hz": 0.0}):
        with pytest.raises(ValueError, match=r"at least|shares"):
            tool["Assumptions"](**wrong)
    with pytest.raises(ValueError, match="more than the share"):
        plan(tool, one, cores=1, used=0.1)


def test_one_robots_share_is_taken_from_the_most_that_kept_up(tool: dict[str, Any]) -> None:
    def row(name: str, value: float) -> dict[str, object]:
        return {"name": name, "value": value}

    series = tool["SERIES"]
    robots = [
        row(f"{series}: most robots that it keeps up with", 4),
        *(
            row(f"{series}, 4 robots: {name}", value)
            for name, value in (("vision", 20), ("router", 8), ("senders", 40))
        ),
        row(f"{series}, 1 robots: vision", 9),
    ]
    control = tool["CONTROL"]
    footprint = [
        *(row(f"{name}: memory, PSS", mb) for name, mb in (("vision", 11), ("router", 22), (control, 33))),
        row(f"{control}: processors at 30 Hz", 3),
    ]
    link = [row(f"{tool[name]}: over the link", kb) for name, kb in (("AT_CENTER", 70), ("IN_CELL", 20))]
    found = tool["measured"](robots, footprint, link)
    assert (found.vision_cores, found.router_cores, found.camera_cores) == pytest.approx((0.05, 0.02, 0.1))
    assert found.control_cores == pytest.approx(0.03)
    assert (found.vision_mb, found.router_mb, found.control_mb) == (11, 22, 33)
    assert (found.link_kb_s, found.status_kb_s) == (70, 20)
    with pytest.raises(ValueError, match="make bench-robots"):
        tool["measured"]([], footprint, link)


def test_page_says_what_was_measured(tool: dict[str, Any]) -> None:
    text = tool["PAGE"].read_text(encoding="utf-8")
    assert tool["page"](text, tool["read_results"]()) == text, "run tools/scaling.py --write"


def test_plan_is_printed_for_other_assumptions() -> None:
    command = [sys.executable, str(TOOL), "--robots", "200", "--control", "center"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=30, check=True)
    assert done.stdout.startswith("| 200 robots, control at the center |")
    assert "routers in all" in done.stdout
