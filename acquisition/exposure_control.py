"""Set exposures and average only frames that were exposed so."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from acquisition.averaging import AveragedFrames, average_frames
from acquisition.devices import Camera, Frame, FrameImage
from acquisition.errors import CameraFeatureError, CaptureError

_BLOCKS_ACROSS = 32
_LEAST_BLOCK_PX = 4
"""Frames are compared by the means of some thousand blocks, in which noise is small."""

_FRESH_WITHIN = 0.3
"""Of the change that is expected: lamps and shutters differ by less, a stale frame by all of it."""

_TOLD_WITHIN = 0.06
"""Standard error of a frame's share of the change from which on it tells: a fifth of the above."""

_LIT_SHARE = 1e-3
"""Of the range, at least 1 DN: blocks that bright are lit; their noise is a sixth of it."""

Verdict = Literal["fresh", "stale", "dark"]

_Blocks = NDArray[np.float64]


class _ExposureChange:
    """A change to a longer exposure of the same scene, by the average before it and the ratio.

    The projection of a frame on the predicted difference is 1 of a fresh frame and 0 of a stale
    one.
    """

    def __init__(
        self, before: AveragedFrames, ratio: float, *, black_level_dn: float, max_level_dn: float
    ) -> None:
        old_dn = before.mean_dn.astype(np.float64)
        new_dn = np.minimum(black_level_dn + (old_dn - black_level_dn) * ratio, max_level_dn)
        old = _block_means(old_dn)
        # Elsewhere there is nothing but noise and what the stated black level is off.
        self._is_lit = old - black_level_dn > _lit_dn(black_level_dn, max_level_dn)
        self._old_dn = old[self._is_lit]
        self._step_dn = _block_means(new_dn)[self._is_lit] - self._old_dn
        self._energy_dn2 = float(np.sum(self._step_dn**2))
        # Of the frame, whose shot noise grows by the ratio at most, and of what it is judged by.
        grown = ratio + ratio**2 / before.frames_used
        variance_dn2 = _block_means(before.variance_dn2)[self._is_lit]
        noise_dn2 = grown * variance_dn2 / _block_side(old_dn.shape) ** 2
        self._noise_dn2 = float(np.sum(noise_dn2))
        scatter_dn4 = float(np.sum(self._step_dn**2 * noise_dn2))
        self._is_told = 0 < scatter_dn4**0.5 < _TOLD_WITHIN * self._energy_dn2

    def verdict(self, image_dn: FrameImage) -> Verdict:
        """What a frame is; ``dark`` where the scene has too little light to tell."""
        if not self._is_told:
            return "dark"
        change_dn = _block_means(image_dn)[self._is_lit] - self._old_dn
        share = float(np.vdot(change_dn, self._step_dn)) / self._energy_dn2
        rest_dn2 = float(np.sum((change_dn - self._step_dn) ** 2))
        is_near = rest_dn2 < _FRESH_WITHIN**2 * self._energy_dn2 + 4 * self._noise_dn2
        return "fresh" if abs(share - 1) < _FRESH_WITHIN and is_near else "stale"


class _SteadyLight:
    """Whether frames have the exposure of the first of them, of a scene that nobody knows yet."""

    def __init__(self, ratio: float, *, black_level_dn: float, max_level_dn: float) -> None:
        self._limit = float(np.clip(np.sqrt(max(ratio, 1 / ratio)), 1.1, 1.4))
        self._black_level_dn = black_level_dn
        self._max_level_dn = max_level_dn
        self._lit_dn = _lit_dn(black_level_dn, max_level_dn)
        self._first: tuple[_Blocks, _Blocks] | None = None

    def is_broken_by(self, image_dn: FrameImage) -> bool:
        """Whether a frame has another exposure than the first."""
        light_dn = _block_means(image_dn) - self._black_level_dn
        saturated = _block_means(image_dn >= self._max_level_dn)
        if self._first is None:
            self._first = light_dn, saturated
            return False
        first_dn, first_saturated = self._first
        is_lit = np.maximum(light_dn, first_dn) > self._lit_dn
        is_lit &= (saturated == 0) & (first_saturated == 0)
        if not is_lit.any():
            return abs(float(saturated.mean() - first_saturated.mean())) > 0.01
        sums = (max(float(dn[is_lit].sum()), self._lit_dn) for dn in (light_dn, first_dn))
        change = float(np.log(next(sums)) - np.log(next(sums)))
        return abs(change) > float(np.log(self._limit))


def _lit_dn(black_level_dn: float, max_level_dn: float) -> float:
    return max(_LIT_SHARE * (max_level_dn - black_level_dn), 1.0)


