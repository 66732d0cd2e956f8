"""Focus values of a running camera, and of a sweep of the stage through focus."""

from collections import deque
from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from acquisition.averaging import PATIENCE_PERIODS, PATIENCE_S, AveragedFrames, average_frames
from acquisition.bench import BenchDevices
from acquisition.choices import FocusMeasure
from acquisition.devices import Camera, Frame, FrameImage
from acquisition.errors import DeviceError, DeviceTimeoutError, StreamInterruptedError
from acquisition.focus.detail import shows_nothing
from acquisition.focus.measures import Region, focus_value
from acquisition.focus.texture import texture_share
from acquisition.restarting import restarted
from acquisition.stages import home_timeout_s, move_timeout_s, refuse_beyond_limits

_WAITING_S = 1e-3
_WAITING_FRAMES = 64
"""As many frames as a driver may queue; a camera faster than this loop cannot block it."""

_PAIRS = 8

LIGHT_STEP = 0.05
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
    """Focus value at a height that was read back, with its standard error."""

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


class LiveFocus(NamedTuple):
    """Focus value of one frame, and whether there is anything in it to focus on."""

    value: float
    has_detail: bool


class FocusMeter:
    """Focus value of one frame after another; independent of any camera.

    Without a noise model the noise is taken from pairs of consecutive frames: the smallest of the
    last eight, as motion can only add to it. A step of the light, of exposure or gain begins this
    anew: the noise of before is not that of now.

    Parameters
    ----------
    options
        Where and how focus is measured.
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
        """Focus value of the next frame; None for one whose noise is not known yet.

        Raises
        ------
        ValueError
            If the region reaches beyond the frame, or the frame size changes.
        """
        options = self._options
        view = options.view(image_dn)
        light_dn = cv2.mean(view)[0] - black_level_dn
        change_dn = abs(light_dn - self._light_dn)
        self.is_after_step = self._previous is not None and change_dn > max(
            LIGHT_STEP * max(self._light_dn, light_dn), _LEAST_STEP_DN
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
            self._variances.append(variance_between(self._previous, view, black_level_dn))
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
    """Stream, and yield the newest complete frame each time one is requested, until closed.

    Older frames are skipped. The stream is stopped when the iterator is closed.

    Raises
    ------
    DeviceError
        If the camera fails; an interrupted stream is restarted once.
    """
    timeout_s = _frame_timeout_s(camera)
    camera.start()
    try:
        while True:
            frame = _newest(camera, timeout_s)
            if frame.is_complete:
                yield frame
    finally:
        camera.stop()


def focus_values(camera: Camera, options: FocusOptions) -> Generator[LiveFocus, None, None]:
    """Stream, and yield the focus value of every complete frame until closed.

    Without a noise model the noise is taken from pairs of consecutive frames: the smallest of the
    last eight, as motion can only add to it; the first frame then gives no value. The stream is
    stopped when the iterator is closed.

    Raises
    ------
    ValueError
        If the region reaches beyond the frame.
    DeviceError
        If the camera fails; an interrupted stream is restarted once.
    """
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
                yield LiveFocus(value, meter.has_detail)
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

    The noise is each mean's own, from the temporal variance of its frames. The standard error
    comes from the scatter of the focus values of the single frames.

    Parameters
    ----------
    heights_mm
        In the order in which they are visited: from the side of approach.
    frames
        Frames at each height, at least 2.
    field
        Further regions that are measured at each height.

    Raises
    ------
    StageLimitError
        Before anything moves, if a height is outside the travel.
    ValueError
        If the region reaches beyond the frame.
    DeviceError
        If a device fails; on that, and on Ctrl-C, the stage is stopped. A height whose stream was
        interrupted is measured anew, for ``camera.reconnect_timeout_s`` if need be.
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


def variance_between(first_dn: Levels, second_dn: Levels, black_level_dn: float) -> float:
    """Temporal variance of one frame, in DN^2, averaged over the pixels of two frames.

    The light of the second frame is scaled to that of the first, so that flicker does not count.
    What moved between the frames does: over several pairs, the smallest value is the noise.

    Parameters
    ----------
    first_dn, second_dn
        Frames of the same shape ``(rows, cols)``, of the same scene.

    Raises
    ------
    ValueError
        If the shapes differ.
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
