"""What the compose files say, read by compose itself: no daemon is needed."""

import json
import os
import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest

from armsight_operator.certs.folder import Folder
from armsight_operator.certs.layout import CONFIGURATION
from armsight_operator.cli.app import main

ROOT = Path(__file__).parents[1]
BASE, SECURE = "docker-compose.yml", "docker-compose.secure.yml"
EDGE, CENTER = "docker-compose.edge.yml", "docker-compose.center.yml"
BUS = ("router", "sim", "vision", "control", "operator", "page")
BEARERS = BUS[:-1]
"""Of certificates: the page has the operator's."""

CAMERAS = "ARMSIGHT_EXTERNAL_CAMERAS"

HAS_COMPOSE = (
    shutil.which("docker")
    and not subprocess.run(["docker", "compose", "version"], capture_output=True, check=False).returncode
)

pytestmark = pytest.mark.skipif(not HAS_COMPOSE and "ARMSIGHT_CI" not in os.environ, reason="compose is not installed")

Services = dict[str, dict[str, Any]]


def services(*files: str, profile: str = "", **environment: str) -> Services:
    words = [word for file in files for word in ("--file", file)] + (["--profile", profile] if profile else [])
    clean = {name: value for name, value in os.environ.items() if not name.startswith(("ARMSIGHT_", "COMPOSE_"))}
    ended = subprocess.run(
        ["docker", "compose", *words, "config", "--format", "json"],
        cwd=ROOT,
        env=clean | environment,
        capture_output=True,
        text=True,
        timeout=30,
        check=False,
    )
    assert ended.returncode == 0, ended.stderr
    assert ended.stderr == "", "compose has something to complain about"
    return dict(json.loads(ended.stdout)["services"])


def own_cameras(environment: dict[str, str]) -> dict[str, str]:
    """Of sim without cameras of somebody else's, which the first robot alone may have."""
    return {name: value for name, value in environment.items() if name != CAMERAS}


@pytest.fixture(params=[(BASE,), (BASE, SECURE)], ids=["plain", "secure"])
def either(request: pytest.FixtureRequest) -> Services:
    return services(*request.param)


def test_only_router_and_page_have_a_port_and_only_on_this_machine(either: Services) -> None:
    assert set(either) == set(BUS)
    ports = {name: [port["host_ip"] for port in service.get("ports", [])] for name, service in either.items()}
    assert ports == {name: ["127.0.0.1"] if name in ("router", "page") else [] for name in BUS}


def test_every_container_is_confined(either: Services) -> None:
    for name, service in either.items():
        assert 0 < int(service["mem_limit"]) <= 1 << 30, name
        assert service["cpus"] > 0, name
        assert service["pids_limit"] > 0, name
        assert service["read_only"], name
        assert service["cap_drop"] == ["ALL"], name
        assert service["security_opt"] == ["no-new-privileges:true"], name


def test_the_second_robot_is_the_first_under_another_name() -> None:
    both = services(BASE, profile="two-robots")
    assert set(both) == {*BUS, "sim-2", "vision-2", "control-2"}
    for name in ("sim", "vision", "control"):
        first, second = both[name], both[f"{name}-2"]
        assert second["environment"] == own_cameras(first["environment"]) | {"ARMSIGHT_NAMESPACE": "robots/arm-2"}
        for said in ("image", "command", "mem_limit", "tmpfs", "read_only", "cap_drop"):
            assert second.get(said) == first.get(said), (name, said)


def test_shared_memory_is_one_for_all_that_use_the_bus() -> None:
    for name, service in services(BASE, "docker-compose.shm.yml", profile="two-robots").items():
        (shared,) = service["volumes"]
        assert shared["source"] == "frames", name
        assert shared["target"] == "/dev/shm", name  # noqa: S108  where Zenoh's segments are
        assert (service.get("environment") or {}).get("ARMSIGHT_SHARED_MEMORY", "") == "", name


def test_plain_router_is_open_on_purpose_and_the_secure_one_is_not() -> None:
    assert "--insecure-bind" in services(BASE)["router"]["command"]
    assert "--insecure-bind" not in services(BASE, SECURE)["router"]["command"]


def test_secure_bus_is_tls_alone_and_everybody_has_only_what_is_his() -> None:
    secure = services(BASE, SECURE)
    assert "tcp/" not in json.dumps(secure)
    for name in BUS:
        (own,) = secure[name]["volumes"]
        assert own["source"] == str(ROOT / "certs" / ("operator" if name == "page" else name))
        assert (own["target"], own["read_only"]) == ("/etc/armsight", True)
        assert secure[name]["environment"]["ARMSIGHT_ZENOH_CONFIG"] == f"/etc/armsight/{CONFIGURATION}"
    assert {secure[name]["environment"]["ARMSIGHT_CONNECT"] for name in BUS[1:]} == {"tls/router:7447"}
    # with the owner of the keys, who alone can read them
    owned = services(BASE, SECURE, ARMSIGHT_USER="1000:1000")
    assert {service["user"] for service in owned.values()} == {"1000:1000"}


def test_other_machines_reach_the_secure_router_when_told_to() -> None:
    secure = services(BASE, SECURE, ARMSIGHT_BIND="10.0.0.7")
    assert [port["host_ip"] for port in secure["router"]["ports"]] == ["10.0.0.7"]


