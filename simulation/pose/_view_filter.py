"""The prefilter of a whole view, and the noise that it passes.

The derivative of the warp, the lens and so the best prefilter change slowly over a frame: kernels
are computed at few nodes of a lattice over what is seen, checked between them, and interpolated.

``simulate_pose`` weights reference pixels, so the variance at a follow-up pixel is the sum of its
squared weights times their variances. That sum depends on the prefilter at the position and on
where the position is between the pixels. With ``G`` the prefilter's transfer function, which is
periodic, and ``B`` that of the sampling kernel, it is a short Fourier series in the position x,
``sum_m cos(2 pi m x) integral of G(f)^2 B(f) B(m - f) df``, because ``B`` is almost zero beyond
1.5 cycles per pixel.
"""

from dataclasses import dataclass, field
from functools import lru_cache
from math import ceil, sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RectBivariateSpline, RegularGridInterpolator
from scipy.ndimage import binary_dilation

from simulation.arrays import FloatArray
from simulation.choices import PoseModel
from simulation.pose._prefilter import (
    SAMPLING_KERNELS,
    LocalPose,
    SamplingKernel,
    kernel_transfer,
    prefilter,
)
from simulation.pose._varying_filter import VaryingFilter, image_rms, separable_terms
from simulation.pose._warp import BORDER_PX, derivatives
from simulation.pose.view import (
    DEFAULT_OPTIONS,
    PoseOptions,
    PoseView,
    poses_at_followup,
    poses_at_reference,
)
from simulation.psf import Psf, PsfField

_RADII_PX = (8, 12, 16, 20, 24)
"""Half-widths of solved kernels: the compiled filter takes eight taps at a time, and one."""

_EXCESSES, _ONE_EXCESSES = (2e-6,), (2e-8, 2e-7)
"""Mean squared error, over the scene's variance, for which a wider kernel is taken: 0.007 DN^2
where the scene's standard deviation is 60 DN. An affine map needs so few terms that it has a
tighter limit, and where no kernel reaches that, as with a lens, another one."""

_BLUR_SIGMAS, _SPLINE_REACH_PX = 4.5, 4
"""A Gaussian is below 1e-4 of its peak there, and the spline's inverse below 3 %."""

_SHARP_PX2, _SHARP_RADIUS_PX = 0.15, 16
"""With less blur than this the spline's inverse has its whole length, 4e-5 at 12 px, and the edge
of the band at the Nyquist frequency shows."""

_BLUR_MAX_PX = 32.0
"""Widest blur; its kernel has 297 x 297 taps."""

_TERMS_TOLERANCE, _ONE_TERMS_TOLERANCE = 7e-4, 1e-4
"""Error that the separable terms leave, over the image's standard deviation: 0.04 DN of 60. An
affine map needs so few terms that it has the tighter limit."""

_NODES_TOLERANCE = 1e-3
"""Largest error at the middles of cells, that of the terms included."""

_NODES = (3, 5, 9)
"""Nodes along either axis; the last is for views that come near the horizon."""

_PIECES = 8
"""Straight lines by which the weights, cubic over the nodes, cross a cell."""

_ALIKE = 2e-6
"""Derivatives that differ by less belong to one affine map."""

