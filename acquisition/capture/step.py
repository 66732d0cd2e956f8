"""One capture at the bench: approach the height, settle, expose, average, read the height back."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from datetime import datetime
from typing import TypeVar

from acquisition.averaging import AveragedFrames
from acquisition.bench import BenchDevices
from acquisition.bracket import ExposureControl, MergedBracket, merge_bracket
from acquisition.capture.auto_exposure import (
    SHORTEST_EXPOSURE_US,
    bracket_exposures_us,
    find_exposure,
)
from acquisition.devices import CameraSettings, FrameImage
from acquisition.errors import DeviceError, StageStoppedError, StreamInterruptedError
from acquisition.focus import focus_value
from acquisition.plan import CapturePlan, PlanEntry
from acquisition.restarting import restarted
from acquisition.session import Take
from acquisition.stages import home_timeout_s, move_timeout_s

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

    Parameters
    ----------
    interrupted
        Called with the error of an interrupted stream; the capture is then begun anew, again and
        again for ``camera.reconnect_timeout_s``.
    exposures
        Of this camera, where captures were made before; by default a new one.
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
        """Capture an entry at its exposure or, if None, at one found automatically.

        Raises
        ------
        DeviceError
            If a device fails, or the stage is not at rest where it was sent; nothing of the
            capture is kept.
        """
        self._approach(entry.height_mm)
        return self.capture_here(entry, exposure_us)

    def capture_here(self, entry: PlanEntry, exposure_us: float | None) -> Take:
        """Capture an entry as ``capture`` does, with a stage that is at its height already.

        Raises
        ------
        DeviceError
            As ``capture``.
        """
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
        asked_us = bracket_exposures_us(
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
