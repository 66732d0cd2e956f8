"""A camera and a stage that follow a script, and a clock that passes only when they say so."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from itertools import count

import numpy as np

from acquisition.devices import (
    CameraSettings,
    DeviceInfo,
    Frame,
    FrameImage,
    StageState,
    StreamStatistics,
)
from acquisition.errors import DeviceTimeoutError, StageLimitError, StageNotHomedError

ROWS, COLS = 4, 6

SETTINGS = CameraSettings(
    width_px=COLS,
    height_px=ROWS,
    pixel_format="Mono12",
    exposure_us=2000.0,
    gain_db=0.0,
    frame_rate_hz=50.0,
    black_level_dn=64.0,
    features={"Gamma": 1.0},
)


class FakeClock:
    """Monotonic seconds that pass when told."""

    def __init__(self) -> None:
        self.now_s = 100.0

    def __call__(self) -> float:
        return self.now_s


class FakeUtc:
    """Moments in UTC, one second apart."""

    def __init__(self) -> None:
        self._seconds = count()

    def __call__(self) -> datetime:
        return datetime(2025, 3, 4, 5, 6, 7, tzinfo=UTC) + timedelta(seconds=next(self._seconds))


class FakeUids:
    """uid-0, uid-1, ..."""

    def __init__(self, prefix: str = "uid") -> None:
        self._numbers = count()
        self._prefix = prefix

    def __call__(self) -> str:
        return f"{self._prefix}-{next(self._numbers)}"


def frame(level: int | FrameImage, frame_id: int, *, is_complete: bool = True) -> Frame:
    image = np.full((ROWS, COLS), level, np.uint16) if isinstance(level, int) else level
    if not is_complete:
        image = np.empty((0, 0), np.uint16)
    return Frame(
        image_dn=image,
        frame_id=frame_id,
        timestamp_ns=frame_id * 20_000_000,
        is_complete=is_complete,
    )


def steady_frames(level: int = 1000) -> Iterator[Frame]:
    """Good frames without end, alternating one level below and above, ids from 1."""
    return (frame(level + (1 if i % 2 else -1), i) for i in count(1))


class ScriptedCamera:
    """Delivers what the script says: frames, or errors that it raises; then it times out.

    Each frame takes one period of the clock, a timeout all the time it was given.
    """

    def __init__(
        self,
        script: Iterable[Frame | BaseException] | None = None,
        *,
        settings: CameraSettings = SETTINGS,
        clock: FakeClock | None = None,
    ) -> None:
        self.script = iter(steady_frames() if script is None else script)
        self.settings = settings
        self.clock = clock or FakeClock()
        self.info = DeviceInfo(
            vendor="Fakes", model="Scripted", serial_number="C1", firmware="1", driver="simulated"
        )
        self.is_streaming = False
        self.starts = 0
        self.resent_per_frame = 0
        self.resends_packets: bool | None = None
        self.stop_error: Exception | None = None
        self._delivered = 0

    def set_exposure_us(self, exposure_us: float) -> float:
        self.settings = replace(self.settings, exposure_us=exposure_us)
        return exposure_us

    def set_gain_db(self, gain_db: float) -> float:
        self.settings = replace(self.settings, gain_db=gain_db)
        return gain_db

    def start(self) -> None:
        assert not self.is_streaming
        self.is_streaming = True
        self.starts += 1

    def next_frame(self, timeout_s: float) -> Frame:
        assert self.is_streaming
        assert timeout_s > 0
        item = next(self.script, None)
        if item is None:
            self.clock.now_s += timeout_s
            raise DeviceTimeoutError(f"no frame within {timeout_s:.1f} s")
        if isinstance(item, BaseException):
            raise item
        self.clock.now_s += 1 / self.settings.frame_rate_hz
        self._delivered += 1
        return item

    def stop(self) -> None:
        self.is_streaming = False
        if self.stop_error is not None:
            raise self.stop_error

    def statistics(self) -> StreamStatistics:
        return StreamStatistics(
            complete_frames=self._delivered,
            incomplete_frames=0,
            resent_packets=self._delivered * self.resent_per_frame,
            missing_packets=0,
            resends_packets=self.resends_packets,
        )

    def close(self) -> None:
        self.is_streaming = False


class ScriptedStage:
    """Goes where it is sent, off by ``error_mm``; ``on_move`` may raise in its place."""

    def __init__(
        self,
        *,
        limits_mm: tuple[float, float] = (0.0, 300.0),
        error_mm: float = 0.0,
        is_homed: bool = False,
        on_move: Callable[[float], None] = lambda _: None,
    ) -> None:
        self.info = DeviceInfo(
            vendor="Fakes", model="Stage", serial_number="S1", firmware="1", driver="simulated"
        )
        self.limits_mm = limits_mm
        self.error_mm = error_mm
        self.creep_mm = 0.0
        self.is_homed = is_homed
        self.state: StageState = "idle"
        self.on_move = on_move
        self.moves_mm: list[float] = []
        self.homings = 0
        self.stops = 0
        self._position_mm = 0.0

    def home(self, timeout_s: float) -> None:
        assert timeout_s > 0
        self.is_homed = True
        self.homings += 1
        self._position_mm = 0.0

    def move_to(self, height_mm: float, timeout_s: float) -> float:
        assert timeout_s > 0
        if not self.is_homed:
            raise StageNotHomedError("not homed")
        if not self.limits_mm[0] <= height_mm <= self.limits_mm[1]:
            raise StageLimitError("out of travel", height_mm=height_mm, limits_mm=self.limits_mm)
        self.on_move(height_mm)
        self.moves_mm.append(height_mm)
        self._position_mm = height_mm + self.error_mm
        return self._position_mm

    def position_mm(self) -> float:
        return self._position_mm + self.creep_mm

    def stop(self) -> None:
        self.stops += 1

    def emergency_stop(self) -> None:
        self.is_homed = False

    def clear_alarm(self) -> None:
        self.state = "idle"

    def close(self) -> None:
        self.state = "unknown"
