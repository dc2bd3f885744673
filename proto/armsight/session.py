"""Opening a Zenoh session: client of a router, or the router itself; from flags, environment and a file.

A flag wins over its environment variable, that over the configuration file, that over the default.
"""

import argparse
import json
import logging
import os
import re
import sys
import threading
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import zenoh

from armsight import tls
from armsight.endpoints import is_endpoint, is_local, with_send_buffer
from armsight.errors import ConfigError
from armsight.shared_memory import Use, why_not

log = logging.getLogger(__name__)

DEFAULT_ENDPOINT = "tcp/127.0.0.1:7447"
DEFAULT_NAMESPACE = "robots/arm"

# Zenoh's own: under load the loss of frames at 30 Hz falls from a tenth to nothing.
_DATA_LOW_QUEUE = 16

_LATCHED_PATIENCE_MS = 1500
"""How long a lost answer keeps a reader of a latched value from asking again; our own queries say theirs."""

# Zenoh's own of 10 s leaves it to TCP to find out that the network is back, and TCP doubles its pauses: after 5 s of
# partition the arm went on after up to 2.5 s. A connection that was silent for so long is made anew; one that was
# silent for less is tried again by TCP before as much time again is over.
_LEASE_MS = 3000

# An attempt to connect that nobody answers: TCP asks again after 1 s and 2 s, then less and less often. Between 2.5 s
# and the next attempt's first try there is less than another second.
_OPEN_TIMEOUT_MS = 2500

# What a sender may have on its way. Left to itself Linux takes up to 4 MB of frames: where a link falls to 1 Mbit/s
# that is half a minute's worth, and with BBR, which stays at that pace, the arm went on up to 8 s after the link was
# fast again. An endpoint can say more, for frames over a long way: tls/HOST:PORT#so_sndbuf=4194304.
_SEND_BUFFER_BYTES = 131072

# Of a client to another machine: what a slow link's queue does not take gets lost, and TCP can need seconds to send it
# again. After 1 Mbit/s the arm went on in 4 s in two of a hundred cases with the above, in 0.6 s at most with this.
# Within a machine it would cost a pair of frames 1 ms.
_REMOTE_BUFFER_BYTES = 49152

# Of a router's link to another: what the kernel has taken no priority overtakes. Where somebody looks at pictures over
# 20 Mbit/s the loop went on at 23 Hz with 128 KiB, at 26 Hz with this.
_LINK_BUFFER_BYTES = 32768

# Of a router. Zenoh's own of 1000 turns away who comes then.
_MAX_SESSIONS = 10_000

_RETRY = {"period_init_ms": 100, "period_max_ms": 500, "period_increase_factor": 1.5}

_HINT_AFTER_ATTEMPTS = 4

# Errors, but not of what arrives for a subscription that has just ended, which happens at every end.
_ZENOH_LOG = "error,zenoh::api::session=off"

_TLS_FILES = (
    "root_ca_certificate",
    "listen_certificate",
    "listen_private_key",
    "connect_certificate",
    "connect_private_key",
)


@dataclass(frozen=True, slots=True)
class SessionConfig:
    """How one process joins the bus."""

    mode: Literal["client", "router"] = "client"
    endpoints: tuple[str, ...] = (DEFAULT_ENDPOINT,)
    """Where a client connects to, where a router listens."""
    links: tuple[str, ...] = ()
    """Other routers to which a router connects, and again whenever it loses them."""
    namespace: str = DEFAULT_NAMESPACE
    """Stands before every key; empty for a router, which serves all namespaces, and for who asks it about itself."""
    shared_memory: Use = "read"
    """Where this machine lets it: see :func:`open_session`."""
    file: Path | None = None
    """Zenoh configuration (JSON5) to start from, for TLS and access control; TLS files are named relative to it."""

    def __post_init__(self) -> None:
        """Refuses what Zenoh would refuse later and less clearly."""
        for endpoint in (*self.endpoints, *self.links):
            if not is_endpoint(endpoint):
                raise ConfigError(f"endpoint {endpoint!r} is not of the form tcp/HOST:PORT")
        if any(
            part in ("", "*", "**") or set(part) & set("*$?#") for part in self.namespace.split("/") if self.namespace
        ):
            raise ConfigError(f"namespace {self.namespace!r} is not a key such as {DEFAULT_NAMESPACE!r}")


