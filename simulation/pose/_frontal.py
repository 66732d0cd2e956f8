"""A view along the reference's axes, as a plain zoom is: filter and sampling at once, separably.

A term of the filter and the sampling are one banded matrix along either axis, so that only the
pixels of the follow-up are computed, of which there are fewer than of the filtered reference. The
terms' weights are those at the follow-up's pixels.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from simulation.arrays import AnyArray, BoolArray, FloatArray, FloatImage
from simulation.pose._prefilter import SAMPLING_KERNELS, SamplingKernel
from simulation.pose._varying_filter import cells, interpolated
from simulation.pose._view_filter import ViewRequest, view_filter
from simulation.pose._warp import BORDER_PX, NEARER_TOLERANCE_PX2
from simulation.pose.view import PoseView
from simulation.resampling import BandedMatrix, TermWeights, mirrored_rows, put_separable

_STEP_PX, _STEPS = 32, 16
"""Longest step between the pixels at which it is found which image is the sharper; fewest steps."""

_DOUBT = 2.0
"""Changes of the least eigenvalue over a cell within which its sign is not that of the corners."""


def keeps_axes(view: PoseView) -> bool:
    """Whether a view's rows and columns are those of the reference, at other distances."""
    matrix = view.matrix
    others = matrix[0, 1], matrix[1, 0], matrix[2, 0], matrix[2, 1]
    return bool(view.lens[0] == 0 and not any(others))


def shown_px(view: PoseView, axis: int) -> tuple[slice, FloatArray]:
    """Rows (axis 1) or columns (0) of the follow-up that see the reference, and where they do."""
    matrix = view.matrix / view.matrix[2, 2]
    at_px = matrix[axis, axis] * np.arange(view.follow_up[1 - axis]) + matrix[axis, 2]
    inside = (at_px >= -BORDER_PX) & (at_px <= view.reference[1 - axis] - 1 + BORDER_PX)
    which = np.flatnonzero(inside)
    shown = slice(int(which[0]), int(which[-1]) + 1) if len(which) else slice(0, 0)
    return shown, at_px[shown]


@dataclass(frozen=True, slots=True, eq=False)
class FrontalFilter:
    """Matrices along y and x and weights, for the ``rows`` and ``cols`` that see the reference."""

    rows: slice
    cols: slice
    terms: tuple[tuple[BandedMatrix, BandedMatrix], ...]
    weights: TermWeights | None

    @property
    def shown(self) -> tuple[slice, slice]:
        """The part of the follow-up that sees the reference."""
        return self.rows, self.cols

    def put(self, image: AnyArray, out: FloatImage, threads: int) -> None:
        """Write what is seen of the reference to a follow-up, whose dtype is the filter's."""
        made = np.empty((self.terms[0][0].rows, self.terms[0][1].rows), out.dtype)
        put_separable(
            tuple((y, (x,)) for y, x in self.terms),
            image.astype(out.dtype, copy=False),
            made,
            weights=self.weights,
            threads=threads,
        )
        out[self.shown] = made


@lru_cache(maxsize=8)
def frontal_filter(request: ViewRequest, dtype: "np.dtype[np.floating]") -> FrontalFilter:
    """Filter and sampling of a view that `keeps_axes`, for images of a dtype; cached."""
    view, filtered = request.view, view_filter(request)
    kernel = SAMPLING_KERNELS[request.model]
    (rows, y_px), (cols, x_px) = (shown_px(view, axis) for axis in (1, 0))
    along_y, along_x = filtered.along_y, filtered.along_x
    weights = None
    if len(filtered.rows_px) == len(filtered.cols_px) == 1:
        along_y = along_y * filtered.weights[:, 0]
    else:
        node, part = cells(filtered.cols_px, x_px)
        values = interpolated(filtered.weights.swapaxes(1, 2), filtered.rows_px, y_px)
        weights = TermWeights(values.astype(dtype), node, part.astype(dtype))
    height, width = view.reference
    terms = tuple(
        (_sampling(y_px, own_y, kernel, height), _sampling(x_px, own_x, kernel, width))
        for own_y, own_x in zip(along_y, along_x, strict=True)
    )
    return FrontalFilter(rows, cols, terms, weights)


def _sampling(
    at_px: FloatArray, taps: FloatArray, kernel: SamplingKernel, count: int
) -> BandedMatrix:
    """Matrix from ``count`` pixels to the filtered image at positions among them, or mirrored."""
    before = np.floor(at_px)
    part, pieces = (at_px - before)[:, None], np.array(kernel.pieces).T
    of_six = np.hstack(
        [(part ** np.arange(6) @ pieces)[:, ::-1], (1 - part) ** np.arange(6) @ pieces]
    )
    weights = np.zeros((len(at_px), len(taps) + 5))
    for place, weight in enumerate(of_six.T):
        weights[:, place : place + len(taps)] += weight[:, None] * taps
    return mirrored_rows(before.astype(np.int64) - 2 - len(taps) // 2, weights, count)


def sure_nearer(view: PoseView) -> BoolArray | None:
    """Mask of the pixels that are sharper than the reference, or None if some are in doubt."""
    steps = [
        np.append(np.arange(0, size, min(_STEP_PX, size // _STEPS + 1)), size - 1.0)
        for size in view.follow_up
    ]
    xx, xy, yy = np.moveaxis(view.survey(*steps)[..., 2:], 2, 0)
    least = (xx + yy) / 2 - np.hypot((xx - yy) / 2, xy) + NEARER_TOLERANCE_PX2
    corners = np.stack([least[:-1, :-1], least[1:, :-1], least[:-1, 1:], least[1:, 1:]])
    change = corners.max(axis=0) - corners.min(axis=0)
    if np.any(np.abs(corners).min(axis=0) < _DOUBT * change):
        return None
    sizes = [np.diff(np.append(step[:-1], step[-1] + 1)).astype(np.int64) for step in steps]
    return np.repeat(np.repeat(corners[0] < 0, sizes[0], axis=0), sizes[1], axis=1)
