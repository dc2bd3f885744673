"""All checks in order: what was found out goes into pure functions, what they say comes out."""

import os
import sys
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from armsight.endpoints import host_and_port, is_local
from armsight.service import VERSION
from armsight.session import SessionConfig
from armsight.shared_memory import POOL_BYTES, SESSION_BYTES, free_bytes
from armsight_operator.doctor import facts, machine, network, software
from armsight_operator.doctor.finding import Finding
from armsight_operator.errors import MissingExecutableError
from armsight_operator.stack.executables import VISION_VARIABLE, find_executable, repository_root

_HELP_S = 10.0


def examine(config: SessionConfig, ports: Mapping[int, str]) -> list[Finding]:
    """Looks at everything; takes as long as torch's import.

    Args:
        config: where the bus is.
        ports: of this machine, with the commands that serve there.
    """
    with ThreadPoolExecutor(max_workers=5, thread_name_prefix="doctor") as pool:
        graphics, solvers = pool.submit(facts.graphics), pool.submit(facts.compiled_solvers)
        docker, bus, vision = pool.submit(facts.docker), pool.submit(facts.bus, config), pool.submit(_vision)
        findings = _machine()
        seen_vision, vision_zenoh = vision.result()
        findings += [
            software.python(sys.version_info[:3], sys.executable),
            _packages(),
            software.zenoh(facts.installed_version("eclipse-zenoh"), vision_zenoh),
            seen_vision,
            software.gl(graphics.result()),
            software.solvers(solvers.result()),
        ]
        heard = bus.result()
        findings += _ports(heard, ports)
        findings += [network.router(heard), *network.services(heard, VERSION)]
        daemon = docker.result()
    version = daemon.out.strip() if daemon.code == 0 else ""
    return [*findings, machine.docker(version, daemon.last_line)]


def _machine() -> list[Finding]:
    here = Path.cwd()
    return [
        machine.clock(facts.clock()),
        machine.memory_lock(*facts.memory_lock()),
        machine.shared_memory(free_bytes(), POOL_BYTES + SESSION_BYTES),
        machine.disk(facts.free_disk(here), str(here)),
    ]


def _packages() -> Finding:
    pinned = facts.pinned(repository_root())
    if pinned is None:
        return software.needed_packages(facts.unmet())
    return software.packages(pinned, facts.installed())


def _vision() -> tuple[Finding, str]:
    try:
        executable = find_executable("vision")
    except MissingExecutableError as error:
        expected = VISION_VARIABLE in os.environ or (repository_root() / "services" / "vision_cpp").is_dir()
        return software.vision("", str(error), None, expected=expected), ""
    answer = facts.ask([str(executable), "--help"], _HELP_S)
    return software.vision(str(executable), "", answer, expected=True), facts.zenoh_of(executable)


def _ports(heard: network.BusFacts, ports: Mapping[int, str]) -> list[Finding]:
    found = []
    for endpoint in heard.endpoints:
        _, port = host_and_port(endpoint.partition("/")[2])
        if is_local(endpoint) and port.isdigit():
            number = int(port)
            let_in = heard.connected or bool(heard.refusal)
            found.append(machine.port(number, "the router", "--port", facts.holder(number), ours=let_in))
    for number, command in ports.items():
        holder = facts.holder(number)
        ours = holder is not None and command in holder.command
        found.append(machine.port(number, f"`{command}`", "--port", holder, ours=ours))
    return found