_SURVEY_POINTS = 33
"""Positions per axis of the follow-up at which it is found what a view shows."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _Seen:
    """What a view shows: reference coordinates, and the largest stretch of the warp there."""

    top_px: float
    bottom_px: float
    left_px: float
    right_px: float
    largest: float

    @classmethod
    def of(cls, view: PoseView) -> "_Seen":
        """Survey a view; of one that shows nothing, the nearest part of the reference."""
        rows, cols = (
            np.linspace(-0.5, size - 0.5, min(size + 1, _SURVEY_POINTS)) for size in view.follow_up
        )
        x, y = np.meshgrid(cols, rows)
        points = np.stack([x.ravel(), y.ravel()], axis=-1)
        positions, slopes = derivatives(view.matrix, view.lens, points)
        ends = np.array([view.reference[1] - 1, view.reference[0] - 1])
        off_centre = np.abs(positions - ends / 2) - ends / 2
        inside = np.asarray(off_centre.max(axis=1) <= BORDER_PX)
        if not inside.any():
            inside = np.ones_like(inside)
        # The reference's border may be between two positions.
        around = binary_dilation(inside.reshape(x.shape), np.ones((3, 3), dtype=np.bool_)).ravel()
        left, top = np.clip(positions[around].min(axis=0), 0, ends)
        right, bottom = np.clip(positions[around].max(axis=0), 0, ends)
        return cls(
            top_px=float(top),
            bottom_px=float(bottom),
            left_px=float(left),
            right_px=float(right),
            largest=float(np.linalg.norm(slopes[inside], 2, axis=(1, 2)).max()),
        )


@dataclass(frozen=True, slots=True)
class _Request:
    """What decides the terms of a view, for the cache."""

    poses: tuple[LocalPose, ...]
    model: PoseModel
    noise_ratio: float
    radius: int


@dataclass(frozen=True, slots=True)
class ViewRequest:
    """A view with what decides its filter, for the cache."""

    key: tuple[object, ...]
    model: PoseModel
    noise_ratio: float
    view: PoseView = field(compare=False)

    @classmethod
    def of(cls, view: PoseView, options: PoseOptions) -> "ViewRequest":
        """Take what is decided by the options, too."""
        return cls(view.key, options.model_of(view), options.noise_ratio, view)


@lru_cache(maxsize=16)
def view_filter(request: ViewRequest) -> VaryingFilter:
    """Prefilter of a view, with model and noise as for ``prefilter``; refused if it is too wide."""
    view, model, noise_ratio = request.view, request.model, request.noise_ratio
    seen = _Seen.of(view)
    poses = _poses(view, seen, _places(seen, 3))
    radius = kernel_radius(poses, model, noise_ratio)
    if _is_one(poses):
        columns, rows, weights = _terms(_Request(poses[:1], model, noise_ratio, radius))
        one = np.zeros(1)
        return VaryingFilter(
            along_y=columns,
            along_x=rows,
            weights=weights.T[:, :, None],
            rows_px=one,
            cols_px=one,
        )
    for count in _NODES:
        places = _places(seen, count)
        poses = _poses(view, seen, places)
        made = _between_nodes(places, _terms(_Request(poses, model, noise_ratio, radius)))
        if count == _NODES[-1]:
            break
        middles = [(axis[:-1] + axis[1:])[[0, (count - 1) // 2, -1]] / 2 for axis in places]
        between = _poses(view, seen, (middles[0], middles[1]))
        wanted = [prefilter(pose, model, noise_ratio, radius).kernel for pose in between]
        error = np.stack(wanted) - made.kernels(middles[0], middles[1])
        if image_rms(error).max() <= _NODES_TOLERANCE:
            break
    return made


def _view_radius(view: PoseView, model: PoseModel, noise_ratio: float) -> int:
    """Half-width of the kernels of ``view_filter``; the parameters and errors are the same."""
    seen = _Seen.of(view)
    return kernel_radius(_poses(view, seen, _places(seen, 3)), model, noise_ratio)


def kernel_radius(poses: tuple[LocalPose, ...], model: PoseModel, noise_ratio: float) -> int:
    missing_px2 = np.array([_missing_px2(pose) for pose in poses])
    widest_px = sqrt(max(0.0, float(missing_px2.max())))
    if widest_px > _BLUR_MAX_PX:
        raise ValueError(f"a local blur of {widest_px:.3g} px is wider than {_BLUR_MAX_PX:g} px")
    least = _SHARP_RADIUS_PX if missing_px2.min() < _SHARP_PX2 else 0
    for limit in _ONE_EXCESSES if _is_one(poses) else _EXCESSES:
        for radius in _RADII_PX:
            if radius < least:
                continue
            if all(prefilter(pose, model, noise_ratio, radius).excess <= limit for pose in poses):
                return radius
    widest = 4 * ceil((_BLUR_SIGMAS * widest_px + _SPLINE_REACH_PX) / 4)
    return max(widest, _RADII_PX[-1])


def _missing_px2(pose: LocalPose) -> FloatArray:
    """Least and largest variance that the reference's blur lacks."""
    slopes = np.reshape(pose.slopes, (2, 2))
    missing = slopes @ pose.far.covariance_px2 @ slopes.T - pose.near.covariance_px2
    return np.asarray(np.linalg.eigvalsh(missing))


def _is_one(poses: tuple[LocalPose, ...]) -> bool:
    first = poses[0]
    return all(
        pose.near == first.near
        and pose.far == first.far
        and max(abs(a - b) for a, b in zip(pose.slopes, first.slopes, strict=True)) < _ALIKE
        for pose in poses
    )


def _places(seen: _Seen, count: int) -> tuple[FloatArray, FloatArray]:
    return (
        np.linspace(seen.top_px, max(seen.bottom_px, seen.top_px + 1), count),
        np.linspace(seen.left_px, max(seen.right_px, seen.left_px + 1), count),
    )


def _poses(
    view: PoseView, seen: _Seen, places: tuple[FloatArray, FloatArray]
) -> tuple[LocalPose, ...]:
    """Local poses at the nodes of a lattice (rows, cols), row by row."""
    x, y = np.meshgrid(places[1], places[0])
    return poses_at_reference(view, np.stack([x.ravel(), y.ravel()], axis=-1), seen.largest)


