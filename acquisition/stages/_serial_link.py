"""The serial line of a stage: lines with time limits and a log, on an exclusive port."""

import errno
from collections import deque
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from time import monotonic
from typing import Protocol, Self

import serial

from acquisition.bench import StageConfig
from acquisition.errors import (
    BenchConfigError,
    DeviceDisconnectedError,
    DeviceInUseError,
    DeviceProtocolError,
    DeviceTimeoutError,
)

_MAX_BYTES = 5_000_000
"""About 80 000 lines: some hours of a capture session."""


class _WireLog:
    """Appends a line for every line sent (``>``) or received (``<``) and every remark (``#``).

    At ``max_bytes`` the file becomes ``<name>.1``, replacing an earlier one.
    """

    def __init__(
        self,
        path: Path,
        *,
        max_bytes: int = _MAX_BYTES,
        utc_now: Callable[[], datetime] = lambda: datetime.now(UTC),
    ) -> None:
        self._path = path
        self._max_bytes = max_bytes
        self._utc_now = utc_now
        self._file = path.open("a", encoding="ascii")

    def sent(self, data: bytes) -> None:
        """Log what was written to the port."""
        self._write(">", _escaped(data))

    def received(self, data: bytes) -> None:
        """Log one line, or what there was of one, that came from the port."""
        self._write("<", _escaped(data))

    def remark(self, text: str) -> None:
        """Log what happened to the connection."""
        self._write("#", _escaped(text.encode("utf-8")))

    def close(self) -> None:
        """Close the file; closing twice is harmless."""
        self._file.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _write(self, direction: str, text: str) -> None:
        if self._file.closed:
            return
        stamp = self._utc_now().isoformat(timespec="microseconds")
        self._file.write(f"{stamp} {direction} {text}\n")
        # The last lines matter most when the program or the machine dies.
        self._file.flush()
        if self._file.tell() >= self._max_bytes:
            self._file.close()
            self._path.replace(self._path.with_name(self._path.name + ".1"))
            self._file = self._path.open("a", encoding="ascii")


def _escaped(data: bytes) -> str:
    return repr(data)[2:-1]


_READ_SLICE_S = 0.02
"""How long a read waits for its first byte."""

_WRITE_TIMEOUT_S = 1.0
_MAX_LINE_BYTES = 1024
"""No message of the supported protocols is longer."""


class _BytePort(Protocol):
    """An open port; it raises the errors of `acquisition.errors`."""

    def read(self) -> bytes:
        """Return what is there, waiting a moment for the first byte."""
        ...

    def read_waiting(self) -> bytes:
        """Return what is there, without waiting."""
        ...

    def write(self, data: bytes) -> None:
        """Write all of it."""
        ...

    def close(self) -> None:
        """Release the port."""
        ...


class SerialLink:
    """One connection to a named device; it knows lines, not what they mean."""

    def __init__(
        self,
        port: _BytePort,
        *,
        name: str,
        clock: Callable[[], float],
        log: _WireLog | None = None,
    ) -> None:
        self.name = name
        self._port = port
        self._clock = clock
        self._log = log
        self._is_open = True
        self._partial = b""
        self._lines: deque[bytes] = deque()

    def write(self, data: bytes) -> None:
        """Send bytes."""
        self._check_open()
        if self._log:
            self._log.sent(data)
        self._port.write(data)

    def read_line(self, timeout_s: float) -> bytes:
        """Wait for the next line that is not empty, and return it without its end."""
        deadline = self._clock() + timeout_s
        while not self._lines:
            self._receive()
            if not self._lines and self._clock() >= deadline:
                raise DeviceTimeoutError(
                    f"{self.name} did not answer within {timeout_s:g} s", timeout_s=timeout_s
                )
        return self._lines.popleft()

    def waiting_lines(self) -> list[bytes]:
        """Return the unsolicited lines received so far."""
        self._receive(wait=False)
        lines = list(self._lines)
        self._lines.clear()
        return lines

    def drain(self, quiet_s: float, timeout_s: float) -> list[bytes]:
        """Listen until nothing has come for ``quiet_s``; return what came, split into lines."""
        deadline = self._clock() + timeout_s
        heard = list(self._lines)
        self._lines.clear()
        quiet_since = self._clock()
        while self._clock() - quiet_since < quiet_s:
            try:
                got = self._receive()
            except DeviceProtocolError:
                got = True
            if got:
                quiet_since = self._clock()
                heard += self._lines
                self._lines.clear()
            if self._clock() >= deadline:
                raise DeviceProtocolError(
                    f"{self.name} sends unsolicited data without end; "
                    "is this the right port and baud rate?"
                )
        if self._partial:
            heard.append(self._cut_partial())
        return heard

    def remark(self, text: str) -> None:
        """Write a remark to the log."""
        if self._log:
            self._log.remark(text)

    def close(self) -> None:
        """Close port and log; closing twice is harmless."""
        self._is_open = False
        self._port.close()
        if self._log:
            self._log.close()

    def _receive(self, *, wait: bool = True) -> bool:
        """Read once; return whether anything came."""
        self._check_open()
        data = self._port.read() if wait else self._port.read_waiting()
        if not data:
            return False
        *lines, self._partial = (self._partial + data).split(b"\n")
        for line in lines:
            # NULs come from a cable or a power-up; no supported protocol sends them.
            clean = line.strip(b"\r\0 ")
            if clean:
                if self._log:
                    self._log.received(clean)
                self._lines.append(clean)
        if len(self._partial) > _MAX_LINE_BYTES:
            start = self._cut_partial()[:40]
            raise DeviceProtocolError(f"{self.name} sent a line without an end: {start!r}...")
        return True

    def _cut_partial(self) -> bytes:
        cut, self._partial = self._partial, b""
        if self._log:
            self._log.received(cut)
        return cut

    def _check_open(self) -> None:
        if not self._is_open:
            raise DeviceDisconnectedError(f"{self.name} is closed")


