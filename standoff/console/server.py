"""Serves the console on one address until Ctrl-C, and ends connections that take too long."""

from __future__ import annotations

import asyncio
import signal
import socket
import ssl
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from typing import TYPE_CHECKING, Literal
from weakref import WeakKeyDictionary

import h11
import uvicorn
from starlette.types import ASGIApp
from uvicorn.protocols.http.h11_impl import H11Protocol, RequestResponseCycle

from standoff.errors import ApplicationError

if TYPE_CHECKING:
    from uvicorn.server import Protocols

MAX_CONNECTIONS = 256
HEADERS_S, BODY_S = 10.0, 30.0
"""Time for a request's headers and for its body to arrive, each as a whole."""

STALLED_S = 30.0
"""A peer that takes nothing of what it is sent for so long is gone."""

FULL = (
    b"HTTP/1.1 503 Service Unavailable\r\nConnection: close\r\nRetry-After: 10\r\n"
    b"Content-Type: text/plain; charset=utf-8\r\nContent-Length: 54\r\n\r\n"
    b"The computer has as many connections as it can serve.\n"
)

Awaited = Literal["headers", "body", "nothing"]
TIME_S: dict[Awaited, float] = {"headers": HEADERS_S, "body": BODY_S, "nothing": float("inf")}


class LimitedConnection(H11Protocol):
    """One connection, which makes room for a new one while it has not sent a whole request.

    Connections that wait for the rest of a request can be had without the token: they never keep
    out whoever has it. Only connections that are being served, such as the pages' websockets, do.
    """

    _since_s = 0.0
    _state: tuple[RequestResponseCycle | None, Awaited] = (None, "headers")

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]  # as the base class
        """Begin, if there is room."""
        super().connection_made(transport)
        self._since_s = self.loop.time()
        if len(self.connections) > MAX_CONNECTIONS and not self._made_room():
            transport.write(FULL)
            self._end()

    def handle_events(self) -> None:
        """Handle what has arrived, and note what is awaited from then on."""
        super().handle_events()
        state = (self.cycle, self._awaited())
        if state != self._state:
            self._state, self._since_s = state, self.loop.time()

    def end_if_late(self, now_s: float) -> None:
        """End the connection if a part of a request has taken too long to arrive."""
        if now_s - self._since_s >= TIME_S[self._state[1]]:
            self.transport.abort()

    def _awaited(self) -> Awaited:
        if self.conn.their_state is h11.IDLE:
            return "headers"
        return "body" if self.conn.their_state is h11.SEND_BODY else "nothing"

    def _made_room(self) -> bool:
        """End the connection that has waited longest for the rest of a request, if one does."""
        waiting = [
            each
            for each in self.connections
            if isinstance(each, LimitedConnection)
            and each is not self
            and each._state[1] != "nothing"
        ]
        if not waiting:
            return False
        oldest = min(waiting, key=lambda each: each._since_s)
        oldest.transport.abort()
        oldest._leave()
        return True

    def _end(self) -> None:
        self.transport.close()
        self._leave()

    def _leave(self) -> None:
        # At once, not when the loop gets to it: others arrive meanwhile.
        self.connections.discard(self)


class ConnectionWatch:
    """Ends connections that take too long, whenever it is asked to look."""

    def __init__(self, connections: set[Protocols]) -> None:
        self._connections = connections
        self._unsent: WeakKeyDictionary[Protocols, tuple[int, float]] = WeakKeyDictionary()

    def look(self, now_s: float) -> None:
        """End what is late at this time of the loop."""
        for each in list(self._connections):
            if isinstance(each, LimitedConnection):
                each.end_if_late(now_s)
            if self._is_stalled(each, now_s):
                each.transport.abort()

    def _is_stalled(self, connection: Protocols, now_s: float) -> bool:
        """Whether what is to be sent has not become less for too long."""
        unsent = connection.transport.get_write_buffer_size()
        before, since_s = self._unsent.get(connection, (0, now_s))
        if unsent == 0 or unsent < before:
            since_s = now_s
        self._unsent[connection] = (unsent, since_s)
        return now_s - since_s >= STALLED_S


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


def open_socket(host: str, port: int, receive_bytes: int = RECEIVE_BYTES) -> socket.socket:
    """Bind the address; port 0 picks a free port.

    ``receive_bytes``: receive buffer of each connection; over a link with a round trip of ``t``
    seconds, no more than ``receive_bytes / t`` arrives a second.
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
        opened.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, receive_bytes)  # inherited
        opened.bind(address)
        opened.listen(BACKLOG)
    except OSError as error:
        opened.close()
        raise _refused(host, port, error) from error
    return opened


def _refused(host: str, port: int, error: OSError) -> ApplicationError:
    return ApplicationError(
        f"cannot listen on {host}, port {port}: {error.strerror or error}; is standoff already "
        "serving there? --port chooses another port"
    )


def serve(
    app: ASGIApp,
    bound: socket.socket,
    *,
    ready: Callable[[], None],
    tls: ssl.SSLContext | None = None,
) -> None:
    """Serve until SIGINT or SIGTERM; ``ready`` is called once requests are answered.

    ``tls``: encrypts the connections; None serves them as they are.
    """
    asyncio.run(_serve(server_of(app, tls), bound, ready))


def server_of(app: ASGIApp, tls: ssl.SSLContext | None = None) -> uvicorn.Server:
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
        ssl_context_factory=None if tls is None else lambda _config, _make: tls,
    )
    return _Server(config)


class _Server(uvicorn.Server):
    """A server that leaves the signals to us, and ends connections that take too long."""

    def __init__(self, config: uvicorn.Config) -> None:
        super().__init__(config)
        self._watch = ConnectionWatch(self.server_state.connections)

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Begin to serve; a TLS handshake gets the time of a request's headers."""
        loop = asyncio.get_running_loop()
        create = loop.create_server
        if self.config.is_ssl:  # uvicorn has no option for asyncio's, which gives it a minute
            loop.create_server = partial(create, ssl_handshake_timeout=HEADERS_S)  # type: ignore[method-assign]
        try:
            await super().startup(sockets)
        finally:
            loop.create_server = create  # type: ignore[method-assign]

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
