"""The PSF from two photographs of any textured scene at two distances, without an edge target.

Smooth corrections to the position and brightness of far pixels in a near photograph. A homography
leaves out the lens's distortion, and two photographs see the same point under different vignetting.
Both change slowly over the frame: a cubic displacement and a quartic gain are added to the
homography, found by Gauss-Newton from coarse to fine.

The blur kernel between a near photograph and a far one of the same scene. Delbracio, Almansa, Musé,
Morel: Subpixel point spread function estimation from two photographs at different distances. SIAM
J. Imaging Sciences 5 (2012) 1234-1260. With the near image interpolated at the positions of the far
pixels, the far image is linear in the kernel between them. Two things are added here: the near
image's own noise is removed from the normal equations (it would widen the kernel), and a model of
the kernel can be fitted to them just as to the pixels themselves.

The camera blurs both photographs equally in its own pixels. In near pixels, the far PSF is the same
PSF stretched by A = d near / d far, so that the kernel between the photographs has the covariance
``A Sigma A' - Sigma``, which is linear in Sigma. For a pure zoom-out z it is ``(z^2 - 1) Sigma``.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from math import ceil, sqrt
from typing import Final, Self

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline
from scipy.ndimage import distance_transform_edt, gaussian_filter, map_coordinates, spline_filter

from calibration.errors import PairError
from simulation.arrays import BoolArray, FloatArray

_DISPLACEMENT_DEGREE = 3
_GAIN_DEGREE = 4
_BLURS_PX = (6.0, 3.0, 1.5, 0.8, 0.8, 0.8)  # of the far image, level by level
_PSF_GUESS_PX = 0.7
_MARGIN_PX = 4.0
_LEAST_PIXELS = 2000
_CLIPPED_REACH_PX = 3.0
"""Distance from a clipped pixel, in far ones, that the blur of the finest level reaches."""

_FINE_PX = 1.5
"""Levels at which the correlation is looked at: the coarse ones leave little in small frames, the
finest more noise."""

_SLOW_PX = 8.0
"""Width beyond which what both photographs show is taken for their light."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ClippedPixels:
    """Pixels of the near and of the far photograph that are clipped, each of its own shape."""

    near: BoolArray
    far: BoolArray

    @classmethod
    def none(cls, near_shape: tuple[int, ...], far_shape: tuple[int, ...]) -> Self:
        """Nothing is clipped."""
        return cls(near=np.zeros(near_shape, dtype=bool), far=np.zeros(far_shape, dtype=bool))

    def away(self, y_px: FloatArray, x_px: FloatArray, reach_px: float, zoom: float) -> BoolArray:
        """Far pixels with no clipped one within reach in either photograph; near coordinates."""
        beside = _within(self.near, reach_px * zoom)
        rows, cols = (
            np.clip(np.rint(at), 0, most - 1).astype(np.intp)
            for at, most in zip((y_px, x_px), beside.shape, strict=True)
        )
        return np.asarray(~beside[rows, cols] & ~_within(self.far, reach_px))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _SmoothAlignment:
    """Near coordinates and gain of every far pixel, each in the shape of the far image.

    ``far(p) = gain(p) (blurred near)(y(p), x(p)) + offset``. ``jacobian``, shape (2, 2), is the
    mean of d(near x, near y) / d(far x, far y), ``correlation`` that of the aligned photographs.
    """

    y_px: FloatArray
    x_px: FloatArray
    gain: FloatArray
    jacobian: FloatArray
    correlation: float


