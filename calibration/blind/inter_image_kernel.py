"""The kernel that takes a near photograph to a far one of the same scene.

Delbracio, Almansa, Musé, Morel: Subpixel point spread function estimation from two photographs at
different distances. SIAM J. Imaging Sciences 5 (2012) 1234-1260. With the near image interpolated
at the places of the far pixels, the far image is linear in the kernel between them. What is added
here: the near image's own noise is taken out of the normal equations (it would widen the kernel),
and a model of the kernel is fitted by them as by the pixels themselves.
"""

from dataclasses import dataclass
from functools import cache
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline
from scipy.ndimage import spline_filter

from calibration.blind.alignment import SmoothAlignment
from calibration.errors import PairError

__all__ = ["InterImageKernel", "estimate_kernel"]

Array = NDArray[np.float64]

_ORDER: Final = 5  # of the interpolating spline: flat to 1 % up to 0.85 of the Nyquist frequency
_TAPS = _ORDER + 1
_CHUNK = 2048
_MOST_PIXELS = 120_000
_PHASES = 32
_REACH = 24  # samples at which the cardinal spline has died away


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class InterImageKernel:
    """What two photographs say of the kernel between them: the normal equations of its weights.

    ``far(p) = sum_q weights[r + q] near(H p + q) + offset``. The unknowns are the weights, row by
    row, and the offset.

    Parameters
    ----------
    radius_px
        Reach r of the kernel on either side, near pixels.
    normal
        Normal matrix without the near image's noise, shape ``(n, n)``; where the near image holds
        nothing but noise it says nothing, and may fall below zero.
    noisy_normal
        The same as the pixels gave it.
    right
        Right-hand side, shape ``(n,)``.
    squares
        Sum of the far pixels' squares.
    pixels
        Far pixels used.
    """

    radius_px: int
    normal: Array
    noisy_normal: Array
    right: Array
    squares: float
    pixels: int

    def squared_error(self, unknowns: Array) -> float:
        """Sum over the far pixels of the squared difference, the near image's noise taken out."""
        return float(self.squares - 2 * self.right @ unknowns + unknowns @ self.normal @ unknowns)


def estimate_kernel(
    near_dn: Array,
    far_dn: Array,
    alignment: SmoothAlignment,
    *,
    radius_px: int,
    near_noise_dn2: float = 0.0,
) -> InterImageKernel:
    """Normal equations of the kernel from a near photograph to a far one.

    Parameters
    ----------
    near_dn, far_dn
        Linear in light, shape ``(rows, cols)``.
    alignment
        Where the far pixels lie in the near image; the kernel takes up a shift.
    radius_px
        Reach of the kernel in near pixels.
    near_noise_dn2
        Variance of the noise of a pixel of the near image, zero where it is not known.

    Raises
    ------
    PairError
        If the images overlap too little for that many weights.
    """
    places = _far_places(alignment, near_dn.shape, radius_px)
    unknowns = (2 * radius_px + 1) ** 2 + 1
    if len(places.rows) < 4 * unknowns:
        raise PairError(
            f"{len(places.rows)} pixels of the far image lie inside the near one, "
            f"{4 * unknowns} are needed: take the same scene in both",
            reason="little_overlap",
        )
    # Means are taken off for the sake of rounding; the offset takes up what they make.
    coefficients = spline_filter(near_dn - near_dn.mean(), order=_ORDER, mode="mirror")
    values = (far_dn / alignment.gain)[places.rows, places.cols]
    values = values - values.mean()
    normal, right = np.zeros((unknowns, unknowns)), np.zeros(unknowns)
    for start in range(0, len(values), _CHUNK):
        part = slice(start, start + _CHUNK)
        block = np.ones((len(values[part]), unknowns))
        block[:, :-1] = _samples(coefficients, places.y[part], places.x[part], radius_px)
        normal += block.T @ block
        right += block.T @ values[part]
    squares = float(values @ values)
    noisy = normal.copy()
    if near_noise_dn2 > 0:
        normal[:-1, :-1] -= near_noise_dn2 * len(values) * _noise_covariance(places, radius_px)
    return InterImageKernel(
        radius_px=radius_px,
        normal=normal,
        noisy_normal=noisy,
        right=right,
        squares=squares,
        pixels=len(values),
    )


@dataclass(frozen=True, slots=True)
class _Places:
    rows: NDArray[np.intp]
    cols: NDArray[np.intp]
    y: Array
    x: Array


def _far_places(alignment: SmoothAlignment, near_shape: tuple[int, ...], radius_px: int) -> _Places:
    """Far pixels whose whole kernel lies in the near image, thinned evenly to a bounded number."""
    y, x = alignment.y_px, alignment.x_px
    margin = radius_px + _TAPS
    inside = (x >= margin) & (x <= near_shape[1] - 1 - margin)
    inside &= (y >= margin) & (y <= near_shape[0] - 1 - margin)
    chosen = np.flatnonzero(inside)
    # A stride that shares no factor with the rows spreads the pixels over the frame.
    chosen = chosen[:: max(1, -(-len(chosen) // _MOST_PIXELS))]
    rows, cols = np.unravel_index(chosen, inside.shape)
    return _Places(rows=rows, cols=cols, y=y.ravel()[chosen], x=x.ravel()[chosen])


def _samples(coefficients: Array, y: Array, x: Array, radius_px: int) -> Array:
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


def _spline_taps(fraction: Array) -> Array:
    """Weights of the six B-spline coefficients around each place, shape ``(n, 6)``."""
    distance = fraction[:, None] - (np.arange(_TAPS) - _TAPS // 2 + 1)
    return np.asarray(_basis()(distance))


@cache
def _basis() -> BSpline:
    half = (_ORDER + 1) / 2
    return BSpline.basis_element(np.arange(_ORDER + 2) - half, extrapolate=False)


@cache
def _interpolated_noise() -> Array:
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


def _noise_covariance(places: _Places, radius_px: int) -> Array:
    """Mean over the pixels of what unit noise of the near image adds to the normal matrix."""
    table = _interpolated_noise()
    lag = np.abs(np.subtract.outer(np.arange(2 * radius_px + 1), np.arange(2 * radius_px + 1)))
    axes = []
    for place in (places.y, places.x):
        phase = np.floor((place - np.floor(place)) * _PHASES).astype(np.intp) % _PHASES
        axes.append((np.bincount(phase, minlength=_PHASES) / len(place)) @ table)
    return np.asarray(np.kron(axes[0][lag], axes[1][lag]), dtype=np.float64)
