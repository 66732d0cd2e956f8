"""What a camera's pixels receive: the light's Fourier series times the system's transfer function.

A frame is rendered as one period of a periodic picture, wider than the frame on all sides. Charts
and spots have their series in closed form, so nothing is sampled; scenes are sampled ``per_px``
times a pixel, at which cubic B-splines of fine coefficients hardly alias. All is float64: the last
bits, which differ between processors, are far below what rounding to levels shows.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from io import BytesIO
from math import ceil, cos, floor, radians, sin
from typing import Any

import numpy as np
import scipy.fft
import tifffile
from numba import njit
from numpy.typing import NDArray
from PIL import Image

from hil_mocks.benchmark_set._lenses import Lens, contrast, falls_to, system_otf
from hil_mocks.truth import ADC_MAX_DN, Sensor

MARGIN_PX = 24
"""Beyond the frame on each side: what lies there blurs into the frame as it would in a scene."""

_ROWS_AT_ONCE = 192

FloatArray = NDArray[np.float64]
Series = NDArray[np.complex128]
"""Fourier coefficients, shape (rows, cols) of `Grid.freq_y` and `Grid.freq_x`."""

Light = Callable[[FloatArray, FloatArray], FloatArray]
"""Light at positions (x, y) in pixels of the frame; 1 is white."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Grid:
    """Frequencies that a frame of ``(rows, cols)`` is rendered from, for lenses up to ``band``."""

    rows: int
    cols: int
    band_cy_per_px: float
    per_px: int = 8

    @property
    def period_px(self) -> tuple[int, int]:
        """Rows and columns of the periodic picture."""
        return tuple(scipy.fft.next_fast_len(n + 2 * MARGIN_PX, real=True) for n in self.shape)  # type: ignore[return-value]

    @property
    def shape(self) -> tuple[int, int]:
        """``(rows, cols)`` of the frame."""
        return self.rows, self.cols

    @property
    def freq_y(self) -> FloatArray:
        """Cycles per pixel, positive and negative, shape (rows, 1)."""
        rows = self.period_px[0]
        return np.asarray(scipy.fft.fftfreq(rows * self.per_px, 1 / self.per_px)[:, None])

    @property
    def freq_x(self) -> FloatArray:
        """Cycles per pixel from 0 to the band's end, shape (1, cols)."""
        cols = self.period_px[1]
        count = min(int(self.band_cy_per_px * cols) + 1, cols * self.per_px // 2 + 1)
        return np.asarray(np.arange(count)[None, :] / cols)


def pixels(series: Series, lens: Lens, grid: Grid) -> FloatArray:
    """Light on each pixel of a frame, shape ``grid.shape``."""
    rows, cols = grid.period_px
    seen = series * _transfer(lens, grid)
    folded = seen.reshape(grid.per_px, rows, -1).sum(axis=0)
    lines = scipy.fft.ifft(folded, axis=0, norm="forward")
    image = scipy.fft.irfft(lines, n=cols * grid.per_px, axis=1, norm="forward")
    top, left = MARGIN_PX, MARGIN_PX * grid.per_px
    within = image[top : top + grid.rows, left : left + grid.cols * grid.per_px : grid.per_px]
    return np.ascontiguousarray(within)


@lru_cache(maxsize=3)
def _transfer(lens: Lens, grid: Grid) -> NDArray[np.float64] | NDArray[np.complex128]:
    return system_otf(lens, grid.freq_x, grid.freq_y)


def sampled(light: Light, grid: Grid, channels: tuple[int, ...] = ()) -> Series:
    """Series of light that is given at positions, shape ``(*channels, rows, cols)``."""
    rows, cols = (n * grid.per_px for n in grid.period_px)
    x = np.arange(cols) / grid.per_px - MARGIN_PX
    y = np.arange(rows) / grid.per_px - MARGIN_PX
    series = np.empty((*channels, rows, grid.freq_x.size), dtype=np.complex128)
    for top in range(0, rows, _ROWS_AT_ONCE):
        part = slice(top, min(top + _ROWS_AT_ONCE, rows))
        levels = light(*np.meshgrid(x, y[part]))
        lines = scipy.fft.rfft(levels, axis=-1, norm="forward")
        series[..., part, :] = lines[..., : series.shape[-1]]
    return np.asarray(scipy.fft.fft(series, axis=-2, norm="forward", overwrite_x=True))


def spot_series(grid: Grid, x_px: float, y_px: float, sigma_px: float, amplitude: float) -> Series:
    """Series of a Gaussian spot."""
    rows, cols = grid.period_px
    fx, fy = grid.freq_x, grid.freq_y
    volume = amplitude * 2 * np.pi * sigma_px**2 / (rows * cols)
    along_x = np.exp(-2 * (np.pi * sigma_px * fx) ** 2 - 2j * np.pi * fx * (x_px + MARGIN_PX))
    along_y = np.exp(-2 * (np.pi * sigma_px * fy) ** 2 - 2j * np.pi * fy * (y_px + MARGIN_PX))
    return np.asarray(volume * along_x * along_y)


PAPER, INK = 0.9, 0.12
"""Light of the paper and of the squares, relative to white."""

LEAST_SLANT_DEG, LARGEST_SLANT_DEG = 3.0, 40.0
_HALF_LENGTH = 0.25
"""Of a square's side: what the region of an edge shows along it, to either side of its middle."""

_HALF_WIDTH_PX = 10.0
_MOST_HALF_WIDTH = 0.3
"""What it shows across the edge, to either side; the second over the side of a small square."""

_FREQ_CY_PER_PX = (0.1, 0.2, 0.3, 0.4, 0.5)


@dataclass(frozen=True, slots=True, kw_only=True)
class Square:
    """A dark square; its sides are turned by ``slant_deg`` from +x towards +y."""

    x_px: float
    y_px: float
    side_px: float
    slant_deg: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Chart:
    """Dark squares on paper; ``shape`` is that of the frame, ``(rows, cols)``."""

    shape: tuple[int, int]
    squares: tuple[Square, ...]

    def series(self, grid: Grid) -> Series:
        """Fourier series of the chart's light."""
        rows, cols = grid.period_px
        series = np.zeros((grid.freq_y.size, grid.freq_x.size), dtype=np.complex128)
        series[0, 0] = PAPER
        for square in self.squares:
            _add_square(
                series,
                grid.freq_x[0],
                grid.freq_y[:, 0],
                np.array([square.x_px + MARGIN_PX, square.y_px + MARGIN_PX]),
                np.array([square.side_px, radians(square.slant_deg)]),
                (INK - PAPER) / (rows * cols),
            )
        return series

    def edges(self) -> list[tuple[str, float, list[int]]]:
        """Name, direction of the normal in degrees, and region of every edge."""
        found: list[tuple[str, float, list[int]]] = []
        for square in self.squares:
            for turn in range(4):
                normal_deg = square.slant_deg + 90.0 * turn
                found.append((str(len(found)), normal_deg % 360.0, _region(square, normal_deg)))
        return found

    def task_edges(self) -> list[dict[str, Any]]:
        """What a task says of the edges."""
        return [
            {"edge": name, "roi_px": region, "angle_deg": round(normal_deg + 90.0) % 180}
            for name, normal_deg, region in self.edges()
        ]

    def truth_edges(self, lens: Lens) -> dict[str, dict[str, float]]:
        """Name of each edge, and the truth along its normal."""
        return {name: truth_along(lens, normal_deg) for name, normal_deg, _ in self.edges()}


def truth_along(lens: Lens, normal_deg: float) -> dict[str, float]:
    """Frequency at which the system's MTF along a direction falls to 0.5, and it at others."""
    contrasts = {f"mtf_{freq:g}": contrast(lens, freq, normal_deg) for freq in _FREQ_CY_PER_PX}
    return {"mtf50": falls_to(lens, 0.5, normal_deg), **contrasts, "normal_deg": normal_deg}


def chart_of(
    rng: np.random.Generator, shape: tuple[int, int], layout: tuple[int, int], side_px: float
) -> Chart:
    """Chart with ``layout`` (rows, cols) of squares, slanted each by its own angle."""
    squares = []
    pitch_y, pitch_x = (n / count for n, count in zip(shape, layout, strict=True))
    for row in range(layout[0]):
        for col in range(layout[1]):
            slant = rng.uniform(LEAST_SLANT_DEG, LARGEST_SLANT_DEG) * rng.choice([-1.0, 1.0])
            x, y = rng.uniform(-2.0, 2.0, 2)
            squares.append(
                Square(
                    x_px=(col + 0.5) * pitch_x - 0.5 + float(x),
                    y_px=(row + 0.5) * pitch_y - 0.5 + float(y),
                    side_px=side_px,
                    slant_deg=float(slant),
                )
            )
    return Chart(shape=shape, squares=tuple(squares))


def _region(square: Square, normal_deg: float) -> list[int]:
    c, s = cos(radians(normal_deg)), sin(radians(normal_deg))
    x, y = square.x_px + c * square.side_px / 2, square.y_px + s * square.side_px / 2
    along = _HALF_LENGTH * square.side_px
    across = min(_HALF_WIDTH_PX, _MOST_HALF_WIDTH * square.side_px)
    half_x = abs(s) * along + abs(c) * across
    half_y = abs(c) * along + abs(s) * across
    return [floor(x - half_x), floor(y - half_y), ceil(x + half_x) + 1, ceil(y + half_y) + 1]


@njit(cache=True, error_model="numpy")
def _add_square(
    series: Series,
    freq_x: NDArray[np.float64],
    freq_y: NDArray[np.float64],
    centre: NDArray[np.float64],
    side_and_slant: NDArray[np.float64],
    contrast: float,
) -> None:
    """Add two sines over their arguments, each of a sum of angles along x and along y."""
    side, slant = side_and_slant
    wide, high = np.pi * side * np.cos(slant), np.pi * side * np.sin(slant)
    sine_wide, cosine_wide = np.sin(wide * freq_x), np.cos(wide * freq_x)
    sine_high, cosine_high = np.sin(high * freq_x), np.cos(high * freq_x)
    turn_x = np.exp(-2j * np.pi * centre[0] * freq_x)
    for i in range(len(freq_y)):
        y = freq_y[i]
        sine_y, cosine_y = np.sin(high * y), np.cos(high * y)
        sine_down, cosine_down = np.sin(wide * y), np.cos(wide * y)
        turn_y = contrast * side * side * np.exp(-2j * np.pi * centre[1] * y)
        for j in range(len(freq_x)):
            along, across = wide * freq_x[j] + high * y, wide * y - high * freq_x[j]
            size = 1.0
            if abs(along) > 1e-9:
                size = (sine_wide[j] * cosine_y + cosine_wide[j] * sine_y) / along
            if abs(across) > 1e-9:
                size *= (sine_down * cosine_high[j] - cosine_down * sine_high[j]) / across
            series[i, j] += size * turn_x[j] * turn_y


BLACK_LEVEL_DN = 64.0
WHITE_DN = 3400.0
"""Levels above black of white at an exposure of 1."""

STEPS_PER_DN = 16
"""Of the noise-free levels in truth files."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Condition:
    """How a photograph is exposed and stored."""

    name: str  # as the truth names it
    gain_e_per_dn: float | None = 4.0  # None: no noise but that of rounding
    read_noise_e: float = 12.0
    exposure: float = 1.0  # 1 brings white to `WHITE_DN` above black; much more fills bright wells
    jpeg_quality: int | None = None  # 8-bit JPEG, sRGB; None: linear TIFF of 12 bits

    @property
    def suffix(self) -> str:
        """Of the photographs' files."""
        return ".tif" if self.jpeg_quality is None else ".jpg"

    def facts(self) -> dict[str, Any]:
        """Return what a task says of levels and noise."""
        gain = self.gain_e_per_dn
        noise = {
            "variance_at_black_dn2": 1 / 12
            + (0 if gain is None else (self.read_noise_e / gain) ** 2),
            "variance_per_dn": 0.0 if gain is None else 1 / gain,
        }
        if self.jpeg_quality is None:
            levels = {"encoding": "linear", "max_level": ADC_MAX_DN, "black_level": BLACK_LEVEL_DN}
        else:
            levels = {
                "encoding": "srgb",
                "max_level": 255,
                "black_level": 0.0,
                "jpeg_quality": self.jpeg_quality,
            }
        return {**levels, "noise": noise}

    def variance_dn2(self, level_dn: float) -> float:
        """Variance of a level of the linear scale."""
        noise = self.facts()["noise"]
        above = level_dn - BLACK_LEVEL_DN
        return float(noise["variance_at_black_dn2"] + noise["variance_per_dn"] * above)

    def expected_dn(self, light: FloatArray) -> FloatArray:
        """Noise-free level of the linear scale, clipped as by the sensor."""
        level = BLACK_LEVEL_DN + np.maximum(light, 0.0) * (WHITE_DN * self.exposure)
        return np.minimum(level, float(ADC_MAX_DN))

    def levels(self, light: FloatArray, rng: np.random.Generator) -> NDArray[np.uint16]:
        """Levels of 12 bits, with noise."""
        if self.gain_e_per_dn is None:
            return np.rint(self.expected_dn(light)).astype(np.uint16)
        sensor = Sensor(
            white_e_per_us=1.0,
            gain_e_per_dn=self.gain_e_per_dn,
            read_noise_e=self.read_noise_e,
            full_well_e=self.gain_e_per_dn * ADC_MAX_DN,
            black_level_dn=BLACK_LEVEL_DN,
        )
        electrons = np.maximum(light, 0.0) * (WHITE_DN * self.exposure * self.gain_e_per_dn)
        return sensor.expose(electrons, 0.0, "Mono12", rng).astype(np.uint16)

    def stored(self, light: FloatArray, rng: np.random.Generator) -> bytes:
        """Photograph as a file."""
        levels = self.levels(light, rng)
        if self.jpeg_quality is None:
            return _tiff_bytes(levels)
        file = BytesIO()
        Image.fromarray(srgb_levels(levels)).save(file, "JPEG", quality=self.jpeg_quality)
        return file.getvalue()


def srgb_levels(levels_dn: NDArray[np.uint16]) -> NDArray[np.uint8]:
    """8-bit levels of linear ones: black to 0, the largest level to 255.

    IEC 61966-2-1:1999, section 5.2.
    """
    scale = np.arange(ADC_MAX_DN + 1.0)
    linear = np.clip((scale - BLACK_LEVEL_DN) / (ADC_MAX_DN - BLACK_LEVEL_DN), 0.0, 1.0)
    curve = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    return np.asarray(np.rint(255 * curve).astype(np.uint8)[levels_dn])


def truth_tiff(levels_dn: FloatArray, dtype: type[np.uint16] | type[np.int16]) -> bytes:
    """Noise-free levels, or their differences, in steps of 1/16 DN."""
    return _tiff_bytes(np.rint(levels_dn * STEPS_PER_DN).astype(dtype))


def labels_tiff(labels: NDArray[np.bool_] | NDArray[np.uint8]) -> bytes:
    """Numbers of the pixels as a file; of a mask 1 where it holds."""
    return _tiff_bytes(labels.astype(np.uint8))


def _tiff_bytes(levels: NDArray[Any]) -> bytes:
    """Uncompressed grey TIFF that holds nothing but the levels."""
    file = BytesIO()
    tifffile.imwrite(file, levels, photometric="minisblack", metadata=None, software=False)
    return file.getvalue()
