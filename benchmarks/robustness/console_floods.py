"""STOP under floods: how long a moving stage moves on while everything is thrown at the console.

The console, the practice camera and each flood are processes of their own on this machine; the
stage is an emulated Grbl controller on a serial port in this process, whose true height says when
it is at rest. The peer is the same STOP in the same run without a flood. The operator's page was
open before the floods began; another operator comes while they last.
"""

import json
import os
import random
import socket
import statistics
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from http.client import HTTPConnection, HTTPException
from multiprocessing import get_context
from multiprocessing.process import BaseProcess
from pathlib import Path
from threading import Thread
from typing import Annotated

from websockets import Origin
from websockets.exceptions import WebSocketException
from websockets.sync.client import ClientConnection, connect

from benchmarks.harness import Recorder, benchmark
from benchmarks.speed.console import process_of
from hil_mocks.stages import SerialStage
from standoff.shipped_configs import shipped_config
from tests.hil_mocks.gige_bench import free_addresses
from tests.standoff.console.long_session import lengthen
from tests.standoff.console.processes import first_line, standoff_process

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


TOKEN = "a token for the benchmark"
CAPTURES = 10_000
FEED_MM_PER_S = 40.0
LOW_MM, HIGH_MM = 130.0, 490.0
WARM_UP_S = 3.0
SAMPLE_S = 0.002
STILL_S = 0.15
"""At rest is a stage whose true height has not changed for this long."""

BENCH_KEYS = (f"stage.feed_mm_per_min={60 * FEED_MM_PER_S:g}", "stage.settle_s=0.1")
MOCK_KEYS = ("simulated.width_px=780", "simulated.height_px=580")
PLAN = """
schema = "standoff.plan/1"
name = "one height"
heights_mm = [300.0]
frames_per_capture = 2

[[targets]]
kind = "edge"
target = "edge"
orientations_deg = [5.0]
"""


class _Operator:
    """A page that is open all the time, reads what it is sent, and stops the stage."""

    def __init__(self, address: Address, cookie: str) -> None:
        self._opened = ExitStack()
        self._page = self._opened.enter_context(watching(address, cookie, name="Ada"))
        self.state: dict[str, object] = {}
        self._reader = Thread(target=self._read, daemon=True)
        self._reader.start()

    def say(self, **message: object) -> None:
        """Send one message."""
        self._page.send(json.dumps(message))

    def stage(self, key: str) -> object:
        """What the page shows of the stage."""
        stage = self.state.get("stage")
        return stage[key] if isinstance(stage, dict) else None

    def close(self) -> None:
        """Leave."""
        self._opened.close()

    def _read(self) -> None:
        with suppress(WebSocketException, OSError):
            for message in self._page:
                if isinstance(message, bytes):
                    sequence = int.from_bytes(message[4:8], "little")
                    self.say(do="ack", sequence=sequence)
                    continue
                document = json.loads(message)
                if document["type"] == "state":
                    self.state = {**self.state, **document}  # what is new


@dataclass(frozen=True, slots=True, kw_only=True)
class _Rig:
    """The console that is flooded and the stage that it moves."""

    address: Address
    cookie: str
    stage: SerialStage
    console_pid: int


@contextmanager
def _flooded_rig(folder: Path) -> Iterator[_Rig]:
    """Serve a practice camera and a Grbl stage, and the console over them, with a long session."""
    os.environ["STANDOFF_TOKEN"] = TOKEN
    bench = shipped_config("grbl_stage.toml")
    _make_long_session(folder)
    keys = [word for key in MOCK_KEYS for word in ("--set", key)]
    with (
        SerialStage("grbl") as stage,
        standoff_process(
            "mock", "--address", next(free_addresses()), "--json", *keys, cwd=folder
        ) as mock,
    ):
        camera = first_line(mock)["camera_address"]
        bench_keys = (*BENCH_KEYS, f"camera.address={camera}", f"stage.port={stage.port}")
        settings = [word for key in bench_keys for word in ("--set", key)]
        with standoff_process(
            "console", "--bench", bench, "--port", 0, "--json",
            "--sessions", folder / "sessions", *settings, cwd=folder,
        ) as console:  # fmt: skip
            port = int(first_line(console)["url"].rstrip("/").rpartition(":")[2])
            address = ("127.0.0.1", port)
            yield _Rig(
                address=address,
                cookie=_logged_in(address),
                stage=stage,
                console_pid=console.pid,
            )


def _make_long_session(folder: Path) -> None:
    """A session of 10 000 captures in the console's folder."""
    (folder / "plan.toml").write_text(PLAN)
    session = folder / "sessions" / BIG_SESSION
    session.parent.mkdir()
    words = (
        "capture", "--bench", shipped_config("simulated.toml"), "--plan", folder / "plan.toml",
        "--out", session, "--yes", "--set", "simulated.width_px=64",
        "--set", "simulated.height_px=48",
    )  # fmt: skip
    with standoff_process(*words, cwd=folder) as process:
        process.wait(300)
    lengthen(session, CAPTURES)


