"""How well two photographs agree at a pose, beside how well they agree at any other shift.

The locally normalised photographs are correlated over the whole overlap, at the pose and at every
shift from it. What the correlation is at shifts that mean nothing says how surprising the one at
the pose is; a second shift with as much of it says that the scene repeats.

Blocks of a photograph looked for in the other one around the place where a pose puts them. A pose
that follows a few strong outlines, or that chance made agree in part of the overlap, leaves blocks
that are plainly somewhere else. Noise and changes hide blocks, and move none.
"""

from dataclasses import dataclass, field
from math import atanh, log, sqrt
from typing import Self

import cv2
import numpy as np
import scipy.fft
from numpy.typing import NDArray

from calibration.registration._distorted_pose import DistortedPose
from simulation.arrays import AnyArray, BoolArray, Float32Array, FloatArray

_CONTRAST_FLOOR = 0.1
"""Of the whole image's, below which local contrast is not raised."""


def locally_normalised(levels: Float32Array, counted: BoolArray, window_px: int) -> Float32Array:
    """Normalise over a window; 0 where pixels do not count."""
    weight = counted.astype(np.float32)
    share = np.asarray(np.maximum(_mean(weight, window_px), 1e-3), dtype=np.float32)
    middle = _mean(levels * weight, window_px) / share
    deviation = np.asarray((levels - middle) * weight, dtype=np.float32)
    variance = _mean(deviation**2, window_px) / share
    floor = _CONTRAST_FLOOR**2 * float(variance[counted].mean()) if counted.any() else 0.0
    return np.asarray(deviation / np.sqrt(variance + (floor or 1.0)), dtype=np.float32)


def _mean(values: Float32Array, window_px: int) -> Float32Array:
    """Twice over a square: nearly a Gaussian."""
    size = (window_px, window_px)
    once = cv2.blur(values, size, borderType=cv2.BORDER_CONSTANT)
    return np.asarray(cv2.blur(once, size, borderType=cv2.BORDER_CONSTANT), dtype=np.float32)


_PLATEAU_PX = 3
"""Side of a square of one extreme level that no scene with noise shows: clipped pixels."""

_LEAST_BETWEEN = 0.25
"""Share of a photograph that plateaus must leave: of a drawing in two levels, or a page scanned to
white, they are what it shows, and leave 2 to 7 %. A round field of view before black leaves half or
more."""

_PIXEL_VARIANCE_PX2 = 1 / 12


