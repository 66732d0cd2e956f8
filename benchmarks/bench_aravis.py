"""The Aravis driver beside a bare loop over Aravis buffers, on the same simulated camera.

Run with ``python -m benchmarks.bench_aravis [--seconds 60]``. The cameras are a process of their
own. Bare loop and driver take turns in another, each on its camera: processor time is the kernel's
figure for that process and all its threads, between the first frame and the last, without imports
and compiling.
"""

import json
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import NDArray

from acquisition.aravis import AravisCamera, load_aravis, open_device
from acquisition.averaging import average_frames
from acquisition.bench import CameraConfig
from benchmarks.harness import Recorder, bench_parser
from hil_mocks.gige import FrameRequest, GigeDevice

BARE_ADDRESS, DRIVER_ADDRESS = "127.201.7.2", "127.201.7.3"
ROWS, COLS, RATE_HZ = 580, 780, 67.5
EXPOSURE_US = 5000.0
SECONDS, ROUNDS = 60, 6
AVERAGES, FRAMES_PER_AVERAGE = 50, 10
CLIENT_TIMEOUT_S = 300


class RecordedFrames:
    """Sixteen frames of noise over and over, so that the camera takes little of the machine."""

    def __init__(self) -> None:
        rng = np.random.default_rng(1)
        self._frames = [rng.integers(64, 4000, (ROWS, COLS)).astype(np.uint16) for _ in range(16)]

    @property
    def shape(self) -> tuple[int, int]:
        """See `FrameSource.shape`."""
        return ROWS, COLS

    def levels_dn(self, request: FrameRequest) -> NDArray[np.uint16]:
        """See `FrameSource.levels_dn`."""
        return self._frames[request.index % len(self._frames)]


def serve() -> None:
    """Serve the cameras until standard input ends."""
    frames = RecordedFrames()
    with (
        GigeDevice(frames, address=BARE_ADDRESS),
        GigeDevice(frames, address=DRIVER_ADDRESS),
    ):
        print("ready", flush=True)
        sys.stdin.read()


def config() -> CameraConfig:
    return CameraConfig.model_validate(
        {
            "driver": "aravis",
            "address": DRIVER_ADDRESS,
            "pixel_format": "Mono12",
            "exposure_us": EXPOSURE_US,
            "gain_db": 0.0,
            "frame_rate_hz": RATE_HZ,
            "packet_size_bytes": 1500,
        }
    )


class BareLoop:
    """Pop, copy, push back: what any program that uses Aravis has to do."""

    def __init__(self) -> None:
        opened = open_device(BARE_ADDRESS)
        self._api, self._camera = load_aravis().api, opened.camera
        camera = self._camera
        camera.set_pixel_format_from_string("Mono12")
        camera.set_region(0, 0, COLS, ROWS)
        camera.gv_set_packet_size(1500)
        camera.set_exposure_time(EXPOSURE_US)
        camera.set_frame_rate(RATE_HZ)
        camera.gv_set_stream_options(self._api.GvStreamOption.PACKET_SOCKET_DISABLED)
        self._stream = camera.create_stream(None, None)
        self._stream.set_property("socket-buffer", self._api.GvStreamSocketBuffer.FIXED)
        self._stream.set_property("socket-buffer-size", 4 * 2**20)
        payload_bytes = camera.get_payload()
        for _ in range(21):
            self._stream.push_buffer(self._api.Buffer.new_allocate(payload_bytes))

    def run(self, frames: int) -> int:
        """Take as many frames and one more; the number that was not complete."""
        self._camera.start_acquisition()
        lost = 0
        for _ in range(frames + 1):
            buffer = self._stream.timeout_pop_buffer(2_000_000)
            if buffer.get_status() == self._api.BufferStatus.SUCCESS:
                np.frombuffer(buffer.get_data(), np.uint16)
            else:
                lost += 1
            self._stream.push_buffer(buffer)
        self._camera.stop_acquisition()
        return lost


def run_turns(rounds: int, frames: int) -> dict[str, list[float]]:
    """Let both take as many frames in turns: processor seconds, and frames lost, of each turn."""
    bare, camera = BareLoop(), AravisCamera.open(config())
    average_frames(camera, FRAMES_PER_AVERAGE)
    bare.run(FRAMES_PER_AVERAGE)
    figures: dict[str, list[float]] = {
        name: [] for name in ("bare_s", "bare_lost", "driver_s", "driver_lost")
    }
    for _ in range(rounds):
        begin_s = time.process_time()
        figures["bare_lost"].append(bare.run(frames))
        figures["bare_s"].append(time.process_time() - begin_s)
        begin_s = time.process_time()
        figures["driver_lost"].append(average_frames(camera, frames).incomplete_frames)
        figures["driver_s"].append(time.process_time() - begin_s)
    camera.close()
    return figures


