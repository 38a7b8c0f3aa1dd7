"""The server itself: WebSocket on loopback, one thread per client, one call at a time."""

import contextlib
import json
import logging
import threading
from collections.abc import Callable, Mapping

from websockets.exceptions import ConnectionClosed
from websockets.sync.server import Server, ServerConnection
from websockets.sync.server import serve as listen

from demoplan.engines.rosbridge.protocol import Service, answers
from demoplan.errors import UsageError

LOOPBACK = "127.0.0.1"
MOST_BYTES = 1 << 20
"""A longer message ends its client's connection."""

_SILENT = logging.getLogger("demoplan.rosbridge")
_SILENT.addHandler(logging.NullHandler())
_SILENT.propagate = False


class RunningServer:
    """A server that runs in a thread of its own; leave it with ``close``, or use it as a context."""

    def __init__(self, server: Server) -> None:
        """Run it."""
        self._server = server
        self.port = int(server.socket.getsockname()[1])
        self._is_ending = False
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def _serve(self) -> None:
        try:
            self._server.serve_forever()
        except (OSError, ValueError):
            # Its socket is closed when it ends, maybe before the thread has got to look at it.
            if not self._is_ending:
                raise

    def close(self) -> None:
        """End it; clients are told."""
        self._is_ending = True
        self._server.shutdown()
        self._thread.join(timeout=10.0)

    def wait(self) -> None:
        """Return when it has ended."""
        while self._thread.is_alive():
            self._thread.join(timeout=0.5)

    def __enter__(self) -> "RunningServer":
        """The server itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """End it."""
        self.close()


def start(services: Mapping[str, Service], *, port: int = 0) -> RunningServer:
    """Serve from a thread.

    Args:
        services: Name, with its leading slash → service. Calls of all clients are made one after another:
            there is one robot.
        port: Port on loopback; 0 takes a free one.

    Raises:
        UsageError: If the port is taken, or may not be used.
    """
    turn = threading.Lock()

    def talk(connection: ServerConnection) -> None:
        # A client that goes away in the middle of a call takes nothing with it.
        with contextlib.suppress(ConnectionClosed):
            for text in connection:
                with turn:
                    replies = answers(text, services)
                for reply in replies:
                    connection.send(json.dumps(reply, allow_nan=False))

    try:
        server = listen(
            talk, LOOPBACK, port, max_size=MOST_BYTES, logger=_SILENT, ping_timeout=None, compression=None
        )
    except OSError as error:
        raise UsageError(f"port {port} on {LOOPBACK} cannot be used: {error.strerror or error}") from None
    return RunningServer(server)


def serve(
    services: Mapping[str, Service], *, port: int, on_ready: Callable[[int], None] = lambda _: None
) -> None:
    """Serve until interrupted; see :func:`start`. ``on_ready`` is told the port."""
    with start(services, port=port) as running:
        on_ready(running.port)
        running.wait()
