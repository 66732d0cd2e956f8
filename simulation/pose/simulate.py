"""The image that a camera would take of the same plane from another pose.

Model ``matched`` for a homography (tilt, rotation, perspective): at every follow-up pixel the
reference is blurred by what its PSF lacks there, ``A Sigma A^T - Sigma`` with A the derivative of
the homography, and the quintic spline through the result is point-sampled. The theory is in
``docs/theory-pose.md``.
"""

from dataclasses import dataclass
from math import ceil, sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation

from simulation.arrays import AnyArray, BoolArray, FloatArray, FloatImage
from simulation.pose.view import PoseView
from simulation.pose.warped_blur import BORDER_PX, SplineWindow, render
from simulation.psf import GaussianPsf, PsfField
from simulation.resampling import (
    BlurCovariance,
    SplineGaussianTable,
    apply_separable,
    blur_at,
    matched_terms,
    reference_shape,
    refuse_non_finite,
    spline_gaussian,
)

_TILE_PX = 512
"""Side of the follow-up's tiles: each needs a few MB of memory."""

_SURVEY_POINTS = 65
"""Positions per axis at which the missing blur is surveyed beforehand."""

_BORDER_STEP_PX = 32
_BOW_PX = 1.0
"""Steps along a tile's border, and the bow by a lens in between, up to zoom 4 at 10 %; the margin
of the sampling is larger."""

_LEAST_HELD_PX2 = 0.02
"""A smaller common blur is left to the sampling."""

