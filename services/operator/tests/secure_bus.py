"""A router with certificates and rights on the loopback interface, and places on its bus for every bearer."""

import threading
from collections.abc import Mapping
from pathlib import Path

import zenoh

from armsight.bus import Bus
from armsight.session import DEFAULT_NAMESPACE, SessionConfig, open_session
from armsight.topics import WHO
from armsight_operator.certs.configuration import configurations
from armsight_operator.certs.folder import Folder
from armsight_operator.certs.layout import CONFIGURATION, ROUTER
from armsight_operator.stack import free_port

HOST = "127.0.0.1"
BEARERS = {ROUTER: ROUTER} | {name: name for name in WHO}


class SecureBus:
    """Certificates in a folder, a router that may come and go, sessions that are closed at the end."""

    def __init__(self, path: Path, bearers: Mapping[str, str] = BEARERS) -> None:
        """Makes certificates and configurations; nothing runs yet."""
        self.folder = Folder(path)
        self.endpoint = f"tls/{HOST}:{free_port()}"
        self._router: zenoh.Session | None = None
        self._opened: list[zenoh.Session] = []
        self.folder.make(bearers, [HOST], days=90, ca_days=3650)
        self.configure()

    def configure(self) -> None:
        texts = configurations(self.folder.roles(), [self.endpoint], [self.endpoint], [DEFAULT_NAMESPACE])
        for name, text in texts.items():
            self.folder.write_configuration(name, text)

    def file(self, name: str) -> Path:
        return self.folder.path / name / CONFIGURATION

    def config(self, name: str, endpoint: str = "") -> SessionConfig:
        return SessionConfig(endpoints=(endpoint or self.endpoint,), shared_memory="off", file=self.file(name))

    def start_router(self) -> None:
        config = SessionConfig(
            mode="router", endpoints=(self.endpoint,), namespace="", shared_memory="off", file=self.file(ROUTER)
        )
        self._router = open_session(config, threading.Event())
        assert self._router is not None

    def stop_router(self) -> None:
        if self._router is not None:
            self._router.close()  # type: ignore[no-untyped-call]

    def bus(self, name: str) -> Bus:
        session = open_session(self.config(name), threading.Event())
        assert session is not None
        self._opened.append(session)
        return Bus(session)

    def close(self) -> None:
        for session in self._opened:
            session.close()  # type: ignore[no-untyped-call]
        self.stop_router()
