"""Focus values of a running camera, and of a sweep of the stage through focus."""

from collections import deque
from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Literal, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from acquisition.averaging import (
    PATIENCE_PERIODS,
    PATIENCE_S,
    AveragedFrames,
    average_frames,
    restarted,
)
from acquisition.bench import BenchDevices
from acquisition.choices import FocusMeasure
from acquisition.devices import Camera, Frame, FrameImage
from acquisition.errors import DeviceError, DeviceTimeoutError, StreamInterruptedError
from acquisition.focus._measures import Region, focus_value, shows_nothing, texture_share
from acquisition.stages import home_timeout_s, move_timeout_s, refuse_beyond_limits

_Trend = Literal["rising", "steady", "falling"]

_SIGMAS = 5.0
_SIGMA_PER_MAD = 1.4826  # of a Gaussian
_SECOND_DIFFERENCE = 6.0**0.5  # white noise of 1 has second differences of this
_FEWEST = 5
_NOISES = 100
_HELD = 5  # values: detail at the limit of the noise does not come and go
_LEAST_NOISE = 1e-9  # relative; keeps constant values steady


@dataclass(frozen=True, slots=True, kw_only=True)
class FocusReading:
    """Reading of the live focus aid after each focus value.

    ``value`` is the smoothed focus value, ``peak`` the largest ``value`` since the last reset.
    ``is_past_peak`` stays true until the value is back at the peak, so that it does not flicker.
    ``noise`` is the standard deviation of a single focus value, 0 until there are enough values. If
    ``has_detail`` is false, the picture shows nothing to focus on, and the value is that of noise.
    """

    value: float
    peak: float
    trend: _Trend
    is_past_peak: bool
    noise: float
    has_detail: bool = True

    @property
    def percent_of_peak(self) -> float:
        """``value`` in percent of ``peak``; 0 if there is no peak, or nothing to focus on."""
        return 100.0 * self.value / self.peak if self.has_detail and self.peak > 0 else 0.0


class FocusTrace:
    """Follows focus values one by one: a running median, its trend and noise over a ``window``.

    ``drop`` is the relative drop below the peak at which the peak counts as passed, unless the
    noise requires more.
    """

    def __init__(self, *, smoothed: int = 3, window: int = 12, drop: float = 0.03) -> None:
        if smoothed < 1 or smoothed % 2 == 0 or window < 5 or not 0 < drop < 1:
            raise ValueError(
                "smoothed must be odd, window at least 5 and drop in (0, 1); "
                f"got {smoothed}, {window}, {drop}"
            )
        self._smoothed, self._drop = smoothed, drop
        self._raw: deque[float] = deque(maxlen=max(window, smoothed))
        self._noises: deque[float] = deque(maxlen=_NOISES)
        self.reset()

    def reset(self) -> None:
        """Forget the peak, for another target, region or exposure."""
        self._raw.clear()
        self._noises.clear()
        self._peak = -np.inf
        self._has_risen = False
        self._lowest = np.inf
        self._is_past = False
        self._empty = _HELD

    def add(self, value: float, *, has_detail: bool = True) -> FocusReading:
        """Add the next focus value and return the reading; one without detail does not count."""
        if not np.isfinite(value):
            raise ValueError(f"a focus value must be finite, got {value}")
        self._empty = 0 if has_detail else self._empty + 1
        if self._empty and (self._empty >= _HELD or not self._raw):
            return self._nothing(value)
        self._raw.append(value)
        recent = list(self._raw)
        shown = float(np.median(recent[-self._smoothed :]))
        if len(recent) >= _FEWEST:
            self._noises.append(self._noise(recent))
        # Ten differences alone are a poor estimate; the noise changes slowly, so use many windows.
        noise = float(np.median(self._noises)) if self._noises else 0.0
        # Nothing is passed before the noise is known.
        margin = max(self._drop * max(self._peak, 0.0), _SIGMAS * noise if self._noises else np.inf)
        self._lowest = min(self._lowest, shown)
        if shown >= self._peak:
            self._peak = shown
        if self._peak - self._lowest > margin and shown >= self._peak - 0.5 * margin:
            self._has_risen = True
        if self._peak - shown > margin and self._has_risen:
            self._is_past = True
        elif self._peak - shown < 0.5 * margin:
            self._is_past = False
        return FocusReading(
            value=shown,
            peak=float(self._peak),
            trend=self._trend(recent, noise),
            is_past_peak=self._is_past,
            noise=noise,
        )

    def _nothing(self, value: float) -> FocusReading:
        self._raw.clear()
        return FocusReading(
            value=value,
            peak=max(float(self._peak), 0.0),
            trend="steady",
            is_past_peak=False,
            noise=float(np.median(self._noises)) if self._noises else 0.0,
            has_detail=False,
        )

    @staticmethod
    def _noise(recent: list[float]) -> float:
        """Scatter of single values from second differences, which ignore a steady change."""
        bends = np.diff(recent, 2)
        return float(_SIGMA_PER_MAD * np.median(np.abs(bends)) / _SECOND_DIFFERENCE)

    @staticmethod
    def _trend(recent: list[float], noise: float) -> _Trend:
        """Slope over the window, if it exceeds the noise."""
        if len(recent) < _FEWEST:
            return "steady"
        steps = np.arange(len(recent)) - 0.5 * (len(recent) - 1)
        slope = float(steps @ np.array(recent) / (steps @ steps))
        level = max(noise, _LEAST_NOISE * max(abs(v) for v in recent), 1e-300)
        if abs(slope) <= _SIGMAS * level / float(np.sqrt(steps @ steps)):
            return "steady"
        return "rising" if slope > 0 else "falling"