def test_certificates_that_compose_makes_are_those_that_it_mounts(tmp_path: Path) -> None:
    maker = services(BASE, SECURE, profile="certs", ARMSIGHT_NAMESPACE="robots/left")["certs"]
    assert maker["network_mode"] == "none"
    (mounted,) = maker["volumes"]
    assert mounted["target"] == "/certs"
    command = [word.replace("/certs", str(tmp_path), 1) for word in maker["command"]]
    assert command[0] == "armsight"
    with pytest.raises(SystemExit) as ended:
        main(command[1:])
    assert not ended.value.code
    folder = Folder(tmp_path)
    assert set(folder.names()) == {*BEARERS, "camera", "recorder"}
    router = next(entry for entry in folder.entries() if entry.name == "router")
    assert {"router", "127.0.0.1"} <= set(router.hosts)  # as services and as its own health check call it
    for name in BEARERS[1:]:
        text = (tmp_path / name / CONFIGURATION).read_text(encoding="utf-8")
        assert '"namespace": "robots/left"' in text
        assert "tls/router:7447" in text
    assert "tls/0.0.0.0:7447" in (tmp_path / "router" / CONFIGURATION).read_text(encoding="utf-8")


@pytest.mark.parametrize("files", [(BASE,), (BASE, SECURE)], ids=["plain", "secure"])
def test_a_recorder_is_as_confined_as_the_others_and_asked_for_its_health(files: tuple[str, ...]) -> None:
    every = services(*files, profile="record")
    assert set(every) == {*BUS, "recorder"}
    recorder, operator = every["recorder"], every["operator"]
    for said in ("image", "environment", "mem_limit", "cpus", "pids_limit", "read_only", "cap_drop", "security_opt"):
        assert recorder[said] == operator[said], said
    assert "ports" not in recorder
    assert recorder["healthcheck"]["test"] == ["CMD", "armsight", "record", "--health"]
    assert recorder["restart"] == "on-failure:3", "a full disk stays full"
    writable = [volume for volume in recorder["volumes"] if not volume.get("read_only")]
    assert [(volume["source"], volume["target"]) for volume in writable] == [("recordings", "/recordings")]
    own = [volume["source"] for volume in recorder["volumes"] if volume.get("read_only")]
    assert own == ([str(ROOT / "certs" / "recorder")] if SECURE in files else [])


@pytest.mark.parametrize("files", [(BASE,), (BASE, SECURE)], ids=["plain", "secure"])
def test_cameras_are_as_confined_as_the_others_and_have_their_devices_alone(files: tuple[str, ...]) -> None:
    every = services(*files, profile="camera", ARMSIGHT_EXTERNAL_CAMERAS="1 2", ARMSIGHT_VIDEO_2="/dev/video7")
    assert set(every) == {*BUS, "camera"}
    camera, operator = every["camera"], every["operator"]
    for said in ("environment", "mem_limit", "cpus", "pids_limit", "read_only", "cap_drop", "security_opt"):
        assert camera[said] == operator[said], said
    assert "ports" not in camera
    assert [(device["source"], device["target"]) for device in camera["devices"]] == [
        ("/dev/video0", "/dev/video0"),
        ("/dev/video7", "/dev/video2"),
    ]
    assert camera["group_add"] == ["video"]
    command = ["armsight-camera", "--calibration", "/camera/calibration.json"]
    assert camera["command"] == [*command, "--device", "/dev/video0", "--device", "/dev/video2"]
    assert all(volume["read_only"] for volume in camera["volumes"])
    places = {volume["target"]: volume["source"] for volume in camera["volumes"]}
    own = {"/etc/armsight": str(ROOT / "certs" / "camera")} if SECURE in files else {}
    assert places == {"/camera": str(ROOT / "camera")} | own
    assert every["sim"]["environment"][CAMERAS] == "1 2"


def test_sim_is_told_what_one_asks_for() -> None:
    assert services(BASE)["sim"]["command"] == ["armsight-sim", "--target", "default"]
    every = services(BASE, profile="two-robots", ARMSIGHT_SIM="--target visible --fps 15")
    for name in ("sim", "sim-2"):
        assert every[name]["command"] == ["armsight-sim", "--target", "visible", "--fps", "15"]


def test_sim_draws_its_own_cameras_unless_told_otherwise(either: Services) -> None:
    assert either["sim"]["environment"][CAMERAS] == ""


def test_two_machines_have_each_service_once_and_a_router_each() -> None:
    edge = services(BASE, SECURE, EDGE, ARMSIGHT_CENTER="center.local", ARMSIGHT_CENTER_PORT="17447")
    center = services(BASE, SECURE, CENTER, ARMSIGHT_BIND="10.0.0.7")
    assert set(edge) == {"router", "sim", "vision"}
    assert set(center) == {"router", "control", "operator", "page"}
    assert edge["router"]["command"][-1] == "--connect=tls/center.local:17447"
    assert not [word for word in center["router"]["command"] if word.startswith("--connect")]
    # the robot's machine is reached by nobody, the other at the address that was said
    assert [port["host_ip"] for port in edge["router"]["ports"]] == ["127.0.0.1"]
    assert [port["host_ip"] for port in center["router"]["ports"]] == ["10.0.0.7"]
    own = {name: machine["router"]["volumes"] for name, machine in (("edge", edge), ("router", center))}
    for name, volumes in own.items():
        assert [volume["source"] for volume in volumes] == [str(ROOT / "certs" / name)]
    secure = services(BASE, SECURE)
    for name, service in (edge | center).items():
        if name != "router":
            assert service == secure[name], name


def test_second_robot_with_certificates_is_the_second_robot() -> None:
    both = services(BASE, SECURE, profile="two-robots")
    for name in ("sim", "vision", "control"):
        first, second = both[name], both[f"{name}-2"]
        assert second["environment"] == own_cameras(first["environment"]) | {"ARMSIGHT_NAMESPACE": "robots/arm-2"}
        for said in ("image", "command", "mem_limit", "tmpfs", "read_only", "cap_drop", "volumes", "user"):
            assert second.get(said) == first.get(said), (name, said)
