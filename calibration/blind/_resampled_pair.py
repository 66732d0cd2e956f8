"""A near photograph on the pixels of a far one, so that one filter takes it there.

The near image is interpolated within its band at places that lie as dense as its own pixels, on a
grid that has the far pixels on it: what the kernel between both does is then a product of spectra.
Beyond the frame of the near photograph the far one shows what is there, blurred: enough for the
halo that a lens throws into the frame.
"""

from dataclasses import dataclass, replace
from math import ceil, pi
from typing import Protocol, TypeVar

import numpy as np
import scipy.fft
from scipy.ndimage import map_coordinates, spline_filter
from scipy.sparse import csr_matrix

from calibration.blind._cosine_blocks import BLOCK
from calibration.blind._lens_prior import ComplexArray
from simulation.arrays import BoolArray, FloatArray

_PAD_PX = 20
"""Far pixels around the used ones."""

_TAPER_PX = 8
_FEATHER_PX = 2.0  # near, from its own pixels to the far ones beyond
_MARGIN_PX = 3
"""Far pixels between the used ones and the near image's border."""

_FINER_THAN_NEAR = 1.1  # a turned frame's corners reach beyond its Nyquist frequency


class Alignment(Protocol):
    """Near coordinates of far pixels, their mean derivatives by far x and y, and the zoom."""

    @property
    def y_px(self) -> FloatArray: ...
    @property
    def x_px(self) -> FloatArray: ...
    @property
    def jacobian(self) -> FloatArray: ...
    @property
    def zoom(self) -> float: ...


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ResampledPair:
    """A near photograph on the far pixels, ``finer`` times as dense, and the far one.

    ``near_dn`` has its mean ``near_mean_dn`` taken off and a taper at its border. ``far_dn`` is cut
    to whole blocks of eight, from ``top``, ``left`` of the photograph on; ``used`` are pixels that
    both show. ``near_per_far`` is d(near x, near y) / d(far x, far y). ``near_share``: of the
    power of a noise of all near pixels, what ``near_dn`` has; beyond the near frame there is none.
    """

    near_dn: FloatArray
    near_mean_dn: float
    far_dn: FloatArray
    used: BoolArray
    finer: int
    near_per_far: FloatArray
    top: int
    left: int
    near_share: float = 1.0

    @property
    def near_px_per_sample(self) -> float:
        """Area of a sample of ``near_dn`` in near pixels."""
        return abs(float(np.linalg.det(self.near_per_far))) / self.finer**2

    @property
    def taper(self) -> FloatArray:
        """What ``near_dn`` was multiplied by."""
        rows, cols = (_ramps(n, _TAPER_PX * self.finer) for n in self.near_dn.shape)
        return np.multiply.outer(rows, cols)


def resampled(
    near_dn: FloatArray,
    far_dn: FloatArray,
    alignment: Alignment,
    away: BoolArray,
    first: tuple[int, int],
) -> ResampledPair:
    """Interpolate the near photograph; ``away`` are far pixels that may be used.

    The far photograph's first pixel is at row and column ``first`` of a block of cosines.
    """
    y, x = alignment.y_px, alignment.x_px
    both = _inward(y, x, near_dn.shape) >= _MARGIN_PX * alignment.zoom
    places = np.argwhere(both)
    offset = np.array(first)
    start = (places.min(axis=0) - _PAD_PX + offset) // BLOCK * BLOCK - offset
    shape = tuple(_fast_blocks(int(n)) for n in places.max(axis=0) + 1 + _PAD_PX - start)
    finer = ceil(_FINER_THAN_NEAR * alignment.zoom)
    axes = [begin + np.arange(n * finer) / finer for begin, n in zip(start, shape, strict=True)]
    place = np.stack(np.meshgrid(*axes, indexing="ij"))
    fine_y, fine_x = _continued(y, place), _continued(x, place)
    seen = _interpolated(near_dn - near_dn.mean(), fine_y, fine_x)
    level = map_coordinates(near_dn, np.stack([y[both], x[both]]), order=1)
    slope, constant = np.polyfit(far_dn[both], level, 1).tolist()
    beyond = slope * _spline(far_dn, place) + constant - near_dn.mean()
    share = np.clip(_inward(fine_y, fine_x, near_dn.shape) / _FEATHER_PX, 0.0, 1.0)
    top, left = start.tolist()
    pair = ResampledPair(
        near_dn=share * seen + (1 - share) * beyond,
        near_mean_dn=float(near_dn.mean()),
        far_dn=_cut(far_dn, top, left, shape),
        used=_cut(both & away, top, left, shape),
        finer=finer,
        near_per_far=alignment.jacobian,
        top=top,
        left=left,
    )
    taper = pair.taper
    near_share = float(np.sum(np.square(taper * share)) / np.sum(np.square(taper)))
    return replace(pair, near_dn=pair.near_dn * taper, near_share=near_share)


