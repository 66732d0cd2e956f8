"""Serial links and their ports."""

import errno
import os
import time
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path

import pytest
import serial

from acquisition.errors import (
    DeviceDisconnectedError,
    DeviceInUseError,
    DeviceProtocolError,
    DeviceTimeoutError,
)
from acquisition.stages._serial_link import SerialLink, _SerialPort, _WireLog, open_serial_port
from tests.busy_machine import BUSY_S


class ScriptedPort:
    """Delivers one piece for each read; a read takes 10 ms."""

    def __init__(self, *pieces: bytes, endless: bytes = b"") -> None:
        self.pieces = list(pieces)
        self.endless = endless
        self.sent: list[bytes] = []
        self.now_s = 0.0
        self.closed = 0

    def clock(self) -> float:
        return self.now_s

    def read(self) -> bytes:
        self.now_s += 0.01
        return self.read_waiting()

    def read_waiting(self) -> bytes:
        return self.pieces.pop(0) if self.pieces else self.endless

    def write(self, data: bytes) -> None:
        self.sent.append(data)

    def close(self) -> None:
        self.closed += 1


def link(port: ScriptedPort, log: _WireLog | None = None) -> SerialLink:
    return SerialLink(port, name="the stage", clock=port.clock, log=log)


def test_lines_are_put_together_from_pieces() -> None:
    port = ScriptedPort(b"o", b"k\r", b"\n<Id", b"le>\r\n\r\nerr", b"or:1\n")
    opened = link(port)
    assert [opened.read_line(1) for _ in range(3)] == [b"ok", b"<Idle>", b"error:1"]


def test_silence_is_a_timeout_after_its_time() -> None:
    port = ScriptedPort(b"half a li")
    with pytest.raises(DeviceTimeoutError) as silent:
        link(port).read_line(0.5)
    assert silent.value.timeout_s == 0.5
    assert port.now_s == pytest.approx(0.5, abs=0.02)


def test_a_line_without_an_end_is_a_protocol_error() -> None:
    opened = link(ScriptedPort(endless=b"x" * 100))
    with pytest.raises(DeviceProtocolError):
        opened.read_line(10)


def test_nuls_around_a_line_are_dropped() -> None:
    assert link(ScriptedPort(b"\0\0ok\0\r\n")).read_line(1) == b"ok"


def test_draining_waits_for_silence_and_tells_what_it_heard() -> None:
    port = ScriptedPort(b"ok\r\n", b"", b"", b"ok\r\npart")
    opened = link(port)
    assert opened.drain(quiet_s=0.1, timeout_s=1) == [b"ok", b"ok", b"part"]
    assert opened.waiting_lines() == []


def test_a_line_that_never_falls_silent_is_an_error() -> None:
    with pytest.raises(DeviceProtocolError):
        link(ScriptedPort(endless=b"$GPGGA\r\n")).drain(quiet_s=0.1, timeout_s=1)


def test_waiting_lines_takes_no_time() -> None:
    port = ScriptedPort(b"ALARM:1\r\nok\r\nre")
    assert link(port).waiting_lines() == [b"ALARM:1", b"ok"]
    assert port.now_s == 0.0


def test_a_closed_link_says_so() -> None:
    port = ScriptedPort()
    opened = link(port)
    opened.close()
    opened.close()
    for call in (lambda: opened.write(b"?"), lambda: opened.read_line(1)):
        with pytest.raises(DeviceDisconnectedError):
            call()


def at_noon() -> datetime:
    return datetime(2025, 3, 4, 12, 0, 0, 250, tzinfo=UTC)


def test_the_log_has_every_line_with_time_and_direction(tmp_path: Path) -> None:
    path = tmp_path / "wire.log"
    port = ScriptedPort(b"ok\r\n\xffx\r\n")
    opened = link(port, _WireLog(path, utc_now=at_noon))
    opened.write(b"$H\n")
    opened.write(b"\x85")
    opened.read_line(1)
    opened.remark("a remark")
    opened.close()
    stamp = "2025-03-04T12:00:00.000250+00:00"
    assert path.read_text() == (
        f"{stamp} > $H\\n\n{stamp} > \\x85\n{stamp} < ok\n{stamp} < \\xffx\n{stamp} # a remark\n"
    )


def test_the_log_keeps_two_files_of_bounded_size(tmp_path: Path) -> None:
    path = tmp_path / "wire.log"
    with _WireLog(path, max_bytes=1000, utc_now=at_noon) as log:
        for number in range(200):
            log.sent(b"%d\n" % number)
    assert sorted(file.name for file in tmp_path.iterdir()) == ["wire.log", "wire.log.1"]
    assert all(file.stat().st_size <= 1100 for file in tmp_path.iterdir())
    assert "> 199\\n" in path.read_text() + (tmp_path / "wire.log.1").read_text()


def test_the_log_goes_on_where_the_last_session_ended(tmp_path: Path) -> None:
    for _ in range(2):
        with _WireLog(tmp_path / "wire.log", utc_now=at_noon) as log:
            log.received(b"ok")
    assert (tmp_path / "wire.log").read_text().count("< ok") == 2


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

    monkeypatch.setattr("serial.Serial.open", refuse)
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
        _SerialPort(Full()).write(b"?")


@pytest.mark.parametrize("release_dtr", [True, False])
def test_a_board_that_dtr_keeps_in_reset_is_let_go(release_dtr: bool) -> None:
    """On Woodpecker boards DTR leads to the reset without a capacitor: held, nothing answers."""
    main, port = os.openpty()
    try:
        opened = open_serial_port(os.ttyname(port), 115200, release_dtr=release_dtr)
        assert (opened._port.dtr, opened._port.rts) == (not release_dtr, not release_dtr)
        opened.close()
    finally:
        os.close(main)
        os.close(port)
