"""Contrast by frequency of texture, from a photograph of dead leaves whose picture is known.

The target, discs that hide one another (spilled coins), is found by registration: nothing that does
not show it agrees with its picture. Where the photograph's tiles lie on the picture is refined tile
by tile, so that distortion does no harm, and the picture is sampled four times a pixel there.

Two curves follow from the spectra of the tiles, X of the picture and Y of the photograph. The
*intrinsic* one, ``sum Y X* / sum |X|^2``, counts what the photograph shows of the texture that is
there: neither noise nor detail that processing adds has a part in it. The *direct* one, the root of
``(sum |Y|^2 - noise) / sum |X|^2``, counts all detail but white noise, as large as beside the edges
of the photograph. Both are over what the lowest frequencies of the intrinsic one extrapolate to at
frequency 0.

References
----------
Cao, Guichard, Hornung, "Dead leaves model for measuring texture quality on a digital camera", SPIE
7537, 2010. McElvain, Campbell, Miller, Jin, "Texture-based measurement of spatial frequency
response using the dead leaves target: extensions, and application to real camera systems", SPIE
7537, 2010. Kirk, Herzer, Artmann, Kunz, "Description of texture loss using the dead leaves target:
current issues and a new intrinsic approach", SPIE 9023, 2014.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product
from math import hypot, pi
from typing import Final, NamedTuple

import numpy as np
from numpy.polynomial.polynomial import polygrid2d
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from calibration.errors import RegistrationError
from calibration.registration import RegistrationReference, register_images
from calibration.sharpness._star import contrast_at_zero
from simulation.arrays import BoolArray, FloatArray

_TILES_PX = (128, 96, 64)
_ENOUGH_TILES = 25  # for the larger tiles
FEWEST_TILES: Final = 9
_SAMPLES = 4
_MARGIN_PX = 4.0
_ROUNDS = 3
_SHIFT_CY_PER_PX = 0.25
_RING_CY_PER_PX = 1 / 96
_FIRST_MODE = 2.0  # below, the window mixes in the mean
_FREQ_MOST = 0.5
_OVERLAP_ERR = 1.27  # of drawn noise over a jackknife of tiles that overlap and are each aligned
_DEGREES = ((40, 3), (16, 2), (9, 1))  # of the polynomial of places, by the number of tiles

_CLIPPED = 1e-3  # of a tile's pixels, which do not count: more, and the tile is left out
_PLACED_PX = 0.01
_OF_METHOD = 2e-3  # of contrast, without noise

Complex = NDArray[np.complex128]


class _Spectra(NamedTuple):
    """Spectra of a tile of the target and of the photograph, a half of the plane."""

    shown: Complex
    seen: Complex


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TextureSfr:
    """Contrast by frequency of dead leaves, with standard errors; the intrinsic curve is 1 at 0.

    ``direct`` is None where the noise is not known. ``scale_err`` is the relative error of 1.
    ``without`` are the intrinsic curves without each tile, shape ``(tiles, rings)``, of which
    `spread_of` tells the error of any figure: neighbouring frequencies err alike. ``x_px`` and
    ``y_px`` are the target's middle.
    """

    x_px: float
    y_px: float
    tiles: int
    freq_cy_per_px: FloatArray
    intrinsic: FloatArray
    intrinsic_err: FloatArray
    direct: FloatArray | None
    direct_err: FloatArray | None
    scale_err: float
    without: FloatArray


def find_dead_leaves(image_dn: FloatArray, target: FloatArray) -> FloatArray | None:
    """Return where the target lies, a homography of its pixels to the photograph's, or None.

    Both are grey and linear in light, shape ``(rows, cols)``.
    """
    try:
        found = register_images(RegistrationReference.of(image_dn), target)
    except RegistrationError:
        return None
    return found.pose.matrix


def measure_dead_leaves(
    image_dn: FloatArray,
    target: FloatArray,
    matrix: FloatArray,
    noise_dn: float | None,
    clipped: BoolArray | None = None,
) -> TextureSfr | None:
    """Measure a target that was found; None if it is too small, clipped or shows no contrast.

    Parameters
    ----------
    image_dn, target
        Levels linear in light, shape ``(rows, cols)`` each. Pixels of the target are squares.
    matrix
        Homography of the target's pixels to the photograph's.
    noise_dn
        Standard deviation of a pixel's noise; None where it is not known.
    clipped
        Pixels of the photograph that are no measurement: tiles that show them are left out, since
        leaves that are cut off at a level have other spectra.
    """
    tiles = _tiles(image_dn, target, matrix, clipped)
    if tiles is None:
        return None
    spectra, rings, side = _aligned(tiles), _rings(tiles.side), tiles.side
    sums = np.array([_sums(one, rings) for one in spectra])  # tiles, 3, rings
    freq = np.bincount(rings.ring, weights=rings.freq) / rings.modes
    cross, shown, _ = sums.sum(axis=0)
    intrinsic = cross / shown
    intrinsic = intrinsic - _by_window(freq, intrinsic, shown / rings.modes, side)
    without = np.array([one[0] / one[1] for one in sums.sum(axis=0) - sums])
    err = spread_of(without)
    scale = contrast_at_zero(freq, intrinsic, err)
    if scale is None or not scale.value > 0:
        return None
    direct = direct_err = None
    if noise_dn is not None:
        noise = noise_dn**2 * float(np.sum(_window(side, 1) ** 2)) * rings.modes

        def root(one: FloatArray, count: int) -> FloatArray:
            return np.asarray(np.sqrt(np.maximum(one[2] - count * noise, 0.0) / one[1]))

        direct = root(sums.sum(axis=0), len(sums)) / scale.value
        fewer = [root(one, len(sums) - 1) for one in sums.sum(axis=0) - sums]
        direct_err = spread_of(np.array(fewer)) / scale.value
    middle = _projected(matrix, *((size - 1) / 2 for size in reversed(target.shape)))
    return TextureSfr(
        x_px=float(middle[0]),
        y_px=float(middle[1]),
        tiles=len(sums),
        freq_cy_per_px=freq,
        intrinsic=intrinsic / scale.value,
        intrinsic_err=err / scale.value,
        direct=direct,
        direct_err=direct_err,
        without=without / scale.value,
        scale_err=hypot(scale.relative_err, _OF_METHOD),
    )


def _projected(
    matrix: FloatArray, x: FloatArray | float, y: FloatArray | float
) -> tuple[FloatArray, FloatArray]:
    along, across, depth = (row[0] * x + row[1] * y + row[2] for row in matrix)
    return np.asarray(along / depth), np.asarray(across / depth)


class _Tiles(NamedTuple):
    """Tiles of the photograph, from ``corners`` on, and the target about the same places.

    ``back`` takes the photograph's pixels to the target's.
    """

    image_dn: FloatArray
    target: FloatArray
    back: FloatArray
    side: int
    corners: NDArray[np.int64]

    def spectra(self, moved_px: FloatArray) -> Iterator[_Spectra]:
        """Yield the spectra of the target and of the photograph, tile by tile.

        ``moved_px``: polynomial, shape (2, 4, 4), of how far the photograph lies beside.
        """
        window, fine_window = _window(self.side, 1), _window(self.side, _SAMPLES) / _SAMPLES**2
        fy, fx = _modes(self.side)
        turn = np.exp(-2j * pi * (fx + fy) * (0.5 / _SAMPLES - 0.5))
        rows = np.round(fy[:, 0] * self.side).astype(np.int64)
        along = (np.arange(self.side * _SAMPLES) + 0.5) / _SAMPLES - 0.5
        for left, top in self.corners.tolist():
            y = self.image_dn[top : top + self.side, left : left + self.side]
            x = self._sampled(left + along, top + along, moved_px)
            shown = np.fft.rfft2(_without_mean(x, fine_window))[rows][:, : fx.shape[1]]
            shown *= turn / self._between(left + self.side / 2, top + self.side / 2)
            yield _Spectra(shown, np.fft.rfft2(_without_mean(y, window)))

    def _sampled(self, x: FloatArray, y: FloatArray, moved_px: FloatArray) -> FloatArray:
        """The target at a grid of places of the photograph, linear between its pixels."""
        scaled = self.scaled(x, y)
        right, down = (polygrid2d(*scaled, one).T for one in moved_px)
        to = _projected(self.back, x[None, :] - right, y[:, None] - down)
        return np.asarray(map_coordinates(self.target, to[::-1], order=1, mode="nearest"))

    def _between(self, x: float, y: float) -> FloatArray:
        """What squares of the target's pixels become by being joined by lines, at each mode."""
        ahead = _projected(self.back, x + np.array([0.0, 1.0, 0.0]), y + np.array([0.0, 0.0, 1.0]))
        slopes = np.array([one[1:] - one[0] for one in ahead])  # of (column, row) by (x, y)
        fy, fx = _modes(self.side)
        to_x, to_y = np.linalg.solve(
            slopes.T, [np.tile(fx.ravel(), fy.size), np.repeat(fy, fx.size)]
        )
        return np.asarray(np.sinc(to_x) * np.sinc(to_y)).reshape(fy.size, fx.size)

    def scaled(self, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Places from -1 to 1 over the photograph."""
        rows, cols = self.image_dn.shape
        return 2 * x / cols - 1, 2 * y / rows - 1


def _tiles(
    image_dn: FloatArray, target: FloatArray, matrix: FloatArray, clipped: BoolArray | None
) -> _Tiles | None:
    """Tiles within the target, each half over the next: the largest of which there are enough."""
    back = np.asarray(np.linalg.inv(matrix), np.float64)
    rows, cols = target.shape
    ends = _projected(
        matrix,
        np.array([-0.5, cols - 0.5, cols - 0.5, -0.5]),
        np.array([-0.5, -0.5, rows - 0.5, rows - 0.5]),
    )
    sizes = image_dn.shape[::-1]
    best = None
    for side in _TILES_PX:
        steps = [
            np.arange(
                np.ceil(max(one.min(), 0.0) + _MARGIN_PX),
                min(one.max(), size - 1.0) - _MARGIN_PX - side + 1,
                side // 2,
            )
            for one, size in zip(ends, sizes, strict=True)
        ]
        x, y = (grid.ravel() for grid in np.meshgrid(*steps))
        is_within = np.ones(x.size, np.bool_)
        sides = (-_MARGIN_PX, _MARGIN_PX + side - 1)
        for right, down in product(sides, sides):
            to_x, to_y = _projected(back, x + right, y + down)
            is_within &= (to_x >= 0) & (to_y >= 0) & (to_x <= cols - 1) & (to_y <= rows - 1)
        corners = np.column_stack([x, y])[is_within].astype(np.int64)
        if clipped is not None:
            shares = [
                np.mean(clipped[top : top + side, left : left + side])
                for left, top in corners.tolist()
            ]
            corners = corners[np.array(shares) <= _CLIPPED]
        if len(corners) >= FEWEST_TILES:
            best = _Tiles(image_dn, target, back, side, corners)
        if len(corners) >= _ENOUGH_TILES:
            break
    return best


def _aligned(tiles: _Tiles) -> list[_Spectra]:
    """Refine where tiles lie: a polynomial of their places, then each for itself."""
    degree = next(one for least, one in _DEGREES if len(tiles.corners) >= least)
    powers = [(a, b) for a in range(4) for b in range(4) if a + b <= degree]
    x, y = tiles.scaled(*(tiles.corners + 0.5 * (tiles.side - 1)).T)
    known = np.column_stack([x**a * y**b for a, b in powers])
    moved_px = np.zeros((2, 4, 4))
    for _ in range(_ROUNDS):
        spectra = list(tiles.spectra(moved_px))
        shifts = np.array([_shift_px(one) for one in spectra])
        fit = np.linalg.lstsq(known, shifts, rcond=None)[0]
        if np.abs(known @ fit).max() < _PLACED_PX:
            break
        for (a, b), both in zip(powers, fit, strict=True):
            moved_px[:, a, b] += both
    fy, fx = _modes(tiles.side)
    return [
        one._replace(shown=one.shown * np.exp(-2j * pi * (fx * right + fy * down)))
        for one, (right, down) in zip(spectra, shifts.tolist(), strict=True)
    ]


def _modes(side: int) -> tuple[FloatArray, FloatArray]:
    """Frequencies down and to the right, which broadcast."""
    down, right = np.fft.fftfreq(side), np.fft.rfftfreq(side)
    return np.asarray(down[:, None], np.float64), np.asarray(right[None, :], np.float64)


def _window(side: int, samples: int) -> FloatArray:
    """Hann's window over a tile."""
    place = (np.arange(side * samples) + 0.5) / samples
    one = np.sin(pi * place / side) ** 2
    return np.outer(one, one)


def _without_mean(levels: FloatArray, window: FloatArray) -> FloatArray:
    return np.asarray((levels - np.sum(levels * window) / np.sum(window)) * window)


def _shift_px(tile: _Spectra) -> FloatArray:
    """How far ``(x, y)`` a tile lies beside the target: first by whole pixels, then by phases."""
    side = len(tile.seen)
    fy, fx = _modes(side)
    low = np.hypot(fx, fy)
    used = (low > 0) & (low < _SHIFT_CY_PER_PX)
    cross = np.where(used, tile.seen * tile.shown.conj(), 0.0)
    peak = np.fft.irfft2(cross / np.sqrt(np.abs(cross) + 1e-300), s=(side, side))
    down, right = np.unravel_index(int(np.argmax(peak)), peak.shape)
    shift = np.array([right, down], np.float64)
    shift = (shift + side / 2) % side - side / 2
    # The noise is white: the phase of a mode is known as well as the target has contrast there.
    design = -2 * pi * np.column_stack([np.broadcast_to(one, low.shape)[used] for one in (fx, fy)])
    weight = np.abs(cross[used])
    normal = (design * weight[:, None]).T @ design
    for _ in range(3):
        left = np.angle(cross[used] * np.exp(-1j * (design @ shift)))
        shift = shift + np.linalg.solve(normal, design.T @ (weight * left))
    return shift


class _Rings(NamedTuple):
    """Modes by their frequency: the ring of each, and how many each ring has."""

    used: NDArray[np.bool_]
    ring: NDArray[np.int64]
    freq: FloatArray
    modes: FloatArray


def _rings(side: int) -> _Rings:
    size = np.hypot(*_modes(side))
    used = (size >= _FIRST_MODE / side) & (size < _FREQ_MOST)
    width = max(_RING_CY_PER_PX, 1 / side)
    ring = ((size[used] - _FIRST_MODE / side) / width).astype(np.int64)
    modes = np.bincount(ring).astype(np.float64)
    return _Rings(used, ring, size[used], modes)


def _sums(tile: _Spectra, rings: _Rings) -> FloatArray:
    """In phase with the target, of the target, and of the photograph: power in each ring."""
    shown, seen = (one[rings.used] for one in tile)
    powers = ((seen * shown.conj()).real, np.abs(shown) ** 2, np.abs(seen) ** 2)
    return np.array([np.bincount(rings.ring, weights=one) for one in powers])


def _by_window(freq: FloatArray, curve: FloatArray, power: FloatArray, side: int) -> FloatArray:
    """What the window's width in frequency adds to a curve that is weighted by a steep power.

    Hann's window has a variance of 1 / (3 side^2) in frequency along each axis.
    """
    slope = np.gradient(curve, freq)
    steep = 2 * np.gradient(np.log(power), freq) + 1 / freq
    return np.asarray(slope * steep / (6 * side**2))


def spread_of(without: FloatArray) -> FloatArray:
    """Standard error of figures, of the same without each tile (jackknife), shape (tiles, ...)."""
    share = (len(without) - 1) / len(without)
    away = without - without.mean(axis=0)
    return np.asarray(_OVERLAP_ERR * np.sqrt(share * np.sum(away**2, axis=0)))
