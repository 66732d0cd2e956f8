"""Opens a serial port for this program alone. The one module that imports pyserial."""

import errno

import serial

from acquisition.errors import DeviceDisconnectedError, DeviceInUseError, DeviceTimeoutError

__all__ = ["SerialPort", "open_serial_port"]

READ_SLICE_S = 0.02
"""How long one read waits for its first byte."""

WRITE_TIMEOUT_S = 1.0


class SerialPort:
    """An open port; pyserial's errors become ours."""

    def __init__(self, port: serial.Serial) -> None:
        self._port = port

    def read(self) -> bytes:
        """Return what is there, waiting a moment for the first byte; nothing is no error.

        Raises
        ------
        DeviceDisconnectedError
            If the port is gone.
        """
        try:
            first: bytes = self._port.read(1)
        except (OSError, TypeError) as error:  # pyserial: TypeError when closed in mid-read
            raise self._gone() from error
        return first + self.read_waiting() if first else b""

    def read_waiting(self) -> bytes:
        """Return what is there, without waiting.

        Raises
        ------
        DeviceDisconnectedError
            If the port is gone.
        """
        try:
            waiting = self._port.in_waiting
            return self._port.read(waiting) if waiting else b""
        except (OSError, TypeError) as error:
            raise self._gone() from error

    def write(self, data: bytes) -> None:
        """Write all of it.

        Raises
        ------
        DeviceTimeoutError
            If the port does not take it.
        DeviceDisconnectedError
            If the port is gone.
        """
        try:
            self._port.write(data)
        except serial.SerialTimeoutException as error:
            raise DeviceTimeoutError(
                f"the serial port {self._port.port} takes no data; unplug it and plug it in again"
            ) from error
        except OSError as error:
            raise self._gone() from error

    def close(self) -> None:
        """Give the port back; closing twice is harmless."""
        self._port.close()

    def _gone(self) -> DeviceDisconnectedError:
        return DeviceDisconnectedError(
            f"the serial port {self._port.port} is gone; check cable and power. "
            "A stage in mid-move runs on to its target"
        )


def open_serial_port(
    path: str,
    baud_rate: int,
    *,
    read_slice_s: float = READ_SLICE_S,
    write_timeout_s: float = WRITE_TIMEOUT_S,
) -> SerialPort:
    """Open a port exclusively, 8 data bits, no parity, 1 stop bit.

    Opening resets Arduino boards (DTR).

    Raises
    ------
    DeviceDisconnectedError
        If the port is missing, not ours to open, or not a serial port.
    DeviceInUseError
        If another program has it.
    """
    try:
        return SerialPort(
            serial.Serial(
                path,
                baud_rate,
                timeout=read_slice_s,
                write_timeout=write_timeout_s,
                exclusive=True,
            )
        )
    except (OSError, ValueError) as error:
        number = error.errno if isinstance(error, OSError) else None
        if number in (errno.EAGAIN, errno.EBUSY):
            raise DeviceInUseError(
                f"serial port {path}: another program uses it; end that program"
            ) from error
        raise DeviceDisconnectedError(f"serial port {path}: {_why(number, error)}") from error


def _why(number: int | None, error: Exception) -> str:
    if number in (errno.ENOENT, errno.ENODEV, errno.ENXIO):
        return "there is no such port; check cable and power, and stage.port in the bench file"
    if number in (errno.EACCES, errno.EPERM):
        return "no permission; add yourself to the group of the port, often dialout, and log in"
    return f"cannot be opened: {error}"
