"""A router with certificates and rights on the loopback interface, or two, and places on their bus for every bearer."""

import threading
from collections.abc import Mapping, Sequence
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import zenoh
from cryptography import x509
from cryptography.hazmat.primitives import serialization

from armsight.bus import Bus
from armsight.session import DEFAULT_NAMESPACE, SessionConfig, open_session, zenoh_settings
from armsight.topics import WHO
from armsight_operator.certs import authority
from armsight_operator.certs.configuration import configurations
from armsight_operator.certs.folder import Folder
from armsight_operator.certs.layout import CERTIFICATE, CONFIGURATION, ROUTER
from armsight_operator.stack import free_port

HOST = "127.0.0.1"
BEARERS = {ROUTER: ROUTER} | {name: name for name in WHO}


EDGE = "edge"
"""The second router's name."""


class SecureBus:
    """Certificates in a folder, routers that may come and go, sessions that are closed at the end."""

    def __init__(self, path: Path, bearers: Mapping[str, str] = BEARERS, behind_edge: Sequence[str] = ()) -> None:
        """Makes certificates and configurations; nothing runs yet.

        Args:
            path: folder for them.
            bearers: role by name.
            behind_edge: roles whose bearers connect to a second router, which connects to the first; none: one router.
        """
        self.folder = Folder(path)
        self.endpoint = f"tls/{HOST}:{free_port()}"
        self.edge = f"tls/{HOST}:{free_port()}"
        self._roles, self._behind_edge = dict(bearers), tuple(behind_edge)
        self._routers: list[zenoh.Session] = []
        self._opened: list[zenoh.Session] = []
        self.folder.make(dict(bearers) | ({EDGE: ROUTER} if behind_edge else {}), [HOST], days=90, ca_days=3650)
        self.configure()

    def configure(self) -> None:
        routers = {EDGE: self._behind_edge} if self._behind_edge else {}
        texts = configurations(self.folder.roles(), [self.endpoint], [self.endpoint], [DEFAULT_NAMESPACE], routers)
        for name, text in texts.items():
            self.folder.write_configuration(name, text)

    def file(self, name: str) -> Path:
        return self.folder.path / name / CONFIGURATION

    def config(self, name: str, endpoint: str = "") -> SessionConfig:
        own = self.edge if self._roles.get(name) in self._behind_edge else self.endpoint
        return SessionConfig(endpoints=(endpoint or own,), shared_memory="off", file=self.file(name))

    def start_router(self) -> None:
        self._start(ROUTER, self.endpoint)
        if self._behind_edge:
            self._start(EDGE, self.edge, links=(self.endpoint,))

    def _start(self, name: str, endpoint: str, links: tuple[str, ...] = ()) -> None:
        config = SessionConfig(
            mode="router",
            endpoints=(endpoint,),
            links=links,
            namespace="",
            shared_memory="off",
            file=self.file(name),
        )
        router = open_session(config, threading.Event())
        assert router is not None
        self._routers.append(router)

    def stop_router(self) -> None:
        while self._routers:
            self._routers.pop().close()  # type: ignore[no-untyped-call]

    def bus(self, name: str) -> Bus:
        return Bus(self._session(self.config(name)))

    def outside(self, name: str) -> zenoh.Session:
        """A session with this bearer's certificate in no robot's namespace."""
        return self._session(replace(self.config(name), namespace=""))

    def _session(self, config: SessionConfig) -> zenoh.Session:
        session = open_session(config, threading.Event())
        assert session is not None
        self._opened.append(session)
        return session

    def close(self) -> None:
        for session in self._opened:
            session.close()  # type: ignore[no-untyped-call]
        self.stop_router()


def gets_in(config: SessionConfig, tries: int = 1) -> bool:
    """Whether a session opens."""
    for _ in range(tries):
        try:
            zenoh.open(zenoh_settings(config)).close()  # type: ignore[no-untyped-call]
        except zenoh.ZError:
            continue
        return True
    return False


def certify(folder: Folder, name: str, signer: Path, expires: datetime) -> None:
    """Puts a certificate with this expiry, by the authority in another folder or this, in the place of a bearer's."""
    ca = Folder(signer)._authority()
    file = folder.path / name / CERTIFICATE
    old = x509.load_pem_x509_certificate(file.read_bytes())
    made = authority.sign(
        ca,
        old.public_key(),  # type: ignore[arg-type]
        name,
        authority.role_of(old),
        authority.hosts_of(old),
        days=1,
        now=expires - timedelta(days=1),
        serves=authority.role_of(old) == ROUTER,
    )
    file.write_bytes(made.public_bytes(serialization.Encoding.PEM))


def an_hour_ago() -> datetime:
    return datetime.now(UTC) - timedelta(hours=1)