def add_session_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the flags that every process on the bus has."""
    group = parser.add_argument_group("bus")
    group.add_argument(
        "--connect",
        metavar="ENDPOINT",
        action="append",
        help=f"router to connect to, may be given again (environment ARMSIGHT_CONNECT, default {DEFAULT_ENDPOINT})",
    )
    group.add_argument(
        "--namespace", help=f"the robot's name (environment ARMSIGHT_NAMESPACE, default {DEFAULT_NAMESPACE})"
    )
    group.add_argument(
        "--zenoh-config", metavar="FILE", type=Path, help="Zenoh JSON5 file (environment ARMSIGHT_ZENOH_CONFIG)"
    )


def session_config(arguments: argparse.Namespace, shared_memory: Use = "read") -> SessionConfig:
    """The configuration that flags, environment and file add up to.

    Raises:
        ConfigError: a value that can't be used.
    """
    file = arguments.zenoh_config or _path_from_environment("ARMSIGHT_ZENOH_CONFIG")
    connect = arguments.connect or [part for part in os.environ.get("ARMSIGHT_CONNECT", "").split(",") if part]
    namespace = arguments.namespace or os.environ.get("ARMSIGHT_NAMESPACE")
    in_file = _read_file(file) if file else None
    if not connect and file is not None:
        connect = endpoints_in_file(file, "connect", "client")
    if namespace is None and in_file is not None:
        namespace = json.loads(in_file.get_json("namespace"))
    return SessionConfig(
        endpoints=tuple(connect) or (DEFAULT_ENDPOINT,),
        namespace=namespace or DEFAULT_NAMESPACE,
        shared_memory="off" if os.environ.get("ARMSIGHT_SHARED_MEMORY") == "off" else shared_memory,
        file=file,
    )


def endpoints_in_file(file: Path, which: Literal["connect", "listen"], mode: Literal["client", "router"]) -> list[str]:
    """The endpoints that a Zenoh configuration names; none where it leaves them to Zenoh.

    Raises:
        ConfigError: what stands there are none.
    """
    path = f"{which}/endpoints"
    text = _read_file(file).get_json(path)
    if text == zenoh.Config().get_json(path):  # nothing there: Zenoh would listen on every address
        return []
    endpoints = json.loads(text) or []
    if isinstance(endpoints, dict):  # one list for each mode
        endpoints = endpoints.get(mode) or []
    if not isinstance(endpoints, list) or not all(isinstance(endpoint, str) for endpoint in endpoints):
        raise ConfigError(f"{file}: {path} is not a list of endpoints such as {DEFAULT_ENDPOINT!r}")
    return endpoints


def check_role(config: SessionConfig, service: str) -> None:
    """Whether a configuration of `armsight certs make` is a service's own: with another's it would be heard by nobody.

    Raises:
        ConfigError: it is another's.
    """
    if config.file is None:
        return
    metadata = json.loads(_read_file(config.file).get_json("metadata"))
    role = metadata.get("role") if isinstance(metadata, dict) else None
    if role not in (None, service):
        raise ConfigError(
            f"{config.file} and its certificate are for {role}, this is {service}: the router would let it do what "
            f"{role} may, and nothing else"
        )


def open_session(config: SessionConfig, stop: threading.Event) -> zenoh.Session | None:
    """Opens a session, waiting for the router as long as it takes; returns nothing once ``stop`` is set.

    Where shared memory is wanted and can't be had, it says why and goes without.

    Raises:
        ConfigError: Zenoh refuses the configuration, or a router can't listen.
    """
    _log_to_stderr()
    settings, known = None, ""
    attempt = 0
    while not stop.is_set():
        attempt += 1
        in_the_way = why_not(config.shared_memory)
        if settings is None or in_the_way != known:
            settings, known = zenoh_settings(replace(config, shared_memory="off") if in_the_way else config), in_the_way
            if in_the_way:
                log.warning("no shared memory: %s", in_the_way)
        try:
            return zenoh.open(settings)
        except zenoh.ZError as error:
            if config.mode == "router":
                raise ConfigError(f"can't listen on {', '.join(config.endpoints)}: {_reason(error)}") from error
            if attempt % 20 == _HINT_AFTER_ATTEMPTS:
                log.warning(
                    "no router at %s yet, still trying: %s",
                    ", ".join(config.endpoints),
                    refusal(config) or "start one with `armsight up` or `armsight router`; with a password, check it",
                    extra={"error": str(error)},
                )
        stop.wait(0.1)
    return None


def refusal(config: SessionConfig) -> str:
    """Why the router does not let this session in, where certificates are the reason; empty otherwise."""
    files = tls.tls_files(zenoh_settings(replace(config, shared_memory="off")))
    return next((reason for endpoint in config.endpoints if (reason := tls.why_refused(endpoint, files))), "")


def zenoh_settings(config: SessionConfig) -> zenoh.Config:
    """The Zenoh configuration of a session: the file's, with ours on top."""
    settings = _read_file(config.file) if config.file else zenoh.Config()

    def put(path: str, value: object) -> None:
        try:
            settings.insert_json5(path, json.dumps(value))
        except zenoh.ZError as error:
            raise ConfigError(f"zenoh refuses {path} = {value!r}: {_reason(error)}") from error

    put("mode", config.mode)
    put("scouting/multicast/enabled", False)
    put("scouting/gossip/enabled", False)
    put("transport/link/tx/queue/size/data_low", _DATA_LOW_QUEUE)
    put("queries_default_timeout", _LATCHED_PATIENCE_MS)
    put("transport/link/tx/lease", _LEASE_MS)
    put("transport/unicast/open_timeout", _OPEN_TIMEOUT_MS)
    for protocol in ("tcp", "tls"):
        put(f"transport/link/{protocol}/so_sndbuf", _SEND_BUFFER_BYTES)
    if config.mode == "router":
        put("listen/endpoints", list(config.endpoints))
        put("connect/endpoints", [with_send_buffer(link, _LINK_BUFFER_BYTES) for link in config.links])
        put("connect/exit_on_failure", False)  # it serves its own machine meanwhile
        put("transport/unicast/max_sessions", _MAX_SESSIONS)
        put("connect/retry", _RETRY)
        # whoever may ask learns who is connected: `armsight metrics`
        put("adminspace", {"enabled": True, "permissions": {"read": True, "write": False}})
    else:
        put("connect/endpoints", [_bounded(endpoint) for endpoint in config.endpoints])
        put("connect/timeout_ms", 500)
        put("connect/exit_on_failure", True)
        put("connect/retry", _RETRY)
        put("listen/endpoints", [])
        put("namespace", config.namespace or None)
    put("transport/shared_memory/enabled", config.shared_memory != "off")
    put("transport/shared_memory/transport_optimization/enabled", False)  # it copies: see frame_pool
    return settings


