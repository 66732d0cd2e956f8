"""The Aravis driver beside a bare loop over Aravis buffers, on the same simulated camera.

Run with ``python -m benchmarks.bench_aravis [--seconds 60]``. Cameras, bare loop and driver are
processes of their own, so that each client's processor time is the kernel's figure for the whole
process: imports, threads of Aravis and all. Both clients run at the same time, each on a camera
of its own, so that what else the machine does falls on both.
"""

import json
import resource
import subprocess
import sys
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager

import numpy as np
from numpy.typing import NDArray

from acquisition.aravis import AravisCamera, load_aravis, open_device
from acquisition.averaging import average_frames
from acquisition.bench import CameraConfig
from acquisition.devices import Frame
from benchmarks.harness import Recorder, bench_parser
from hil_mocks.gige import FrameRequest, GigeDevice

BARE_ADDRESS, DRIVER_ADDRESS = "127.201.7.2", "127.201.7.3"
ROWS, COLS, RATE_HZ = 580, 780, 67.5
EXPOSURE_US = 5000.0
SECONDS = 60
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


def run_bare(frames: int) -> dict[str, float]:
    """Pop, copy, push back: what any program that uses Aravis has to do."""
    opened = open_device(BARE_ADDRESS)
    api, camera = load_aravis().api, opened.camera
    camera.set_pixel_format_from_string("Mono12")
    camera.set_region(0, 0, COLS, ROWS)
    camera.gv_set_packet_size(1500)
    camera.set_exposure_time(EXPOSURE_US)
    camera.set_frame_rate(RATE_HZ)
    camera.gv_set_stream_options(api.GvStreamOption.PACKET_SOCKET_DISABLED)
    stream = camera.create_stream(None, None)
    stream.set_property("socket-buffer", api.GvStreamSocketBuffer.FIXED)
    stream.set_property("socket-buffer-size", 4 * 2**20)
    payload_bytes = camera.get_payload()
    for _ in range(21):
        stream.push_buffer(api.Buffer.new_allocate(payload_bytes))
    camera.start_acquisition()
    complete = 0
    begin_s = time.monotonic()
    for _ in range(frames + 1):
        buffer = stream.timeout_pop_buffer(2_000_000)
        if buffer.get_status() == api.BufferStatus.SUCCESS:
            np.frombuffer(buffer.get_data(), np.uint16)
            complete += 1
        stream.push_buffer(buffer)
    elapsed_s = time.monotonic() - begin_s
    camera.stop_acquisition()
    return {"complete": complete, "lost": frames + 1 - complete, "elapsed_s": elapsed_s}


def run_driver(frames: int) -> dict[str, float]:
    """Average as many frames through the driver."""
    camera = AravisCamera.open(config())
    deliver, last_id = camera.next_frame, 0

    def next_frame(timeout_s: float) -> Frame:
        nonlocal last_id
        frame = deliver(timeout_s)
        last_id = frame.frame_id
        return frame

    camera.next_frame = next_frame  # type: ignore[method-assign]  # observed, not changed
    begin_s = time.monotonic()
    averaged = average_frames(camera, frames)
    elapsed_s = time.monotonic() - begin_s
    camera.close()
    complete = averaged.frames_used + 1
    return {"complete": complete, "lost": last_id - complete, "elapsed_s": elapsed_s}


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


def client(what: str, frames: int) -> dict[str, float]:
    """Run one client in a process of its own; its figures, with user and system time."""
    done = subprocess.run(
        [sys.executable, "-m", "benchmarks.bench_aravis", what, str(frames)],
        capture_output=True,
        text=True,
        check=True,
        timeout=CLIENT_TIMEOUT_S,
    )
    result: dict[str, float] = json.loads(done.stdout)
    return result


def compare(record: Recorder, seconds: float) -> None:
    """Run both clients at once, then the driver's short averages."""
    frames = round(seconds * RATE_HZ)

    with camera_process():
        client("driver", FRAMES_PER_AVERAGE)  # compiles what is not compiled yet
        with ThreadPoolExecutor(max_workers=2) as clients_at_once:
            bare, driver = clients_at_once.map(client, ("bare", "driver"), (frames, frames))
        latency = client("latency", FRAMES_PER_AVERAGE)
    for name, figures in (("bare Aravis loop", bare), ("driver and average", driver)):
        record.say(
            f"{name:20s} {figures['processor_s']:6.2f} s of processor time "
            f"({figures['user_s']:.2f} user, {figures['system_s']:.2f} system) for {frames} "
            f"frames in {figures['elapsed_s']:.1f} s, {figures['lost']:.0f} lost"
        )
    record.figure(
        f"processor time of {frames} frames through driver and average",
        driver["processor_s"],
        "s",
        peer="a bare loop over Aravis",
        peer_value=bare["processor_s"],
    )
    record.say(f"ratio of processor times {driver['processor_s'] / bare['processor_s']:.2f}")
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
    clients = {"bare": run_bare, "driver": run_driver, "latency": run_latency}
    if sys.argv[1:2] == ["serve"]:
        serve()
    elif sys.argv[1:2] and sys.argv[1] in clients:
        outcome = clients[sys.argv[1]](int(sys.argv[2]))
        used = resource.getrusage(resource.RUSAGE_SELF)
        outcome |= {
            "processor_s": used.ru_utime + used.ru_stime,
            "user_s": used.ru_utime,
            "system_s": used.ru_stime,
        }
        print(json.dumps(outcome))
    else:
        main()
