"""One capture at the bench: approach the height, settle, expose, average, read the height back."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from typing import Literal, TypeVar

import numpy as np

from acquisition.averaging import AveragedFrames, restarted
from acquisition.bench import BenchDevices
from acquisition.bracket import MergedBracket, merge_bracket
from acquisition.devices import Camera, CameraSettings, FrameImage
from acquisition.errors import CaptureError, DeviceError, StageStoppedError, StreamInterruptedError
from acquisition.exposure_control import ExposureControl
from acquisition.focus import focus_value
from acquisition.plan import CapturePlan, PlanEntry
from acquisition.session import Take
from acquisition.stages import home_timeout_s, move_timeout_s

EXPOSURE_AIM = 0.7
"""Fraction of the range above the black level that the brightest parts should reach."""

_TOLERANCE = 0.1
_LEAST_RATIO = 1.2
"""Of two exposures of a bracket, below which whole periods of flicker are not worth it."""

SHORTEST_EXPOSURE_US = 50.0
_EXPOSURE_TRIALS = 8
_TRIAL_FRAMES = 2
_BRIGHT_PERCENTILE = 99.5

_SATURATED_STEP = 4.0
_LARGEST_STEP = 16.0

ExposureLimit = Literal["shortest", "longest", "flicker"]
"""What keeps an exposure from the wanted level: a limit, or that it is whole periods of flicker."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _ExposureStep:
    """The exposure to set next, whether it is settled, and what limits it by over 10 %."""

    exposure_us: float
    is_settled: bool
    limited_by: tuple[ExposureLimit, ...] = ()


