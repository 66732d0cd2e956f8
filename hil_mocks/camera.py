"""The simulated camera: an in-process `Camera` with faults on demand."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from acquisition.bench import CameraConfig
from acquisition.devices import CameraSettings, DeviceInfo, Frame, StreamStatistics
from acquisition.errors import (
    CameraFeatureError,
    DeviceDisconnectedError,
    DeviceError,
    DeviceTimeoutError,
)
from hil_mocks.clock import SimulatedClock
from hil_mocks.scene import MONO8_SHIFT, PIXEL_FORMATS, Sensor

FrameFate = Literal["complete", "incomplete", "lost", "disconnected"]

EXPOSURE_RANGE_US = (21.0, 60_000_000.0)
EXPOSURE_STEP_US = 1.0
GAIN_RANGE_DB = (0.0, 31.0)
GAIN_STEP_DB = 1.0
"""Ranges like those of a Manta G-046B; whole microseconds and decibels are read back."""

LAST_FRAME_ID = 65535
PACKETS_PER_INCOMPLETE_FRAME = 3


def following_frame_id(frame_id: int) -> int:
    """Next 16-bit block id of GigE Vision: 0 is reserved, so 65535 is followed by 1."""
    return frame_id % LAST_FRAME_ID + 1


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraFaults:
    """Faults by frame, counted from 0 since the camera was opened.

    Parameters
    ----------
    seed
        Seed of the two rates: the same frames fail in every run.
    incomplete_rate, lost_rate
        Fraction of the frames that arrive without all packets, or not at all.
    incomplete_frames, lost_frames
        Frames that always fail.
    frozen_id_from
        From this frame on the frame id does not change.
    disconnect_at
        At this frame the cable is pulled.
    exposure_delay_frames
        Least and most frames after a change of exposure that are still exposed as before; each
        change draws its own delay. The setting is read back at once all the same.
    states_exposure
        Whether frames state their exposure, as chunk data do.
    """

    seed: int = 0
    incomplete_rate: float = 0.0
    lost_rate: float = 0.0
    incomplete_frames: frozenset[int] = frozenset()
    lost_frames: frozenset[int] = frozenset()
    frozen_id_from: int | None = None
    disconnect_at: int | None = None
    exposure_delay_frames: tuple[int, int] = (0, 0)
    states_exposure: bool = False

    def exposure_delay(self, change: int) -> int:
        """Frames by which change number ``change`` of the exposure takes effect late."""
        least, most = self.exposure_delay_frames
        return int(np.random.default_rng([self.seed, change]).integers(least, most + 1))

    def fate(self, index: int) -> FrameFate:
        """What happens to frame ``index``."""
        if self.disconnect_at is not None and index >= self.disconnect_at:
            return "disconnected"
        draw = np.random.default_rng([self.seed, index]).random()
        if index in self.lost_frames or draw < self.lost_rate:
            return "lost"
        if index in self.incomplete_frames or draw < self.lost_rate + self.incomplete_rate:
            return "incomplete"
        return "complete"


class _DelayedExposure:
    """The exposure of each frame: changes that take effect a few frames after they were made."""

    def __init__(self, exposure_us: float) -> None:
        self._changes = 0
        self._from_frame: list[tuple[int, float]] = [(0, exposure_us)]

    def change(self, exposure_us: float, frame: int, faults: CameraFaults) -> None:
        """Change it before frame ``frame``; a change never overtakes the one before."""
        due = max(frame + faults.exposure_delay(self._changes), self._from_frame[-1][0])
        self._changes += 1
        self._from_frame.append((due, exposure_us))

    def of_frame(self, frame: int) -> float:
        """Exposure of frame ``frame``, counted since the camera was opened."""
        while len(self._from_frame) > 1 and self._from_frame[1][0] <= frame:
            self._from_frame.pop(0)
        return self._from_frame[0][1]


class SimulatedCamera:
    """A camera that photographs what ``look`` returns, one frame per period of its clock.

    Frame ``k`` after the ``j``-th start has its own noise, which depends only on ``seed``, ``j``
    and ``k``.

    Parameters
    ----------
    config
        Initial pixel format, exposure, gain and frame rate.
    sensor
        Converts light to levels.
    look
        Light on each pixel at this moment, relative to white paper, shape ``(rows, cols)``.
    shape
        ``(rows, cols)`` of its frames.
    clock
        Shared with the stage.
    seed
        Seed of the noise.
    """

    def __init__(
        self,
        config: CameraConfig,
        *,
        sensor: Sensor,
        look: Callable[[], NDArray[np.float32]],
        shape: tuple[int, int],
        clock: SimulatedClock,
        seed: int,
    ) -> None:
        if config.pixel_format not in PIXEL_FORMATS:
            raise CameraFeatureError(
                f"the simulated camera has no pixel format {config.pixel_format!r}; "
                f"it has {', '.join(PIXEL_FORMATS)}",
                feature="PixelFormat",
            )
        self.faults = CameraFaults()
        self._config = config
        self._sensor = sensor
        self._look = look
        self._clock = clock
        self._seed = seed
        self._starts = 0
        self._frames_since_start = 0
        self._frames_since_open = 0
        self._frame_id = 0
        self._is_streaming = False
        self._is_open = True
        self._exposed_s = 0.0
        self._complete = 0
        self._incomplete = 0
        self._gain_db = _stepped(config.gain_db, GAIN_RANGE_DB, GAIN_STEP_DB, "dB")
        self._settings = CameraSettings(
            width_px=shape[1],
            height_px=shape[0],
            pixel_format=config.pixel_format,
            exposure_us=_stepped(config.exposure_us, EXPOSURE_RANGE_US, EXPOSURE_STEP_US, "us"),
            gain_db=self._gain_db,
            frame_rate_hz=config.frame_rate_hz,
            black_level_dn=sensor.black_level_dn
            / (2**MONO8_SHIFT if config.pixel_format == "Mono8" else 1),
            gain=self._gain_db,
            gain_unit="dB",
            features={"Gamma": 1.0, "BinningHorizontal": 1, "BinningVertical": 1},
        )
        self._exposures = _DelayedExposure(self._settings.exposure_us)

    @property
    def info(self) -> DeviceInfo:
        """See `Camera.info`."""
        return DeviceInfo(
            vendor="standoff",
            model="Simulated camera",
            serial_number=f"SIM-{self._seed}",
            firmware="1",
            driver="simulated",
        )

    @property
    def settings(self) -> CameraSettings:
        """See `Camera.settings`."""
        return self._settings

    @property
    def is_open(self) -> bool:
        """Whether it can be used: it was not closed."""
        return self._is_open

    @property
    def exposure_limits_us(self) -> tuple[float, float]:
        """See `LimitedExposureCamera`."""
        return EXPOSURE_RANGE_US

    def set_exposure_us(self, exposure_us: float) -> float:
        """See `Camera.set_exposure_us`; whole microseconds."""
        self._check_open()
        value = _stepped(exposure_us, EXPOSURE_RANGE_US, EXPOSURE_STEP_US, "us")
        self._settings = replace(self._settings, exposure_us=value)
        self._exposures.change(value, self._frames_since_open, self.faults)
        self._exposed_s = 0.0
        return value

    def set_gain_db(self, gain_db: float) -> float:
        """See `Camera.set_gain_db`; whole decibels."""
        self._check_open()
        value = _stepped(gain_db, GAIN_RANGE_DB, GAIN_STEP_DB, "dB")
        self._gain_db = value
        self._settings = replace(self._settings, gain_db=value, gain=value)
        return value

    def start(self) -> None:
        """See `Camera.start`; frame ids begin at 1 again."""
        self._check_open()
        if self._is_streaming:
            raise DeviceError("the simulated camera is already streaming")
        self._starts += 1
        self._frames_since_start = 0
        self._frame_id = 0
        self._exposed_s = 0.0
        self._is_streaming = True

    def next_frame(self, timeout_s: float) -> Frame:
        """See `Camera.next_frame`; a frame that is not exposed by then comes at a later call."""
        self._check_open()
        if not self._is_streaming:
            raise DeviceError("the simulated camera has not been started")
        fate = self.faults.fate(self._frames_since_open)
        if fate == "disconnected":
            self._is_streaming = False
            raise DeviceDisconnectedError("the simulated camera is disconnected")
        left_s = self._period_s() - self._exposed_s
        if fate != "lost" and left_s > timeout_s:
            self._exposed_s += timeout_s
            self._clock.advance(timeout_s)
            raise _no_frame(timeout_s)
        self._exposed_s = 0.0
        is_frozen = (
            self.faults.frozen_id_from is not None
            and self._frames_since_open >= self.faults.frozen_id_from
        )
        index = self._frames_since_start
        self._frames_since_start += 1
        self._frames_since_open += 1
        if not is_frozen:
            self._frame_id = following_frame_id(self._frame_id)
        if fate == "lost":
            self._clock.advance(timeout_s)
            raise _no_frame(timeout_s)
        self._clock.advance(left_s)
        exposure_us = self._exposures.of_frame(self._frames_since_open - 1)
        return self._frame(index, exposure_us, is_complete=fate == "complete")

    def stop(self) -> None:
        """See `Camera.stop`."""
        self._is_streaming = False

    def statistics(self) -> StreamStatistics:
        """See `Camera.statistics`."""
        return StreamStatistics(
            complete_frames=self._complete,
            incomplete_frames=self._incomplete,
            resent_packets=0,
            missing_packets=self._incomplete * PACKETS_PER_INCOMPLETE_FRAME,
        )

    def close(self) -> None:
        """See `Camera.close`."""
        self._is_streaming = False
        self._is_open = False

    def reopened(self) -> "SimulatedCamera":
        """The camera as it is opened again: its first settings, its cable back in, other noise."""
        again = SimulatedCamera(
            self._config,
            sensor=self._sensor,
            look=self._look,
            shape=(self._settings.height_px, self._settings.width_px),
            clock=self._clock,
            seed=self._seed,
        )
        again.faults = replace(self.faults, disconnect_at=None)
        again._starts = self._starts
        return again

    def _frame(self, index: int, exposure_us: float, *, is_complete: bool) -> Frame:
        if not is_complete:
            self._incomplete += 1
            empty = np.empty((0, 0), np.uint8 if self._is_mono8 else np.uint16)
            return Frame(
                image_dn=empty,
                frame_id=self._frame_id,
                timestamp_ns=self._clock.now_ns,
                is_complete=False,
            )
        self._complete += 1
        electrons = self._sensor.electrons(self._look(), exposure_us)
        rng = np.random.default_rng([self._seed, self._starts, index])
        return Frame(
            image_dn=self._sensor.expose(
                electrons, self._gain_db, self._settings.pixel_format, rng
            ),
            frame_id=self._frame_id,
            timestamp_ns=self._clock.now_ns,
            exposure_us=exposure_us if self.faults.states_exposure else None,
        )

    @property
    def _is_mono8(self) -> bool:
        return self._settings.pixel_format == "Mono8"

    def _period_s(self) -> float:
        """Time between frames, which a long exposure increases."""
        return max(1 / self._settings.frame_rate_hz, self._settings.exposure_us * 1e-6)

    def _check_open(self) -> None:
        if not self._is_open:
            raise DeviceDisconnectedError("the simulated camera is closed")


def _no_frame(timeout_s: float) -> DeviceTimeoutError:
    return DeviceTimeoutError(
        f"no frame from the simulated camera within {timeout_s} s", timeout_s=timeout_s
    )


def _stepped(value: float, limits: tuple[float, float], step: float, unit: str) -> float:
    """Nearest value that the camera can be set to.

    Raises
    ------
    DeviceError
        If the value is outside the range; nothing is set.
    """
    if not limits[0] <= value <= limits[1]:
        raise DeviceError(
            f"the simulated camera accepts {limits[0]:g} to {limits[1]:g} {unit}, got {value:g}"
        )
    return round(value / step) * step
