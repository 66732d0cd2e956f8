"""Floods of a console: what a hostile or broken program may send, as fast as it can.

Each is a function of the address and the cookie of somebody who is in; each runs until its process
is ended, and is counted by nobody: the console decides how much of it is served.
"""

import json
import random
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from http.client import HTTPConnection, HTTPException
from multiprocessing import get_context
from multiprocessing.process import BaseProcess
from threading import Thread

from websockets import Origin
from websockets.exceptions import WebSocketException
from websockets.sync.client import ClientConnection, connect

Address = tuple[str, int]
Flood = Callable[[Address, str], None]

HALF_SENT = 600
"""Connections that one flood holds, or tries to."""

DRIP_S = 1.0
BIG_SESSION = "big"


def _guesses(address: Address, _: str) -> None:
    """Guess the token."""
    while True:
        ask(address, "POST", "/login", body=f"token=guess{random.random()}")


def _half_sent(address: Address, _: str) -> None:
    """Begin requests and never end them."""
    _drip(address, b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\nX-Slow: ")


def _half_bodies(address: Address, _: str) -> None:
    """Begin bodies and never end them."""
    _drip(address, b"POST /login HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: 4000\r\n\r\n")


def _connections(address: Address, _: str) -> None:
    """Connect and leave again."""
    while True:
        with suppress(OSError), socket.create_connection(address, timeout=5):
            pass


def _bad_names(address: Address, cookie: str) -> None:
    """Ask under names that are none, and open websockets from pages that are none."""
    upgrade = {
        "Connection": "Upgrade",
        "Upgrade": "websocket",
        "Sec-WebSocket-Version": "13",
        "Sec-WebSocket-Key": "AAAAAAAAAAAAAAAAAAAAAA==",
    }
    while True:
        ask(address, "GET", "/", headers={"Host": "[", "Cookie": cookie})
        ask(address, "GET", "/live", headers={"Origin": "http://[", "Cookie": cookie} | upgrade)


def _pages(address: Address, cookie: str) -> None:
    """Read the largest pages again and again."""
    while True:
        for path in (f"/sessions/{BIG_SESSION}", "/sessions", "/", "/doctor"):
            ask(address, "GET", path, headers={"Cookie": cookie})


def _messages(address: Address, cookie: str) -> None:
    """Send messages, good and bad, faster than they can be read."""
    while True:
        with suppress(OSError, WebSocketException), watching(address, cookie) as page:
            while True:
                page.send("{" * 100)
                page.send('{"do": "preview", "plan": "nothing"}')
                page.send('{"do": "ack", "sequence": 1}')


def _deaf_viewers(address: Address, cookie: str) -> None:
    """Ask for pictures and read none."""
    while True:
        # The client stops reading when 16 messages wait for it, and answers no ping then.
        with suppress(OSError, WebSocketException), watching(address, cookie):
            time.sleep(60)


FLOODS: dict[str, tuple[Flood, int]] = {
    "guesses of the token": (_guesses, 4),
    "half-sent requests": (_half_sent, 1),
    "half-sent bodies": (_half_bodies, 1),
    "connections": (_connections, 4),
    "bad Host and Origin": (_bad_names, 4),
    "pages of 10 000 captures": (_pages, 8),
    "messages": (_messages, 8),
    "viewers that read nothing": (_deaf_viewers, 8),
}
"""What is sent, and by how many threads."""


def flooding(names: list[str], address: Address, cookie: str) -> list[BaseProcess]:
    """Start the named floods, each in a process of its own."""
    context = get_context("spawn")
    processes: list[BaseProcess] = []
    for name in names:
        process = context.Process(target=_flood, args=(name, address, cookie), daemon=True)
        process.start()
        processes.append(process)
    return processes


def _flood(name: str, address: Address, cookie: str) -> None:
    flood, number = FLOODS[name]
    threads = [Thread(target=flood, args=(address, cookie), daemon=True) for _ in range(number)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()


def _drip(address: Address, begin: bytes) -> None:
    """Hold connections that have sent ``begin``, and a letter more now and then."""
    held: list[socket.socket] = []
    while True:
        with suppress(OSError):
            while len(held) < HALF_SENT:
                held.append(socket.create_connection(address, timeout=5))
                held[-1].sendall(begin)
        time.sleep(DRIP_S)
        for each in list(held):
            try:
                each.sendall(b"x")
            except OSError:
                each.close()
                held.remove(each)


def ask(
    address: Address,
    method: str,
    path: str,
    *,
    body: str = "",
    headers: dict[str, str] | None = None,
) -> int:
    """Ask once on a connection of its own; the status, 0 without an answer."""
    connection = HTTPConnection(*address, timeout=10)
    try:
        connection.request(method, path, body=body or None, headers=headers or {})
        answer = connection.getresponse()
        answer.read()
    except (OSError, HTTPException):
        return 0
    else:
        return answer.status
    finally:
        connection.close()


@contextmanager
def watching(address: Address, cookie: str, name: str = "") -> Iterator[ClientConnection]:
    """Open the websocket of a page that is in, and ask for pictures."""
    host = f"{address[0]}:{address[1]}"
    with connect(
        f"ws://{host}/live",
        origin=Origin(f"http://{host}"),
        additional_headers={"Cookie": cookie},
        open_timeout=30,
    ) as page:
        viewer = f"{random.getrandbits(128):032x}"
        page.send(json.dumps({"do": "hello", "viewer": viewer, "name": name, "pictures": True}))
        yield page
