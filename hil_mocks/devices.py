"""The in-process clock, `Camera` and `Stage` of the simulated bench, with faults on demand."""

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from math import ceil, floor, isfinite
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from acquisition.bench import CameraConfig, StageConfig
from acquisition.devices import CameraSettings, DeviceInfo, Frame, StageState, StreamStatistics
from acquisition.errors import (
    CameraFeatureError,
    DeviceDisconnectedError,
    DeviceError,
    DeviceTimeoutError,
    StageAlarmError,
    StageLimitError,
    StageNotHomedError,
    StageStalledError,
    StageStoppedError,
)
from hil_mocks.truth import MONO8_SHIFT, PIXEL_FORMATS, Sensor

NS_PER_S = 1_000_000_000


class SimulatedClock:
    """A clock that camera and stage share and advance.

    ``slice_s`` is the longest time by which a move advances the clock at once.
    """

    slice_s = float("inf")

    def __init__(self) -> None:
        self._now_ns = 0

    @property
    def now_ns(self) -> int:
        """Time since the bench was switched on, in ns."""
        return self._now_ns

    @property
    def now_s(self) -> float:
        """Time since the bench was switched on, in s."""
        return self._now_ns / NS_PER_S

    def advance(self, duration_s: float) -> None:
        """Let time pass; ValueError if the duration is negative."""
        if not duration_s >= 0:
            raise ValueError(f"a duration must not be negative, got {duration_s} s")
        self._now_ns += round(duration_s * NS_PER_S)