@lru_cache(maxsize=32)
def _terms(request: _Request) -> tuple[FloatArray, FloatArray, FloatArray]:
    kernels = [
        prefilter(pose, request.model, request.noise_ratio, request.radius).kernel
        for pose in request.poses
    ]
    tolerance = _TERMS_TOLERANCE if len(kernels) > 1 else _ONE_TERMS_TOLERANCE
    return separable_terms(np.stack(kernels), tolerance)


def _between_nodes(
    places: tuple[FloatArray, FloatArray], terms: tuple[FloatArray, FloatArray, FloatArray]
) -> VaryingFilter:
    """Filter whose weights are cubic over the nodes, in straight lines."""
    columns, rows, weights = terms
    count = len(places[0])
    fine = [np.linspace(axis[0], axis[-1], (count - 1) * _PIECES + 1) for axis in places]
    degree = min(3, count - 1)
    maps = np.stack(
        [
            RectBivariateSpline(
                places[0], places[1], weight.reshape(count, count), kx=degree, ky=degree
            )(fine[0], fine[1])
            for weight in weights.T
        ]
    )
    # Interpolation is linear in the nodes' values, so that the kernels' sums stay 1.
    return VaryingFilter(
        along_y=columns, along_x=rows, weights=maps, rows_px=fine[0], cols_px=fine[1]
    )


_POINTS = 9
"""Positions per axis at which the squares are summed; cubic between."""

ORDERS = ((0, 0), (1, 0), (0, 1), (1, 1), (1, -1))
"""Orders (x, y) of the series; every one but the first represents its opposite too."""


def pose_noise_gain(
    homography: NDArray[np.floating[Any]],
    reference: tuple[int, int],
    size: tuple[int, int],
    psf: Psf | PsfField | None,
    options: PoseOptions = DEFAULT_OPTIONS,
) -> FloatArray:
    """Variance of the simulated follow-up, ``(height, width)``, if each reference pixel's is 1.

    ``reference`` is ``(rows, cols)``, the rest as in ``simulate_pose``. At most about 1; 1 where
    the follow-up takes a reference pixel as it is. Pixels mirrored beyond the reference's border
    count like others.
    """
    view = PoseView.of(homography, reference, size, psf, options.origin_px, options.distortion_k1)
    lattice = [np.linspace(0.0, max(count - 1, 1), _POINTS) for count in view.follow_up]
    x, y = np.meshgrid(lattice[1], lattice[0])
    poses = poses_at_followup(view, np.stack([x.ravel(), y.ravel()], axis=-1))
    model, noise_ratio = options.model_of(view), options.noise_ratio
    radius = _view_radius(view, model, noise_ratio)
    kernels = [prefilter(pose, model, noise_ratio, radius).kernel for pose in poses]
    sampling = SAMPLING_KERNELS[model]
    series = np.stack([squares_series(kernel, sampling) for kernel in kernels]).reshape(
        _POINTS, _POINTS, -1
    )
    height, width = view.follow_up
    along_series = RegularGridInterpolator((lattice[0], lattice[1]), series, method="cubic")
    gain = np.empty((height, width))
    cols = np.arange(width, dtype=np.float64)
    for row in range(height):
        x, y = view.survey(np.array([float(row)]), cols)[0, :, :2].T
        terms = along_series(np.column_stack([np.full(width, float(row)), cols]))
        waves = [np.cos(2 * np.pi * (m * x + n * y)) for m, n in ORDERS[1:]]
        gain[row] = terms[:, 0] + 2 * np.sum(terms[:, 1:].T * waves, axis=0)
    return gain


def squares_series(kernel: FloatArray, sampling: SamplingKernel) -> FloatArray:
    """Coefficients of ``ORDERS`` for a prefilter: its squared weights, by the position."""
    period = 2 * len(kernel)
    square = kernel_transfer(kernel, period) ** 2
    # Columns inside the half plane stand for two frequencies each.
    square[:, 1:-1] *= 2
    fy: FloatArray = np.fft.fftfreq(period).astype(np.float64)
    fx: FloatArray = np.fft.rfftfreq(period).astype(np.float64)
    return (
        np.array(
            [_product(sampling, fy, n) @ square @ _product(sampling, fx, m) for m, n in ORDERS]
        )
        / period**2
    )


def _product(kernel: SamplingKernel, freq: FloatArray, order: int) -> FloatArray:
    """Sum of ``B(f) B(order - f)`` over the aliases of f."""
    alias = freq + np.arange(-3, 4.0)[:, None]
    return np.asarray((kernel.transfer(alias) * kernel.transfer(order - alias)).sum(axis=0))