def _block_side(shape: tuple[int, ...]) -> int:
    shorter = min(shape)
    return min(max(_LEAST_BLOCK_PX, shorter // _BLOCKS_ACROSS), shorter)


def _block_means(image: NDArray[np.number] | NDArray[np.bool_]) -> _Blocks:
    """Means of square blocks; what is left at the right and below is not looked at."""
    side = _block_side(image.shape)
    rows, cols = (length // side for length in image.shape)
    blocks = image[: rows * side, : cols * side].reshape(rows, side, cols, side)
    return np.asarray(np.mean(blocks, axis=(1, 3), dtype=np.float64))


_FEWEST_SKIPPED = 3
"""Frames left out after a change of exposure where neither the camera nor the light tells. Sensors
that set up an exposure while they read out the one before are two frames late."""

_MOST_SKIPPED = 32
"""Frames within which every camera follows its exposure, or has failed to."""

_STEP_US = 2.0
_SET_WITHIN = 0.2
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
    some cameras are several frames late. A frame that states its exposure (chunk data) is judged by
    that. Otherwise its light decides: after a change of the same scene `_ExposureChange` knows what
    a frame must show; at a new scene the frames of an average must show the same light, after as
    many have been left out as this camera ever needed. If a later change tells that this was not
    enough, the bracket is begun anew. After others have set the exposure nobody knows how long ago
    that was: it counts as a change.

    The camera must not be streaming. ``asked_us`` is the exposure that it was configured with and
    has followed; None if nobody knows.
    """

    def __init__(self, camera: Camera, asked_us: float | None, clock: Callable[[], float]) -> None:
        self._camera = camera
        self._clock = clock
        self._asked_us = self._set_us = math.nan
        if asked_us is not None:
            self._asked_us, self._set_us = asked_us, camera.settings.exposure_us
        self._frames_late = _FEWEST_SKIPPED
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
        """
        ratio = self._set(exposure_us)
        if ratio == 1:
            return self._averaged(frames_asked, lambda _: False, keep_frames=keep_frames)
        late = self._frames_late
        try:
            return self._at_new_scene(frames_asked, ratio, late, keep_frames=keep_frames)
        except _LightChangedError:
            return self._averaged(
                frames_asked, _Settler(None, _MOST_SKIPPED).is_stale, keep_frames=keep_frames
            )

    def settle(self, exposure_us: float) -> None:
        """Set an exposure, and see to it that whoever streams next gets frames of it."""
        if self._set(exposure_us) != 1:
            self.average(2, exposure_us)

    def bracket(
        self, frames_asked: int, exposures_us: Sequence[float], *, keep_frames: bool = False
    ) -> tuple[ExposedFrames, ...]:
        """Average frames of each of several ascending exposures of one scene."""
        late = self._frames_late
        try:
            taken = self._bracket(frames_asked, exposures_us, late, keep_frames=keep_frames)
        except (_NotFollowedError, _LightChangedError):
            late = _MOST_SKIPPED
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
                _ExposureChange(
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
            light = _SteadyLight(
                ratio, black_level_dn=settings.black_level_dn, max_level_dn=settings.max_level_dn
            )
            settler = _Settler(light, skipped)
            try:
                return self._averaged(frames_asked, settler.is_stale, keep_frames=keep_frames)
            except _LightChangedError:
                # What came before was stale; what comes now follows.
                self._frames_late = max(
                    self._frames_late, min(skipped + frames_asked, _MOST_SKIPPED)
                )
        raise _LightChangedError("they differ from one frame to the next")

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
        """Set the exposure; return its ratio to that of the last average, infinite if unknown."""
        before_us = self._camera.settings.exposure_us
        is_known = before_us == self._set_us
        # Cameras round: what was asked last and is still set is not another exposure.
        if is_known and exposure_us in (self._asked_us, before_us):
            return self._change
        set_us = self._camera.set_exposure_us(exposure_us)
        if not abs(set_us - exposure_us) <= max(_STEP_US, _SET_WITHIN * exposure_us):
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

    def __init__(self, light: _SteadyLight | None, skipped: int) -> None:
        self._light = light
        self._left = skipped

    def is_stale(self, frame: Frame) -> bool:
        if self._left > 0:
            self._left -= 1
            return True
        if self._light is not None and self._light.is_broken_by(frame.image_dn):
            raise _LightChangedError("they differ from one frame to the next")
        return False


class _Follower:
    """Leaves out frames until they follow a change, and any later one that does not."""

    def __init__(self, change: _ExposureChange, frames_late: int) -> None:
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
        if self._stale > _MOST_SKIPPED:
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