def _logged_in(address: Address) -> str:
    """The cookie of somebody who knows the token."""
    connection = HTTPConnection(*address, timeout=30)
    connection.request("GET", f"/login?token={TOKEN.replace(' ', '+')}")
    answer = connection.getresponse()
    cookie = answer.getheader("set-cookie")
    connection.close()
    if cookie is None:
        raise RuntimeError(f"the token was refused with {answer.status}")
    return cookie.partition(";")[0]


def _wait_for(condition: object, what: str, timeout_s: float = 120.0) -> None:
    assert callable(condition)
    end_s = time.monotonic() + timeout_s
    while not condition():
        if time.monotonic() > end_s:
            raise TimeoutError(what)
        time.sleep(0.01)


def _stop_s(rig: _Rig, operator: _Operator) -> float:
    """Start a long move, send STOP, and measure how long the stage still moves."""
    _wait_for(lambda: operator.stage("motion") == "idle", "stage at rest")
    begin_mm = rig.stage.true_height_mm
    operator.say(do="take", name="Ada")
    operator.say(do="move", height_mm=LOW_MM if begin_mm > (LOW_MM + HIGH_MM) / 2 else HIGH_MM)
    _wait_for(lambda: abs(rig.stage.true_height_mm - begin_mm) > 20, "stage under way")
    sent_s = moved_s = time.monotonic()
    operator.say(do="stop")
    height_mm = rig.stage.true_height_mm
    while time.monotonic() - moved_s < STILL_S:
        time.sleep(SAMPLE_S)
        now_mm = rig.stage.true_height_mm
        if now_mm != height_mm:
            height_mm, moved_s = now_mm, time.monotonic()
    return moved_s - sent_s


def _measure(record: Recorder, rig: _Rig, tries: int, choice: Sequence[str]) -> None:
    operator = _Operator(rig.address, rig.cookie)
    _wait_for(lambda: operator.stage("motion") in ("idle", "alarm"), "stage there")
    operator.say(do="take", name="Ada")
    operator.say(do="home")
    _wait_for(lambda: operator.stage("is_homed"), "stage homed")
    quiet = [_stop_s(rig, operator) for _ in range(tries)]
    record.say(f"{'no flood':28} {_told(quiet)}  {_connections_of(rig)} open")
    for names in ([name] for name in choice) if len(choice) < len(FLOODS) else (
        *([name] for name in FLOODS),
        list(FLOODS),
    ):  # fmt: skip
        name = names[0] if len(names) == 1 else "all at once"
        processes = flooding(names, rig.address, rig.cookie)
        try:
            time.sleep(WARM_UP_S)
            try:
                stops = [_stop_s(rig, operator) for _ in range(tries)]
                record.say(f"{name:28} {_told(stops)}  {_connections_of(rig)} open{_came_in(rig)}")
                record.figure(f"STOP, worst, {name}", max(stops), "s", "no flood", max(quiet))
            except (TimeoutError, OSError, WebSocketException) as error:
                record.say(f"{name:28} no STOP: {error!r}; {_connections_of(rig)} open")
                operator = _Operator(rig.address, rig.cookie)
        finally:
            for process in processes:
                process.kill()
            for process in processes:
                process.join()
    record.say(f"memory of the console {process_of(rig.console_pid).memory_mb:.0f} MB")


def _told(stops: Sequence[float]) -> str:
    return f"median {statistics.median(stops):6.3f} s, worst {max(stops):6.3f} s"


def _connections_of(rig: _Rig) -> int:
    """Connections that the console holds: its sockets without the one that listens, and a few."""
    number = 0
    for file in Path(f"/proc/{rig.console_pid}/fd").iterdir():
        with suppress(FileNotFoundError):
            number += file.readlink().name.startswith("socket:")
    return number


def _came_in(rig: _Rig) -> str:
    """Whether another page is served meanwhile."""
    begin_s = time.monotonic()
    status = ask(rig.address, "GET", "/doctor", headers={"Cookie": rig.cookie})
    return f"; another page {status} after {time.monotonic() - begin_s:.2f} s"


@benchmark("starlette", "uvicorn", "websockets")
def main(
    record: Recorder,
    *,
    flood: Annotated[list[str] | None, f"only this one of {list(FLOODS)}"] = None,
) -> None:
    with (
        tempfile.TemporaryDirectory() as folder,
        _flooded_rig(Path(folder)) as rig,
    ):
        record.say(f"load {os.getloadavg()[0]:.1f}")
        _measure(record, rig, record.pick(10, 3), flood or list(FLOODS))
        record.say(f"load {os.getloadavg()[0]:.1f}")