def run_latency(frames: int) -> dict[str, float]:
    """Median time of a short average, start to stop, and of its share that is not waiting."""
    camera = AravisCamera.open(config())
    average_frames(camera, frames)
    times_s = []
    for _ in range(AVERAGES):
        begin_s = time.perf_counter()
        average_frames(camera, frames)
        times_s.append(time.perf_counter() - begin_s)
    camera.close()
    return {"median_s": float(np.median(times_s)), "worst_s": max(times_s)}


@contextmanager
def camera_process() -> Iterator[None]:
    arguments = [sys.executable, "-m", "benchmarks.bench_aravis", "serve"]
    with subprocess.Popen(
        arguments, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as server:
        assert server.stdout is not None
        assert server.stdout.readline() == "ready\n"
        yield
        assert server.stdin is not None
        server.stdin.close()


def client(what: str, *numbers: int) -> dict[str, Any]:
    """Run one client in a process of its own; its figures."""
    done = subprocess.run(
        [sys.executable, "-m", "benchmarks.bench_aravis", what, *map(str, numbers)],
        capture_output=True,
        text=True,
        check=True,
        timeout=CLIENT_TIMEOUT_S,
    )
    result: dict[str, Any] = json.loads(done.stdout)
    return result


def compare(record: Recorder, seconds: float) -> None:
    """Let bare loop and driver take turns, then measure the driver's short averages."""
    frames = round(seconds * RATE_HZ / ROUNDS)
    with camera_process():
        turns = client("turns", ROUNDS, frames)
        latency = client("latency", FRAMES_PER_AVERAGE)
    bare_ms, driver_ms = (1e3 * np.median(turns[key]) / frames for key in ("bare_s", "driver_s"))
    for name, milliseconds, lost in (
        ("bare Aravis loop", bare_ms, turns["bare_lost"]),
        ("driver and average", driver_ms, turns["driver_lost"]),
    ):
        record.say(
            f"{name:20s} {milliseconds:6.3f} ms of processor time a frame; "
            f"{frames * ROUNDS - sum(lost)} of {frames * ROUNDS} frames"
        )
    record.figure(
        "processor time of a frame through driver and average",
        driver_ms,
        "ms",
        peer="a bare loop over Aravis",
        peer_value=bare_ms,
    )
    record.say(f"ratio of processor times {driver_ms / bare_ms:.2f}")
    ideal_s = (FRAMES_PER_AVERAGE + 1) / RATE_HZ
    record.figure(
        f"average of {FRAMES_PER_AVERAGE} frames, start to stop",
        1e3 * latency["median_s"],
        "ms",
        peer="the camera's own time for them",
        peer_value=1e3 * ideal_s,
    )
    record.say(
        f"average of {FRAMES_PER_AVERAGE} frames: median of {AVERAGES} "
        f"{1e3 * latency['median_s']:.1f} ms, worst {1e3 * latency['worst_s']:.1f} ms; ideal "
        f"{1e3 * ideal_s:.1f} ms, ratio {latency['median_s'] / ideal_s:.2f}"
    )


def main() -> None:
    parser = bench_parser(__doc__)
    parser.add_argument("--seconds", type=float, help="seconds of frames, 60 by default")
    given = parser.parse_args()
    library = load_aravis()
    with Recorder.of(
        given,
        "aravis",
        packages=("numpy", "numba", "PyGObject"),
        note=f"Aravis {library.aravis_version}; {COLS} x {ROWS} Mono12, {RATE_HZ} frames/s, "
        "packets of 1500 bytes",
    ) as record:
        compare(record, given.seconds or record.pick(SECONDS, 5))


if __name__ == "__main__":
    clients: dict[str, Callable[..., dict[str, Any]]] = {"turns": run_turns, "latency": run_latency}
    if sys.argv[1:2] == ["serve"]:
        serve()
    elif sys.argv[1:2] and sys.argv[1] in clients:
        print(json.dumps(clients[sys.argv[1]](*map(int, sys.argv[2:]))))
    else:
        main()
