import errno
import os
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
import serial

from acquisition.errors import DeviceDisconnectedError, DeviceInUseError, DeviceTimeoutError
from acquisition.stages.serial_link import SerialPort, open_serial_port
from tests.busy_machine import BUSY_S


@pytest.fixture
def terminal() -> Iterator[tuple[int, str]]:
    master, slave = os.openpty()
    yield master, os.ttyname(slave)
    for end in (master, slave):
        try:
            os.close(end)
        except OSError:
            continue


def test_bytes_go_both_ways(terminal: tuple[int, str]) -> None:
    master, path = terminal
    port = open_serial_port(path, 115200)
    port.write(b"$I\n")
    assert os.read(master, 10) == b"$I\n"
    os.write(master, b"ok\r\n")
    time.sleep(0.01)
    assert port.read() == b"ok\r\n"
    assert port.read() == b""
    assert port.read_waiting() == b""
    port.close()
    port.close()


def test_a_missing_port_is_named_with_the_remedy(tmp_path: Path) -> None:
    with pytest.raises(DeviceDisconnectedError) as missing:
        open_serial_port(str(tmp_path / "ttyNone"), 115200)
    assert isinstance(missing.value.__cause__, OSError)
    assert missing.value.__cause__.errno == errno.ENOENT
    assert "ttyNone" in str(missing.value)


def test_a_port_that_another_program_has_is_refused(terminal: tuple[int, str]) -> None:
    port = open_serial_port(terminal[1], 115200)
    with pytest.raises(DeviceInUseError):
        open_serial_port(terminal[1], 115200)
    port.close()
    open_serial_port(terminal[1], 115200).close()


def test_a_port_without_permission_names_the_group(monkeypatch: pytest.MonkeyPatch) -> None:
    # Root may open everything, so the refusal is scripted.
    def refuse(*_: object, **__: object) -> None:
        raise serial.SerialException(errno.EACCES, "could not open port")

    monkeypatch.setattr("serial.Serial", refuse)
    with pytest.raises(DeviceDisconnectedError) as refused:
        open_serial_port("/dev/ttyUSB0", 115200)
    assert "dialout" in str(refused.value)


def test_what_is_no_serial_port_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(DeviceDisconnectedError):
        open_serial_port(str(tmp_path / "file"), 115200)


def test_a_cable_that_is_pulled_is_noticed_at_once(terminal: tuple[int, str]) -> None:
    master, path = terminal
    port = open_serial_port(path, 115200)
    os.close(master)
    started = time.monotonic()
    with pytest.raises(DeviceDisconnectedError):
        port.read()
    assert time.monotonic() - started < 0.5 + BUSY_S
    with pytest.raises(DeviceDisconnectedError):
        port.write(b"?")
    port.close()


def test_a_port_that_takes_no_data_is_a_timeout() -> None:
    class Full(serial.Serial):
        def write(self, b: object, /) -> int:
            raise serial.SerialTimeoutException("Write timeout")

    with pytest.raises(DeviceTimeoutError):
        SerialPort(Full()).write(b"?")