def align_smoothly(
    near_dn: FloatArray,
    far_dn: FloatArray,
    far_to_near: FloatArray,
    clipped: ClippedPixels | None = None,
) -> _SmoothAlignment:
    """Refine a homography, right to a few px, by a smooth displacement and gain."""
    rows, cols = np.mgrid[: far_dn.shape[0], : far_dn.shape[1]].astype(np.float64)
    start_y, start_x = _projected(far_to_near, rows, cols)
    inside = _inside(start_y, start_x, near_dn.shape)
    if np.count_nonzero(inside) < _LEAST_PIXELS:
        raise PairError(
            "the two photographs hardly overlap: photograph the same scene in both",
            reason="little_overlap",
        )
    clipped = clipped or ClippedPixels.none(near_dn.shape, far_dn.shape)
    u, v = _normalised(cols, inside), _normalised(rows, inside)
    moves, gains = _monomials(u, v, _DISPLACEMENT_DEGREE), _monomials(u, v, _GAIN_DEGREE)
    zoom = sqrt(abs(float(np.linalg.det(_mean_jacobian(start_y, start_x, inside)))))
    move_x, move_y = np.zeros(len(moves)), np.zeros(len(moves))
    gain = np.zeros(len(gains))
    correlation = 0.0
    for blur in _BLURS_PX:
        x = start_x + np.tensordot(move_x, moves, axes=1)
        y = start_y + np.tensordot(move_y, moves, axes=1)
        used = inside & _inside(y, x, near_dn.shape)
        used &= clipped.away(y, x, _CLIPPED_REACH_PX, zoom)
        _refuse_too_few(used)
        own_px = sqrt((zoom * blur) ** 2 + _PSF_GUESS_PX**2 * (zoom**2 - 1))
        smooth = gaussian_filter(near_dn, own_px)
        slope_y, slope_x = _slopes(smooth)
        points = np.stack([y[used], x[used]])
        seen = map_coordinates(smooth, points, order=1)
        seen_y = map_coordinates(slope_y, points, order=1)
        seen_x = map_coordinates(slope_x, points, order=1)
        blurred = gaussian_filter(far_dn, blur)
        target = blurred[used]
        shapes, lights = moves[:, used], gains[:, used]
        brightness = 1.0 if not gain.any() else gain @ lights
        design = np.vstack([
            brightness * seen_x * shapes,
            brightness * seen_y * shapes,
            seen * lights,
            np.ones_like(seen)[None],
        ])  # fmt: skip
        normal = design @ design.T
        solution: FloatArray = np.asarray(np.linalg.lstsq(normal, design @ target)[0], np.float64)
        count = len(moves)
        move_x, move_y = move_x + solution[:count], move_y + solution[count : 2 * count]
        gain = solution[2 * count : -1]
        residual = solution @ design - target
        if blur <= _FINE_PX:
            correlation = max(correlation, _correlation(blurred, residual, used))
    x = start_x + np.tensordot(move_x, moves, axes=1)
    y = start_y + np.tensordot(move_y, moves, axes=1)
    seen_by_both = inside & _inside(y, x, near_dn.shape)
    return _SmoothAlignment(
        y_px=y,
        x_px=x,
        gain=np.tensordot(gain, gains, axes=1),
        jacobian=_mean_jacobian(y, x, seen_by_both),
        correlation=correlation,
    )


