"""The console behind a real server, and requests exactly as they are written."""

import asyncio
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from threading import Thread
from typing import TYPE_CHECKING

from standoff.console.bench_hub import ConsoleHub
from standoff.console.server import open_socket, server_of
from standoff.console.web._application import console_app
from tests.standoff.console.hub_fixtures import DEADLINE_S, wait_for

if TYPE_CHECKING:
    from starlette.testclient import TestClient

Address = tuple[str, int]


@contextmanager
def served(
    hub: ConsoleHub, *, token: str | None = None, certificate: Path | None = None
) -> Iterator[Address]:
    """Serve the console of a hub on a free port; with a certificate and its key, by TLS."""
    server = server_of(console_app(hub, token=token))
    if certificate is not None:
        server.config.ssl_certfile = certificate
    with open_socket("127.0.0.1", 0) as bound:
        thread = Thread(target=lambda: asyncio.run(server.serve(sockets=[bound])))
        thread.start()
        try:
            wait_for(lambda: server.started, "the server")
            yield ("127.0.0.1", bound.getsockname()[1])
        finally:
            server.should_exit = True
            thread.join()


def page_client(hub: ConsoleHub) -> "TestClient":
    """A client of a hub's pages, on this computer."""
    from starlette.testclient import TestClient

    return TestClient(console_app(hub), client=("127.0.0.1", 1), base_url="http://127.0.0.1")


def sent(address: Address, data: bytes) -> socket.socket:
    """Connect and send what need not be a whole request."""
    connection = socket.create_connection(address, timeout=DEADLINE_S)
    connection.sendall(data)
    return connection


def answer_of(connection: socket.socket) -> bytes:
    """Everything that is sent until the console closes the connection."""
    received = b""
    try:
        while data := connection.recv(65536):
            received += data
    except ConnectionResetError:
        pass
    return received


def answered(address: Address, *lines: bytes) -> int:
    """Status of a request that is made of these lines, headers unchecked."""
    request = b"\r\n".join((*lines, b"Connection: close", b"", b""))
    if any(line.lower().startswith(b"upgrade") for line in lines):
        request = b"\r\n".join((*lines, b"Connection: Upgrade", b"", b""))
    with sent(address, request) as connection:
        return int(answer_of(connection).split(b" ")[1])
