"""Why a router can't be joined over TLS: Zenoh itself only says that it took too long.

A handshake of our own, with the same files, tells what either side has against the other's certificate.
"""

import json
import socket
import ssl
from dataclasses import dataclass

import zenoh

from armsight.endpoints import host_and_port

_TIMEOUT_S = 1.0

SETTINGS = "transport/link/tls"
"""Where Zenoh's configuration has everything of TLS."""

_OURS = {
    "CERTIFICATE_REQUIRED": "the router wants a certificate, and we show none: set connect_certificate and "
    "connect_private_key (a folder of `armsight certs make` has both)",
    "CERTIFICATE_EXPIRED": "our certificate {certificate} has expired: `armsight certs renew`",
    "UNKNOWN_CA": "our certificate {certificate} is not signed by the router's CA",
    "DECRYPT_ERROR": "our certificate {certificate} is not signed by the router's CA",
}
"""What the router has against us, by the name of its alert."""

_NO_TLS = "what listens there speaks no TLS: connect to tcp/…, or start the router with its --zenoh-config"

_EXPIRED, _PURPOSE, _HOST_MISMATCH, _ADDRESS_MISMATCH = 10, 26, 62, 64
"""OpenSSL's codes of what we have against the router."""


@dataclass(frozen=True, slots=True)
class TlsFiles:
    """What a session shows and trusts; empty: nothing."""

    ca: str
    certificate: str
    key: str


def tls_files(settings: zenoh.Config) -> TlsFiles:
    """The files that a session connects with."""

    def get(name: str) -> str:
        return str(json.loads(settings.get_json(f"{SETTINGS}/{name}")) or "")

    return TlsFiles(get("root_ca_certificate"), get("connect_certificate"), get("connect_private_key"))


def why_refused(endpoint: str, files: TlsFiles) -> str:
    """What keeps a client from joining the router at an endpoint; empty where certificates are not the reason."""
    protocol, _, address = endpoint.partition("/")
    host, port = host_and_port(address)
    try:
        if protocol == "tls":
            return _refusal(host, int(port), files)
        if protocol == "tcp" and _speaks_tls(host, int(port)):
            return f"the router there wants certificates: connect to tls/{address} with --zenoh-config"
    except (OSError, ValueError):  # nothing listens, or it isn't an address: no matter of certificates
        pass
    return ""


def _refusal(host: str, port: int, files: TlsFiles) -> str:
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    try:
        if files.ca:
            context.load_verify_locations(files.ca)
        else:
            context.load_default_certs()
        if files.certificate:
            context.load_cert_chain(files.certificate, files.key or None)
    except ssl.SSLError as error:
        return f"{files.ca}, {files.certificate} and {files.key} don't fit together: {error.reason or 'not PEM files'}"
    with socket.create_connection((host, port), _TIMEOUT_S) as plain:
        try:
            link = context.wrap_socket(plain, server_hostname=host)
        except TimeoutError:  # a router without TLS waits for the rest of what it takes for its own
            return _NO_TLS
        except ssl.SSLCertVerificationError as error:
            return _theirs(error, host, files)
        except ssl.SSLError as error:
            return _ours(error, files)
        with link:
            try:
                link.recv(1)  # only now comes what the router has against our certificate
            except TimeoutError:
                return ""
            except ssl.SSLError as error:
                return _ours(error, files)
    return ""


def _theirs(error: ssl.SSLCertVerificationError, host: str, files: TlsFiles) -> str:
    if error.verify_code == _EXPIRED:
        return "the router's certificate has expired: `armsight certs renew router`, then start the router again"
    if error.verify_code == _PURPOSE:
        return f"what listens at {host} has no router's certificate: another bearer's key is in use there"
    if error.verify_code in (_HOST_MISMATCH, _ADDRESS_MISMATCH):
        return f"the router's certificate is not for {host}: `armsight certs renew router --host {host}`"
    return f"the router's certificate is not signed by our CA, {files.ca or 'which is not set: root_ca_certificate'}"


def _ours(error: ssl.SSLError, files: TlsFiles) -> str:
    reason = error.reason or ""
    if "WRONG_VERSION_NUMBER" in reason:
        return _NO_TLS
    text = next((text for alert, text in _OURS.items() if alert in reason), "")
    return text.format(certificate=files.certificate) if text else f"TLS failed: {reason.lower().replace('_', ' ')}"


def _speaks_tls(host: str, port: int) -> bool:
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname = False
    context.verify_mode = ssl.CERT_NONE  # nothing is sent: only whether it answers in TLS
    with socket.create_connection((host, port), _TIMEOUT_S) as plain:
        try:
            with context.wrap_socket(plain, server_hostname=host) as link:
                return link.version() is not None
        except (ssl.SSLError, TimeoutError):
            return False