_LINE_SIGMAS = 4
"""Reach of the points that form a correlated blur."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SimulatedPose:
    """A simulated follow-up on its own pixel grid.

    Parameters
    ----------
    image
        Shape ``(rows, cols)`` or ``(rows, cols, channels)``, float32 or float64, finite; 0 where
        ``outside``.
    nearer
        Shape ``(rows, cols)``: the real follow-up is sharper than the reference there, in at
        least one direction, which no simulation can recover; False where ``outside``.
    outside
        Shape ``(rows, cols)``: the pixel looks past the reference, by more than half a pixel.
    """

    image: FloatImage
    nearer: BoolArray
    outside: BoolArray

    def __repr__(self) -> str:
        rows, cols = self.image.shape[:2]
        return (
            f"SimulatedPose({cols} x {rows} px, {self.outside.mean():.1%} outside the reference, "
            f"{self.nearer.mean():.1%} less sharp than it should be)"
        )


@dataclass(frozen=True, slots=True, eq=False)
class SharedBlur:
    """Division of the missing blur into one for the whole image and one for each position."""

    held_px2: FloatArray
    """Elements xx, xy, yy."""

    table: SplineGaussianTable
    margin_px: int


def simulate_pose(
    image: AnyArray,
    homography: NDArray[np.floating[Any]],
    size: tuple[int, int],
    psf: GaussianPsf | PsfField | None,
    *,
    origin_px: tuple[float, float] | None = None,
    distortion_k1: float = 0.0,
) -> SimulatedPose:
    """Image of the same plane from another pose of the same camera.

    Parameters
    ----------
    image
        Reference, shape ``(rows, cols)`` or ``(rows, cols, channels)``; uint8, uint16, float32 or
        float64; linear in light.
    homography
        Shape (3, 3): follow-up pixel ``(x, y, 1)`` to reference pixel, up to a factor; pixel
        centres at integers.
    size
        ``(width, height)`` of the follow-up.
    psf
        Total PSF (optics and pixel) of the camera. A field is evaluated at each image's own
        pixel: the reference's for the reference, the follow-up's for the follow-up.
    origin_px
        Position ``(x, y)`` of the follow-up's pixel (0, 0) in the camera's frame, if the
        follow-up is a part of that frame; by default it is the whole frame. It matters only for
        a field and a distortion.
    distortion_k1
        Radial distortion of the lens that took both: an ideal point at the radius r from the
        reference's centre, 1 at its corner, is seen at ``r (1 + k1 r^2)``. The homography is then
        that of the ideal points.

    Returns
    -------
    SimulatedPose
        In the input's units; float64 for float64 input, else float32.

    Raises
    ------
    ValueError
        If the homography is not finite, singular or puts its horizon inside the follow-up's frame;
        if the follow-up shows nothing of the reference; if the image is of another kind or not
        finite; if the PSF is missing or a field belongs to another frame; if no lens has such a
        distortion; if the follow-up needs too wide a blur.
    """
    view = PoseView.of(homography, reference_shape(image), size, psf, origin_px, distortion_k1)
    height, width = view.follow_up
    shares = shared_blur(view)
    dtype = np.dtype(np.float64 if image.dtype == np.float64 else np.float32)
    planes = image[:, :, None] if image.ndim == 2 else image
    refuse_non_finite(image)
    result = np.zeros((planes.shape[2], height, width), dtype=dtype)
    nearer = np.zeros((height, width), dtype=np.bool_)
    outside = np.ones((height, width), dtype=np.bool_)
    for top in range(0, height, _TILE_PX):
        for left in range(0, width, _TILE_PX):
            tile = np.s_[top : top + _TILE_PX, left : left + _TILE_PX]
            seen = _seen(view, (top, left), nearer[tile].shape)
            if seen is None:
                continue
            for channel in range(planes.shape[2]):
                spline = _spline_window(planes[:, :, channel], seen, shares, dtype)
                made = render(view.warp, spline, shares.table, (top, left), nearer[tile].shape)
                result[channel][tile], nearer[tile], outside[tile] = made
    if outside.all():
        raise ValueError("the follow-up shows nothing of the reference")
    pixels = result[0] if image.ndim == 2 else np.ascontiguousarray(np.moveaxis(result, 0, -1))
    return SimulatedPose(image=pixels, nearer=nearer, outside=outside)


def shared_blur(view: PoseView) -> SharedBlur:
    """Find the largest blur that every position needs, and the widest rest."""
    rows, cols = (np.unique(np.linspace(0, n - 1, min(n, _SURVEY_POINTS))) for n in view.follow_up)
    seen = view.survey(rows, cols)
    x, y = seen[..., 0], seen[..., 1]
    inside = (
        (x >= -BORDER_PX)
        & (x <= view.reference[1] - 1 + BORDER_PX)
        & (y >= -BORDER_PX)
        & (y <= view.reference[0] - 1 + BORDER_PX)
    )
    # The reference's border may be between two positions.
    counted = np.asarray(binary_dilation(inside, np.ones((3, 3), dtype=np.bool_)))
    blurs: FloatArray = seen.reshape(-1, 5)[counted.ravel(), 2:]
    if len(blurs) == 0:
        blurs = np.zeros((1, 3))
    held = _common_blur(blurs)
    rest = blurs - held
    sigma_px = 1.05 * sqrt(max(float(rest[:, [0, 2]].max()), 0.0))
    table = spline_gaussian(sigma_px)
    return SharedBlur(held, table, table.weights.shape[2] // 2 + ceil(_LINE_SIGMAS * sigma_px) + 2)


def _common_blur(blurs_px2: FloatArray) -> FloatArray:
    """Largest multiple of the mean blur that leaves no position a negative rest; (xx, xy, yy)."""
    mean = blurs_px2.mean(axis=0)
    xx, xy, yy = mean
    if not (xx > 0 and xx * yy - xy * xy > 0):
        return np.zeros(3)
    # Least eigenvalue of inverse(mean) blur: both are 2 x 2.
    determinant = xx * yy - xy * xy
    trace = (yy * blurs_px2[:, 0] - 2 * xy * blurs_px2[:, 1] + xx * blurs_px2[:, 2]) / determinant
    product = (blurs_px2[:, 0] * blurs_px2[:, 2] - blurs_px2[:, 1] ** 2) / determinant
    least = (trace / 2 - np.sqrt(np.maximum(trace**2 / 4 - product, 0.0))).min()
    share = 1.0 if least > 1 - 1e-6 else float(least)
    if share * max(xx, yy) < _LEAST_HELD_PX2:
        return np.zeros(3)
    return np.asarray(share * mean)


def _spline_window(
    image: AnyArray,
    seen: tuple[int, int, int, int],
    shares: SharedBlur,
    dtype: np.dtype[Any],
) -> SplineWindow:
    """Spline through the commonly blurred pixels around a window, its ends included.

    The margin that the sampling reaches into is mirrored at the image's edge.
    """
    top, bottom, left, right = seen
    margin = shares.margin_px
    rows = np.arange(top - margin, bottom + margin + 1)
    cols = np.arange(left - margin, right + margin + 1)
    size = (image.shape[0], image.shape[1])
    xx, xy, yy = shares.held_px2.tolist()
    total: FloatImage | None = None
    for kernel in matched_terms(BlurCovariance(yy_px2=yy, xx_px2=xx, xy_px2=xy)):
        along_y, used_rows = blur_at(rows, kernel.along_y, size[0])
        along_x, used_cols = blur_at(cols, kernel.along_x, size[1])
        part = apply_separable(along_y, along_x, image[used_rows, used_cols].astype(dtype))
        total = part if total is None else np.add(total, part, out=total)
    assert total is not None
    return SplineWindow(total, (top - margin, left - margin), (xx, xy, yy), size)


def _seen(
    view: PoseView, first: tuple[int, int], shape: tuple[int, int]
) -> tuple[int, int, int, int] | None:
    """Reference pixels around what a tile sees: top, bottom, left, right, or None."""
    rows, cols = (
        np.linspace(start, start + count - 1, max(2, ceil((count - 1) / _BORDER_STEP_PX) + 1))
        for start, count in zip(first, shape, strict=True)
    )
    # Without the horizon in the frame, the inside of the tile is inside its warped border.
    border = [view.survey(rows[[0, -1]], cols), view.survey(rows, cols[[0, -1]])]
    x, y = np.concatenate([points[..., :2].reshape(-1, 2) for points in border]).T
    # A homography keeps the border's lines straight; a lens bows them.
    bow_px = 0.0 if view.lens[0] == 0 else _BOW_PX
    bounds = []
    for coordinate, size in ((y, view.reference[0]), (x, view.reference[1])):
        low, high = coordinate.min() - bow_px, coordinate.max() + bow_px
        if high < -BORDER_PX or low > size - 1 + BORDER_PX:
            return None
        bounds += [max(int(np.floor(low)), -1), min(int(np.ceil(high)), size)]
    return bounds[0], bounds[1], bounds[2], bounds[3]