_WAITING_S = 1e-3
_WAITING_FRAMES = 64
"""As many frames as a driver may queue; a camera faster than this loop cannot block it."""

_PAIRS = 8

_LIGHT_STEP = 0.05
"""Relative change of the light from one frame to the next that is none of focus or scene."""

_LEAST_STEP_DN = 2.0

Levels = NDArray[np.integer[Any] | np.floating[Any]]
NoiseModel = Callable[[float], float]
"""Temporal variance of one frame in DN^2 at a mean level in DN."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FocusOptions:
    """Where and how focus is measured; with ``noise`` None, the noise is measured too."""

    measure: FocusMeasure = "squared-gradient"
    region: Region | None = None
    noise: NoiseModel | None = None

    def view(self, image_dn: FrameImage) -> FrameImage:
        """The part of a frame that is measured."""
        return image_dn if self.region is None else self.region.cut(image_dn)  # type: ignore[return-value]  # a view keeps its type


@dataclass(frozen=True, slots=True, kw_only=True)
class FocusPoint:
    """Focus value, with its standard error, at a height read back from the stage."""

    height_mm: float
    value: float
    err: float
    level_dn: float
    saturated_fraction: float
    field: tuple[float, ...] = ()
    """Focus values of further regions, in the order in which they were asked for."""
    texture_share: float = 0.0
    """Share of the detail that does not lie along one edge across the region."""
    has_detail: bool = True
    """Whether there was anything to focus on."""


class _LiveFocus(NamedTuple):
    """Focus value of one frame, and whether there is anything in it to focus on."""

    value: float
    has_detail: bool


class FocusMeter:
    """Focus value of one frame after another; independent of any camera.

    Without a noise model the noise is the smallest of the last eight pairs of frames, as motion can
    only add to it. A step of light, exposure or gain begins this anew.
    """

    def __init__(self, options: FocusOptions) -> None:
        self._options = options
        self._previous: FrameImage | None = None
        self._light_dn = 0.0
        self._variances: deque[float] = deque(maxlen=_PAIRS)
        self.is_after_step = False
        """Whether the last frame had another light than the one before it."""
        self.has_detail = True
        """Whether there was anything to focus on in the last frame that has a value."""

    def add(self, image_dn: FrameImage, black_level_dn: float) -> float | None:
        """Focus value of the next frame; None for one whose noise is not known yet."""
        options = self._options
        view = options.view(image_dn)
        light_dn = cv2.mean(view)[0] - black_level_dn
        change_dn = abs(light_dn - self._light_dn)
        self.is_after_step = self._previous is not None and change_dn > max(
            _LIGHT_STEP * max(self._light_dn, light_dn), _LEAST_STEP_DN
        )
        self._light_dn = light_dn
        if self.is_after_step:
            self._variances.clear()
            self._previous = None
        if options.noise is not None:
            variance = options.noise(light_dn + black_level_dn)
        elif self._previous is None:
            self._previous = view
            return None
        else:
            self._variances.append(_variance_between(self._previous, view, black_level_dn))
            variance = min(self._variances)
        self._previous = view
        self.has_detail = not shows_nothing(view)
        return focus_value(
            view,
            black_level_dn=black_level_dn,
            noise_variance_dn2=variance,
            measure=options.measure,
        )


def newest_frames(camera: Camera) -> Generator[Frame, None, None]:
    """Stream, and yield the newest complete frame each time one is requested, until closed."""
    timeout_s = _frame_timeout_s(camera)
    camera.start()
    try:
        while True:
            frame = _newest(camera, timeout_s)
            if frame.is_complete:
                yield frame
    finally:
        camera.stop()


def focus_values(camera: Camera, options: FocusOptions) -> Generator[_LiveFocus, None, None]:
    """Stream, and yield the focus value of every complete frame until closed."""
    timeout_s = _frame_timeout_s(camera)
    black_level_dn = camera.settings.black_level_dn
    meter = FocusMeter(options)
    camera.start()
    try:
        while True:
            frame = _next(camera, timeout_s)
            if not frame.is_complete:
                continue
            value = meter.add(frame.image_dn, black_level_dn)
            if value is not None:
                yield _LiveFocus(value, meter.has_detail)
    finally:
        camera.stop()


def sweep_focus(
    devices: BenchDevices,
    heights_mm: Sequence[float],
    options: FocusOptions,
    *,
    frames: int,
    field: Sequence[Region] = (),
    progress: Callable[[FocusPoint], None] = lambda _: None,
) -> tuple[FocusPoint, ...]:
    """Go to each height in turn and measure the focus value of the mean of ``frames`` frames.

    The noise is each mean's own, from the temporal variance of its frames, at least 2; the standard
    error comes from the scatter of the single frames' values. ``field`` are further regions that
    are measured. On an error, and on Ctrl-C, the stage is stopped; a height whose stream was
    interrupted is measured anew.
    """
    stage, stage_config = devices.stage, devices.config.stage
    for height_mm in heights_mm:
        refuse_beyond_limits(height_mm, stage.limits_mm)
    points = []
    try:
        if not stage.is_homed:
            stage.home(home_timeout_s(stage_config, stage))
        for height_mm in heights_mm:
            read_back_mm = stage.move_to(height_mm, move_timeout_s(stage_config))
            point = restarted(
                partial(_point, devices, read_back_mm, options, frames, field),
                timeout_s=devices.config.camera.reconnect_timeout_s,
                clock=devices.clock,
            )
            points.append(point)
            progress(point)
    except BaseException as error:
        try:
            stage.stop()
        except DeviceError as stop_error:
            error.add_note(f"stopping the stage failed too: {stop_error}")
        raise
    return tuple(points)


def _variance_between(first_dn: Levels, second_dn: Levels, black_level_dn: float) -> float:
    """Temporal variance of one frame, in DN^2, from two frames of a scene, brought to one light.

    What moved between the frames adds: over several pairs, the smallest value is the noise.
    """
    if first_dn.shape != second_dn.shape:
        raise ValueError(f"frames must have one shape, got {first_dn.shape}, {second_dn.shape}")
    pixels = first_dn.size
    means = cv2.mean(first_dn)[0], cv2.mean(second_dn)[0]
    # Sums of squares above black, without copies of the frames.
    first, second = (
        cv2.norm(frame, cv2.NORM_L2SQR) - pixels * black_level_dn * (2 * mean - black_level_dn)
        for frame, mean in zip((first_dn, second_dn), means, strict=True)
    )
    apart = cv2.norm(first_dn, second_dn, cv2.NORM_L2SQR)
    light = (means[0] - black_level_dn, means[1] - black_level_dn)
    scale = light[0] / light[1] if min(light) > 0 else 1.0
    product = 0.5 * (first + second - apart)
    left = first + scale**2 * second - 2 * scale * product
    return max(left / pixels / (1.0 + scale**2), 0.0)


def _frame_timeout_s(camera: Camera) -> float:
    settings = camera.settings
    period_s = max(1 / settings.frame_rate_hz, 1e-6 * settings.exposure_us)
    return max(PATIENCE_S, PATIENCE_PERIODS * period_s)


def _newest(camera: Camera, timeout_s: float) -> Frame:
    newest = _next(camera, timeout_s)
    for _ in range(_WAITING_FRAMES):
        try:
            frame = camera.next_frame(_WAITING_S)
        except StreamInterruptedError:
            camera.start()
            break
        except DeviceTimeoutError:
            break
        if frame.is_complete:
            newest = frame
    return newest


def _next(camera: Camera, timeout_s: float) -> Frame:
    try:
        return camera.next_frame(timeout_s)
    except StreamInterruptedError:
        camera.start()
        return camera.next_frame(timeout_s)


def _point(
    devices: BenchDevices,
    height_mm: float,
    options: FocusOptions,
    frames: int,
    field: Sequence[Region],
) -> FocusPoint:
    settings = devices.camera.settings
    singles: list[float] = []

    def measure(image_dn: FrameImage) -> None:
        singles.append(
            focus_value(
                options.view(image_dn),
                black_level_dn=settings.black_level_dn,
                measure=options.measure,
            )
        )

    averaged = average_frames(devices.camera, frames, keep_frame=measure, clock=devices.clock)

    def value_in(region: Region | None) -> tuple[float, float]:
        """Focus value of the mean in a region, and the mean level."""
        mean = averaged.mean_dn if region is None else region.cut(averaged.mean_dn)
        variance = averaged.variance_dn2 if region is None else region.cut(averaged.variance_dn2)
        level_dn = float(mean.mean(dtype=np.float64))
        measured_dn2 = float(variance.mean(dtype=np.float64))
        frame_dn2 = measured_dn2 if options.noise is None else options.noise(level_dn)
        return (
            focus_value(
                mean,
                black_level_dn=settings.black_level_dn,
                noise_variance_dn2=frame_dn2 / averaged.frames_used,
                measure=options.measure,
            ),
            level_dn,
        )

    value, level_dn = value_in(options.region)
    mean_dn = averaged.mean_dn if options.region is None else options.region.cut(averaged.mean_dn)
    return FocusPoint(
        height_mm=height_mm,
        value=value,
        err=float(np.std(singles, ddof=1) / np.sqrt(len(singles))),
        level_dn=level_dn,
        saturated_fraction=_saturated_fraction(averaged, options.region),
        field=tuple(value_in(region)[0] for region in field),
        texture_share=texture_share(mean_dn),
        has_detail=not shows_nothing(mean_dn),
    )


def _saturated_fraction(averaged: AveragedFrames, region: Region | None) -> float:
    if averaged.is_saturated is None:
        return 0.0
    is_saturated = averaged.is_saturated.view(np.uint8)
    return float(np.mean(is_saturated if region is None else region.cut(is_saturated)))
