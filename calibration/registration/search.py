"""Poses found without features: every zoom and turn tried, every shift correlated.

For scenes without corners or blobs, or so noisy that none is found twice. Both photographs are
reduced to thumbnails; where they agree best over a large overlap is worth a refinement.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from math import atan2, cos, pi, sin

import cv2
import numpy as np
import scipy.fft

from calibration.registration.dense import AlignedPhotograph, locally_normalised
from calibration.registration.hypotheses import PoseHypothesis
from simulation.arrays import Float32Array, FloatArray

_LONG_SIDE_PX = 64
_WINDOW_PX = 15
_TURN_STEP_RAD = pi / 18
_ZOOM_STEP = 0.13
"""Of the log zoom: at the thumbnail's edge neither step moves a detail by more than its size."""

_ZOOM_RANGE = (0.4, 2.8)
_OVERLAP_LEAST = 0.2
"""Of the smaller of the two views."""

_FOUND = 8


@dataclass(frozen=True, slots=True, eq=False)
class _Thumbnail:
    """Normalised levels and which count; ``factor`` photograph pixels to one."""

    levels: Float32Array
    counted: Float32Array
    factor: float

    def to_photograph(self) -> FloatArray:
        """Thumbnail pixel ``(x, y, 1)`` to photograph pixel."""
        aside = (self.factor - 1) / 2
        return np.array([[self.factor, 0, aside], [0, self.factor, aside], [0, 0, 1.0]])


def searched_poses(
    reference: AlignedPhotograph, followup: AlignedPhotograph, zoom: float | None
) -> Iterator[PoseHypothesis]:
    """Similarities for which thumbnails agree best, the best first.

    Parameters
    ----------
    reference, followup
        The photographs.
    zoom
        Expected ratio of distances, follow-up over reference; None tries 0.4 to 2.8.
    """
    low, high = _ZOOM_RANGE if zoom is None else (zoom * 0.85, zoom * 1.18)
    zooms = np.exp(np.arange(np.log(low), np.log(high) + _ZOOM_STEP, _ZOOM_STEP))
    near = _thumbnail(reference, _LONG_SIDE_PX)
    found: list[tuple[float, FloatArray]] = []
    for one in zooms.tolist():
        # The follow-up's thumbnail has about the pixels that the reference shows of it.
        far = _thumbnail(followup, max(round(_LONG_SIDE_PX * min(one, 1.0)), 16))
        scale = one * far.factor / near.factor
        spectra = _Spectra(near, far, scale)
        turns = np.arange(0.0, 2 * pi, _TURN_STEP_RAD).tolist()
        found += [spectra.best_shift(turn) for turn in turns]
        found.sort(key=lambda pair: -pair[0])
        del found[4 * _FOUND :]
    kept: list[FloatArray] = []
    for _, matrix in found:
        if not any(_is_same(matrix, other) for other in kept):
            kept.append(matrix)
        if len(kept) == _FOUND:
            break
    for matrix in kept:
        yield PoseHypothesis(matrix=matrix)


def _thumbnail(photograph: AlignedPhotograph, long_side_px: int) -> _Thumbnail:
    rows, cols = photograph.shape
    factor = max(max(rows, cols) / long_side_px, 1.0)
    # Blurred before it is sampled.
    coarse = photograph.reduced(max(int(factor / 2), 1))
    rest = factor / max(int(factor / 2), 1)
    blurred = coarse.smoothed(0.5 * rest, 0.5 * rest)
    matrix = np.array([[rest, 0, (rest - 1) / 2], [0, rest, (rest - 1) / 2]])
    size = (int(coarse.shape[1] / rest), int(coarse.shape[0] / rest))
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    levels = np.asarray(cv2.warpAffine(blurred.levels, matrix, size, flags=flags), dtype=np.float32)
    counted = np.ones(levels.shape, dtype=np.bool_)
    if blurred.usable is not None:
        share = cv2.warpAffine(blurred.usable.astype(np.float32), matrix, size, flags=flags)
        counted = np.asarray(share > 0.9)
    return _Thumbnail(
        locally_normalised(levels, counted, _WINDOW_PX), counted.astype(np.float32), factor
    )


class _Spectra:
    """The reference's thumbnail and a follow-up's, to be correlated at one turn after another.

    ``scale`` pixels of the reference's thumbnail to one of the follow-up's.
    """

    def __init__(self, near: _Thumbnail, far: _Thumbnail, scale: float) -> None:
        self._near, self._far, self._scale = near, far, scale
        self._side = int(np.hypot(*far.levels.shape) * scale) + 2
        self._size = scipy.fft.next_fast_len(self._side + max(near.levels.shape), real=True)
        self._levels = self._spectrum(near.levels)
        self._squares = self._spectrum(np.square(near.levels))
        self._counted = self._spectrum(near.counted)

    def best_shift(self, turn: float) -> tuple[float, FloatArray]:
        """Evidence and matrix, follow-up to reference photograph, of the best shift."""
        far = self._far
        rows, cols = far.levels.shape
        middle, own = self._side / 2, np.array([(cols - 1) / 2, (rows - 1) / 2])
        linear = self._scale * np.array([[cos(turn), -sin(turn)], [sin(turn), cos(turn)]])
        matrix = np.column_stack([linear, middle - linear @ own])
        size = (self._side, self._side)
        levels = np.asarray(cv2.warpAffine(far.levels, matrix, size), dtype=np.float32)
        counted = np.asarray(cv2.warpAffine(far.counted, matrix, size) > 0.9, dtype=np.float32)
        levels *= counted
        mask = np.conj(self._spectrum(counted))
        number = self._inverse(mask * self._counted)
        product = self._inverse(np.conj(self._spectrum(levels)) * self._levels)
        ours = self._inverse(np.conj(self._spectrum(np.square(levels))) * self._counted)
        theirs = self._inverse(mask * self._squares)
        least = _OVERLAP_LEAST * min(float(counted.sum()), float(self._near.counted.sum()))
        square = np.where(
            (number > least) & (product > 0), product**2 / np.maximum(ours * theirs, 1e-6), 0.0
        )
        evidence = -0.5 * number * np.log(1 - np.minimum(square, 0.999))
        best = int(np.argmax(evidence))
        shift_y, shift_x = (
            at if at < self._size - self._side else at - self._size
            for at in np.unravel_index(best, evidence.shape)
        )
        whole = np.vstack([matrix, [0, 0, 1.0]])
        whole[:2, 2] += shift_x, shift_y
        back = np.asarray(np.linalg.inv(far.to_photograph()))
        return float(evidence.flat[best]), self._near.to_photograph() @ whole @ back

    def _spectrum(self, values: Float32Array) -> FloatArray:
        return np.asarray(scipy.fft.rfft2(values, s=(self._size, self._size)))

    def _inverse(self, series: FloatArray) -> Float32Array:
        return np.asarray(scipy.fft.irfft2(series, s=(self._size, self._size)))


def _is_same(one: FloatArray, other: FloatArray) -> bool:
    """Whether two similarities are neighbours among those tried."""
    ours, theirs = (complex(matrix[0, 0], matrix[1, 0]) for matrix in (one, other))
    ratio = ours / theirs
    turned = abs(atan2(ratio.imag, ratio.real))
    return turned < 1.5 * _TURN_STEP_RAD and abs(np.log(abs(ratio))) < 1.5 * _ZOOM_STEP
