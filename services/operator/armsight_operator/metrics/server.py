"""The metrics over HTTP: `/metrics`, and `/healthz` for whoever watches this process itself."""

import socket
import threading
from collections.abc import Callable, Iterable
from socketserver import ThreadingMixIn
from types import TracebackType
from typing import Any, Self
from wsgiref.simple_server import WSGIRequestHandler, WSGIServer, make_server

from prometheus_client import CollectorRegistry, make_wsgi_app

from armsight_operator.errors import PortInUseError

_REQUEST_S = 5.0
"""Somebody who sends half a request is not waited for any longer."""
_MOST_AT_ONCE = 16

_Answer = Iterable[bytes]
_Application = Callable[[dict[str, Any], Callable[..., Any]], _Answer]


class MetricsServer:
    """Serves until it is left."""

    def __init__(self, host: str, port: int, registry: CollectorRegistry, connected: Callable[[], bool]) -> None:
        """Listens at once; port 0 takes a free one.

        Raises:
            PortInUseError: it can't listen there.
        """
        application = _application(make_wsgi_app(registry), connected)
        kind = _Server6 if ":" in host else _Server
        try:
            self._server = make_server(host, port, application, kind, _Handler)
        except OSError as error:
            raise PortInUseError(
                f"can't serve metrics on {host} port {port}: {error.strerror or error}; choose another with --port"
            ) from error
        self._thread = threading.Thread(target=self._server.serve_forever, args=(0.1,), name="metrics", daemon=True)
        self._thread.start()

    @property
    def url(self) -> str:
        """Where they are."""
        host, port = self._server.server_address[:2]
        return f"http://{f'[{host!s}]' if ':' in str(host) else str(host)}:{port}/metrics"

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._server.shutdown()
        self._server.server_close()
        self._thread.join(timeout=1.0)


def _application(serve_metrics: Any, connected: Callable[[], bool]) -> _Application:
    def answer(environ: dict[str, Any], start_response: Callable[..., Any]) -> _Answer:
        match environ["PATH_INFO"]:
            case "/metrics" | "/":
                return serve_metrics(environ, start_response)  # type: ignore[no-any-return]
            case "/healthz":
                here = connected()
                start_response("200 OK" if here else "503 Service Unavailable", [("Content-Type", "text/plain")])
                return [b"ok\n" if here else b"no router yet, or no longer\n"]
        start_response("404 Not Found", [("Content-Type", "text/plain")])
        return [b"metrics are at /metrics\n"]

    return answer


class _Server(ThreadingMixIn, WSGIServer):
    daemon_threads = True
    block_on_close = False  # SIGTERM waits for nobody who reads slowly

    def __init__(self, *arguments: Any, **options: Any) -> None:
        self._places = threading.BoundedSemaphore(_MOST_AT_ONCE)
        super().__init__(*arguments, **options)

    def server_bind(self) -> None:
        # not HTTPServer's: it asks for this host's name, which may take seconds
        self.socket.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        self.socket.bind(self.server_address)
        self.server_address = self.socket.getsockname()
        self.server_name, self.server_port = str(self.server_address[0]), int(self.server_address[1])
        self.setup_environ()

    def process_request(self, request: Any, client_address: Any) -> None:
        if not self._places.acquire(blocking=False):
            self.shutdown_request(request)
            return
        super().process_request(request, client_address)

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        try:
            super().process_request_thread(request, client_address)
        finally:
            self._places.release()

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Somebody hung up in the middle: nothing that anybody must read of."""


class _Server6(_Server):
    address_family = socket.AF_INET6


class _Handler(WSGIRequestHandler):
    timeout = _REQUEST_S

    def log_message(self, format: str, *args: Any) -> None:  # noqa: A002
        """Scrapes are not logged."""