def _next_exposure(
    exposure_us: float,
    bright_dn: float,
    *,
    black_level_dn: float,
    max_level_dn: float,
    limits_us: tuple[float, float],
    mains_hz: float = 0.0,
) -> _ExposureStep:
    """Return the exposure that brings the bright parts of an image to 70 % of the range.

    The camera is linear, so that one step from an unsaturated image suffices; a saturated one says
    no more than "shorter". Where the light flickers with ``mains_hz`` (0: it does not), exposures
    longer than a period of the flicker are whole multiples of it.
    """
    shortest_us, longest_us = limits_us
    if not (0 < shortest_us <= longest_us and exposure_us > 0):
        raise ValueError(
            "exposure and limits must be positive and in order, "
            f"got {exposure_us} us, {limits_us} us"
        )
    span_dn = max_level_dn - black_level_dn
    light = (bright_dn - black_level_dn) / span_dn
    if bright_dn >= max_level_dn:
        factor = 1 / _SATURATED_STEP
    else:
        factor = min(EXPOSURE_AIM / max(light, EXPOSURE_AIM / _LARGEST_STEP), _LARGEST_STEP)
    wanted_us = exposure_us * factor
    clipped_us = min(max(wanted_us, shortest_us), longest_us)
    asked_us = max(without_flicker(clipped_us, mains_hz), shortest_us)
    # Whole periods cannot come closer than half of one; there the present one stays.
    is_settled = abs(asked_us - exposure_us) <= _TOLERANCE * exposure_us
    applied: dict[ExposureLimit, bool] = {
        "shortest": wanted_us < shortest_us,
        "longest": wanted_us > longest_us,
        "flicker": asked_us < clipped_us,
    }
    set_us = exposure_us if is_settled else asked_us
    is_wanted = abs(wanted_us - set_us) <= _TOLERANCE * set_us
    return _ExposureStep(
        exposure_us=set_us,
        is_settled=is_settled,
        limited_by=() if is_wanted else tuple(limit for limit, is_so in applied.items() if is_so),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class FoundExposure:
    """An exposure as read back, the fraction of the range of its brightest parts, and its limit."""

    exposure_us: float
    bright_fraction: float
    limited_by: tuple[ExposureLimit, ...] = ()


def find_exposure(
    camera: Camera,
    exposures: ExposureControl,
    *,
    limits_us: tuple[float, float],
    mains_hz: float,
) -> FoundExposure:
    """Set the exposure for the brightest parts of what an idle camera sees, in eight trials."""
    exposure_us = camera.settings.exposure_us
    for _ in range(_EXPOSURE_TRIALS):
        taken = exposures.average(_TRIAL_FRAMES, exposure_us)
        settings = camera.settings
        bright_dn = float(np.percentile(taken.averaged.mean_dn, _BRIGHT_PERCENTILE))
        step = _next_exposure(
            settings.exposure_us,
            bright_dn,
            black_level_dn=settings.black_level_dn,
            max_level_dn=settings.max_level_dn,
            limits_us=limits_us,
            mains_hz=mains_hz,
        )
        if step.is_settled:
            span_dn = settings.max_level_dn - settings.black_level_dn
            return FoundExposure(
                exposure_us=settings.exposure_us,
                bright_fraction=(bright_dn - settings.black_level_dn) / span_dn,
                limited_by=step.limited_by,
            )
        exposure_us = step.exposure_us
    raise CaptureError(
        f"no exposure was found in {_EXPOSURE_TRIALS} trials; is the light steady? "
        "Set the exposure by hand",
        frames_complete=0,
        frames_asked=_TRIAL_FRAMES,
    )


def without_flicker(exposure_us: float, mains_hz: float) -> float:
    """Shorten an exposure to whole periods of the flicker, if it lasts at least one."""
    if mains_hz <= 0:
        return exposure_us
    period_us = 0.5e6 / mains_hz
    periods = math.floor(exposure_us / period_us + 1e-9)
    return periods * period_us if periods else exposure_us


def _bracket_exposures_us(
    shortest_us: float, ratios: Sequence[float], mains_hz: float
) -> tuple[float, ...]:
    """Exposures of a bracket, ascending; longer ones in whole periods of the flicker."""
    exposures_us = [shortest_us]
    for ratio in ratios[1:]:
        asked_us = shortest_us * ratio
        whole_us = without_flicker(asked_us, mains_hz)
        is_apart = whole_us >= _LEAST_RATIO * exposures_us[-1]
        exposures_us.append(whole_us if is_apart else asked_us)
    return tuple(exposures_us)


def flicker_fraction(exposure_us: float, mains_hz: float) -> float:
    """Amplitude of the flicker left in a capture, as a fraction of that of the light itself.

    Lamps on the mains flicker at twice its frequency f; an exposure T averages that down to
    ``|sin(2 pi f T) / (2 pi f T)|``, which is 0 for whole periods. Also 0 for ``mains_hz`` 0.
    """
    if mains_hz <= 0:
        return 0.0
    phase = 2.0 * math.pi * mains_hz * exposure_us * 1e-6
    return abs(math.sin(phase) / phase)


T = TypeVar("T")


@dataclass(frozen=True, slots=True, kw_only=True)
class _Exposed:
    """The frames of one capture, averaged and perhaps merged, and the computer's clock around."""

    averaged: AveragedFrames
    settings: CameraSettings
    raw_frames: tuple[FrameImage, ...]
    started: datetime
    finished: datetime
    bracket: MergedBracket | None = None


class CaptureStep:
    """Makes the captures of a plan with a camera and a stage; stores nothing.

    A capture whose stream breaks off is begun anew, as `restarted` does, after ``interrupted`` was
    called with the error.
    """

    def __init__(
        self,
        plan: CapturePlan,
        devices: BenchDevices,
        *,
        interrupted: Callable[[PlanEntry, StreamInterruptedError], None],
        utc_now: Callable[[], datetime],
        exposures: ExposureControl | None = None,
    ) -> None:
        bench = devices.config
        self.frames_asked = plan.frames_per_capture or bench.capture.frames_per_capture
        self._plan = plan
        self._bench = bench
        self._camera = devices.camera
        self._stage = devices.stage
        self._interrupted = interrupted
        self._clock = devices.clock
        self._sleep = devices.sleep
        self._utc_now = utc_now
        self._approached_mm: float | None = None
        self._exposure_us = bench.camera.exposure_us
        self._exposures = exposures or ExposureControl(
            devices.camera, self._exposure_us, devices.clock
        )

    def forget_approach(self) -> None:
        """Approach the next height anew, even if it is the same as the last one."""
        self._approached_mm = None

    def capture(self, entry: PlanEntry, exposure_us: float | None) -> Take:
        """Capture an entry at its exposure or, if None, at one found automatically."""
        self._approach(entry.height_mm)
        return self.capture_here(entry, exposure_us)

    def capture_here(self, entry: PlanEntry, exposure_us: float | None) -> Take:
        """Capture an entry as ``capture`` does, with a stage that is at its height already."""
        self._require_still()
        if exposure_us is None:
            self._begun_anew(entry, self._find_exposure)
        else:
            self._exposure_us = exposure_us
        exposed = self._begun_anew(entry, lambda: self._expose(entry))
        # Checked after the exposure: a stage that moved or crept away spoils the capture.
        self._require_still()
        return Take(
            averaged=exposed.averaged,
            settings=exposed.settings,
            raw_frames=exposed.raw_frames,
            height_mm=self._checked(entry.height_mm, self._stage.position_mm()),
            focus_value=(
                None if entry.kind in ("flat", "dark") else self._focus_value(exposed.averaged)
            ),
            started=exposed.started,
            finished=exposed.finished,
            bracket=exposed.bracket,
        )

    def park(self, height_mm: float) -> None:
        """Park the stage at a height."""
        self.forget_approach()
        self._stage.move_to(height_mm, move_timeout_s(self._bench.stage))

    def _begun_anew(self, entry: PlanEntry, work: Callable[[], T]) -> T:
        """Do what streams, from its beginning again where the stream breaks off."""
        return restarted(
            work,
            timeout_s=self._bench.camera.reconnect_timeout_s,
            clock=self._clock,
            interrupted=lambda error: self._interrupted(entry, error),
        )

    def _expose(self, entry: PlanEntry) -> _Exposed:
        """Average the frames of one exposure, or of each of a bracket and merge them."""
        started = self._utc_now()
        frames, keep = self.frames_asked, self._plan.keep_frames
        if entry.bracket is None:
            taken = self._exposures.average(frames, self._exposure_us, keep_frames=keep)
            return _Exposed(
                averaged=taken.averaged,
                settings=self._camera.settings,
                raw_frames=taken.raw_frames,
                started=started,
                finished=self._utc_now(),
            )
        asked_us = _bracket_exposures_us(
            self._exposure_us, entry.bracket.ratios(), self._bench.capture.mains_hz
        )
        each = self._exposures.bracket(frames, asked_us, keep_frames=keep)
        finished, settings = self._utc_now(), self._camera.settings
        merged = merge_bracket(
            [one.exposure_us for one in each],
            [one.averaged for one in each],
            black_level_dn=settings.black_level_dn,
            max_level_dn=settings.max_level_dn,
        )
        return _Exposed(
            averaged=merged.averaged,
            settings=replace(settings, exposure_us=each[0].exposure_us),
            raw_frames=tuple(frame for one in each for frame in one.raw_frames),
            started=started,
            finished=finished,
            bracket=merged,
        )

    def _focus_value(self, averaged: AveragedFrames) -> float:
        return focus_value(
            averaged.mean_dn,
            black_level_dn=self._camera.settings.black_level_dn,
            noise_variance_dn2=float(averaged.variance_dn2.mean()) / averaged.frames_used,
        )

    def _find_exposure(self) -> None:
        """Find the exposure for the brightest parts of the target, within a frame period."""
        config = self._bench.camera
        longest_us = max(1e6 / config.frame_rate_hz, config.exposure_us)
        self._exposure_us = find_exposure(
            self._camera,
            self._exposures,
            limits_us=(SHORTEST_EXPOSURE_US, longest_us),
            mains_hz=self._bench.capture.mains_hz,
        ).exposure_us

    def _approach(self, height_mm: float) -> None:
        if self._approached_mm == height_mm:
            return
        if not self._stage.is_homed:
            self._stage.home(home_timeout_s(self._bench.stage, self._stage))
        self._approached_mm = None
        self._checked(height_mm, self._stage.move_to(height_mm, move_timeout_s(self._bench.stage)))
        if self._plan.settle_s:
            self._sleep(self._plan.settle_s)
        self._approached_mm = height_mm

    def _require_still(self) -> None:
        """Reject a capture that overlaps a move, whoever moves the stage."""
        state = self._stage.state
        if state != "idle":
            raise DeviceError(
                f"the stage was not at rest ({state}) during a capture, which was discarded; "
                "stop whatever moves the stage and run again"
            )

    def _checked(self, asked_mm: float, read_back_mm: float) -> float:
        """Return the height read back, if it is where the stage was sent."""
        tolerance_mm = self._bench.stage.tolerance_mm
        # The negation also refuses NaN. The nanometre allows for decimal fractions, not stages.
        if not abs(read_back_mm - asked_mm) <= tolerance_mm + 1e-6:
            raise StageStoppedError(
                f"the stage is at {read_back_mm:.3f} mm, not at {asked_mm:.3f} mm "
                f"(tolerance {tolerance_mm:g} mm); home it and run again",
                is_asked=False,
                height_mm=read_back_mm,
            )
        return read_back_mm