class _SerialPort:
    """An open port; translates pyserial's errors into ours."""

    def __init__(self, port: serial.Serial) -> None:
        self._port = port

    def read(self) -> bytes:
        """Return what is there, waiting a moment for the first byte; no data is not an error."""
        try:
            first: bytes = self._port.read(1)
        except (OSError, TypeError) as error:  # pyserial: TypeError when closed in mid-read
            raise self._gone() from error
        return first + self.read_waiting() if first else b""

    def read_waiting(self) -> bytes:
        """Return what is there, without waiting."""
        try:
            waiting = self._port.in_waiting
            return self._port.read(waiting) if waiting else b""
        except (OSError, TypeError) as error:
            raise self._gone() from error

    def write(self, data: bytes) -> None:
        """Write all of it."""
        try:
            self._port.write(data)
        except serial.SerialTimeoutException as error:
            raise DeviceTimeoutError(
                f"the serial port {self._port.port} accepts no data; unplug it and plug it in again"
            ) from error
        except OSError as error:
            raise self._gone() from error

    def close(self) -> None:
        """Release the port; closing twice is harmless."""
        self._port.close()

    def _gone(self) -> DeviceDisconnectedError:
        return DeviceDisconnectedError(
            f"the serial port {self._port.port} is gone; check cable and power. "
            "A stage that was moving continues to its target"
        )


def open_stage_link(config: StageConfig, *, name: str) -> SerialLink:
    """Open the port and the wire log."""
    try:
        log = _WireLog(Path(config.wire_log)) if config.wire_log else None
    except OSError as error:
        raise BenchConfigError(
            f"stage.wire_log {config.wire_log}: {error.strerror}", keys=("stage.wire_log",)
        ) from error
    try:
        port = open_serial_port(config.port or "", config.baud_rate, release_dtr=config.release_dtr)
    except BaseException:
        if log:
            log.close()
        raise
    return SerialLink(port, name=f"{name} on {config.port}", clock=monotonic, log=log)


def open_serial_port(
    path: str,
    baud_rate: int,
    *,
    read_slice_s: float = _READ_SLICE_S,
    write_timeout_s: float = _WRITE_TIMEOUT_S,
    release_dtr: bool = False,
) -> _SerialPort:
    """Open a port exclusively, 8 data bits, no parity, 1 stop bit; DTR resets Arduino boards.

    Where DTR leads to the reset without the usual capacitor, a board stands still as long as DTR
    is held: ``release_dtr`` lets go of it, and of RTS.
    """
    port = serial.Serial(
        None, baud_rate, timeout=read_slice_s, write_timeout=write_timeout_s, exclusive=True
    )
    port.dtr = port.rts = not release_dtr
    try:
        port.port = path
        port.open()
        return _SerialPort(port)
    except (OSError, ValueError) as error:
        number = error.errno if isinstance(error, OSError) else None
        if number in (errno.EAGAIN, errno.EBUSY):
            raise DeviceInUseError(
                f"serial port {path} is in use by another program; close that program"
            ) from error
        raise DeviceDisconnectedError(f"serial port {path}: {_why(number, error)}") from error


def _why(number: int | None, error: Exception) -> str:
    if number in (errno.ENOENT, errno.ENODEV, errno.ENXIO):
        return "no such port; check cable and power, and stage.port in the bench file"
    if number in (errno.EACCES, errno.EPERM):
        return "no permission; add yourself to the port's group, often dialout, and log in again"
    return f"cannot be opened: {error}"
