"""The cable between a simulated controller and its host, and its faults."""

from dataclasses import dataclass
from typing import Protocol


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
    """Faults of the line from now on.

    Parameters
    ----------
    only
        Only lines to the host that begin with this are affected.
    count
        Number of lines to affect before the fault ends; 0 for no end.
    lose, duplicate, delay_s
        A line is lost, arrives twice, or arrives late.
    before, inside, after
        Bytes inserted before a line, in its middle, or after its end.
    cut
        The second half of a line is lost, including its end.
    merge
        A line loses its end.
    swap
        Two bytes, the first of which becomes the second: a corrupted digit, a bad checksum.
    chunk_bytes
        Bytes arrive in pieces of this size, one piece per read.
    echo
        What the host sends is echoed.
    garbled
        Wrong baud rate: every byte in both directions arrives changed.
    mute
        Nothing arrives at the host.
    deaf
        Nothing arrives at the controller.
    chatter
        Another device: these bytes arrive without end.
    blocked
        The port accepts no bytes.
    unplugged
        The cable is unplugged.
    unplug_after_bytes
        It is unplugged after this many more bytes have reached the host.
    """

    only: bytes = b""
    count: int = 0
    lose: bool = False
    duplicate: bool = False
    delay_s: float = 0.0
    before: bytes = b""
    inside: bytes = b""
    after: bytes = b""
    cut: bool = False
    merge: bool = False
    swap: bytes = b""
    chunk_bytes: int = 0
    echo: bool = False
    garbled: bool = False
    mute: bool = False
    deaf: bool = False
    chatter: bytes = b""
    blocked: bool = False
    unplugged: bool = False
    unplug_after_bytes: int | None = None


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