class RealTimeClock(SimulatedClock):
    """A clock in real time: advancing it takes that long, and moves can be stopped."""

    slice_s = 0.05

    def __init__(
        self,
        *,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        super().__init__()
        self._clock = clock
        self._sleep = sleep
        self._start_s = clock()

    @property
    def now_ns(self) -> int:
        """See `SimulatedClock.now_ns`."""
        return round((self._clock() - self._start_s) * NS_PER_S)

    @property
    def now_s(self) -> float:
        """See `SimulatedClock.now_s`."""
        return self._clock() - self._start_s

    def advance(self, duration_s: float) -> None:
        """Wait; ValueError if the duration is negative."""
        if not duration_s >= 0:
            raise ValueError(f"a duration must not be negative, got {duration_s} s")
        self._sleep(duration_s)


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
    """Faults by frame, counted from 0 since the camera was opened."""

    seed: int = 0  # of the two rates: the same frames fail in every run
    incomplete_rate: float = 0.0  # part of the frames that arrive without all packets
    lost_rate: float = 0.0  # part that does not arrive
    incomplete_frames: frozenset[int] = frozenset()  # those that always fail
    lost_frames: frozenset[int] = frozenset()  # likewise
    frozen_id_from: int | None = None  # from this frame on the frame id does not change
    disconnect_at: int | None = None  # at this frame the cable is pulled
    exposure_delay_frames: tuple[int, int] = (0, 0)  # least and most; each change draws its own
    states_exposure: bool = False  # as chunk data do

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
    and ``k``. ``look`` gives the light on each pixel at this moment, relative to white paper.
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
    """Nearest value that the camera can be set to; DeviceError outside the range."""
    if not limits[0] <= value <= limits[1]:
        raise DeviceError(
            f"the simulated camera accepts {limits[0]:g} to {limits[1]:g} {unit}, got {value:g}"
        )
    return round(value / step) * step


STEPS_PER_MM = 250.0
"""Steps of 4 um: 20.25 mm is between two of them and reads back as 20.248 mm."""

GIVES_UP_S = 2.0
"""Time without progress after which a move ends."""

OVERSHOOT_MM = 0.5
"""How far a move from the wrong side overshoots its target before it approaches."""


@dataclass(frozen=True, slots=True, kw_only=True)
class StageFaults:
    """Faults from now on."""

    never_settles: bool = False  # arrives but keeps vibrating: it gives up after `GIVES_UP_S`
    stops_short_mm: float = 0.0  # before its target, and its read-back says so
    interrupted_by: Literal["door", "hold"] | None = None
    """The next move stops half-way and the position is void; clear the alarm once this is None."""

    alarm: str | None = None  # text of an alarm that the next move raises before anything moves
    home_switch_missing: bool = False  # homing never finds its switch
    lost_steps_mm: float = 0.0  # the true height is so far below the read-back
    backlash_mm: float = 0.0  # lag of the true height when the last move was from the wrong side
    unplugged: bool = False  # nothing answers


class SimulatedStage:
    """A spindle stage with a stepper motor and a reference switch.

    The switch is at the lower limit if heights are approached from below, else at the upper one.
    """

    def __init__(self, config: StageConfig, *, clock: SimulatedClock) -> None:
        self.faults = StageFaults()
        self._config = config
        self._clock = clock
        self._is_homed = False
        self._is_open = True
        self._is_moving = False
        self._is_stop_wanted = False
        self._alarm: str | None = None
        self._interruption: Literal["door", "hold"] | None = None
        low, high = config.limits_mm
        self._steps = round((low + high) / 2 * STEPS_PER_MM)
        self._came_up = self._approaches_upwards

    @property
    def info(self) -> DeviceInfo:
        """See `Stage.info`."""
        return DeviceInfo(
            vendor="standoff",
            model="Simulated stage",
            serial_number="SIM-1",
            firmware="1",
            driver="simulated",
        )

    @property
    def limits_mm(self) -> tuple[float, float]:
        """See `Stage.limits_mm`."""
        return self._config.limits_mm

    @property
    def is_homed(self) -> bool:
        """See `Stage.is_homed`."""
        return self._is_homed

    @property
    def state(self) -> StageState:
        """See `Stage.state`; only a thread other than the one that moves it sees it moving."""
        self._check_answers()
        if self._alarm is not None:
            return "alarm"
        if self._interruption is not None:
            return self._interruption
        return "moving" if self._is_moving else "idle"

    @property
    def true_height_mm(self) -> float:
        """True height of the camera, which no read-back can show."""
        lag_mm = 0.0
        if self._came_up != self._approaches_upwards:
            lag_mm = self.faults.backlash_mm if self._came_up else -self.faults.backlash_mm
        return self._steps / STEPS_PER_MM - lag_mm - self.faults.lost_steps_mm

    def home(self, timeout_s: float) -> None:
        """See `Stage.home`."""
        self._check_ready()
        low, high = self.limits_mm
        switch = (
            ceil(low * STEPS_PER_MM) if self._approaches_upwards else floor(high * STEPS_PER_MM)
        )
        self._is_homed = self._is_stop_wanted = False
        if self.faults.home_switch_missing:
            self._clock.advance(timeout_s)
        if self.faults.home_switch_missing or not self._travel(switch, timeout_s):
            raise DeviceTimeoutError(
                f"the simulated stage found no reference switch within {timeout_s} s",
                timeout_s=timeout_s,
            )
        self._came_up = self._approaches_upwards
        self._is_homed = True

    def move_to(self, height_mm: float, timeout_s: float) -> float:
        """See `Stage.move_to`."""
        self._check_ready()
        if not self._is_homed:
            raise StageNotHomedError("the simulated stage must be homed before it moves")
        low, high = self.limits_mm
        if not (isfinite(height_mm) and low <= height_mm <= high):
            raise StageLimitError(
                f"the simulated stage travels from {low:g} to {high:g} mm, "
                f"not to {height_mm:g} mm; nothing moved",
                height_mm=height_mm,
                limits_mm=self.limits_mm,
            )
        if self.faults.alarm is not None:
            self._alarm = self.faults.alarm
            raise StageAlarmError(
                f"the simulated stage is in alarm: {self._alarm}", code=self._alarm
            )
        target = self._steps_at(height_mm)
        left_s = timeout_s
        self._is_stop_wanted = False
        for stop in self._stops(target):
            started_s = self._clock.now_s
            if self.faults.interrupted_by is not None:
                self._interrupt((self._steps + stop) // 2, left_s)
            if not self._travel(stop, left_s):
                raise DeviceTimeoutError(
                    f"the simulated stage did not reach {height_mm} mm within {timeout_s} s; "
                    f"it was stopped at {self.position_mm():.3f} mm",
                    timeout_s=timeout_s,
                )
            left_s -= self._clock.now_s - started_s
        self._settle(target, height_mm, left_s, timeout_s)
        return self.position_mm()

    def position_mm(self) -> float:
        """See `Stage.position_mm`; StageNotHomedError if the position is not known."""
        self._check_answers()
        if not self._is_homed:
            raise StageNotHomedError("the simulated stage does not know its position: home it")
        return self._steps / STEPS_PER_MM

    def travel_height_mm(self) -> float | None:
        """See `TravellingStage`."""
        return self._steps / STEPS_PER_MM if self._is_homed else None

    def stop(self) -> None:
        """See `Stage.stop`; only on a real-time clock is there a move to stop."""
        self._check_answers()
        self._is_stop_wanted = True

    def emergency_stop(self) -> None:
        """See `Stage.emergency_stop`; leaves an alarm."""
        self._is_homed = False
        self._alarm = "emergency stop"

    def clear_alarm(self) -> None:
        """See `Stage.clear_alarm`."""
        self._check_answers()
        self._interruption = self.faults.interrupted_by
        self._alarm = None
        self._check_ready()

    def close(self) -> None:
        """See `Stage.close`."""
        self._is_open = False

    @property
    def _approaches_upwards(self) -> bool:
        return self._config.approach == "from_below"

    def _steps_at(self, height_mm: float) -> int:
        """Nearest step within the travel."""
        low, high = self.limits_mm
        nearest = round(height_mm * STEPS_PER_MM)
        return min(max(nearest, ceil(low * STEPS_PER_MM)), floor(high * STEPS_PER_MM))

    def _stops(self, target: int) -> list[int]:
        """Step counts to visit in turn, so that the last one is approached from the right side."""
        side = 1 if self._approaches_upwards else -1
        is_there = target == self._steps and self._came_up == self._approaches_upwards
        if is_there or side * (target - self._steps) > 0:
            return [target]
        low, high = self.limits_mm
        beyond_mm = target / STEPS_PER_MM - side * OVERSHOOT_MM
        return [self._steps_at(min(max(beyond_mm, low), high)), target]

    def _travel(self, target: int, time_s: float) -> bool:
        """Go to the target, or as far as the time allows; return whether it was reached."""
        if target == self._steps:
            return True
        steps_per_s = self._config.feed_mm_per_min / 60 * STEPS_PER_MM
        left_s = max(time_s, 0.0)
        self._came_up = target > self._steps
        self._is_moving = True
        try:
            while True:
                needed_s = abs(target - self._steps) / steps_per_s
                part_s = min(needed_s, left_s, self._clock.slice_s)
                self._clock.advance(part_s)
                if part_s == needed_s:
                    self._steps = target
                    return True
                way = floor(part_s * steps_per_s)
                self._steps += way if target > self._steps else -way
                left_s -= part_s
                if self._is_stop_wanted:
                    at_mm = self._steps / STEPS_PER_MM
                    raise StageStoppedError(
                        f"the simulated stage stopped at {at_mm:.3f} mm, as it was told to",
                        is_asked=True,
                        height_mm=at_mm,
                    )
                if left_s <= 0:
                    return False
        finally:
            self._is_moving = False

    def _settle(self, target: int, height_mm: float, left_s: float, timeout_s: float) -> None:
        if self.faults.stops_short_mm:
            side = 1 if self._approaches_upwards else -1
            self._steps = self._steps_at(target / STEPS_PER_MM - side * self.faults.stops_short_mm)
        is_near = abs(self._steps - target) <= self._config.tolerance_mm * STEPS_PER_MM
        if self.faults.never_settles and left_s > GIVES_UP_S:
            self._clock.advance(GIVES_UP_S)
            raise StageStalledError(
                f"the simulated stage did not settle at {height_mm} mm: no progress for "
                f"{GIVES_UP_S:g} s; it is at {self.position_mm():.3f} mm",
                timeout_s=GIVES_UP_S,
                state="idle",
                height_mm=self.position_mm(),
            )
        if self.faults.never_settles or not is_near or self._config.settle_s > left_s:
            self._clock.advance(max(left_s, 0.0))
            raise DeviceTimeoutError(
                f"the simulated stage did not settle at {height_mm} mm within {timeout_s} s; "
                f"it is at {self.position_mm():.3f} mm",
                timeout_s=timeout_s,
            )
        self._clock.advance(self._config.settle_s)

    def _interrupt(self, steps: int, left_s: float) -> None:
        self._travel(steps, left_s)
        self._interruption, self._is_homed = self.faults.interrupted_by, False
        self._check_ready()

    def _check_ready(self) -> None:
        self._check_answers()
        if self._interruption is not None:
            raise StageAlarmError(
                f"the simulated stage is in state {self._interruption}, in which it cannot move; "
                "close its door or release its hold, then clear the alarm and home",
                code=self._interruption,
            )
        if self._alarm is not None:
            raise StageAlarmError(
                f"the simulated stage is in alarm: {self._alarm}; clear the alarm, then home",
                code=self._alarm,
            )

    def _check_answers(self) -> None:
        if not self._is_open:
            raise DeviceDisconnectedError("the simulated stage is closed")
        if self.faults.unplugged:
            raise DeviceDisconnectedError("the simulated stage does not answer")
