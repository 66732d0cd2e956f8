"""Connections of the console: how many there may be, and how long a request may take to arrive.

The server would wait for the rest of a request for ever, and for a peer that reads nothing.
"""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Literal
from weakref import WeakKeyDictionary

import h11
from uvicorn.protocols.http.h11_impl import H11Protocol, RequestResponseCycle

if TYPE_CHECKING:
    from uvicorn.server import Protocols

MAX_CONNECTIONS = 256
HEADERS_S, BODY_S = 10.0, 30.0
"""Time for a request's headers and for its body to arrive, each as a whole."""

STALLED_S = 30.0
"""A peer that takes nothing of what it is sent for so long is gone."""

FULL = (
    b"HTTP/1.1 503 Service Unavailable\r\nConnection: close\r\nRetry-After: 10\r\n"
    b"Content-Type: text/plain; charset=utf-8\r\nContent-Length: 53\r\n\r\n"
    b"The console has as many connections as it can serve.\n"
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
    """Ends connections that take too long, whenever it is asked to look.

    Parameters
    ----------
    connections
        Those of the server.
    """

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
