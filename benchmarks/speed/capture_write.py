"""Time of a capture's parts for one camera of 780 x 580: average, focus value, storing.

Run with ``python -m benchmarks.speed.capture_write [--on DIRECTORY]``; the directory decides which
disk is measured. Each line names its peer: the plain way to do the same.
"""

import os
import tempfile
import time
from datetime import UTC, datetime
from itertools import cycle
from pathlib import Path

import numpy as np
import tifffile
from numpy.typing import NDArray

from acquisition.averaging import AveragedFrames, average_frames
from acquisition.devices import CameraSettings, DeviceInfo, Frame, StreamStatistics
from acquisition.focus import focus_value
from acquisition.plan import CapturePlan, PlanEntry, parse_plan
from acquisition.session import Session, SessionWriter, Take
from benchmarks.harness import Recorder, Work, benchmark, medians_s
from simulation.arrays import Float32Array
from tests.hil_mocks.benches import bench_config

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


class _MemoryCamera:
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


def _written_durably(path: Path, pages: Float32Array) -> None:
    with path.open("wb") as file:
        tifffile.imwrite(file, pages)
        file.flush()
        os.fsync(file.fileno())


def _compare(
    record: Recorder,
    what: str,
    ours: Work,
    peer: str,
    theirs: Work,
    rounds: int,
    *,
    is_warm: bool = False,
) -> None:
    """Time two pieces of work that take turns, so that a disk's moods meet both."""
    ours_s, peer_s = medians_s([ours, theirs], rounds, is_warm=is_warm)
    record.time(what, ours_s, peer, peer_s)


def _numpy_average(images: list[NDArray[np.uint16]]) -> tuple[object, ...]:
    stack = np.stack(images).astype(np.float64)
    return stack.mean(0), stack.var(0, ddof=1), stack.min(), stack.max()


def _numpy_focus(image_dn: NDArray[np.uint16]) -> float:
    light = image_dn.astype(np.float64) - SETTINGS.black_level_dn
    gradient = np.mean(np.diff(light, axis=0) ** 2) + np.mean(np.diff(light, axis=1) ** 2)
    return float(gradient / np.mean(light**2))


def _store(session: SessionWriter, entry: PlanEntry, averaged: AveragedFrames) -> None:
    now = datetime.now(UTC)
    session.add_capture(
        entry,
        Take(
            averaged=averaged,
            settings=SETTINGS,
            height_mm=entry.height_mm,
            focus_value=0.1,
            started=now,
            finished=now,
        ),
    )


def _measure(record: Recorder, directory: Path) -> None:
    rng = np.random.default_rng(1)
    images = [rng.integers(0, 4096, (ROWS, COLS)).astype(np.uint16) for _ in range(FRAMES + 1)]
    camera = _MemoryCamera(images)
    rounds = record.pick(ROUNDS, 10)
    _compare(
        record,
        f"average of {FRAMES} frames",
        lambda: average_frames(camera, FRAMES),
        "numpy mean and var of the float64 stack",
        lambda: _numpy_average(images[1:]),
        rounds,
    )
    _compare(
        record,
        "focus value of a frame",
        lambda: focus_value(images[0], black_level_dn=64.0),
        "numpy differences in float64",
        lambda: _numpy_focus(images[0]),
        rounds,
    )
    averaged = average_frames(camera, FRAMES)
    pages = np.stack([averaged.mean_dn, averaged.variance_dn2])
    with tempfile.TemporaryDirectory(dir=directory) as folder:
        path = Path(folder) / "session"
        with SessionWriter(
            path, plan=plan(), bench=bench_config(), devices={}, operator="benchmark"
        ) as session:
            entries = iter(session.entries)
            _compare(
                record,
                "store: TIFF, sha256, fsync, journal",
                lambda: _store(session, next(entries), averaged),
                "tifffile and fsync",
                lambda: _written_durably(Path(folder) / f"plain{time.monotonic_ns()}.tif", pages),
                rounds,
                is_warm=True,  # the plan holds no entry to warm up with
            )
        plain = next(Path(folder).glob("plain*.tif"))
        reader = Session(path)
        capture = reader.records[0]
        _compare(
            record,
            "load: sha256, parse",
            lambda: reader.load(capture),
            "tifffile alone, unverified",
            lambda: tifffile.imread(plain),
            rounds,
        )


@benchmark("numpy", "numba", "tifffile")
def main(record: Recorder, *, on: Path | None = None) -> None:
    _measure(record, on or Path(tempfile.gettempdir()))
