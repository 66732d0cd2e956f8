"""Mean and temporal variance of frames of one's own, which are seen once and not kept."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from acquisition.frame_sums import FrameSums
from calibration.errors import NoiseError
from calibration.noise.capture_list import NoiseCapture, NoiseCaptures, NoiseKind
from calibration.noise.photon_transfer import MOST_CLIPPED, QUANTISATION_DN2
from simulation.arrays import AnyArray, FloatArray, FloatImage

FEWEST_FRAMES = 2
_MOST_FRAMES = 10_000
"""Sums of 16-bit levels stay exact: N 2^16 < 2^32 and N^2 2^32 < 2^64."""
_INTEGERS = (np.uint8, np.uint16)


class FrameGroup:
    """Frames of one dark or flat level, at one exposure and gain.

    Levels of 8 and 16 bits are summed exactly, as in a capture of the bench; those of other types
    as Welford does ("Note on a method for calculating corrected sums of squares and products",
    Technometrics 4, 1962, 419).

    Parameters
    ----------
    kind
        What the frames show.
    name
        Of the group, for tables and messages.
    exposure_us
        None where it is not known.
    """

    def __init__(self, kind: NoiseKind, name: str, exposure_us: float | None = None) -> None:
        self.kind = kind
        self.name = name
        self.exposure_us = exposure_us
        self.frames = 0
        self._bits = 0
        self._largest: NDArray[Any] = np.zeros(0)
        self._sums: FrameSums | None = None
        self._mean: FloatArray = np.zeros(0)
        self._squares: FloatArray = np.zeros(0)
        self._statistics: tuple[FloatImage, FloatImage] | None = None

    @property
    def shape(self) -> tuple[int, ...]:
        """``(rows, cols)`` of every frame."""
        return self._largest.shape

    @property
    def max_dn(self) -> float:
        """Largest level in any frame."""
        return float(self._largest.max())

    @property
    def level_bits(self) -> int:
        """The bits that are set in any level, as a whole number: what the levels step by."""
        return self._bits

    def add(self, frame_dn: AnyArray) -> None:
        """Add a frame of whole levels, shape ``(rows, cols)``.

        Raises
        ------
        NoiseError
            If it has another size than the others, or levels that are no whole numbers.
        """
        if self.frames and frame_dn.shape != self.shape:
            raise NoiseError(
                f"{self.name}: frames of {_size(self.shape)} and {_size(frame_dn.shape)} pixels; "
                "give those of one camera and region",
                reason="settings",
            )
        if self.frames == _MOST_FRAMES:
            raise NoiseError(f"{self.name}: {_MOST_FRAMES} frames at most", reason="settings")
        frame: NDArray[Any] = np.ascontiguousarray(frame_dn)
        whole = np.abs(frame.astype(np.int64)) if frame.dtype.kind == "f" else frame
        if frame.dtype.kind == "f" and not np.array_equal(np.abs(frame), whole):
            raise NoiseError(
                f"{self.name}: levels that are no whole numbers, as of means or scaled frames; "
                "give single frames as the camera wrote them",
                reason="settings",
            )
        self._bits |= int(np.bitwise_or.reduce(whole, axis=None))
        self.frames += 1
        if self.frames == 1:
            self._begin(frame)
        np.maximum(self._largest, frame, out=self._largest)
        if self._sums is not None:
            self._sums.add(frame)
            return
        off = frame - self._mean
        self._mean += off / self.frames
        self._squares += off * (frame - self._mean)

    def finish(self) -> None:
        """Keep the mean and the variance alone: no more frames will come.

        Raises
        ------
        NoiseError
            If they are too few.
        """
        if self.frames < FEWEST_FRAMES:
            raise NoiseError(
                f"{self.name}: {self.frames} frame; a {self.kind} level takes {FEWEST_FRAMES} at "
                "least, at one exposure, for a variance from frame to frame",
                reason="no_dark" if self.kind == "dark" else "no_flat",
            )
        if self._sums is not None:
            self._statistics = self._sums.mean_and_variance(self.frames)
        else:
            variance = self._squares / (self.frames - 1)
            self._statistics = (self._mean.astype(np.float32), variance.astype(np.float32))
        self._sums, self._mean, self._squares = None, np.zeros(0), np.zeros(0)

    def statistics(self) -> tuple[FloatImage, FloatImage]:
        """Mean and unbiased temporal variance of one frame, float32."""
        assert self._statistics is not None, "finish comes first"
        return self._statistics

    def saturated_pixels(self, max_level_dn: float) -> int:
        """Pixels that reached a level in any frame."""
        return int(np.count_nonzero(self._largest >= max_level_dn))

    def _begin(self, frame: NDArray[Any]) -> None:
        self._largest = frame.copy()
        if frame.dtype.type in _INTEGERS:
            rows, cols = frame.shape
            self._sums = FrameSums((rows, cols), np.iinfo(frame.dtype).max)
        else:
            self._mean, self._squares = np.zeros(frame.shape), np.zeros(frame.shape)


def noise_captures(
    groups: Sequence[FrameGroup],
    *,
    max_level_dn: float,
    camera: str | None = None,
    notes: tuple[str, ...] = (),
) -> NoiseCaptures:
    """Return groups of frames as the captures of a noise measurement.

    Parameters
    ----------
    groups
        Finished, with names of their own.
    max_level_dn
        Level at which the frames are clipped.
    camera
        Its model.
    notes
        What there is to say of them.

    Raises
    ------
    NoiseError
        If they differ in size, or a dark is saturated.
    """
    step_dn = _step_dn(groups)
    max_level_dn = max_level_dn // step_dn * step_dn
    first = groups[0]
    for group in groups[1:]:
        if group.shape != first.shape:
            raise NoiseError(
                f"{first.name} has frames of {_size(first.shape)} pixels, {group.name} of "
                f"{_size(group.shape)}; give those of one camera and region",
                reason="settings",
            )
    for group in groups:
        clipped = group.saturated_pixels(max_level_dn)
        if group.kind == "dark" and clipped > MOST_CLIPPED * group.statistics()[0].size:
            raise NoiseError(
                f"{group.name}: {clipped} pixels of a dark reach {max_level_dn:g} DN, where the "
                "camera clips; put the lens cap on, or are darks and flats exchanged?",
                reason="no_dark",
                saturated=clipped,
            )
    if step_dn > 1:
        notes = (
            *notes,
            f"the levels step by {step_dn} DN, as of {step_dn.bit_length() - 1} bits that are "
            "not used; the rounding is taken as such",
        )
    return NoiseCaptures(
        captures=tuple(
            NoiseCapture(
                kind=group.kind,
                name=group.name,
                frames=group.frames,
                exposure_us=group.exposure_us,
                saturated_pixels=group.saturated_pixels(max_level_dn),
                load=group.statistics,
            )
            for group in groups
        ),
        max_level_dn=max_level_dn,
        frames_averaged=1,
        quantisation_dn2=step_dn**2 * QUANTISATION_DN2,
        facts={"camera_model": camera},
        notes=notes,
    )


def _step_dn(groups: Sequence[FrameGroup]) -> int:
    """The power of two by which all levels step, as of 12 bits in the upper ones of 16."""
    bits = 0
    for group in groups:
        bits |= group.level_bits
    return bits & -bits if bits else 1


def _size(shape: tuple[int, ...]) -> str:
    return " x ".join(str(each) for each in reversed(shape))
