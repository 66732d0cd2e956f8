"""The image that a camera would take of the same plane from another pose.

For any homography (tilt, rotation, perspective), lens distortion and PSF the reference is filtered
by a kernel that varies over it, and sampled once by a piecewise polynomial. The theory is in
``docs/theory-pose.md``. Two models choose both:

``matched``
    The ratio of the two transfer functions, up to the Nyquist frequency, then a quintic spline.
``lmmse``
    The least mean squared error for scenes with a first-order covariance, aliases included.
"""

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from math import ceil
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
from numpy.typing import NDArray

from simulation.arrays import AnyArray, BoolArray, FloatImage
from simulation.by_value import ByValue
from simulation.notebook import Shown
from simulation.pose.aligned import keeps_axes, render_aligned
from simulation.pose.options import DEFAULT_OPTIONS, PoseOptions
from simulation.pose.sampling import (
    BORDER_PX,
    REACH_AFTER_PX,
    REACH_BEFORE_PX,
    Canvas,
    CoefficientWindow,
    render,
)
from simulation.pose.sampling_kernel import SAMPLING_KERNELS
from simulation.pose.six_by_six import weight_table
from simulation.pose.varying_filter import VaryingFilter
from simulation.pose.view import PoseView
from simulation.pose.view_filter import view_filter
from simulation.psf import Psf, PsfField
from simulation.resampling import reference_shape, refuse_non_finite

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_TILE_PX = 1024
"""Side of the follow-up's tiles: at zoom 1.5 each needs 20 MB of memory in float32."""

_BORDER_STEP_PX = 32
_BOW_PX = 1.0
"""Steps along a tile's border, and the bow by a lens in between, up to zoom 4 at 10 %; the margin
of the sampling is larger."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class SimulatedPose(Shown, ByValue):
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

    def plot(self, ax: "Axes | None" = None) -> "Figure":
        """Return a figure of the follow-up, dark to bright, in its own pixels."""
        from simulation.figures import drawn  # matplotlib, for whoever looks

        shown = self.image.astype(np.float64)
        dark, bright = (
            np.percentile(shown[~self.outside], [0.1, 99.9]) if not self.outside.all() else (0, 1)
        )
        shown = np.clip((shown - dark) / max(bright - dark, 1e-9), 0.0, 1.0)

        def draw(axes: "Axes") -> None:
            axes.imshow(shown, cmap="gray", vmin=0.0, vmax=1.0)
            axes.set(xlabel="x / px", ylabel="y / px")

        rows, cols = shown.shape[:2]
        return drawn(draw, ax, (6.4, 6.4 * rows / cols + 0.6))


def simulate_pose(
    image: AnyArray,
    homography: NDArray[np.floating[Any]],
    size: tuple[int, int],
    psf: Psf | PsfField | None,
    options: PoseOptions = DEFAULT_OPTIONS,
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
    options
        Model, noise, threads, the follow-up's place in the frame, and the lens's distortion.

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
    view = PoseView.of(
        homography, reference_shape(image), size, psf, options.origin_px, options.distortion_k1
    )
    height, width = view.follow_up
    model = options.model_of(view)
    filtered = view_filter(view, model, options.noise_ratio)
    refuse_non_finite(image)
    dtype = np.dtype(np.float64 if image.dtype == np.float64 else np.float32)
    planes = image[:, :, None] if image.ndim == 2 else image
    result = np.zeros((planes.shape[2], height, width), dtype=dtype)
    table = weight_table(np.array(SAMPLING_KERNELS[model].pieces)).astype(dtype)
    nearer = np.zeros((height, width), dtype=np.bool_)
    outside = np.ones((height, width), dtype=np.bool_)
    is_aligned = keeps_axes(view)

    def make(tile: tuple[slice, slice]) -> None:
        first, shape = (tile[0].start, tile[1].start), nearer[tile].shape
        seen = _seen(view, first, shape)
        if seen is None:
            return
        for channel in range(planes.shape[2]):
            window = _window(planes[:, :, channel], seen, filtered, table)
            canvas = Canvas(result[channel], nearer, outside)
            if is_aligned:
                render_aligned(view, window, canvas, first, shape)
            else:
                render(view.warp, window, canvas, first, shape)

    if options.threads == 1:
        for tile in _tiles(height, width):
            make(tile)
    else:
        with ThreadPoolExecutor(options.threads) as pool:
            list(pool.map(make, _tiles(height, width)))
    if outside.all():
        raise ValueError("the follow-up shows nothing of the reference")
    pixels = result[0] if image.ndim == 2 else np.ascontiguousarray(np.moveaxis(result, 0, -1))
    return SimulatedPose(image=pixels, nearer=nearer, outside=outside)


def _tiles(height: int, width: int) -> Iterator[tuple[slice, slice]]:
    for top in range(0, height, _TILE_PX):
        for left in range(0, width, _TILE_PX):
            yield slice(top, top + _TILE_PX), slice(left, left + _TILE_PX)


def _window(
    image: AnyArray, seen: tuple[int, int, int, int], filtered: VaryingFilter, table: FloatImage
) -> CoefficientWindow:
    """Coefficients around a window, its ends included; mirrored at the image's edge."""
    top, bottom, left, right = seen
    before, after = REACH_BEFORE_PX + filtered.radius, REACH_AFTER_PX + filtered.radius
    rows, cols = image.shape
    inside = image[
        max(top - before, 0) : bottom + after + 1, max(left - before, 0) : right + after + 1
    ]
    window = cv2.copyMakeBorder(
        np.ascontiguousarray(inside, table.dtype),
        max(before - top, 0),
        max(bottom + after + 1 - rows, 0),
        max(before - left, 0),
        max(right + after + 1 - cols, 0),
        cv2.BORDER_REFLECT,
    )
    origin = (top - REACH_BEFORE_PX, left - REACH_BEFORE_PX)
    coefficients = filtered.apply(np.asarray(window), origin)
    return CoefficientWindow(coefficients, origin, image.shape[:2], table)


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
