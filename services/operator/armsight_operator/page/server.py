"""The web server: viser, on this machine alone unless told otherwise, for its own pages alone, and soon gone."""

import logging
import os
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from http import HTTPStatus
from types import TracebackType
from typing import Any, Self

import rich
import viser
import websockets.asyncio.server

from armsight.errors import ConfigError
from armsight_operator.errors import PortInUseError
from armsight_operator.exposure import is_own_page

log = logging.getLogger(__name__)

_STOP_S = 1.0
"""A browser that does not say goodbye is not waited for longer."""

_PORT_OVERRIDE = "_VISER_PORT_OVERRIDE"


class _Viser(viser.ViserServer):
    """Without the way around every firewall that viewers could ask for."""

    def request_share_url(self, verbose: bool = True) -> str | None:
        """Never: whoever has the address moves the arm."""
        del verbose
        log.warning("refused to share the page with the internet")
        return None


class Server:
    """A running server and its viewers.

    Args:
        host: address to listen on.
        port: 0 takes a free one.

    Raises:
        ConfigError: the address is none of this machine.
        PortInUseError: somebody else listens there.
    """

    def __init__(self, host: str, port: int) -> None:
        """Starts listening."""
        check_bindable(host, port)
        # viser prints to the terminal, whoever asks
        rich.reconfigure(quiet=True)
        # what browsers get wrong is theirs: other sites are refused with a line of ours
        logging.getLogger("websockets").setLevel(logging.CRITICAL)
        os.environ.pop(_PORT_OVERRIDE, None)
        names = {"localhost", host.lower(), socket.gethostname().lower()}
        with _only_own_pages(lambda headers: is_own_page(headers.get("Host", ""), headers.get("Origin"), names)):
            self.viser = _Viser(host=host, port=port, verbose=False)
        self.host = host
        self.port: int = self.viser.get_port()
        if port not in (0, self.port):  # viser takes the next one that is free
            self.close()
            raise _taken(host, port, "in use")

    @property
    def address(self) -> str:
        """For a browser of this machine."""
        host = {"0.0.0.0": "127.0.0.1", "::": "::1"}.get(self.host, self.host)  # noqa: S104
        return f"http://{f'[{host}]' if ':' in host else host}:{self.port}"

    @property
    def viewers(self) -> int:
        """How many browsers look."""
        return len(self.viser.get_clients())

    def close(self) -> None:
        """Ends the server and its threads; a browser that hangs is left to the end of the process."""
        thread = threading.Thread(target=self.viser.stop, name="stop page", daemon=True)
        thread.start()
        thread.join(timeout=_STOP_S)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.close()


def check_bindable(host: str, port: int) -> None:
    """Whether a server can listen there.

    Raises:
        ConfigError: the address is none of this machine.
        PortInUseError: somebody else listens there.
    """
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
    except (OSError, UnicodeError) as error:
        raise ConfigError(f"--host {host!r} is no address: {error}; 127.0.0.1 is this machine alone") from error
    with socket.socket(family, kind, protocol) as probe:
        # as the server does it: what is left of closed connections is not in the way
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind(address)
        except OSError as error:
            raise _taken(host, port, error.strerror or "in use") from error


def _taken(host: str, port: int, reason: str) -> PortInUseError:
    return PortInUseError(
        f"the page can't be served at {host}:{port} ({reason}): does another one run? "
        "Choose another --port (`armsight up`: --page-port, or --no-page)"
    )


@contextmanager
def _only_own_pages(is_own: Callable[[Any], bool]) -> Iterator[None]:
    """While a server starts: makes it answer only browsers that show a page of its own.

    viser has no option for this, and any page on the web may open a connection to 127.0.0.1: it would move the arm.
    """
    module = websockets.asyncio.server
    serve = module.serve

    def guarded(handler: Any, host: str, port: int, *, process_request: Any, **options: Any) -> Any:
        def check(connection: Any, request: Any) -> Any:
            if not is_own(request.headers):
                log.warning("refused a connection of another site", extra={"origin": request.headers.get("Origin")})
                return connection.respond(HTTPStatus.FORBIDDEN, "only for pages of this server\n")
            return process_request(connection, request)

        return serve(handler, host, port, process_request=check, **options)

    setattr(module, "serve", guarded)  # noqa: B010
    try:
        yield
    finally:
        setattr(module, "serve", serve)  # noqa: B010
