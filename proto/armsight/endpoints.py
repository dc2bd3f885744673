"""What Zenoh's endpoints say: PROTOCOL/ADDRESS, metadata after a ?, settings of this one alone after a #."""

import ipaddress
import re

_WITH_PORT = ("tcp", "udp", "tls", "quic", "ws")
"""Protocols whose address is a host and a port; what others want only Zenoh knows."""

_IN_FILE_SYSTEM = ("unixsock-stream", "unixpipe")
_WITH_SEND_BUFFER = ("tcp", "tls")
_SEND_BUFFER = "so_sndbuf"


def is_endpoint(text: str) -> bool:
    """Whether Zenoh could make something of it."""
    protocol, _, address = text.partition("/")
    if protocol not in _WITH_PORT:
        return bool(protocol and address)
    host, port = host_and_port(address)
    return bool(host) and bool(re.fullmatch(r"[0-9]{1,5}", port)) and 0 < int(port) < 65536


def host_and_port(address: str) -> tuple[str, str]:
    """The parts of HOST:PORT, without an endpoint's options and the brackets of an IPv6 address."""
    host, _, port = re.split(r"[?#]", address, maxsplit=1)[0].rpartition(":")
    return host.strip("[]"), port


def is_local(endpoint: str) -> bool:
    """Whether only processes of this machine can connect there."""
    protocol, _, address = endpoint.partition("/")
    if protocol in _IN_FILE_SYSTEM:
        return True
    host, _ = host_and_port(address)
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def with_send_buffer(endpoint: str, size: int) -> str:
    """The endpoint with a send buffer of the kernel's, in bytes, unless it says one or has none."""
    if endpoint.partition("/")[0] not in _WITH_SEND_BUFFER or f"{_SEND_BUFFER}=" in endpoint:
        return endpoint
    return f"{endpoint}{';' if '#' in endpoint else '#'}{_SEND_BUFFER}={size}"
