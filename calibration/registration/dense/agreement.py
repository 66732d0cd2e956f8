"""How well two photographs agree at a pose, beside how well they agree at any other shift.

The locally normalised photographs are correlated over the whole overlap, at the pose and at every
shift from it. What the correlation is at shifts that mean nothing says how surprising the one at
the pose is; a second shift with as much of it says that the scene repeats.
"""

from dataclasses import dataclass
from math import atanh, log, sqrt

import cv2
import numpy as np
import scipy.fft

from calibration.registration.dense import AlignedPhotograph, locally_normalised
from calibration.registration.distorted_pose import DistortedPose
from simulation.arrays import BoolArray, Float32Array, FloatArray

_LONG_SIDE_PX = 192
"""Of the coarser photograph, reduced: what a scene has in common is told at this size."""

_OVERLAP_PX = 2000
_FINER_MOST = 4
"""An overlap of fewer pixels is compared at up to four times the resolution: of a photograph from
six times nearer, the whole frame's resolution leaves 30 x 20 pixels, of which none can be told."""

_WINDOW_PX = 21
_SHARED_LEAST = 0.35
"""Share of the overlap that a shift must keep to be compared."""

_LOBE = 0.5
"""Shifts around the pose with at least this part of its correlation belong to its own peak."""

_CORRELATION_MOST = 0.9995


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Agreement:
    """Agreement of two photographs at a pose.

    Parameters
    ----------
    correlation
        Of the locally normalised photographs over the overlap.
    significance
        That correlation in standard deviations of those at other shifts, both after Fisher's
        transformation.
    overlap_px, overlap
        Pixels of the coarser photograph in common, at the resolution of the comparison, and as a
        share of its usable ones.
    rival_correlation, rival_shift_px
        The highest correlation elsewhere, and its shift ``(x, y)`` in pixels of the coarser
        photograph.
    """

    correlation: float
    significance: float
    overlap_px: int
    overlap: float
    rival_correlation: float
    rival_shift_px: tuple[float, float]

    @property
    def evidence(self) -> float:
        """Log likelihood ratio of the pose to no relation, per pixel of the coarser photograph."""
        square = min(max(self.correlation, 0.0), _CORRELATION_MOST) ** 2
        return -0.5 * self.overlap * log(1 - square)


