"""Serves the console on one address until Ctrl-C."""

import asyncio
import signal
import socket
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import uvicorn
from starlette.types import ASGIApp

from standoff.console.serving.connections import ConnectionWatch, LimitedConnection
from standoff.errors import ApplicationError

GRACE_S = 2
"""How long to wait for pages at the end."""

PING_S, PONG_S = 3.0, 4.0
"""A page that ends without a word is noticed within the sum: its control must come free soon."""

MAX_MESSAGE_CHARS = 4096
"""Of one message of a page."""

RECEIVE_BYTES = 16 * 1024
"""Receive buffer of a connection: bounds what one read brings, and so how long others wait."""

BACKLOG = 64
"""Connections that wait to be accepted, and that the loop accepts in one turn."""

WATCH_TICKS = 10
"""The server ticks ten times a second; connections are looked at once."""


def open_socket(host: str, port: int) -> socket.socket:
    """Bind the address; port 0 picks a free port.

    Raises
    ------
    ApplicationError
        If the address cannot be bound.
    """
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(
            host, port, type=socket.SOCK_STREAM
        )[0]
        opened = socket.socket(family, kind, protocol)
    except UnicodeError as error:  # not a valid domain name, such as a label of 64 characters
        raise ApplicationError(
            f"cannot listen on {host}: it is not a host name or address"
        ) from error
    except OSError as error:
        raise _refused(host, port, error) from error
    try:
        opened.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        opened.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BYTES)  # inherited
        opened.bind(address)
        opened.listen(BACKLOG)
    except OSError as error:
        opened.close()
        raise _refused(host, port, error) from error
    return opened


def _refused(host: str, port: int, error: OSError) -> ApplicationError:
    return ApplicationError(
        f"cannot listen on {host}, port {port}: {error.strerror or error}; is a console already "
        "running there? --port chooses another port"
    )


def serve(app: ASGIApp, bound: socket.socket, *, ready: Callable[[], None]) -> None:
    """Serve until SIGINT or SIGTERM.

    Parameters
    ----------
    ready
        Called once requests are answered.
    """
    asyncio.run(_serve(server_of(app), bound, ready))


def server_of(app: ASGIApp) -> uvicorn.Server:
    """Return a server of the application that leaves the signals alone."""
    config = uvicorn.Config(
        app,
        loop="asyncio",
        http=LimitedConnection,
        ws="websockets-sansio",
        ws_max_size=4 * MAX_MESSAGE_CHARS,  # UTF-8 has up to four bytes a character
        ws_ping_interval=PING_S,
        ws_ping_timeout=PONG_S,
        ws_per_message_deflate=False,  # pictures of noise do not shrink
        backlog=BACKLOG,
        log_level="error",  # a warning for every bad request would be a flood of its own
        access_log=False,
        server_header=False,
        proxy_headers=False,
        timeout_graceful_shutdown=GRACE_S,
        lifespan="off",
    )
    return _Server(config)


class _Server(uvicorn.Server):
    """A server that leaves the signals to us, and ends connections that take too long."""

    def __init__(self, config: uvicorn.Config) -> None:
        super().__init__(config)
        self._watch = ConnectionWatch(self.server_state.connections)

    async def on_tick(self, counter: int) -> bool:
        """Look after the connections, besides what the server does ten times a second."""
        if counter % WATCH_TICKS == 0:
            self._watch.look(asyncio.get_running_loop().time())
        return await super().on_tick(counter)

    @contextmanager
    def capture_signals(self) -> Iterator[None]:
        """Leave the signals alone: Ctrl-C is the normal end of a console, not an error."""
        yield


async def _serve(server: uvicorn.Server, bound: socket.socket, ready: Callable[[], None]) -> None:
    loop = asyncio.get_running_loop()

    def end() -> None:
        server.should_exit = True

    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, end)
    serving = asyncio.create_task(server.serve(sockets=[bound]))
    while not server.started and not serving.done():
        await asyncio.sleep(0.01)
    if not serving.done():
        ready()
    await serving
