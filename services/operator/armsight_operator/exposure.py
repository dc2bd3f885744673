"""Who could reach what listens at an endpoint, and whether they would have to prove who they are."""

import ipaddress
from collections.abc import Collection, Sequence
from urllib.parse import urlsplit

from armsight.endpoints import host_and_port, is_local
from armsight_operator.errors import InsecureBindError

_WITH_CERTIFICATES = ("tls", "quic")
_MUTUAL = "enable_mtls"


def check_exposure(endpoints: Sequence[str], *, mutual_tls: bool, links: Sequence[str] = ()) -> None:
    """Refuses endpoints at which anybody on the network could command the arm.

    Args:
        endpoints: where a router is to listen.
        mutual_tls: whether it lets nobody in without a certificate of its own CA, where it speaks TLS.
        links: other routers that it is to connect to.

    Raises:
        InsecureBindError: an endpoint that other machines reach, or a router on one, without certificates.
    """
    for endpoint in endpoints:
        if not _is_safe(endpoint, mutual_tls=mutual_tls):
            raise InsecureBindError(
                f"{endpoint} is open to every machine that reaches this one, without certificates: whoever connects "
                "moves the arm. Listen on 127.0.0.1, or with certificates (`armsight certs make`, docs/security.md), "
                "or say --insecure-bind"
            )
    for link in links:
        if not _is_safe(link, mutual_tls=mutual_tls):
            raise InsecureBindError(
                f"a link to {link} has no certificates: whoever connects to the router there moves the arm here. "
                "Link with certificates (`armsight certs make --router`, docs/deploy.md), or say --insecure-bind"
            )


def check_host_exposure(host: str, what: str, risk: str, instead: str = "") -> None:
    """Refuses an address that other machines reach, for what asks nobody who they are.

    Args:
        host: name or address to listen at.
        what: is served there.
        risk: what anybody can do who reaches it.
        instead: another way to come to it from outside, if there is one.

    Raises:
        InsecureBindError: other machines reach it.
    """
    if not is_local(f"tcp/{f'[{host}]' if ':' in host else host}:1"):
        raise InsecureBindError(
            f"{what} at {host or 'every address'} is open to every machine that reaches this one, without "
            f"certificates: {risk}. Listen on 127.0.0.1{instead and f' and {instead}'}, or say --insecure-bind"
        )


def is_own_page(host: str, origin: str | None, names: Collection[str]) -> bool:
    """Whether a request comes from a page that we served ourselves.

    Any site that a browser shows may connect to this machine, and name an address of its own for it: neither is ours.

    Args:
        host: what the browser takes us for, as HOST or HOST:PORT.
        origin: of the page that asks; programs that are no browsers give none.
        names: of ours, in lower case; addresses in numbers are nobody else's anyway.
    """
    try:
        name = (urlsplit(f"//{host}").hostname or "").lower()
        theirs = urlsplit(origin).netloc.lower() if origin is not None else host.lower()
    except ValueError:
        return False
    return theirs == host.lower() and (name in names or _is_number(name))


def _is_number(name: str) -> bool:
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True


def _is_safe(endpoint: str, *, mutual_tls: bool) -> bool:
    return is_local(endpoint) or _wants_certificates(endpoint, mutual_tls=mutual_tls)


def _wants_certificates(endpoint: str, *, mutual_tls: bool) -> bool:
    """What stands after # configures this endpoint alone, and wins over the file."""
    if endpoint.partition("/")[0] not in _WITH_CERTIFICATES:
        return False
    pairs = [pair.partition("=") for pair in endpoint.partition("#")[2].split(";")]
    own = [value == "true" for name, _, value in pairs if name == _MUTUAL]
    return all(own) if own else mutual_tls


def reachable_from_here(endpoint: str) -> str:
    """Where this machine connects to what listens at an endpoint: every address is also the loopback's."""
    protocol, _, address = endpoint.partition("/")
    host, port = host_and_port(address)
    try:
        is_every = ipaddress.ip_address(host).is_unspecified
    except ValueError:
        return endpoint
    if not is_every:
        return endpoint
    loopback = "[::1]" if ":" in host else "127.0.0.1"
    return f"{protocol}/{loopback}:{port}"