def _projected(
    far_to_near: FloatArray, y_px: FloatArray, x_px: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Near coordinates ``(y, x)`` of far ones."""
    x, y, scale = np.tensordot(far_to_near, np.stack([x_px, y_px, np.ones_like(x_px)]), axes=1)
    return y / scale, x / scale


def _refuse_too_few(used: BoolArray) -> None:
    if np.count_nonzero(used) < _LEAST_PIXELS:
        raise PairError(
            f"clipped pixels and their neighbours leave {np.count_nonzero(used)} pixels that both "
            f"photographs show, {_LEAST_PIXELS} are needed; shorten the exposure",
            reason="saturated",
        )


def _correlation(seen: FloatArray, residual: FloatArray, used: BoolArray) -> float:
    """Correlation of what is seen with what was fitted to it, without what is slow."""
    fitted, target = np.zeros((2, *seen.shape))
    target[used] = seen[used]
    fitted[used] = seen[used] + residual
    share = np.maximum(gaussian_filter(used.astype(np.float64), _SLOW_PX), 1e-9)
    fitted, target = (
        (image - gaussian_filter(image, _SLOW_PX) / share)[used] for image in (fitted, target)
    )
    power = float(np.sqrt(np.sum(fitted**2) * np.sum(target**2)))
    return float(fitted @ target) / power if power > 0 else 0.0


def _within(mask: BoolArray, reach_px: float) -> BoolArray:
    """Pixels so near to one of the mask."""
    if not mask.any():
        return mask
    return np.asarray(distance_transform_edt(~mask) <= reach_px)


def _inside(y: FloatArray, x: FloatArray, shape: tuple[int, ...]) -> BoolArray:
    within_y = (y >= _MARGIN_PX) & (y <= shape[0] - 1 - _MARGIN_PX)
    return np.asarray(within_y & (x >= _MARGIN_PX) & (x <= shape[1] - 1 - _MARGIN_PX))


def _normalised(coordinate: FloatArray, inside: BoolArray) -> FloatArray:
    low, high = float(coordinate[inside].min()), float(coordinate[inside].max())
    return np.asarray(2 * (coordinate - low) / max(high - low, 1.0) - 1)


def _monomials(u: FloatArray, v: FloatArray, degree: int) -> FloatArray:
    return np.stack([u**i * v**j for i in range(degree + 1) for j in range(degree + 1 - i)])


def _mean_jacobian(y: FloatArray, x: FloatArray, inside: BoolArray) -> FloatArray:
    (x_down, x_right), (y_down, y_right) = _slopes(x), _slopes(y)
    mean = [float(slope[inside].mean()) for slope in (x_right, x_down, y_right, y_down)]
    return np.array(mean).reshape(2, 2)


def _slopes(image: FloatArray) -> tuple[FloatArray, FloatArray]:
    down, right = np.gradient(image)
    return np.asarray(down), np.asarray(right)


_ORDER: Final = 5  # of the interpolating spline: flat to 1 % up to 0.85 of the Nyquist frequency
_TAPS = _ORDER + 1
_CHUNK = 2048
_MOST_PIXELS = 120_000
_PHASES = 32
_REACH = 24  # samples after which the cardinal spline is negligible


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _InterImageKernel:
    """Normal equations of the weights of the kernel between two photographs.

    ``far(p) = sum_q weights[r + q] near(H p + q) + offset``: the unknowns are the weights, row by
    row, and the offset; r is ``radius_px``, in near pixels. ``normal`` is without the near image's
    noise, so that it may be negative somewhere; ``noisy_normal`` is what the pixels give.
    """

    radius_px: int
    normal: FloatArray
    noisy_normal: FloatArray
    right: FloatArray
    squares: float
    pixels: int

    def squared_error(self, unknowns: FloatArray) -> float:
        """Sum of the squared differences at the far pixels, without the near image's noise."""
        return float(self.squares - 2 * self.right @ unknowns + unknowns @ self.normal @ unknowns)


def estimate_kernel(
    near_dn: FloatArray,
    far_dn: FloatArray,
    alignment: _SmoothAlignment,
    *,
    radius_px: int,
    near_noise_dn2: float = 0.0,
    clipped: ClippedPixels | None = None,
) -> _InterImageKernel:
    """Normal equations of the kernel from a near photograph to a far one.

    The kernel reaches ``radius_px`` near pixels and absorbs a remaining shift. The near noise is
    that of a pixel, 0 where it is not known.
    """
    points = _far_points(alignment, near_dn.shape, radius_px, clipped)
    unknowns = (2 * radius_px + 1) ** 2 + 1
    if len(points.rows) < 4 * unknowns:
        is_clipped = len(_far_points(alignment, near_dn.shape, radius_px, None).rows) > 4 * unknowns
        raise PairError(
            f"only {len(points.rows)} pixels of the far image are inside the near one"
            f"{' and away from clipped ones' if is_clipped else ''}, {4 * unknowns} are needed: "
            f"{'shorten the exposure' if is_clipped else 'photograph the same scene in both'}",
            reason="saturated" if is_clipped else "little_overlap",
        )
    # Means are subtracted to reduce rounding errors; the offset absorbs them.
    coefficients = spline_filter(near_dn - near_dn.mean(), order=_ORDER, mode="mirror")
    values = (far_dn / alignment.gain)[points.rows, points.cols]
    values = values - values.mean()
    normal, right = np.zeros((unknowns, unknowns)), np.zeros(unknowns)
    for start in range(0, len(values), _CHUNK):
        part = slice(start, start + _CHUNK)
        block = np.ones((len(values[part]), unknowns))
        block[:, :-1] = _samples(coefficients, points.y[part], points.x[part], radius_px)
        normal += block.T @ block
        right += block.T @ values[part]
    squares = float(values @ values)
    noisy = normal.copy()
    if near_noise_dn2 > 0:
        normal[:-1, :-1] -= near_noise_dn2 * len(values) * _noise_covariance(points, radius_px)
    return _InterImageKernel(
        radius_px=radius_px,
        normal=normal,
        noisy_normal=noisy,
        right=right,
        squares=squares,
        pixels=len(values),
    )


@dataclass(frozen=True, slots=True)
class _FarPoints:
    rows: NDArray[np.intp]
    cols: NDArray[np.intp]
    y: FloatArray
    x: FloatArray


def _far_points(
    alignment: _SmoothAlignment,
    near_shape: tuple[int, ...],
    radius_px: int,
    clipped: ClippedPixels | None,
) -> _FarPoints:
    """Far pixels whose kernel is inside the near image, unclipped, thinned evenly to a limit."""
    y, x = alignment.y_px, alignment.x_px
    margin = radius_px + _TAPS
    inside = (x >= margin) & (x <= near_shape[1] - 1 - margin)
    inside &= (y >= margin) & (y <= near_shape[0] - 1 - margin)
    if clipped is not None:
        # The weights in the corners of the kernel are next to nothing.
        inside &= clipped.away(y, x, 1.0, float(radius_px + 1))
    chosen = np.flatnonzero(inside)
    # A stride with no common factor with the rows spreads the pixels over the frame.
    chosen = chosen[:: max(1, -(-len(chosen) // _MOST_PIXELS))]
    rows, cols = np.unravel_index(chosen, inside.shape)
    return _FarPoints(rows=rows, cols=cols, y=y.ravel()[chosen], x=x.ravel()[chosen])


def _samples(coefficients: FloatArray, y: FloatArray, x: FloatArray, radius_px: int) -> FloatArray:
    """The near image at (y, x) plus every offset of the kernel, shape ``(n, (2 r + 1)^2)``."""
    width = 2 * radius_px + 1
    first_y = np.floor(y).astype(np.intp) - _TAPS // 2 + 1 - radius_px
    first_x = np.floor(x).astype(np.intp) - _TAPS // 2 + 1 - radius_px
    span = width + _TAPS - 1
    windows = np.lib.stride_tricks.sliding_window_view(coefficients, (span, span))
    patches = windows[first_y, first_x]
    taps_y, taps_x = _spline_taps(y - np.floor(y)), _spline_taps(x - np.floor(x))
    along = np.zeros((len(y), span, width))
    both = np.zeros((len(y), width, width))
    for t in range(_TAPS):
        along += taps_x[:, t, None, None] * patches[:, :, t : t + width]
    for t in range(_TAPS):
        both += taps_y[:, t, None, None] * along[:, t : t + width]
    return both.reshape(len(y), -1)


def _spline_taps(fraction: FloatArray) -> FloatArray:
    """Weights of the six B-spline coefficients around each position, shape ``(n, 6)``."""
    distance = fraction[:, None] - (np.arange(_TAPS) - _TAPS // 2 + 1)
    return np.asarray(_basis()(distance))


@cache
def _basis() -> BSpline:
    half = (_ORDER + 1) / 2
    return BSpline.basis_element(np.arange(_ORDER + 2) - half, extrapolate=False)


@cache
def _interpolated_noise() -> FloatArray:
    """Covariance of white noise interpolated at f and f + lag, by phase of f and by lag >= 0."""
    unit = np.zeros(2 * _REACH + 1)
    unit[_REACH] = 1.0
    coefficients = spline_filter(unit, order=_ORDER, mode="mirror")
    table = np.zeros((_PHASES, 2 * _REACH + 1))
    for phase in range(_PHASES):
        offsets = np.arange(-_REACH, _REACH + 1) + (phase + 0.5) / _PHASES
        distance = offsets[:, None] - np.arange(-_REACH, _REACH + 1)
        cardinal = np.nan_to_num(_basis()(distance)) @ coefficients
        table[phase] = np.correlate(cardinal, cardinal, "full")[2 * _REACH :]
    return table


def _noise_covariance(points: _FarPoints, radius_px: int) -> FloatArray:
    """Contribution of unit noise in the near image to the normal matrix, averaged over pixels."""
    table = _interpolated_noise()
    lag = np.abs(np.subtract.outer(np.arange(2 * radius_px + 1), np.arange(2 * radius_px + 1)))
    axes = []
    for position in (points.y, points.x):
        phase = np.floor((position - np.floor(position)) * _PHASES).astype(np.intp) % _PHASES
        axes.append((np.bincount(phase, minlength=_PHASES) / len(position)) @ table)
    return np.asarray(np.kron(axes[0][lag], axes[1][lag]), dtype=np.float64)


LEAST_ZOOM = 1.15
_LEAST_CORRELATION = 0.6
"""Of aligned photographs; scenes that do not match reach 0.47, as their shapes are bent to fit."""
_WIDEST_SIGMA_PX = 1.2
_REACH_SIGMAS = 3.5
_RADII_PX = (4, 12)
_GRID = 64  # samples of the kernel's transfer function along each axis
_SHARPEST_PX2 = 0.03  # the pixel alone has 1/12
_GAIN = 5  # index among the parameters of the Gaussian
_MOST_STEPS = 50
_CONVERGED = 1e-9


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PairPsf:
    """Total PSF covariance from two photographs, px^2; its error is of (xx, xy, yy)."""

    zoom: float
    covariance_px2: FloatArray
    covariance_err_px2: FloatArray


def pair_psf(
    near_dn: FloatArray,
    far_dn: FloatArray,
    far_to_near: FloatArray,
    *,
    near_noise_dn2: float = 0.0,
    clipped: ClippedPixels | None = None,
) -> PairPsf:
    """Total PSF from a near and a far photograph; without the near noise, noise counts as blur."""
    alignment = align_smoothly(near_dn, far_dn, far_to_near, clipped)
    if alignment.correlation < _LEAST_CORRELATION:
        raise PairError(
            "the photographs do not match where they were expected to, their correlation is "
            f"{alignment.correlation:.2f}",
            reason="not_aligned",
        )
    jacobian = alignment.jacobian
    zoom = sqrt(abs(float(np.linalg.det(jacobian))))
    if zoom < LEAST_ZOOM:
        raise PairError(
            f"the second photograph is {zoom:.3f} times as far away as the first; at least "
            f"{LEAST_ZOOM} is needed, and 2 is good",
            reason="one_distance",
        )
    reach = _REACH_SIGMAS * _WIDEST_SIGMA_PX * sqrt(zoom**2 - 1)
    radius = min(max(ceil(reach), _RADII_PX[0]), _RADII_PX[1])
    kernel = estimate_kernel(
        near_dn,
        far_dn,
        alignment,
        radius_px=radius,
        near_noise_dn2=near_noise_dn2,
        clipped=clipped,
    )
    between, between_err = _gaussian_of(kernel)
    # (A x A - I) vec Sigma = vec Sigma_k, for the three elements of symmetric matrices.
    a, b, c, d = jacobian.ravel()
    system = np.array(
        [
            [a * a - 1, 2 * a * b, b * b],
            [a * c, a * d + b * c - 1, b * d],
            [c * c, 2 * c * d, d * d - 1],
        ]
    )
    inverse = np.linalg.inv(system)
    xx, xy, yy = inverse @ between
    if np.linalg.eigvalsh([[xx, xy], [xy, yy]])[0] < _SHARPEST_PX2:
        raise PairError(
            "the far photograph is not softer than the near one: was it taken in focus?",
            reason="sharp",
        )
    return PairPsf(
        zoom=zoom,
        covariance_px2=np.array([[xx, xy], [xy, yy]]),
        covariance_err_px2=inverse @ between_err @ inverse.T,
    )


def combined(pairs: Sequence[PairPsf]) -> tuple[FloatArray, FloatArray]:
    """Weighted mean of the elements (xx, xy, yy), with errors that hold how they disagree."""
    if not pairs:
        raise ValueError("there is no pair of photographs")
    elements = [pair.covariance_px2[[0, 0, 1], [0, 1, 1]] for pair in pairs]
    weights = [np.linalg.inv(pair.covariance_err_px2) for pair in pairs]
    covariance = np.linalg.inv(np.sum(weights, axis=0))
    mean = covariance @ np.sum([w @ e for w, e in zip(weights, elements, strict=True)], axis=0)
    if len(pairs) > 1:
        chi2 = sum(
            float((e - mean) @ w @ (e - mean)) for w, e in zip(weights, elements, strict=True)
        )
        covariance = covariance * max(1.0, chi2 / (3 * (len(pairs) - 1)))
    return mean, covariance


def _gaussian_of(kernel: _InterImageKernel) -> tuple[FloatArray, FloatArray]:
    """Covariance elements (xx, xy, yy) of the Gaussian that fits the pixels best, and their error.

    Gauss-Newton on the squared error of the far pixels, with a shift, a gain and an offset free.
    """
    guess = _REACH_SIGMAS / kernel.radius_px
    parameters = np.array([guess**-2, 0.0, guess**-2, 0.0, 0.0, 1.0, 0.0]) * 0.5
    parameters[_GAIN] = 1.0
    unknowns, slopes = _gaussian_kernel(parameters, kernel.radius_px)
    error = kernel.squared_error(unknowns)
    for _ in range(_MOST_STEPS):
        system = slopes.T @ kernel.normal @ slopes
        step = np.linalg.solve(system, slopes.T @ (kernel.right - kernel.normal @ unknowns))
        for shrunk in 0.5 ** np.arange(12):
            trial = parameters + shrunk * step
            if not _is_covariance(trial):
                continue
            unknowns, slopes = _gaussian_kernel(trial, kernel.radius_px)
            if kernel.squared_error(unknowns) <= error:
                break
        else:
            break
        gained, error = error - kernel.squared_error(unknowns), kernel.squared_error(unknowns)
        parameters = trial
        if gained <= _CONVERGED * error:
            break
    unknowns, slopes = _gaussian_kernel(parameters, kernel.radius_px)
    # The pixels scatter about the model with the noise of both images.
    noisy = error + float(unknowns @ (kernel.noisy_normal - kernel.normal) @ unknowns)
    variance = noisy / max(kernel.pixels - len(parameters), 1)
    inverse = np.linalg.inv(slopes.T @ kernel.normal @ slopes)
    covariance = variance * inverse @ (slopes.T @ kernel.noisy_normal @ slopes) @ inverse
    return parameters[:3], np.asarray(covariance[:3, :3])


def _is_covariance(parameters: FloatArray) -> bool:
    xx, xy, yy = parameters[:3]
    return bool(xx > 0 and yy > 0 and xy**2 < xx * yy)


def _gaussian_kernel(parameters: FloatArray, radius: int) -> tuple[FloatArray, FloatArray]:
    """Weights and offset of a Gaussian kernel from its transfer function, and their derivatives."""
    xx, xy, yy, shift_x, shift_y, gain, offset = parameters
    fy, fx = np.meshgrid(np.fft.fftfreq(_GRID), np.fft.fftfreq(_GRID), indexing="ij")
    exponent = -2 * np.pi**2 * (xx * fx**2 + 2 * xy * fx * fy + yy * fy**2)
    transfer = np.exp(exponent - 2j * np.pi * (fx * shift_x + fy * shift_y))
    factors = np.stack(
        [
            gain * -2 * np.pi**2 * fx**2,
            gain * -4 * np.pi**2 * fx * fy,
            gain * -2 * np.pi**2 * fy**2,
            gain * -2j * np.pi * fx,
            gain * -2j * np.pi * fy,
            np.ones_like(fx),
        ]
    )
    crop = np.r_[-radius : radius + 1]
    grids = np.fft.ifft2(factors * transfer).real[:, crop[:, None], crop]
    slopes = np.zeros((crop.size**2 + 1, len(parameters)))
    slopes[:-1, :-1] = grids.reshape(len(grids), -1).T
    slopes[-1, -1] = 1.0
    return np.append(gain * slopes[:-1, _GAIN], offset), slopes