def _bounded(endpoint: str) -> str:
    return endpoint if is_local(endpoint) else with_send_buffer(endpoint, _REMOTE_BUFFER_BYTES)


def _log_to_stderr() -> None:
    """Starts Zenoh's own log, errors only unless RUST_LOG says otherwise.

    Zenoh writes it to file descriptor 1 and can't be told otherwise, in the middle of what a command prints for pipes.
    Descriptor 1 becomes stderr, and what Python prints goes on to where it pointed.
    """
    if sys.stdout is not sys.__stdout__ or sys.stdout is None:  # replaced: done before, or somebody captures it
        zenoh.init_log_from_env_or(_ZENOH_LOG)
        return
    sys.stdout.flush()
    stdout = os.fdopen(os.dup(1), "w", encoding=sys.stdout.encoding, errors=sys.stdout.errors, buffering=1)
    os.dup2(2, 1)
    sys.stdout = stdout
    zenoh.init_log_from_env_or(_ZENOH_LOG)


def _read_file(file: Path) -> zenoh.Config:
    try:
        settings = zenoh.Config.from_file(str(file))
    except zenoh.ZError as error:
        raise ConfigError(f"{file} is not a Zenoh configuration: {_reason(error)}") from error
    for name in _TLS_FILES:
        named = json.loads(settings.get_json(f"{tls.SETTINGS}/{name}"))
        if not named:
            continue
        path = file.parent.absolute() / named
        if not os.access(path, os.R_OK):  # Zenoh would try again for ever
            raise ConfigError(f"{file}: {name} {path} is missing or can't be read by this user")
        settings.insert_json5(f"{tls.SETTINGS}/{name}", json.dumps(str(path)))
    return settings


def _reason(error: zenoh.ZError) -> str:
    # where in Zenoh's sources it failed helps nobody who set an option
    return re.sub(r" at \S+\.rs:[0-9]+\.?", "", str(error))


def _path_from_environment(name: str) -> Path | None:
    value = os.environ.get(name)
    return Path(value) if value else None
