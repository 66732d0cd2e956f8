"""A simulated controller on a pseudo-terminal: a serial port that any program can open."""

import os
import select
from collections.abc import Callable
from threading import Event, RLock, Thread
from time import monotonic
from types import TracebackType
from typing import Self

from hil_mocks.stages.serial_line import LineFaults, SerialLine

TICK_S = 0.002


class PtyPort:
    """Serves a line on a pseudo-terminal in its own thread; Linux and macOS only.

    Parameters
    ----------
    line
        Firmware and cable.
    clock
        Time in seconds for the firmware; ``time.monotonic`` times a factor makes it run faster.
    """

    def __init__(self, line: SerialLine, *, clock: Callable[[], float] = monotonic) -> None:
        self.line = line
        self._clock = clock
        self._lock = RLock()
        self._ended = Event()
        self._master: int | None = None
        self._slave: int | None = None
        self._thread: Thread | None = None
        self.path = ""

    def start(self) -> None:
        """Open the pseudo-terminal and serve it."""
        self._open_terminal()
        self._thread = Thread(target=self._serve, name=f"pty {self.path}", daemon=True)
        self._thread.start()

    def plug_in(self) -> None:
        """Plug the cable back in after a fault has pulled it out; the path may change."""
        with self._lock:
            self.line.faults = LineFaults()
            if self._master is None:
                self._open_terminal()

    def close(self) -> None:
        """End the thread and remove the port; closing twice is harmless."""
        self._ended.set()
        if self._thread is not None:
            self._thread.join()
        self._unplug()

    def locked(self) -> RLock:
        """Lock to hold while firmware, plant or faults are changed or read."""
        return self._lock

    def __enter__(self) -> Self:
        self.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def _open_terminal(self) -> None:
        import tty  # Windows, where this is never started, has none

        master, self._slave = os.openpty()
        tty.setraw(self._slave)
        os.set_blocking(master, False)
        self.path = os.ttyname(self._slave)
        self._master = master

    def _serve(self) -> None:
        while not self._ended.is_set():
            master = self._master
            if master is None:
                self._ended.wait(TICK_S)
            else:
                readable, _, _ = select.select([master], [], [], TICK_S)
                if readable:
                    self._receive(master)
            with self._lock:
                data = self.line.take(self._clock())
                if self.line.is_unplugged:
                    self._unplug()
            if data and self._master is not None:
                self._transmit(self._master, data)

    def _receive(self, master: int) -> None:
        try:
            data = os.read(master, 4096)
        except OSError:  # nobody has the port open
            data = b""
        with self._lock:
            self.line.pass_time(self._clock())
            self.line.send(data)

    def _transmit(self, master: int, data: bytes) -> None:
        try:
            os.write(master, data)
        except BlockingIOError:
            # Nobody reads: a full buffer loses new data, as a real one does.
            return

    def _unplug(self) -> None:
        for end in (self._master, self._slave):
            if end is not None:
                os.close(end)
        self._master = self._slave = None
