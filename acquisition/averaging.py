"""Average frames into one capture: exact mean, temporal variance and stream faults."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from acquisition.devices import Camera, CameraSettings, Frame, FrameImage, StreamStatistics
from acquisition.errors import CaptureError, DeviceError, DeviceTimeoutError, StreamInterruptedError
from acquisition.frame_sums import FrameSums

T = TypeVar("T")

_RESTARTS_PER_S = 2.0
"""A stream breaks off after a second at the least: more restarts than this are no stalls."""


def restarted(
    work: Callable[[], T],
    *,
    timeout_s: float,
    clock: Callable[[], float],
    interrupted: Callable[[StreamInterruptedError], None] = lambda _: None,
) -> T:
    """Do some work, from its beginning again each time its stream breaks off.

    A busy computer or network breaks a stream off for a second at a time and more than once. It is
    begun anew once in any case, and again within ``timeout_s`` of the first interruption;
    ``interrupted`` is called with each that is survived.
    """
    first_s: float | None = None
    restarts = 0
    while True:
        try:
            return work()
        except StreamInterruptedError as error:
            now_s = clock()
            first_s = now_s if first_s is None else first_s
            is_late = now_s - first_s > timeout_s or restarts > _RESTARTS_PER_S * timeout_s
            if restarts > 0 and is_late:
                raise
            restarts += 1
            interrupted(error)


_MAX_FRAMES = 10_000
"""Bound that keeps every sum of 16-bit levels exact: N 2^16 < 2^32 and N^2 2^32 < 2^64."""

PATIENCE_S, PATIENCE_PERIODS = 3.0, 10
"""A capture without a good frame for the longer of these two times has failed. A busy machine that
fetches 60 frames a second at 5 is far from it; no fault that ends by itself lasts as long."""

_TORN_IN_A_ROW = 3
"""Fewest refused frames without a good one between them that end a capture: a machine that was
suspended for longer than `PATIENCE_S` finds the frame on the wire torn, and the next one whole."""

_CEILING_S, _CEILING_PERIODS = 60.0, 20
"""A capture may take this long, and this many frame periods for each frame: beyond it the light has
changed more than any average is worth."""

_STALLED_REMEDY = "check the camera's power, cable and trigger, then run again"
_TORN_REMEDY = (
    "use larger packets (jumbo frames: MTU 9000), a larger receive buffer (net.core.rmem_max), a "
    "lower camera.frame_rate_hz or camera.bandwidth_limit_bytes_per_s, or another cable, switch or "
    "network card (`standoff doctor` says more), then run again"
)
_SHAPE_REMEDY = "restart the camera, then run again"
_EXPOSURE_REMEDY = (
    "the camera states a different exposure from the one that was set; switch its automatic "
    "exposure and sequencer off, then run again"
)
_GAIN_REMEDY = (
    "the camera states a different gain from the one that was set; switch its automatic gain and "
    "sequencer off, then run again"
)
_SLOW_REMEDY = "end other programs or ask for fewer frames_per_capture, then run again"


_EXPOSURE_STEP_US = 1.0
_EXPOSURE_ROUNDING = 1e-3
"""A frame's exposure may differ from the one read back by the larger of the two: some cameras
state it in whole microseconds, others in rows of the sensor."""

_GAIN_STEP, _GAIN_ROUNDING = 0.1, 1e-2
"""The same of its gain, in the camera's unit: some state it to a tenth of a decibel."""


@dataclass(frozen=True, slots=True, kw_only=True)
class AveragedFrames:
    """The mean and temporal variance of N frames at one pose, and how the stream behaved.

    ``mean_dn`` and ``variance_dn2`` are float32 of shape ``(rows, cols)``; the variance is the
    unbiased one (N - 1) of a *single* frame. ``is_saturated`` marks the pixels that reached the
    largest level in any frame, each of which biases the mean; None stands for none.
    ``stale_frames`` were left out as exposed, or perhaps exposed, before the exposure was changed.
    """

    mean_dn: NDArray[np.float32]
    variance_dn2: NDArray[np.float32]
    frames_used: int
    incomplete_frames: int
    resent_packets: int
    saturated_pixels: int
    min_dn: int
    max_dn: int
    first_timestamp_ns: int
    last_timestamp_ns: int
    stale_frames: int = 0
    is_saturated: NDArray[np.bool_] | None = None


