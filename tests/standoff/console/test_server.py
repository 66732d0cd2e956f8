"""Connections that are slow, that are many, or that read nothing."""

import asyncio
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("starlette", reason="the console's extra is not installed")
pytest.importorskip("websockets", reason="the console's extra is not installed")


from uvicorn.server import ServerState
from websockets import Origin
from websockets.sync.client import ClientConnection, connect

from standoff.console import server as connections
from standoff.console.bench_hub import BenchHub
from standoff.console.server import (
    BODY_S,
    HEADERS_S,
    STALLED_S,
    ConnectionWatch,
    LimitedConnection,
    server_of,
)
from standoff.console.web._application import console_app
from tests.standoff.console.hub_fixtures import DEADLINE_S, idle_hub, wait_for
from tests.standoff.console.served import Address, answer_of, answered, sent, served

WHOLE = b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n"
HALF = b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\nX-Slow: "
HALF_BODY = b"POST /login HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: 4000\r\n\r\n"


class Wire:
    """A transport that keeps what is written, and takes as much of it as the peer does."""

    def __init__(self) -> None:
        self.unsent = 0
        self.written = b""
        self.is_ended = False

    def get_extra_info(self, _name: str) -> None:
        return None

    def get_write_buffer_size(self) -> int:
        return self.unsent

    def write(self, data: bytes) -> None:
        self.written += data

    def abort(self) -> None:
        self.is_ended = True

    close = abort

    def is_closing(self) -> bool:
        return self.is_ended

    def pause_reading(self) -> None: ...

    def resume_reading(self) -> None: ...


class Served:
    """A console whose time passes when the test says so."""

    def __init__(self, hub: BenchHub) -> None:
        self.now_s = 1000.0
        self.loop = asyncio.new_event_loop()
        self.loop.time = lambda: self.now_s  # type: ignore[method-assign]  # the test's time
        self.state = ServerState()
        self.watch = ConnectionWatch(self.state.connections)
        self._config = server_of(console_app(hub, token="a long enough secret")).config
        self._config.load()

    def connected(self) -> tuple[LimitedConnection, Wire]:
        """A new connection."""
        wire: Any = Wire()
        connection = LimitedConnection(self._config, self.state, {}, _loop=self.loop)
        connection.connection_made(wire)
        return connection, wire

    def work(self) -> None:
        """Let the application answer what it can."""
        for _ in range(20):
            self.loop.run_until_complete(asyncio.sleep(0))

    def wait(self, seconds: float) -> None:
        """Let time pass, and look after the connections."""
        self.now_s += seconds
        self.watch.look(self.now_s)

    def close(self) -> None:
        """End what is still being answered."""
        for task in self.state.tasks:
            task.cancel()
        self.work()
        self.loop.close()


@pytest.fixture
def console(tmp_path: Path) -> Iterator[Served]:
    made = Served(idle_hub(tmp_path))
    yield made
    made.close()


@pytest.mark.parametrize(
    ("begin", "time_s"), [(b"", HEADERS_S), (HALF, HEADERS_S), (HALF_BODY, BODY_S)]
)
def test_a_request_must_be_whole_in_time_however_its_bytes_drip(
    console: Served, begin: bytes, time_s: float
) -> None:
    connection, wire = console.connected()
    if begin:
        connection.data_received(begin)
    for _ in range(round(time_s) - 1):
        console.wait(1.0)
        if begin:  # no bytes at all would be the end of the connection
            connection.data_received(b"x")
        console.work()
    assert not wire.is_ended
    console.wait(1.0)
    assert wire.is_ended


def test_the_time_begins_anew_with_each_request_of_a_connection(console: Served) -> None:
    connection, wire = console.connected()
    for _ in range(5):
        console.wait(HEADERS_S - 1)
        connection.data_received(WHOLE[:20])
        connection.data_received(WHOLE[20:])
        console.work()
    assert wire.written.count(b"HTTP/1.1 401 ") == 5
    assert not wire.is_ended
    connection.data_received(HALF)
    console.wait(HEADERS_S)
    assert wire.is_ended


def test_a_body_that_nobody_reads_ends_in_time_as_well(console: Served) -> None:
    connection, wire = console.connected()
    connection.data_received(b"GET / HTTP/1.1\r\nHost: a\r\nContent-Length: 100000000\r\n\r\n")
    console.work()
    assert b" 401 " in wire.written
    for _ in range(round(BODY_S)):
        assert not wire.is_ended
        connection.data_received(b"x" * 1000)
        console.wait(1.0)
    assert wire.is_ended


@pytest.mark.parametrize(
    ("taken_at_s", "is_ended"), [(None, True), (STALLED_S - 2, False)], ids=["deaf", "slow"]
)
def test_a_peer_that_takes_nothing_is_let_go_and_a_slow_one_is_not(
    console: Served, taken_at_s: float | None, is_ended: bool
) -> None:
    connection, wire = console.connected()
    connection.data_received(WHOLE[:-2] + b"Content-Length: 0\r\n\r\n")
    connection._state = (None, "nothing")  # it is being served
    wire.unsent = 10**6
    for second in range(round(STALLED_S) + 1):
        wire.unsent += -10 if second == taken_at_s else 100
        console.wait(1.0)
    assert wire.is_ended is is_ended


def test_half_sent_requests_make_room_for_whole_ones(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(connections, "MAX_CONNECTIONS", 4)
    with served(idle_hub(tmp_path)) as address, ExitStack() as open_:
        held = [open_.enter_context(sent(address, HALF)) for _ in range(3)]
        held.append(open_.enter_context(sent(address, HALF_BODY)))
        assert answered(address, b"GET /static/icon.svg HTTP/1.1", b"Host: 127.0.0.1") == 200
        assert answer_of(held[0]) == b""  # the oldest one made room
        held[1].sendall(b"x\r\n\r\n")  # the others may still become whole
        assert held[1].recv(12) == b"HTTP/1.1 200"


def test_pages_that_are_watched_are_not_let_go_for_new_connections(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(connections, "MAX_CONNECTIONS", 2)
    hub = idle_hub(tmp_path)
    with served(hub) as address, ExitStack() as open_:
        pages = [open_.enter_context(watching(address, number)) for number in range(2)]
        wait_for(lambda: hub.control.view("0" * 32).viewers == 2, "two pages")
        assert answered(address, b"GET / HTTP/1.1", b"Host: 127.0.0.1") == 503
        for page in pages:
            page.send('{"do": "stop"}')
            assert page.recv(DEADLINE_S)
        pages.pop().close()
        wait_for(
            lambda: answered(address, b"GET / HTTP/1.1", b"Host: 127.0.0.1") == 200, "room again"
        )


@contextmanager
def watching(address: Address, number: int) -> Iterator[ClientConnection]:
    """Open the websocket of a page."""
    host = f"{address[0]}:{address[1]}"
    with connect(f"ws://{host}/live", origin=Origin(f"http://{host}")) as page:
        page.send(f'{{"do": "hello", "viewer": "{number:032x}"}}')
        yield page
