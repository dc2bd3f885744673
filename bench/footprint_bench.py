"""What each part takes: its time to start, its memory, its share of the processors, its image's size.

Writes results/footprint.json. Each service is started when those that it waits for are well, and timed until it says
so of itself (the router: until it listens, the page: until it answers). Then the loop runs with all of them.
"""

import json
import shutil
import socket
import statistics
import subprocess
import time
from contextlib import suppress
from dataclasses import replace

from processes import memory, processor_s
from running import bus_of, until

from armsight import topics
from armsight.bus import Bus
from armsight.v1.health_pb2 import HEALTH_STATUS_OK
from armsight_operator.stack import Stack
from results import Result, publish

SERVICES = ("sim", "vision", "control")
ROUNDS = 3
LIGHT = "closed-form"
LOOP_SECONDS = 20.0
IMAGES = ("sim", "vision", "control", "camera", "operator")


def listens(port: int) -> bool:
    """Whether somebody takes connections there."""
    with suppress(OSError), socket.create_connection(("127.0.0.1", port), timeout=0.2):
        return True
    return False


def start_up_s(stack: Stack, bus: Bus | None, name: str) -> float:
    """Starts one process and waits for its word."""
    health = None if bus is None else bus.subscriber(topics.HEALTH, name)
    began = time.monotonic()
    stack.start(name)
    if health is None:
        port = stack.page_port if name == "page" else stack.port
        assert port is not None
        until(lambda: listens(port), f"{name} listens")
    else:
        until(lambda: health.latest is not None and health.latest.message.status == HEALTH_STATUS_OK, f"{name} is well")
        health.close()
    return time.monotonic() - began


def measure_processes() -> list[Result]:
    """Start-up as the median of some rounds; memory and processors while the arm follows its target in the last."""
    times: dict[str, list[float]] = {}
    rows: list[Result] = []
    for _ in range(ROUNDS):
        with Stack(target="default", mode="track", page_port=0) as stack:
            times.setdefault("router", []).append(start_up_s(stack, None, "router"))
            with bus_of(stack.endpoint, stack.namespace) as bus:
                for name in SERVICES:
                    times.setdefault(name, []).append(start_up_s(stack, bus, name))
            times.setdefault("page", []).append(start_up_s(stack, None, "page"))
            if len(times["page"]) == ROUNDS:
                rows = measure_loop(stack)
    started = [
        Result(f"{name}: start-up", statistics.median(each), "s", "", None, "", None) for name, each in times.items()
    ]
    return started + rows


def measure_light_control() -> list[Result]:
    """The same of control without torch, once."""
    with Stack(target="default", mode="track", extra={"control": ["--solver", LIGHT]}) as stack:
        stack.start("router")
        with bus_of(stack.endpoint, stack.namespace) as bus:
            for name in SERVICES:
                started_s = start_up_s(stack, bus, name)
        title = f"control --solver {LIGHT}"
        rows = [row for row in measure_loop(stack) if row.name.startswith("control: ")]
    rows.insert(0, Result("control: start-up", started_s, "s", "", None, "", None))
    return [replace(row, name=row.name.replace("control", title, 1)) for row in rows]


def measure_loop(stack: Stack) -> list[Result]:
    """Of every process, while the loop runs at 30 Hz."""
    pids = {name: process.pid for name in stack.names if (process := stack.process(name)) is not None}
    before, began = {name: processor_s([pid]) for name, pid in pids.items()}, time.monotonic()
    time.sleep(LOOP_SECONDS)
    took_s = time.monotonic() - began
    rows = []
    for name, pid in pids.items():
        share, told = (processor_s([pid]) - before[name]) / took_s, memory(pid)
        rows += [
            Result(f"{name}: memory, PSS", told.pss_mb, "MB", "", None, "", None),
            Result(f"{name}: memory, RSS", told.rss_mb, "MB", "", None, "", None),
            Result(f"{name}: processors at 30 Hz", 100 * share, "% of a core", "", None, "", None),
        ]
    return rows


def measure_images() -> list[Result]:
    """What a Docker daemon says of the images; nothing, and a word about it, where none answers or none are built."""
    docker = shutil.which("docker")
    if docker is None:
        print("sizes of images left out: there is no docker")
        return []
    names = [f"armsight/{name}" for name in IMAGES]
    asked = subprocess.run([docker, "image", "inspect", *names], capture_output=True, text=True, check=False)
    found = json.loads(asked.stdout or "[]")
    if not found:
        print(f"sizes of images left out: {asked.stderr.strip().splitlines()[0]}")
    return [
        Result(f"image {each['RepoTags'][0]}", each["Size"] / 1e6, "MB", "", None, "", None)
        for each in found
        if each["RepoTags"]
    ]


if __name__ == "__main__":
    publish("footprint", [*measure_processes(), *measure_light_control(), *measure_images()])
