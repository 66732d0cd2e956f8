"""Time of a capture's parts for one camera of 780 x 580: average, focus value, storing.

Run with ``python -m benchmarks.bench_capture_write [directory]``; the directory decides which
disk is measured. Each line names its peer: the plain way to do the same.
"""

import os
import platform
import sys
import tempfile
import time
from collections.abc import Callable
from datetime import UTC, datetime
from itertools import cycle
from pathlib import Path

import numpy as np
import tifffile
from numpy.typing import NDArray

from acquisition.averaging import AveragedFrames, average_frames
from acquisition.bench import BenchConfig
from acquisition.devices import CameraSettings, DeviceInfo, Frame, StreamStatistics
from acquisition.focus import focus_value
from acquisition.plan import CapturePlan, PlanEntry, parse_plan
from acquisition.session import Session
from acquisition.session_writer import SessionWriter

ROWS, COLS, FRAMES, ROUNDS = 580, 780, 10, 40

SETTINGS = CameraSettings(
    width_px=COLS,
    height_px=ROWS,
    pixel_format="Mono12",
    exposure_us=2000.0,
    gain_db=0.0,
    frame_rate_hz=67.5,
    black_level_dn=64.0,
)


class MemoryCamera:
    """Frames from memory without any wait, so that only our own work is timed."""

    info = DeviceInfo(vendor="", model="", serial_number="", firmware="", driver="simulated")
    settings = SETTINGS

    def __init__(self, images: list[NDArray[np.uint16]]) -> None:
        self._images = cycle(images)
        self._frame_id = 0

    def set_exposure_us(self, exposure_us: float) -> float:
        """Return the exposure as it is."""
        return exposure_us

    def set_gain_db(self, gain_db: float) -> float:
        """Return the gain as it is."""
        return gain_db

    def start(self) -> None:
        """Begin."""

    def next_frame(self, timeout_s: float) -> Frame:
        """Give the next image."""
        self._frame_id += 1
        return Frame(
            image_dn=next(self._images), frame_id=self._frame_id, timestamp_ns=self._frame_id
        )

    def stop(self) -> None:
        """End."""

    def statistics(self) -> StreamStatistics:
        """Nothing is ever lost."""
        return StreamStatistics(
            complete_frames=self._frame_id,
            incomplete_frames=0,
            resent_packets=0,
            missing_packets=0,
        )

    def close(self) -> None:
        """End."""


def plan() -> CapturePlan:
    return parse_plan(
        {
            "schema": "standoff.plan/1",
            "name": "benchmark",
            "heights_mm": [float(h) for h in range(ROUNDS)],
            "targets": [{"kind": "edge", "target": "E"}],
        },
        source="benchmark",
    )


def bench() -> BenchConfig:
    return BenchConfig.model_validate(
        {
            "camera": {
                "driver": "simulated",
                "pixel_format": "Mono12",
                "exposure_us": 2000.0,
                "gain_db": 0.0,
                "frame_rate_hz": 67.5,
            },
            "stage": {"driver": "simulated", "limits_mm": [0.0, 100.0]},
            "optics": {"focal_length_mm": 8.0, "pixel_pitch_um": 8.3},
        }
    )


def median_ms(work: Callable[[], object]) -> float:
    """Median time of ``ROUNDS`` calls, in ms."""
    times_ms = []
    for _ in range(ROUNDS):
        begin = time.perf_counter()
        work()
        times_ms.append(1e3 * (time.perf_counter() - begin))
    return float(np.median(times_ms))


def medians_in_turn_ms(*works: Callable[[], object]) -> list[float]:
    """Median times of pieces of work that take turns, so that a disk's moods meet all, in ms."""
    times_ms: list[list[float]] = [[] for _ in works]
    for _ in range(ROUNDS):
        for work, times in zip(works, times_ms, strict=True):
            begin = time.perf_counter()
            work()
            times.append(1e3 * (time.perf_counter() - begin))
    return [float(np.median(times)) for times in times_ms]


def written_durably(path: Path, pages: NDArray[np.float32]) -> None:
    with path.open("wb") as file:
        tifffile.imwrite(file, pages)
        file.flush()
        os.fsync(file.fileno())


def report(what: str, ours_ms: float, peer: str, peer_ms: float) -> None:
    ratio = peer_ms / ours_ms
    print(f"{what:34s} {ours_ms:7.2f} ms   {peer:38s} {peer_ms:7.2f} ms   {ratio:5.2f} x")


def numpy_average(images: list[NDArray[np.uint16]]) -> tuple[object, ...]:
    stack = np.stack(images).astype(np.float64)
    return stack.mean(0), stack.var(0, ddof=1), stack.min(), stack.max()


def numpy_focus(image_dn: NDArray[np.uint16]) -> float:
    light = image_dn.astype(np.float64) - SETTINGS.black_level_dn
    gradient = np.mean(np.diff(light, axis=0) ** 2) + np.mean(np.diff(light, axis=1) ** 2)
    return float(gradient / np.mean(light**2))


def store(session: SessionWriter, entry: PlanEntry, averaged: AveragedFrames) -> None:
    now = datetime.now(UTC)
    session.add_capture(
        entry,
        averaged,
        settings=SETTINGS,
        height_mm=entry.height_mm,
        focus_value=0.1,
        started=now,
        finished=now,
    )


def main(directory: Path) -> None:
    rng = np.random.default_rng(1)
    images = [rng.integers(0, 4096, (ROWS, COLS)).astype(np.uint16) for _ in range(FRAMES + 1)]
    camera = MemoryCamera(images)
    print(
        f"Python {platform.python_version()}, numpy {np.__version__}, "
        f"tifffile {tifffile.__version__}, {platform.machine()}, medians of {ROUNDS}"
    )
    report(
        f"average of {FRAMES} frames",
        median_ms(lambda: average_frames(camera, FRAMES)),
        "numpy mean and var of the float64 stack",
        median_ms(lambda: numpy_average(images[1:])),
    )
    report(
        "focus value of a frame",
        median_ms(lambda: focus_value(images[0], black_level_dn=64.0)),
        "numpy differences in float64",
        median_ms(lambda: numpy_focus(images[0])),
    )
    averaged = average_frames(camera, FRAMES)
    pages = np.stack([averaged.mean_dn, averaged.variance_dn2])
    with tempfile.TemporaryDirectory(dir=directory) as folder:
        path = Path(folder) / "session"
        with SessionWriter(
            path, plan=plan(), bench=bench(), devices={}, operator="benchmark"
        ) as session:
            entries = iter(session.entries)
            ours_ms, plain_ms = medians_in_turn_ms(
                lambda: store(session, next(entries), averaged),
                lambda: written_durably(Path(folder) / f"plain{time.monotonic_ns()}.tif", pages),
            )
        report("store: TIFF, sha256, fsync, journal", ours_ms, "tifffile and fsync", plain_ms)
        plain = next(Path(folder).glob("plain*.tif"))
        reader = Session.open(path)
        record = reader.records[0]
        report(
            "load: sha256, parse",
            median_ms(lambda: reader.load(record)),
            "tifffile alone, unverified",
            median_ms(lambda: tifffile.imread(plain)),
        )


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(tempfile.gettempdir()))