class Folding:
    """From some frequencies of the resampled near photograph to an image of far pixels."""

    def __init__(self, pair: ResampledPair, kept: BoolArray) -> None:
        fine_cols = pair.near_dn.shape[1]
        self._rows, self._cols = pair.far_dn.shape
        self._width = self._cols // 2 + 1
        row, col = np.nonzero(kept)
        to, of, signs = [], [], []
        # Of a real image half of the frequencies are held; the others are their conjugates.
        for sign, exists in ((1, col >= 0), (-1, (col > 0) & (2 * col < fine_cols))):
            down, across = (sign * row) % self._rows, (sign * col) % self._cols
            held = np.flatnonzero(exists & (across < self._width))
            to.append(down[held] * self._width + across[held])
            of.append(held)
            signs.append(np.full(held.size, sign / pair.finer**2))
        at, values = (np.concatenate(to), np.concatenate(of)), np.concatenate(signs)
        size = (self._rows * self._width, row.size)
        self._real = csr_matrix((np.abs(values), at), size)
        self._imaginary = csr_matrix((values, at), size)

    def image(self, series: ComplexArray) -> FloatArray:
        """Far pixels of a series at the kept frequencies."""
        folded = (self._real @ series.real) + 1j * (self._imaginary @ series.imag)
        shape = (self._rows, self._cols)
        return np.asarray(scipy.fft.irfft2(folded.reshape(self._rows, self._width), s=shape))


def _inward(y: FloatArray, x: FloatArray, shape: tuple[int, ...]) -> FloatArray:
    """Distance from the border, negative beyond it."""
    down = np.minimum(y, shape[0] - 1 - y)
    return np.asarray(np.minimum(down, np.minimum(x, shape[1] - 1 - x)))


def _fast_blocks(count: int) -> int:
    size = -(-count // BLOCK) * BLOCK
    while scipy.fft.next_fast_len(size, real=True) != size:
        size += BLOCK
    return size


def _continued(field: FloatArray, place: FloatArray) -> FloatArray:
    """A smooth field of the far pixels at places between, and straight on beyond them."""
    down, right = (float(np.mean(np.diff(field, axis=axis))) for axis in (0, 1))
    within = _clipped(place, field.shape)
    beyond = down * (place[0] - within[0]) + right * (place[1] - within[1])
    return np.asarray(map_coordinates(field, within, order=3, mode="nearest") + beyond)


def _spline(image: FloatArray, place: FloatArray) -> FloatArray:
    coefficients = spline_filter(image, order=3, mode="mirror")
    within = _clipped(place, image.shape)
    made = map_coordinates(coefficients, within, order=3, mode="mirror", prefilter=False)
    return np.asarray(made)


def _clipped(place: FloatArray, shape: tuple[int, ...]) -> FloatArray:
    last = np.reshape(np.array(shape) - 1.0, (2, 1, 1))
    return np.asarray(np.clip(place, 0.0, last), dtype=np.float64)


def _interpolated(image: FloatArray, y: FloatArray, x: FloatArray) -> FloatArray:
    """Band-limited to twice the samples, mirrored at the borders, and by splines from there."""
    rows, cols = image.shape
    series: FloatArray = np.zeros((2 * rows, 2 * cols))
    series[:rows, :cols] = scipy.fft.dctn(image, norm="ortho")
    double: FloatArray = np.asarray(2 * scipy.fft.idctn(series, norm="ortho"))
    coefficients = spline_filter(double, order=5, mode="reflect")
    # The doubled samples stand at (i + 1/2) / 2 - 1/2.
    at = np.stack([2 * y + 0.5, 2 * x + 0.5])
    return np.asarray(map_coordinates(coefficients, at, order=5, mode="reflect", prefilter=False))


_Pixel = TypeVar("_Pixel", np.float64, np.bool_)


def _cut(
    image: np.ndarray[tuple[int, ...], np.dtype[_Pixel]],
    top: int,
    left: int,
    shape: tuple[int, ...],
) -> np.ndarray[tuple[int, ...], np.dtype[_Pixel]]:
    """A window of an image; zeros where it reaches beyond."""
    made = np.zeros(shape, dtype=image.dtype)
    begin_y, begin_x = max(top, 0), max(left, 0)
    part = image[begin_y : top + shape[0], begin_x : left + shape[1]]
    y, x = begin_y - top, begin_x - left
    made[y : y + part.shape[0], x : x + part.shape[1]] = part
    return made


def _ramps(count: int, width: int) -> FloatArray:
    ramp = np.ones(count)
    rise = 0.5 - 0.5 * np.cos(pi * (np.arange(width) + 0.5) / width)
    ramp[:width], ramp[-width:] = rise, rise[::-1]
    return ramp
