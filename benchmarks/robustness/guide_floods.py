"""The live verdict of a paired phone while another device floods the guide.

The guide and each flood are processes of their own on this machine. The phone, at 127.0.0.1, holds
still before its reference and sends two frames at a time; the flood comes from 127.0.0.2. The peer
is the same phone in the same run without a flood.

    python -m benchmarks.robustness.guide_floods [--seconds 10]
"""

import http.client
import json
import os
import socket
import ssl
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from multiprocessing import get_context
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import Thread
from typing import Annotated
from urllib.parse import urlsplit

import cv2
import numpy as np

from benchmarks.harness import Recorder, benchmark
from benchmarks.truth.hand_held import HeldPose
from tests.standoff.console.guide.scenes import save, wall
from tests.standoff.console.guide.serving import trusting
from tests.standoff.console.processes import first_line, standoff_process

Flood = Callable[[str, bytes], None]
FLOODER = "127.0.0.2"
CONNECTIONS = 8
SIZE = (640, 480)
IN_FLIGHT = 2
BEGINNING_S = 2.0


class Client:
    """One connection of a device to the guide, by TLS; opened again when it is ended."""

    def __init__(self, entry: str, source: str) -> None:
        parts = urlsplit(entry)
        self._host, self._port = str(parts.hostname), int(parts.port or 0)
        self._origin = f"https://{self._host}:{self._port}"
        self._source = source
        self._cookie = ""
        self._open()
        answer = self.ask("GET", f"{parts.path}?{parts.query}")
        self._cookie = (answer.getheader("set-cookie") or "").partition(";")[0]
        answer.read()

    def _open(self) -> None:
        context: ssl.SSLContext = trusting()
        self._wire = http.client.HTTPSConnection(
            self._host, self._port, timeout=30, context=context, source_address=(self._source, 0)
        )

    def ask(self, method: str, path: str, body: bytes | None = None) -> http.client.HTTPResponse:
        """Send a request."""
        headers = {"Origin": self._origin, "Cookie": self._cookie}
        self._wire.request(method, path, body=body, headers=headers)
        return self._wire.getresponse()

    def frame(self, data: bytes) -> tuple[int, bytes]:
        """Send a frame; 0 where the connection was ended."""
        try:
            answer = self.ask("POST", "/frames", data)
            return answer.status, answer.read()
        except (OSError, http.client.HTTPException):
            self._wire.close()
            self._open()
            return 0, b""


def _polite(flood: Flood, entry: str, data: bytes) -> None:
    """Flood with what is left of this computer: a real flood is made on another one."""
    os.nice(19)
    flood(entry, data)


def _frames_of(entry: str, data: bytes) -> None:
    """A paired device that sends frames of another scene as fast as it can."""
    client = Client(entry, FLOODER)
    while True:
        client.frame(data)


def _hostile(entry: str, _: bytes) -> None:
    """A paired device that sends what is no frame."""
    client, data = Client(entry, FLOODER), b"\xff\xd8" + bytes(500_000)
    while True:
        client.frame(data)


def _stranger(entry: str, data: bytes) -> None:
    """A device that is not paired."""
    client = Client(entry.partition("login")[0], FLOODER)
    while True:
        client.frame(data)


def _connections(entry: str, _: bytes) -> None:
    """Connections that send nothing."""
    parts, held = urlsplit(entry), []
    while True:
        with suppress(OSError):
            held.append(
                socket.create_connection(
                    (str(parts.hostname), int(parts.port or 0)), 5, source_address=(FLOODER, 0)
                )
            )
        held = held[-200:]
        time.sleep(0.001)


FLOODS: dict[str, Flood | None] = {
    "none": None,
    "frames of another scene": _frames_of,
    "what is no frame": _hostile,
    "frames without the token": _stranger,
    "connections": _connections,
}


@contextmanager
def _flooded(flood: Flood | None, entry: str, data: bytes) -> Iterator[None]:
    if flood is None:
        yield
        return
    context = get_context("spawn")
    made = [
        context.Process(target=_polite, args=(flood, entry, data), daemon=True)
        for _ in range(CONNECTIONS)
    ]
    for process in made:
        process.start()
    try:
        yield
    finally:
        for process in made:
            process.terminate()
            process.join()


class Phone:
    """Sends frames, two at a time, and notes when verdicts come and how old they are."""

    def __init__(self, entry: str, data: bytes) -> None:
        self.ages_s: list[float] = []
        self.greens = self.refused = 0
        self._entry, self._data = entry, data
        self._ends_s = 0.0

    def run(self, seconds: float) -> None:
        """Send for some time."""
        self._ends_s = time.monotonic() + seconds
        threads = [Thread(target=self._send, args=(0.1 * each,)) for each in range(IN_FLIGHT)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()

    def _send(self, wait_s: float) -> None:
        client = Client(self._entry, "127.0.0.1")
        time.sleep(wait_s)
        while time.monotonic() < self._ends_s:
            begun_s = time.monotonic()
            at = f"/frames?at={1e3 * begun_s:.1f}"
            try:
                answer = client.ask("POST", at, self._data)
                status, text = answer.status, answer.read()
            except (OSError, http.client.HTTPException):
                client = Client(self._entry, "127.0.0.1")
                continue
            if status == 200 and b"verdict" in text:
                self.ages_s.append(time.monotonic() - begun_s)
                self.greens += json.loads(text)["verdict"] == "go"
            else:
                self.refused += status != 200
            time.sleep(max(0.1 - (time.monotonic() - begun_s), 0))


@benchmark("numpy", "opencv-contrib-python-headless", "uvicorn")
def main(
    record: Recorder,
    *,
    seconds: Annotated[float, "of each flood"] = 10.0,
) -> None:
    """Measure the phone's verdicts under each flood."""
    seconds = record.pick(seconds, 3.0)
    rng = np.random.default_rng(1)
    jpeg = [cv2.IMWRITE_JPEG_QUALITY, 60]
    with TemporaryDirectory() as name:
        folder = Path(name)
        scenes = [wall(seed).resized(SIZE).seen([HeldPose()], rng) for seed in (1, 9)]
        reference = save(wall().seen([HeldPose()], rng), folder / "reference.jpg")
        own, other = (cv2.imencode(".jpg", one, jpeg)[1].tobytes() for one in scenes)
        words = ("guide", reference, "--out", folder / "out", "--host", "127.0.0.1", "--port", 0)
        with standoff_process(*words, "--json", cwd=folder) as process:
            entry = first_line(process)["entry"]
            record.say(
                "  flood                       verdicts/s  good  age, median and 95 %  refused"
            )
            for flood_name, flood in FLOODS.items():
                with _flooded(flood, entry, other):
                    time.sleep(BEGINNING_S if flood is None else 2 * BEGINNING_S)
                    phone = Phone(entry, own)
                    phone.run(seconds)
                ages = np.array(phone.ages_s or [np.inf])
                middle, late = np.percentile(ages, (50, 95))
                record.say(
                    f"  {flood_name:26} {len(phone.ages_s) / seconds:10.1f} {phone.greens:6d} "
                    f"{1e3 * middle:8.0f} ms {1e3 * late:8.0f} ms {phone.refused:8d}"
                )
                record.figure(f"{flood_name}: verdicts", len(phone.ages_s) / seconds, "1/s")
                record.figure(f"{flood_name}: age, 95 %", 1e3 * float(late), "ms")
