"""Charts of slanted dark squares, whose Fourier series is in closed form."""

from dataclasses import dataclass
from math import ceil, cos, floor, radians, sin
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from hil_mocks.benchmark_set.frames import MARGIN_PX, Grid, Series
from hil_mocks.benchmark_set.lenses import Lens, contrast, falls_to

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
