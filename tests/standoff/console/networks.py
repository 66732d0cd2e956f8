"""Networks between a page and the console: they hold every byte, pass it on late, or are slow."""

import socket
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from queue import SimpleQueue
from threading import Event, Lock, Thread

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


SLOW_PIECE_BYTES = 1024
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
                while data := source.recv(SLOW_PIECE_BYTES):
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