def average_frames(
    camera: Camera,
    frames_asked: int,
    *,
    keep_frame: Callable[[FrameImage], None] | None = None,
    is_stale: Callable[[Frame], bool] | None = None,
    clock: Callable[[], float] = time.monotonic,
) -> AveragedFrames:
    """Stream until ``frames_asked`` good frames are averaged, 2 to 10 000, never fewer.

    The first frame is skipped (its exposure may have begun before). Incomplete and repeated frames,
    those of the wrong shape or of another stated exposure are replaced as long as good ones come. A
    capture fails that gets no good frame for 3 s (or 10 frame periods), that after this time has
    refused more than two frames for each one asked for, or that takes 60 s and 20 frame periods for
    each.

    ``keep_frame`` is called with every frame that goes into the average, ``is_stale`` with every
    good one, to leave out what was exposed before a change; what it raises ends the average.
    """
    if not 2 <= frames_asked <= _MAX_FRAMES:
        raise ValueError(f"frames_asked must be from 2 to {_MAX_FRAMES}, got {frames_asked}")
    settings = camera.settings
    before = camera.statistics()
    tally = _Tally(frames_asked, resends=lambda: _Resends.between(before, camera.statistics()))
    sums = FrameSums((settings.height_px, settings.width_px), settings.max_level_dn)
    stamps_ns: list[int] = []
    with _streaming(camera):
        progress = _Progress(settings, tally, clock)
        seen_ids = {_next_frame(camera, progress).frame_id}
        while tally.good < frames_asked:
            progress.require()
            frame = _next_frame(camera, progress)
            if not frame.is_complete:
                tally.incomplete += 1
            elif frame.frame_id in seen_ids:
                tally.repeated += 1
            elif frame.image_dn.shape != sums.shape:
                tally.misshapen += 1
            elif not _has_exposure(frame, settings):
                tally.otherwise_exposed += 1
            elif not _has_gain(frame, settings):
                tally.otherwise_amplified += 1
            elif is_stale is not None and is_stale(frame):
                tally.stale += 1
            else:
                seen_ids.add(frame.frame_id)
                sums.add(frame.image_dn)
                stamps_ns.append(frame.timestamp_ns)
                tally.good += 1
                if keep_frame is not None:
                    keep_frame(frame.image_dn)
    mean_dn, variance_dn2 = sums.mean_and_variance(tally.good)
    is_saturated = sums.is_saturated
    return AveragedFrames(
        mean_dn=mean_dn,
        variance_dn2=variance_dn2,
        frames_used=tally.good,
        incomplete_frames=tally.incomplete,
        resent_packets=camera.statistics().resent_packets - before.resent_packets,
        saturated_pixels=0 if is_saturated is None else int(np.count_nonzero(is_saturated)),
        min_dn=sums.min_dn,
        max_dn=sums.max_dn,
        first_timestamp_ns=stamps_ns[0],
        last_timestamp_ns=stamps_ns[-1],
        stale_frames=tally.stale + tally.otherwise_exposed + tally.otherwise_amplified,
        is_saturated=is_saturated,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class _Resends:
    """What became of lost packets, as far as camera and driver say."""

    resent: int
    is_possible: bool | None

    @classmethod
    def between(cls, before: StreamStatistics, now: StreamStatistics) -> "_Resends":
        """What was sent again between two readings of the counts."""
        return cls(
            resent=now.resent_packets - before.resent_packets, is_possible=now.resends_packets
        )

    @property
    def told(self) -> str:
        """It in words, to be followed by others; empty where nothing is known."""
        # Not how many were lost: Aravis counts all behind the first gap of a frame.
        if self.is_possible is None:
            return ""
        if not self.is_possible:
            return "this camera does not resend lost packets; "
        if self.resent == 0:
            return "the camera resent no lost packet, although it says that it can; "
        return f"the camera resent {self.resent} lost packets, which was not enough; "


@dataclass(slots=True)
class _Tally:
    """What the stream has delivered after the skipped frame."""

    asked: int
    resends: Callable[[], _Resends]
    good: int = 0
    incomplete: int = 0
    repeated: int = 0
    misshapen: int = 0
    otherwise_exposed: int = 0
    otherwise_amplified: int = 0
    stale: int = 0

    @property
    def refused(self) -> int:
        """Frames that did not go into the average because something is wrong with them."""
        return self.incomplete + self.repeated + self.misshapen + self.otherwise_set

    @property
    def otherwise_set(self) -> int:
        """Frames that state another exposure or gain than was set."""
        return self.otherwise_exposed + self.otherwise_amplified

    @property
    def remedy(self) -> str:
        """What the operator can do about most of the frames that were refused."""
        if 2 * self.otherwise_set <= self.refused:
            return f"{self.resends().told}{_TORN_REMEDY}" if self.incomplete else _SHAPE_REMEDY
        return (
            _EXPOSURE_REMEDY if self.otherwise_exposed >= self.otherwise_amplified else _GAIN_REMEDY
        )

    def failure(self, reason: str) -> CaptureError:
        """Return the error that gives the count and the reason."""
        resends = self.resends()
        counts = {
            "incomplete": self.incomplete,
            "with a repeated id": self.repeated,
            "of the wrong shape": self.misshapen,
            "with a different exposure": self.otherwise_exposed + self.stale,
            "with a different gain": self.otherwise_amplified,
        }
        refused = {what: count for what, count in counts.items() if count}
        faults = ", ".join(f"{count} {what}" for what, count in refused.items())
        came = self.good + self.refused + self.stale
        return CaptureError(
            f"only {self.good} of {self.asked} frames"
            + (f" ({came} came: {faults})" * bool(faults))
            + f": {reason}",
            frames_complete=self.good,
            frames_asked=self.asked,
            frames_refused=refused,
            packets_resent=resends.resent,
            resends_packets=resends.is_possible,
        )


class _Progress:
    """Whether a capture advances; nothing is judged before a frame that waits was fetched."""

    def __init__(self, settings: CameraSettings, tally: _Tally, clock: Callable[[], float]) -> None:
        period_s = max(1 / settings.frame_rate_hz, 1e-6 * settings.exposure_us)
        self.patience_s = max(PATIENCE_S, PATIENCE_PERIODS * period_s)
        self._ceiling_s = _CEILING_S + _CEILING_PERIODS * (tally.asked + 1) * period_s
        self._tally = tally
        self._clock = clock
        self._began_s = self._good_s = clock()
        self._good = self._refused_before = 0

    def require(self) -> None:
        """Raise the `CaptureError` of a capture that no longer advances."""
        tally, now_s = self._tally, self._clock()
        taken_s = now_s - self._began_s
        if tally.good > self._good:
            self._good, self._good_s, self._refused_before = tally.good, now_s, tally.refused
        if taken_s > self._ceiling_s:
            raise tally.failure(f"not done within {self._ceiling_s:.0f} s; {_SLOW_REMEDY}")
        in_a_row = tally.refused - self._refused_before
        if in_a_row >= _TORN_IN_A_ROW and now_s - self._good_s > self.patience_s:
            raise tally.failure(f"no good frame for {self.patience_s:.1f} s; {tally.remedy}")
        if tally.refused > 2 * tally.asked and taken_s > self.patience_s:
            raise tally.failure(f"gave up after {taken_s:.1f} s; {tally.remedy}")

    def stalled(self, error: DeviceTimeoutError) -> CaptureError:
        """Return the error of a camera that sends nothing."""
        return self._tally.failure(f"the camera stalled ({error}); {_STALLED_REMEDY}")


def _has_exposure(frame: Frame, settings: CameraSettings) -> bool:
    """Whether nothing speaks against it: not every camera states a frame's exposure."""
    if frame.exposure_us is None:
        return True
    tolerance_us = max(_EXPOSURE_STEP_US, _EXPOSURE_ROUNDING * settings.exposure_us)
    return abs(frame.exposure_us - settings.exposure_us) <= tolerance_us


def _has_gain(frame: Frame, settings: CameraSettings) -> bool:
    """Whether nothing speaks against it: few cameras state a frame's gain."""
    if frame.gain is None or settings.gain is None:
        return True
    return abs(frame.gain - settings.gain) <= max(_GAIN_STEP, _GAIN_ROUNDING * abs(settings.gain))


def _next_frame(camera: Camera, progress: _Progress) -> Frame:
    try:
        return camera.next_frame(progress.patience_s)
    except DeviceTimeoutError as error:
        raise progress.stalled(error) from error


@contextmanager
def _streaming(camera: Camera) -> Iterator[None]:
    """Stream inside the block; a failure inside takes precedence over a failure to stop."""
    try:
        camera.start()
        yield
    except BaseException as error:
        try:
            camera.stop()
        except DeviceError as stop_error:
            error.add_note(f"stopping the stream failed too: {stop_error}")
        raise
    camera.stop()
