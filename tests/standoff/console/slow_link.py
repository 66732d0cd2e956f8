"""A slow connection between a page and the console: so many bytes a second, and a way to go."""

import socket
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from queue import SimpleQueue
from threading import Lock, Thread

from tests.standoff.console.relay import Relay
from tests.standoff.console.served import Address

PIECE_BYTES = 1024
BUFFER_BYTES = 16 * 1024


class SlowLink(Relay):
    """Passes connections on, all of them together at a rate, each byte after a delay.

    What does not fit is kept, as many routers do, without a limit: whoever sends more than the
    rate makes the delay grow.

    Parameters
    ----------
    console
        Where the console listens.
    rate_bytes_per_s
        Towards the page; what the page sends is little.
    delay_s
        Each way.
    """

    def __init__(self, console: Address, rate_bytes_per_s: float, delay_s: float) -> None:
        self.rate_bytes_per_s = rate_bytes_per_s
        self._delay_s = delay_s
        self._lock = Lock()
        self._free_s = 0.0
        self.passed_bytes = 0
        super().__init__(console)

    def connected(self, page: socket.socket, console: socket.socket) -> None:
        """See `Relay`."""
        for each in (page, console):
            each.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        page.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, BUFFER_BYTES)
        self._pass_on(page, console, is_to_page=False)
        self._pass_on(console, page, is_to_page=True)

    def _pass_on(self, source: socket.socket, target: socket.socket, *, is_to_page: bool) -> None:
        waiting: SimpleQueue[tuple[float, bytes]] = SimpleQueue()

        def read() -> None:
            with suppress(OSError):
                while data := source.recv(PIECE_BYTES):
                    waiting.put(
                        (self._leaves_s(len(data)) if is_to_page else time.monotonic(), data)
                    )
            waiting.put((time.monotonic(), b""))

        def write() -> None:
            with suppress(OSError):
                while (piece := waiting.get())[1] and not self._is_closing.is_set():
                    time.sleep(max(0.0, piece[0] + self._delay_s - time.monotonic()))
                    target.sendall(piece[1])
                    self.passed_bytes += len(piece[1]) if is_to_page else 0
                target.shutdown(socket.SHUT_WR)

        for work in (read, write):
            Thread(target=work, daemon=True).start()

    def _leaves_s(self, size: int) -> float:
        """When the link is done with so many bytes more."""
        with self._lock:
            self._free_s = max(self._free_s, time.monotonic()) + size / self.rate_bytes_per_s
            return self._free_s


@contextmanager
def slow_link(console: Address, rate_bytes_per_s: float, delay_s: float) -> Iterator[SlowLink]:
    """Put a slow connection before a console."""
    link = SlowLink(console, rate_bytes_per_s, delay_s)
    try:
        yield link
    finally:
        link.close()
