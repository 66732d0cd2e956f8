"""Set exposures and average only frames that were exposed so."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from acquisition.averaging import AveragedFrames, average_frames
from acquisition.bracket.exposure_change import ExposureChange, SteadyLight
from acquisition.devices import Camera, Frame, FrameImage
from acquisition.errors import CameraFeatureError, CaptureError

FEWEST_SKIPPED = 3
"""Frames left out after a change of exposure where neither the camera nor the light tells. Sensors
that set up an exposure while they read out the one before are two frames late."""

MOST_SKIPPED = 32
"""Frames within which every camera follows its exposure, or has failed to."""

STEP_US = 2.0
SET_WITHIN = 0.2
"""Relative, or steps: cameras round exposures; one that is further off was cut off at a limit."""

_STEADY_TRIALS = 6


@dataclass(frozen=True, slots=True, kw_only=True)
class ExposedFrames:
    """An average of frames of one exposure, in us as read back, and the frames if asked for."""

    exposure_us: float
    averaged: AveragedFrames
    raw_frames: tuple[FrameImage, ...] = ()


class ExposureControl:
    """The exposure of a camera, whose frames follow it with a delay that it does not state.

    A setting is read back at once, but frames that the sensor had begun are exposed as before, and
    some cameras are several frames late. A frame that states its exposure (chunk data) is judged
    by that. Otherwise its light decides: after a change of the same scene `ExposureChange` knows
    what a frame must show; at a new scene the frames of an average must show the same light, after
    as many have been left out as this camera ever needed. If a later change tells that this was
    not enough, the bracket is begun anew. After others have set the exposure nobody knows how long
    ago that was: it counts as a change.

    Parameters
    ----------
    camera
        Opened and configured; it must not be streaming.
    asked_us
        The exposure that it was configured with and has followed; None if nobody knows.
    clock
        Monotonic time in seconds.
    """

    def __init__(self, camera: Camera, asked_us: float | None, clock: Callable[[], float]) -> None:
        self._camera = camera
        self._clock = clock
        self._asked_us = self._set_us = math.nan
        if asked_us is not None:
            self._asked_us, self._set_us = asked_us, camera.settings.exposure_us
        self._frames_late = FEWEST_SKIPPED
        self._change = 1.0

    @property
    def frames_late(self) -> int:
        """How many frames are left out after a change where nothing tells: the most seen so far."""
        return self._frames_late

    def average(
        self, frames_asked: int, exposure_us: float, *, keep_frames: bool = False
    ) -> ExposedFrames:
        """Average frames of one exposure, set if it is not set already.

        Light that flickers too much to tell is no reason to fail: more frames are then left out.

        Raises
        ------
        CameraFeatureError
            If the camera sets another exposure.
        CaptureError
            If the average fails.
        """
        ratio = self._set(exposure_us)
        if ratio == 1:
            return self._averaged(frames_asked, lambda _: False, keep_frames=keep_frames)
        late = self._frames_late
        try:
            return self._at_new_scene(frames_asked, ratio, late, keep_frames=keep_frames)
        except _LightChangedError:
            return self._averaged(
                frames_asked, _Settler(None, MOST_SKIPPED).is_stale, keep_frames=keep_frames
            )

    def settle(self, exposure_us: float) -> None:
        """Set an exposure, and see to it that whoever streams next gets frames of it.

        Raises
        ------
        CameraFeatureError
            If the camera sets another exposure.
        CaptureError
            If the camera sends no frames.
        """
        if self._set(exposure_us) != 1:
            self.average(2, exposure_us)

    def bracket(
        self, frames_asked: int, exposures_us: Sequence[float], *, keep_frames: bool = False
    ) -> tuple[ExposedFrames, ...]:
        """Average frames of each of several ascending exposures of one scene.

        Raises
        ------
        CameraFeatureError
            If the camera sets another exposure.
        CaptureError
            If an average fails, or the exposure of the frames does not settle.
        """
        late = self._frames_late
        try:
            taken = self._bracket(frames_asked, exposures_us, late, keep_frames=keep_frames)
        except (_NotFollowedError, _LightChangedError):
            late = MOST_SKIPPED
        else:
            if self._frames_late <= late:
                return taken
            # The camera is later than the first average allowed for.
            late = self._frames_late
        try:
            return self._bracket(frames_asked, exposures_us, late, keep_frames=keep_frames)
        except (_NotFollowedError, _LightChangedError) as error:
            raise CaptureError(
                f"the frames do not show the exposure that was set ({error}); keep light and scene "
                "still, and check that nothing else regulates the exposure",
                frames_complete=0,
                frames_asked=frames_asked * len(exposures_us),
            ) from error

    def _bracket(
        self,
        frames_asked: int,
        exposures_us: Sequence[float],
        skipped: int,
        *,
        keep_frames: bool,
    ) -> tuple[ExposedFrames, ...]:
        ratio = self._set(exposures_us[0])
        taken = [self._at_new_scene(frames_asked, ratio, skipped, keep_frames=keep_frames)]
        for exposure_us in exposures_us[1:]:
            shorter = taken[-1]
            self._set(exposure_us)
            settings = self._camera.settings
            follower = _Follower(
                ExposureChange(
                    shorter.averaged,
                    settings.exposure_us / shorter.exposure_us,
                    black_level_dn=settings.black_level_dn,
                    max_level_dn=settings.max_level_dn,
                ),
                self._frames_late,
            )
            taken.append(self._averaged(frames_asked, follower.is_stale, keep_frames=keep_frames))
            self._frames_late = max(self._frames_late, follower.frames_late)
            _require_monotonic(shorter, taken[-1])
        return tuple(taken)

    def _at_new_scene(
        self, frames_asked: int, ratio: float, skipped: int, *, keep_frames: bool
    ) -> ExposedFrames:
        """Average frames that show the same light, after leaving out some."""
        settings = self._camera.settings
        for _ in range(_STEADY_TRIALS):
            light = SteadyLight(
                ratio, black_level_dn=settings.black_level_dn, max_level_dn=settings.max_level_dn
            )
            settler = _Settler(light, skipped)
            try:
                return self._averaged(frames_asked, settler.is_stale, keep_frames=keep_frames)
            except _LightChangedError:
                # What came before was stale; what comes now follows.
                self._frames_late = max(
                    self._frames_late, min(skipped + frames_asked, MOST_SKIPPED)
                )
        raise _LightChangedError("they differ from one to another")

    def _averaged(
        self, frames_asked: int, is_stale: Callable[[Frame], bool], *, keep_frames: bool
    ) -> ExposedFrames:
        exposure_us = self._camera.settings.exposure_us
        raw_frames: list[FrameImage] = []

        def may_be_stale(frame: Frame) -> bool:
            # A frame that states its exposure was judged by it before.
            return frame.exposure_us is None and is_stale(frame)

        averaged = average_frames(
            self._camera,
            frames_asked,
            keep_frame=raw_frames.append if keep_frames else None,
            is_stale=may_be_stale,
            clock=self._clock,
        )
        self._change = 1.0
        return ExposedFrames(
            exposure_us=exposure_us, averaged=averaged, raw_frames=tuple(raw_frames)
        )

    def _set(self, exposure_us: float) -> float:
        """Set the exposure and read it back; return by how much it changed since the last average.

        1 means not at all, infinite that nobody knows. An average that was interrupted shows
        nothing of a change before it.
        """
        before_us = self._camera.settings.exposure_us
        is_known = before_us == self._set_us
        # Cameras round: what was asked last and is still set is not another exposure.
        if is_known and exposure_us in (self._asked_us, before_us):
            return self._change
        set_us = self._camera.set_exposure_us(exposure_us)
        if not abs(set_us - exposure_us) <= max(STEP_US, SET_WITHIN * exposure_us):
            raise CameraFeatureError(
                f"the camera set an exposure of {set_us:g} us, not {exposure_us:g} us; ask for one "
                "within its limits",
                feature="ExposureTime",
            )
        self._asked_us, self._set_us = exposure_us, set_us
        self._change = set_us / before_us if is_known or set_us != before_us else math.inf
        return self._change


class _LightChangedError(Exception):
    """A frame has another exposure than those before it."""


class _NotFollowedError(Exception):
    """The camera does not follow its exposure, or followed it later than was thought."""


class _Settler:
    """Leaves out the first frames of a new scene; the others must be of one exposure."""

    def __init__(self, light: SteadyLight | None, skipped: int) -> None:
        self._light = light
        self._left = skipped

    def is_stale(self, frame: Frame) -> bool:
        if self._left > 0:
            self._left -= 1
            return True
        if self._light is not None and self._light.is_broken_by(frame.image_dn):
            raise _LightChangedError("they differ from one to another")
        return False


class _Follower:
    """Leaves out frames until they follow a change, and any later one that does not."""

    def __init__(self, change: ExposureChange, frames_late: int) -> None:
        self.frames_late = 0
        self._change = change
        self._left = frames_late
        self._stale = 0

    def is_stale(self, frame: Frame) -> bool:
        verdict = self._change.verdict(frame.image_dn)
        if verdict == "dark":
            self._left -= 1
            return self._left >= 0
        if verdict == "fresh":
            return False
        self._stale += 1
        self.frames_late = self._stale + 1  # and the one that every average leaves out
        if self._stale > MOST_SKIPPED:
            raise _NotFollowedError(f"{self._stale} frames after the change")
        return True


def _require_monotonic(shorter: ExposedFrames, longer: ExposedFrames) -> None:
    """What saturates at an exposure saturates at a longer one."""
    saturated, later = shorter.averaged.is_saturated, longer.averaged.is_saturated
    if saturated is None:
        return
    odd = int((saturated if later is None else saturated & ~later).sum())
    if odd > max(4, 1e-3 * saturated.size):
        raise _NotFollowedError(
            f"{odd} pixels saturate at {shorter.exposure_us:g} us but not at "
            f"{longer.exposure_us:g} us"
        )
