"""The Aravis driver beside a bare loop over Aravis buffers, on the same simulated camera.

Run with ``python -m benchmarks.speed.aravis [--seconds 60]``. The cameras are a process of their
own. Bare loop and driver take turns in another, each on its camera: processor time is the kernel's
figure for that process and all its threads, between the first frame and the last, without imports
and compiling.
"""

import time
from multiprocessing import get_context
from multiprocessing.connection import Connection
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from acquisition.aravis import AravisCamera, load_aravis, open_device
from acquisition.averaging import average_frames
from acquisition.bench import CameraConfig
from benchmarks.harness import Recorder, apart, benchmark
from hil_mocks.gige import FrameRequest, GigeDevice

BARE_ADDRESS, DRIVER_ADDRESS = "127.201.7.2", "127.201.7.3"
ROWS, COLS, RATE_HZ = 580, 780, 67.5
EXPOSURE_US = 5000.0
SECONDS, ROUNDS = 60, 6
AVERAGES, FRAMES_PER_AVERAGE = 50, 10


class _RecordedFrames:
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


def _serve(pipe: Connection) -> None:
    """Serve the cameras until told to end."""
    frames = _RecordedFrames()
    with GigeDevice(frames, address=BARE_ADDRESS), GigeDevice(frames, address=DRIVER_ADDRESS):
        pipe.send("ready")
        pipe.recv()


def _config() -> CameraConfig:
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


class _BareLoop:
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


def _run_turns(rounds: int, frames: int) -> dict[str, list[float]]:
    """Let both take as many frames in turns: processor seconds, and frames lost, of each turn."""
    bare, camera = _BareLoop(), AravisCamera.open(_config())
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


def _run_latency(frames: int) -> dict[str, float]:
    """Median time of a short average, start to stop, and of its share that is not waiting."""
    camera = AravisCamera.open(_config())
    average_frames(camera, frames)
    times_s = []
    for _ in range(AVERAGES):
        begin_s = time.perf_counter()
        average_frames(camera, frames)
        times_s.append(time.perf_counter() - begin_s)
    camera.close()
    return {"median_s": float(np.median(times_s)), "worst_s": max(times_s)}


def _compare(record: Recorder, seconds: float) -> None:
    """Let bare loop and driver take turns, then measure the driver's short averages."""
    frames = round(seconds * RATE_HZ / ROUNDS)
    context = get_context("spawn")
    ours, theirs = context.Pipe()
    server = context.Process(target=_serve, args=(theirs,), daemon=True)
    server.start()
    ours.recv()
    turns = apart(_run_turns, ROUNDS, frames)
    latency = apart(_run_latency, FRAMES_PER_AVERAGE)
    ours.send("end")
    server.join()
    for name in ("bare", "driver"):
        lost = round(sum(turns[f"{name}_lost"]))
        record.say(f"{name}: {lost} of {frames * ROUNDS} frames lost")
    bare_s, driver_s = (float(np.median(turns[f"{key}_s"])) / frames for key in ("bare", "driver"))
    record.time(
        "processor time of a frame through driver and average",
        driver_s,
        "a bare loop over Aravis",
        bare_s,
    )
    record.time(
        f"average of {FRAMES_PER_AVERAGE} frames, start to stop",
        latency["median_s"],
        "the camera's own time for them",
        (FRAMES_PER_AVERAGE + 1) / RATE_HZ,
    )
    record.say(f"worst of {AVERAGES}: {1e3 * latency['worst_s']:.1f} ms")


@benchmark(
    "numpy",
    "numba",
    "PyGObject",
    note=f"{COLS} x {ROWS} Mono12, {RATE_HZ} frames/s, packets of 1500 bytes",
)
def main(
    record: Recorder, *, seconds: Annotated[float | None, "seconds of frames, 60 by default"] = None
) -> None:
    record.say(f"Aravis {load_aravis().aravis_version}")
    _compare(record, seconds or record.pick(SECONDS, 5))