@dataclass(frozen=True, slots=True, eq=False)
class AlignedPhotograph:
    """Grey levels over their standard deviation as float32, and the pixels that count, if not all.

    ``is_drawing`` where most of it lies at the ends of its levels.
    """

    levels: Float32Array = field(repr=False)
    usable: BoolArray | None = field(repr=False)
    scale_dn: float
    is_drawing: bool = False
    _reduced: dict[int, Self] = field(default_factory=dict, repr=False)

    @classmethod
    def of(cls, image: AnyArray, left_out: BoolArray | None = None) -> Self:
        """Take a grey image; clipped plateaus and what is ``left_out`` do not count.

        Plateaus do count where they are nearly all that there is.
        """
        values = np.asarray(image, dtype=np.float32)
        if values.ndim != 2 or values.size == 0 or not np.isfinite(values).all():
            raise ValueError(
                f"alignment needs grey images with finite values, got shape {image.shape}"
            )
        if left_out is not None and left_out.shape != values.shape:
            raise ValueError(
                f"the mask has the shape {left_out.shape}, the photograph {values.shape}"
            )
        unusable = _clipped(values)
        is_drawing = np.count_nonzero(unusable) > (1 - _LEAST_BETWEEN) * unusable.size
        if is_drawing:
            unusable[:] = False
        if left_out is not None:
            unusable |= left_out
        usable = ~unusable if unusable.any() else None
        counted = values if usable is None else values[usable]
        middle = (
            float(np.median(counted[:: max(counted.size // 100_000, 1)])) if len(counted) else 0.0
        )
        scale = _spread(values, usable) if counted.size else 0.0
        levels = values - np.float32(middle)
        levels /= np.float32(scale or 1.0)
        if usable is not None:
            levels[~usable] = 0.0
        return cls(levels, usable, scale, is_drawing=bool(is_drawing))

    @property
    def shape(self) -> tuple[int, int]:
        """``(rows, cols)``."""
        return self.levels.shape[0], self.levels.shape[1]

    def mirrored(self) -> Self:
        """Return the photograph with its columns reversed."""
        usable = None if self.usable is None else np.ascontiguousarray(self.usable[:, ::-1])
        return self._with(np.ascontiguousarray(self.levels[:, ::-1]), usable)

    def where(self, counted: BoolArray) -> Self:
        """Return the photograph of which only these pixels count, shape ``(rows, cols)``."""
        usable = counted if self.usable is None else counted & self.usable
        return self._with(self.levels, usable)

    def reduced(self, factor: int) -> Self:
        """Return the means of whole blocks of ``factor`` x ``factor`` pixels."""
        if factor == 1:
            return self
        # Every hypothesis and every resolution asks for them again.
        if factor not in self._reduced:
            self._reduced[factor] = self._shrunk_by(factor)
        return self._reduced[factor]

    def _shrunk_by(self, factor: int) -> Self:
        rows, cols = (n // factor for n in self.shape)
        part = np.s_[: rows * factor, : cols * factor]
        levels = _shrunk(self.levels[part], rows, cols)
        if self.usable is None:
            return self._with(levels, None)
        share = _shrunk(self.usable[part].astype(np.float32), rows, cols)
        return self._with(_ratio(levels, share), share > 0.99)

    def _with(self, levels: Float32Array, usable: BoolArray | None) -> Self:
        return type(self)(levels, usable, self.scale_dn, is_drawing=self.is_drawing)

    def smoothed(self, sigma_x_px: float, sigma_y_px: float) -> Self:
        """Return it after a Gaussian blur; what mixes with unusable pixels becomes unusable."""
        blur = (0, 0), max(sigma_x_px, 1e-3), max(sigma_y_px, 1e-3)
        levels = _blurred(self.levels, *blur)
        if self.usable is None:
            return self._with(levels, None)
        share = _blurred(self.usable.astype(np.float32), *blur)
        return self._with(_ratio(levels, share), share > 0.98)


def _spread(values: Float32Array, usable: BoolArray | None) -> float:
    mask = None if usable is None else usable.view(np.uint8)
    return float(cv2.meanStdDev(values, mask=mask)[1][0, 0])


def _clipped(values: Float32Array) -> BoolArray:
    """Pixels of plateaus at the highest or the lowest level, and their neighbours."""
    clipped = np.zeros(values.shape, dtype=np.bool_)
    square = np.ones((_PLATEAU_PX, _PLATEAU_PX), dtype=np.uint8)
    around = np.ones((_PLATEAU_PX + 2, _PLATEAU_PX + 2), dtype=np.uint8)
    for level in (values.max(), values.min()):
        plateau = cv2.erode((values == level).astype(np.uint8), square)
        if plateau.any():
            clipped |= cv2.dilate(plateau, around).astype(np.bool_)
    return clipped


def _shrunk(values: Float32Array, rows: int, cols: int) -> Float32Array:
    made = cv2.resize(values, (cols, rows), interpolation=cv2.INTER_AREA)
    return np.asarray(made, dtype=np.float32)


def _blurred(
    values: NDArray[np.float32], size: tuple[int, int], sigma_x_px: float, sigma_y_px: float
) -> Float32Array:
    made = cv2.GaussianBlur(
        values, size, sigma_x_px, sigmaY=sigma_y_px, borderType=cv2.BORDER_REFLECT
    )
    return np.asarray(made, dtype=np.float32)


def _ratio(levels: Float32Array, share: Float32Array) -> Float32Array:
    return np.asarray(levels / np.maximum(share, np.float32(1e-3)), dtype=np.float32)


def blur_variance_px2(sigma_px: float, factor: int) -> float:
    """Variance of the blur of a photograph reduced by a factor, in its own pixels."""
    return (sigma_px**2 + (factor**2 - 1) * _PIXEL_VARIANCE_PX2) / factor**2


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

    ``significance`` is the correlation in standard deviations of those at other shifts, both after
    Fisher's transformation. The overlap counts pixels of the coarser photograph at the resolution
    of the comparison, and is a share of its usable ones. The rival is the highest correlation
    elsewhere, at a shift ``(x, y)`` in pixels of the coarser photograph.
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
    """Judge a pose from the coarser target, reduced by the factor, to the source; or None."""
    found = _compared_at(source, target, pose, factor)
    return None if found is None else _judged(found, factor)


def correlation_at(
    source: AlignedPhotograph, target: AlignedPhotograph, pose: DistortedPose, factor: int
) -> float:
    """Correlation alone, as ``agreement_at`` has it; 0 where nothing is in common."""
    found = _compared_at(source, target, pose, factor)
    if found is None:
        return 0.0
    ours, theirs = found.ours[found.inside], found.theirs[found.inside]
    return float(np.sum(ours * theirs) / np.sqrt(np.sum(ours**2) * np.sum(theirs**2) + 1e-12))


def seen_by(
    source: AlignedPhotograph, pose: DistortedPose, factor: int, shape: tuple[int, int]
) -> tuple[Float32Array, BoolArray]:
    """The finer photograph as the coarser one, reduced to ``shape``, sees it, and where."""
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
class _Compared:
    """The source as the target sees it and the target, both normalised, and where they count."""

    ours: Float32Array
    inside: BoolArray
    theirs: Float32Array
    usable: BoolArray


def _compared_at(
    source: AlignedPhotograph, target: AlignedPhotograph, pose: DistortedPose, factor: int
) -> _Compared | None:
    """The two photographs as they are compared at a pose; None where they share too little."""
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
    return _Compared(
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


def _judged(compared: _Compared, factor: int) -> Agreement:
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
    grown = cv2.dilate(is_own.astype(np.uint8), np.ones((3, 3), dtype=np.uint8)).astype(np.bool_)
    peaks = np.where(highest & ~grown, elsewhere, 0.0)
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


_VOTING_SIDE_PX = 400
_BLOCK_PX = 32
_REACH_PX = 16
"""Of the coarser photograph, reduced; side of a block, and how far it is looked for."""

_LEAST_SHARE = 0.9
_LEAST_DETAIL = 0.1
"""Share of a block in the overlap, and its mean square beside that of the normalised photograph."""

_RECOGNISED = 0.6
"""Correlation of a block from which it is recognised."""

_AS_WELL = 0.95
_PLACE_PX = 1.5
"""A block is in its place if its best place is so near, or the best of the next pixels so good."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _BlockVotes:
    """Blocks that are recognised where a pose puts them, and elsewhere."""

    here: int
    elsewhere: int

    @property
    def share_elsewhere(self) -> float:
        """Share of the recognised blocks that lie elsewhere; 0 if there are none."""
        return self.elsewhere / max(self.here + self.elsewhere, 1)


def block_votes(
    source: AlignedPhotograph, target: AlignedPhotograph, pose: DistortedPose
) -> _BlockVotes:
    """Look for every block of the coarser target with detail where a pose puts it."""
    factor = max(round(max(target.shape) / _VOTING_SIDE_PX), 1)
    found = _compared_at(source, target, pose, factor)
    if found is None:
        return _BlockVotes(here=0, elsewhere=0)
    ours, inside = found.ours * found.inside, found.inside & found.usable
    theirs = np.asarray(found.theirs * found.usable, dtype=np.float32)
    votes = {True: 0, False: 0}
    rows, cols = inside.shape
    for top in range(0, rows - _BLOCK_PX + 1, _BLOCK_PX // 2):
        for left in range(0, cols - _BLOCK_PX + 1, _BLOCK_PX // 2):
            block = np.s_[top : top + _BLOCK_PX, left : left + _BLOCK_PX]
            detail = float(np.mean(theirs[block] ** 2))
            if inside[block].mean() < _LEAST_SHARE or detail < _LEAST_DETAIL:
                continue
            is_here = _is_here(ours, theirs[block], inside, (top, left))
            if is_here is not None:
                votes[is_here] += 1
    return _BlockVotes(here=votes[True], elsewhere=votes[False])


def _is_here(
    ours: Float32Array, block: Float32Array, inside: BoolArray, at: tuple[int, int]
) -> bool | None:
    """Whether a block lies at its place; None where it is recognised nowhere."""
    low = [max(along - _REACH_PX, 0) for along in at]
    window = np.s_[low[0] : at[0] + _BLOCK_PX + _REACH_PX, low[1] : at[1] + _BLOCK_PX + _REACH_PX]
    seen, area = np.ascontiguousarray(ours[window], dtype=np.float32), _BLOCK_PX**2
    square = _summed(seen**2)
    spread = np.sqrt(np.maximum(square, _LEAST_DETAIL / 2 * area) * float(np.sum(block**2)))
    correlation = np.asarray(cv2.matchTemplate(seen, block, cv2.TM_CCORR)) / spread
    shared = _summed(inside[window].astype(np.float32)) / area
    correlation = np.where(shared < _LEAST_SHARE, -1.0, correlation)
    row, col = np.unravel_index(int(np.argmax(correlation)), correlation.shape)
    best = float(correlation[row, col])
    if best < _RECOGNISED:
        return None
    y, x = (along - first for along, first in zip(at, low, strict=True))
    around = correlation[max(y - 1, 0) : y + 2, max(x - 1, 0) : x + 2]
    is_near = np.hypot(row - y, col - x) <= _PLACE_PX
    return bool(is_near or around.max() > _AS_WELL * best)


def _summed(values: Float32Array) -> FloatArray:
    """Sums over all blocks of an array."""
    ones = np.ones((_BLOCK_PX, _BLOCK_PX), dtype=np.float32)
    return np.asarray(cv2.matchTemplate(values, ones, cv2.TM_CCORR), dtype=np.float64)
