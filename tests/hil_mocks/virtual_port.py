"""A serial port in process, in which time passes only while somebody waits."""

from acquisition.errors import DeviceDisconnectedError, DeviceTimeoutError
from hil_mocks.devices import SimulatedClock
from hil_mocks.stages import SerialLine

READ_SLICE_S = 0.005
BYTE_S = 10 / 115200
"""A start bit, 8 data bits and a stop bit."""


class VirtualPort:
    """Stands where a driver expects its open port; the driver sleeps on the same clock."""

    def __init__(self, line: SerialLine, *, clock: SimulatedClock) -> None:
        self.line = line
        self._clock = clock

    def read(self) -> bytes:
        """Return what is there, waiting a moment for the first byte."""
        data = self.read_waiting()
        if data:
            return data
        self._clock.advance(READ_SLICE_S)
        return self.read_waiting()

    def read_waiting(self) -> bytes:
        """Return what is there, without waiting."""
        data = self.line.take(self._clock.now_s)
        if not data:
            self._check_plugged()
        self._clock.advance(len(data) * BYTE_S)
        return data

    def write(self, data: bytes) -> None:
        """Write all of it."""
        self._check_plugged()
        if self.line.faults.blocked:
            self._clock.advance(1.0)
            raise DeviceTimeoutError("the virtual port takes no data")
        self.line.pass_time(self._clock.now_s)
        self.line.send(data)

    def close(self) -> None:
        """Give the port back: there is none to give."""

    def _check_plugged(self) -> None:
        if self.line.is_unplugged:
            raise DeviceDisconnectedError("the virtual port is gone")