def comparison_factor(pose: DistortedPose) -> int:
    """Power of two by which the target is reduced to be judged at a pose, target to source."""
    rows, cols = pose.followup_shape
    factor = 1
    while max(rows, cols) / factor > 1.5 * _LONG_SIDE_PX:
        factor *= 2
    shared_px, least = pose.overlap * rows * cols, max(factor // _FINER_MOST, 1)
    while factor > least and shared_px < _OVERLAP_PX * factor**2:
        factor //= 2
    return factor


def agreement_at(
    source: AlignedPhotograph, target: AlignedPhotograph, pose: DistortedPose, factor: int
) -> Agreement | None:
    """Judge a pose; None where the photographs have nothing in common there.

    Parameters
    ----------
    source, target
        The finer and the coarser photograph.
    pose
        Target to source.
    factor
        By which the target is reduced first.
    """
    found = compared_at(source, target, pose, factor)
    return None if found is None else _judged(found, factor)


def correlation_at(
    source: AlignedPhotograph, target: AlignedPhotograph, pose: DistortedPose, factor: int
) -> float:
    """Correlation alone, as ``agreement_at`` has it; 0 where nothing is in common."""
    found = compared_at(source, target, pose, factor)
    if found is None:
        return 0.0
    ours, theirs = found.ours[found.inside], found.theirs[found.inside]
    return float(np.sum(ours * theirs) / np.sqrt(np.sum(ours**2) * np.sum(theirs**2) + 1e-12))


def seen_by(
    source: AlignedPhotograph, pose: DistortedPose, factor: int, shape: tuple[int, int]
) -> tuple[Float32Array, BoolArray]:
    """The finer photograph as the coarser one sees it, and which pixels it shows.

    Parameters
    ----------
    source
        The finer photograph.
    pose
        Of the coarser one in it.
    factor, shape
        By which the coarser one is reduced, and its shape ``(rows, cols)`` then.
    """
    source_factor = _source_factor(pose, factor)
    ratio = pose.zoom * factor / source_factor
    near = source.reduced(source_factor)
    if ratio > 1:
        blur_px = 0.5 * sqrt(ratio**2 - 1)
        near = near.smoothed(blur_px, blur_px)
    return _warped(near, pose, factor, source_factor, shape)


def _source_factor(pose: DistortedPose, factor: int) -> int:
    """Power of two by which the finer photograph is reduced beside the coarser one."""
    return factor << int(np.log2(max(pose.zoom, 1.0) + 1e-9))


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Compared:
    """The source as the target sees it and the target, both normalised, and where they count."""

    ours: Float32Array
    inside: BoolArray
    theirs: Float32Array
    usable: BoolArray


def compared_at(
    source: AlignedPhotograph, target: AlignedPhotograph, pose: DistortedPose, factor: int
) -> Compared | None:
    """The two photographs as they are compared at a pose; None where they share too little.

    Arguments are those of ``agreement_at``.
    """
    far = target.reduced(factor).smoothed(1.0, 1.0)
    source_factor = _source_factor(pose, factor)
    near = source.reduced(source_factor)
    blur_px = max(pose.zoom * factor / source_factor, 1.0)
    near = near.smoothed(blur_px, blur_px)
    seen, inside = _warped(near, pose, factor, source_factor, far.shape)
    usable = np.ones(far.shape, dtype=np.bool_) if far.usable is None else far.usable
    inside &= usable
    if np.count_nonzero(inside) < _WINDOW_PX**2:
        return None
    return Compared(
        ours=locally_normalised(seen, inside, _WINDOW_PX),
        inside=inside,
        theirs=locally_normalised(far.levels, usable, _WINDOW_PX),
        usable=usable,
    )


def _warped(
    near: AlignedPhotograph,
    pose: DistortedPose,
    factor: int,
    source_factor: int,
    shape: tuple[int, int],
) -> tuple[Float32Array, BoolArray]:
    rows, cols = shape
    y, x = np.meshgrid(np.arange(float(rows)), np.arange(float(cols)), indexing="ij")
    to_y, to_x = pose.to_reference_px((y + 0.5) * factor - 0.5, (x + 0.5) * factor - 0.5)
    to_y, to_x = ((at + 0.5) / source_factor - 0.5 for at in (to_y, to_x))
    inside = (to_y >= 0) & (to_y <= near.shape[0] - 1) & (to_x >= 0) & (to_x <= near.shape[1] - 1)
    at_x, at_y = (np.clip(at, -9.0, 3e4).astype(np.float32) for at in (to_x, to_y))
    seen = cv2.remap(near.levels, at_x, at_y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    if near.usable is not None:
        share = cv2.remap(near.usable.astype(np.float32), at_x, at_y, cv2.INTER_LINEAR)
        inside &= np.asarray(share) > 0.98
    return np.asarray(seen, dtype=np.float32), inside


def _judged(compared: Compared, factor: int) -> Agreement:
    ours, theirs = compared.ours, compared.theirs
    inside, usable = compared.inside, compared.usable
    mask, other = inside.astype(np.float32), usable.astype(np.float32)
    number = _correlated(mask, other)
    enough = number > _SHARED_LEAST * np.count_nonzero(inside)
    spread = np.sqrt(
        np.maximum(_correlated(ours**2, other), 1e-9)
        * np.maximum(_correlated(mask, theirs**2), 1e-9)
    )
    found = np.where(enough, _correlated(ours, theirs) / np.maximum(spread, 1e-6), 0.0)
    correlation = float(found[0, 0])
    is_own = _own_peak(found, _LOBE * correlation)
    elsewhere = np.where(is_own, 0.0, found)
    rest = elsewhere[enough & ~is_own]
    deviation = (
        float(np.sqrt(np.mean(np.arctanh(np.clip(rest, -0.99, 0.99)) ** 2))) if len(rest) else 1.0
    )
    # A slope of the pose's own peak is no rival.
    highest = cv2.dilate(elsewhere, np.ones((5, 5), dtype=np.uint8)) <= np.where(is_own, -1, found)
    peaks = np.where(highest & ~_grown(is_own), elsewhere, 0.0)
    row, col = divmod(int(np.argmax(peaks)), found.shape[1])
    shift_y, shift_x = (
        at if at < size // 2 else at - size
        for at, size in zip((row, col), found.shape, strict=True)
    )
    bounded = min(max(correlation, -_CORRELATION_MOST), _CORRELATION_MOST)
    return Agreement(
        correlation=correlation,
        significance=atanh(bounded) / max(deviation, 1e-3),
        overlap_px=int(np.count_nonzero(inside)),
        overlap=float(inside.sum() / max(float(usable.sum()), 1.0)),
        rival_correlation=float(peaks[row, col]),
        rival_shift_px=(float(shift_x * factor), float(shift_y * factor)),
    )


def _correlated(ours: Float32Array, theirs: Float32Array) -> FloatArray:
    """Sum over pixels of ours times theirs at every shift, (0, 0) first, negative ones last."""
    size = [scipy.fft.next_fast_len(2 * n, real=True) for n in ours.shape]
    series = np.conj(scipy.fft.rfft2(ours, s=size)) * scipy.fft.rfft2(theirs, s=size)
    return np.asarray(scipy.fft.irfft2(series, s=size), dtype=np.float64)


def _own_peak(found: FloatArray, least: float) -> BoolArray:
    """Shifts connected with (0, 0) at which the correlation is at least so high."""
    middle = tuple(n // 2 for n in found.shape)
    centred = np.fft.fftshift(found)
    _, labels = cv2.connectedComponents((centred >= max(least, 1e-6)).astype(np.uint8))
    own = labels == labels[middle]
    own[middle[0] - 2 : middle[0] + 3, middle[1] - 2 : middle[1] + 3] = True
    return np.asarray(np.fft.ifftshift(own))


def _grown(mask: BoolArray) -> BoolArray:
    return cv2.dilate(mask.astype(np.uint8), np.ones((3, 3), dtype=np.uint8)).astype(np.bool_)
