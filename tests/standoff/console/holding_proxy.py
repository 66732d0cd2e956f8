"""A network between a page and the console: it can hold every byte, or pass them on late."""

import socket
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from threading import Thread

from tests.standoff.console.relay import Relay
from tests.standoff.console.served import Address

PIECE_BYTES = 64 * 1024
TICK_S = 0.01


class HoldingProxy(Relay):
    """Passes connections on to a console; nothing is lost while it holds.

    Parameters
    ----------
    console
        Where the console listens.
    """

    def __init__(self, console: Address) -> None:
        self.is_holding = False
        self.is_mute = False  # nothing of the page reaches the console
        self.delay_s = 0.0  # to the page
        super().__init__(console)

    def connected(self, page: socket.socket, console: socket.socket) -> None:
        """See `Relay`."""
        Thread(target=self._pass_on, args=(page, console, False), daemon=True).start()
        Thread(target=self._pass_on, args=(console, page, True), daemon=True).start()

    def _pass_on(self, source: socket.socket, target: socket.socket, to_page: bool) -> None:
        with suppress(OSError):
            while data := source.recv(PIECE_BYTES):
                arrived_s = time.monotonic()
                while (
                    self.is_holding
                    or (self.is_mute and not to_page)
                    or (to_page and time.monotonic() - arrived_s < self.delay_s)
                ) and not self._is_closing.is_set():
                    time.sleep(TICK_S)
                target.sendall(data)
        with suppress(OSError):
            target.shutdown(socket.SHUT_WR)


@contextmanager
def holding_proxy(console: Address) -> Iterator[HoldingProxy]:
    """Put a network before a console."""
    proxy = HoldingProxy(console)
    try:
        yield proxy
    finally:
        proxy.close()
