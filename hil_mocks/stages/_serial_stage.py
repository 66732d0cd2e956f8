"""A simulated stage on a pseudo-terminal, in real time: cable, port, controller and mechanics."""

import os
import select
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from threading import Event, RLock, Thread
from time import monotonic
from typing import Literal, Protocol, Self

from hil_mocks.stages._grbl import GrblFirmware
from hil_mocks.stages._plant import StagePlant
from hil_mocks.stages._zaber import ZaberFirmware


class Firmware(Protocol):
    """A controller driven by bytes and time."""

    def receive(self, data: bytes) -> None:
        """Receive bytes from the host."""
        ...

    def advance(self, now_s: float) -> None:
        """Run until this time."""
        ...

    def take_lines(self) -> list[bytes]:
        """Return what there is to send, as lines with their ends, and forget it."""
        ...


@dataclass(frozen=True, slots=True, kw_only=True)
class LineFaults:
    """Faults of the line from now on."""

    only: bytes = b""  # affects only lines to the host that begin with this
    count: int = 0  # lines to affect before the fault ends; 0 for no end
    lose: bool = False  # a line is lost
    duplicate: bool = False  # a line arrives twice
    delay_s: float = 0.0  # a line arrives late
    before: bytes = b""  # bytes before a line
    inside: bytes = b""  # in its middle
    after: bytes = b""  # after its end
    cut: bool = False  # the second half of a line is lost, with its end
    merge: bool = False  # a line loses its end
    swap: bytes = b""  # of two bytes, the first becomes the second: a wrong digit or checksum
    chunk_bytes: int = 0  # arrive at a time, one piece a read
    echo: bool = False  # what the host sends is echoed
    garbled: bool = False  # wrong baud rate: every byte in both directions is changed
    mute: bool = False  # nothing arrives at the host
    deaf: bool = False  # nothing arrives at the controller
    chatter: bytes = b""  # another device: these bytes arrive without end
    blocked: bool = False  # the port accepts no bytes
    unplugged: bool = False  # the cable is
    unplug_after_bytes: int | None = None  # as many more have reached the host


class SerialLine:
    """Carries bytes between a firmware and its host, subject to its faults."""

    def __init__(self, firmware: Firmware) -> None:
        self._firmware = firmware
        self._faults = LineFaults()
        self._spoilt = 0
        self._delivered = 0
        self._ready = b""
        self._late: list[tuple[float, bytes]] = []

    @property
    def faults(self) -> LineFaults:
        """Its faults; setting them restarts the counts."""
        return self._faults

    @faults.setter
    def faults(self, faults: LineFaults) -> None:
        self._faults = faults
        self._spoilt = 0
        self._delivered = 0

    @property
    def is_unplugged(self) -> bool:
        """Whether the host has lost the port."""
        limit = self._faults.unplug_after_bytes
        return self._faults.unplugged or (limit is not None and self._delivered >= limit)

    def send(self, data: bytes) -> None:
        """Carry bytes from the host."""
        if self._faults.echo:
            self._ready += data
        if self._faults.deaf or self.is_unplugged:
            return
        self._firmware.receive(_garbled(data) if self._faults.garbled else data)

    def pass_time(self, now_s: float) -> None:
        """Let the controller run until now."""
        self._firmware.advance(now_s)

    def take(self, now_s: float) -> bytes:
        """Return what has reached the host by now."""
        self._firmware.advance(now_s)
        lines = self._firmware.take_lines()
        self._ready += self._faults.chatter
        for line in lines:
            self._ready += self._spoil(line, now_s)
        for due_s, line in self._late:
            if due_s <= now_s:
                self._ready += line
        self._late = [(due_s, line) for due_s, line in self._late if due_s > now_s]
        if self._faults.mute or self.is_unplugged:
            self._ready = b""
            return b""
        data, self._ready = self._piece()
        self._delivered += len(data)
        return _garbled(data) if self._faults.garbled else data

    def _piece(self) -> tuple[bytes, bytes]:
        size = self._faults.chunk_bytes or len(self._ready)
        limit = self._faults.unplug_after_bytes
        if limit is not None:
            size = min(size, limit - self._delivered)
        return self._ready[:size], self._ready[size:]

    def _spoil(self, line: bytes, now_s: float) -> bytes:
        faults = self._faults
        if not line.startswith(faults.only) or (faults.count and self._spoilt >= faults.count):
            return line
        self._spoilt += 1
        text, end = line.rstrip(b"\r\n"), b"\r\n"
        if faults.lose:
            return b""
        if faults.swap:
            text = text.replace(faults.swap[:1], faults.swap[1:2])
        half = len(text) // 2
        text = faults.before + text[:half] + faults.inside + text[half:]
        if faults.cut:
            text, end = text[: len(text) // 2], b""
        if faults.merge:
            end = b""
        line = text + end + faults.after
        if faults.delay_s:
            self._late.append((now_s + faults.delay_s, line))
            return b""
        return line * 2 if faults.duplicate else line


def _garbled(data: bytes) -> bytes:
    """Data as received at a wrong baud rate: other bytes, line ends lost."""
    return bytes((byte * 7 + 0x93) & 0xFF | 0x80 for byte in data)


TICK_S = 0.002


class PtyPort:
    """Serves a line on a pseudo-terminal in its own thread; Linux and macOS only.

    ``clock`` is the firmware's; ``time.monotonic`` times a factor makes it run faster.
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

    def __exit__(self, *_: object) -> None:
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


StageProtocol = Literal["grbl", "zaber"]

LOW_SWITCH_MM, HIGH_SWITCH_MM = 119.5, 519.5
START_MM = 300.0
"""Travel as in the shipped ``grbl_stage.toml`` and ``zaber_stage.toml``."""


class SerialStage:
    """Stands in for a commercial stage; the simulated camera sees its true height.

    The Grbl controller is grblHAL: opening its port does not reset it. A ``clock`` of
    ``time.monotonic`` times a factor makes it run faster.
    """

    def __init__(self, protocol: StageProtocol, *, clock: Callable[[], float] = monotonic) -> None:
        start_s = clock()
        self.plant = StagePlant(
            low_switch_mm=LOW_SWITCH_MM, high_switch_mm=HIGH_SWITCH_MM, start_mm=START_MM
        )
        self.firmware: GrblFirmware | ZaberFirmware = (
            GrblFirmware(self.plant, dialect="grblhal")
            if protocol == "grbl"
            else ZaberFirmware(self.plant)
        )
        self.line = SerialLine(self.firmware)
        self._pty = PtyPort(self.line, clock=lambda: clock() - start_s)

    @property
    def port(self) -> str:
        """Path of its serial port, once open."""
        return self._pty.path

    @property
    def true_height_mm(self) -> float:
        """Present true height of the camera."""
        with self._pty.locked():
            return self.plant.true_height_mm

    def plug_in(self) -> None:
        """Plug the cable back in after a fault has pulled it out; ``port`` may change."""
        self._pty.plug_in()

    @contextmanager
    def locked(self) -> Iterator[None]:
        """Halt everything while a part is changed."""
        with self._pty.locked():
            yield

    def __enter__(self) -> Self:
        self._pty.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._pty.close()
