"""What stands between a page and the console, and passes their connections on."""

import socket
from contextlib import suppress
from threading import Event, Thread

from tests.standoff.console.served import Address


class Relay:
    """Accepts the connections of pages; what becomes of each is for those that derive from it.

    Parameters
    ----------
    console
        Where the console listens.
    """

    def __init__(self, console: Address) -> None:
        self._console = console
        self._listening = socket.create_server(("127.0.0.1", 0))
        self._open: list[socket.socket] = []
        self._is_closing = Event()
        Thread(target=self._accept, daemon=True).start()

    @property
    def url(self) -> str:
        """What a page opens."""
        return f"http://127.0.0.1:{self._listening.getsockname()[1]}/"

    def close(self) -> None:
        """End all connections."""
        self._is_closing.set()
        for each in (self._listening, *self._open):
            with suppress(OSError):
                each.shutdown(socket.SHUT_RDWR)
            each.close()

    def connected(self, page: socket.socket, console: socket.socket) -> None:
        """Begin to pass a connection on, in threads."""
        raise NotImplementedError

    def _accept(self) -> None:
        while not self._is_closing.is_set():
            try:
                page, _ = self._listening.accept()
                console = socket.create_connection(self._console)
            except OSError:
                return
            self._open += [page, console]
            self.connected(page, console)
