"""The blur kernel between a near photograph and a far one of the same scene, without a model of it.

Delbracio, Almansa, Musé, Morel: Subpixel point spread function estimation from two photographs at
different distances. SIAM J. Imaging Sciences 5 (2012) 1234-1260. With the near image interpolated
at the positions of the far pixels, the far image is linear in the kernel between them. The near
image's own noise can be removed from the normal equations: it would widen the kernel.
"""

from dataclasses import dataclass
from functools import cache
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline
from scipy.ndimage import spline_filter

from calibration.blind.two_distance import ClippedPixels, SmoothAlignment
from calibration.errors import PairError
from simulation.arrays import FloatArray

_ORDER: Final = 5  # of the interpolating spline: flat to 1 % up to 0.85 of the Nyquist frequency
_TAPS = _ORDER + 1
_CHUNK = 2048
_MOST_PIXELS = 120_000
_PHASES = 32
_REACH = 24  # samples after which the cardinal spline is negligible


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class InterImageKernel:
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
    alignment: SmoothAlignment,
    *,
    radius_px: int,
    near_noise_dn2: float = 0.0,
    clipped: ClippedPixels | None = None,
) -> InterImageKernel:
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
    return InterImageKernel(
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
    alignment: SmoothAlignment,
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
