"""Flat scenes in millimetres whose Gaussian blur has a closed form.

Plane coordinates follow the image of an upright camera: x to the right, y down, the origin
where the unmoved optical axis meets the plane. Reflectance 1 is white paper.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import cos, radians, sin
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

Coordinates = NDArray[np.float64]
Reflectance = NDArray[np.float64] | NDArray[np.float32]

WHITE_PAPER = 1.0
"""Reflectance of white paper, the unit of every reflectance here."""

BLACK_PAPER = 0.06
"""Reflectance of printed black; toner on paper reflects a few per cent."""

STEP_REACH = 6.0
"""Widths beyond which a Gaussian step is taken as complete; 1 - Phi(6) is 1e-9."""


class Scene(Protocol):
    """A plane that reflects light."""

    def reflectance(self, x_mm: Coordinates, y_mm: Coordinates, sigma_mm: float) -> Reflectance:
        """Reflectance after a Gaussian blur, exact rather than sampled.

        Parameters
        ----------
        x_mm, y_mm
            Plane coordinates, any shape, the same for both.
        sigma_mm
            Standard deviation of the isotropic blur, at least 0.

        Returns
        -------
        ndarray, of that shape
            The scene convolved with the Gaussian; 1 is white paper.
        """
        ...


def gaussian_step(distance_mm: Coordinates, sigma_mm: float) -> NDArray[np.float64]:
    """Unit step at distance 0 after a Gaussian blur: Phi(distance / sigma)."""
    step = (distance_mm > 0).astype(np.float64)
    if sigma_mm == 0:
        return step
    near = np.abs(distance_mm) < STEP_REACH * sigma_mm
    step[near] = ndtr(distance_mm[near] / sigma_mm)
    return step


@dataclass(frozen=True, slots=True, kw_only=True)
class Uniform:
    """A uniform sheet."""

    level: float = WHITE_PAPER

    def reflectance(self, x_mm: Coordinates, y_mm: Coordinates, sigma_mm: float) -> Reflectance:
        """See `Scene.reflectance`."""
        return np.full(x_mm.shape, self.level)


@dataclass(frozen=True, slots=True, kw_only=True)
class Edge:
    """A straight edge along the x axis: ``low`` above it, ``high`` below (y > 0)."""

    low: float = BLACK_PAPER
    high: float = WHITE_PAPER

    def reflectance(self, x_mm: Coordinates, y_mm: Coordinates, sigma_mm: float) -> Reflectance:
        """See `Scene.reflectance`."""
        return self.low + (self.high - self.low) * gaussian_step(y_mm, sigma_mm)


@dataclass(frozen=True, slots=True, kw_only=True)
class Rectangle:
    """A rectangle about the origin, parallel to the axes; ``contrast`` inside and 0 outside."""

    width_mm: float
    height_mm: float
    contrast: float

    def reflectance(self, x_mm: Coordinates, y_mm: Coordinates, sigma_mm: float) -> Reflectance:
        """See `Scene.reflectance`."""
        half_x, half_y = self.width_mm / 2, self.height_mm / 2
        across = gaussian_step(x_mm + half_x, sigma_mm) - gaussian_step(x_mm - half_x, sigma_mm)
        down = gaussian_step(y_mm + half_y, sigma_mm) - gaussian_step(y_mm - half_y, sigma_mm)
        return self.contrast * across * down


@dataclass(frozen=True, slots=True, kw_only=True)
class ZonePlate:
    """Rings whose frequency grows with the radius, under a Gaussian window.

    ``amplitude cos(a r^2) exp(-r^2 / (2 window^2))``, where ``a`` makes the local frequency
    ``freq_cy_per_mm`` at a radius of one window. It is the real part of a Gaussian with complex
    variance, and so is its blur.
    """

    amplitude: float
    window_mm: float
    freq_cy_per_mm: float

    def reflectance(self, x_mm: Coordinates, y_mm: Coordinates, sigma_mm: float) -> Reflectance:
        """See `Scene.reflectance`."""
        chirp = np.pi * self.freq_cy_per_mm / self.window_mm
        precision = complex(1 / self.window_mm**2, -2 * chirp)
        spread = 1 + precision * sigma_mm**2
        r2 = x_mm**2 + y_mm**2
        seen = r2 < (STEP_REACH**2) * (self.window_mm**2 + sigma_mm**2)
        rings = np.zeros(x_mm.shape)
        rings[seen] = (np.exp(-0.5 * precision / spread * r2[seen]) / spread).real
        return self.amplitude * rings


@dataclass(frozen=True, slots=True, kw_only=True)
class CellGrid:
    """A print of square cells about the origin, on a sheet of uniform ``margin``.

    Each transition between two columns or rows of cells is a Gaussian step of its own, so the
    blurred print is an exact sum over the cells within reach.

    Parameters
    ----------
    cells
        Reflectance of each cell, shape ``(rows, cols)``.
    cell_mm
        Side of a cell.
    margin
        Reflectance of the sheet around the print.
    """

    cells: NDArray[np.float64]
    cell_mm: float
    margin: float = WHITE_PAPER

    def reflectance(self, x_mm: Coordinates, y_mm: Coordinates, sigma_mm: float) -> Reflectance:
        """See `Scene.reflectance`."""
        rows, cols = self.cells.shape
        framed = np.pad(self.cells, 1, constant_values=self.margin)
        u = x_mm / self.cell_mm + cols / 2 + 1
        v = y_mm / self.cell_mm + rows / 2 + 1
        sigma = sigma_mm / self.cell_mm
        reach = int(np.ceil(STEP_REACH * sigma))
        at_col, at_row = np.floor(u).astype(np.intp), np.floor(v).astype(np.intp)
        offsets = range(-reach, reach + 1)
        wide = [_cell_weight(u - at_col - k, sigma) for k in offsets]
        high = [_cell_weight(v - at_row - k, sigma) for k in offsets]
        total = np.zeros(x_mm.shape)
        for k, row_weight in zip(offsets, high, strict=True):
            row = np.clip(at_row + k, 0, rows + 1)
            for m, col_weight in zip(offsets, wide, strict=True):
                col = np.clip(at_col + m, 0, cols + 1)
                total += row_weight * col_weight * framed[row, col]
        return total


def _cell_weight(position: Coordinates, sigma: float) -> NDArray[np.float64]:
    """Fraction of a Gaussian about ``position`` inside the unit cell from 0 to 1."""
    return gaussian_step(position, sigma) - gaussian_step(position - 1, sigma)


@dataclass(frozen=True, slots=True, kw_only=True)
class Placed:
    """A scene turned by ``angle_deg`` from +x towards +y, then moved."""

    scene: Scene
    x_mm: float = 0.0
    y_mm: float = 0.0
    angle_deg: float = 0.0

    def reflectance(self, x_mm: Coordinates, y_mm: Coordinates, sigma_mm: float) -> Reflectance:
        """See `Scene.reflectance`."""
        c, s = cos(radians(self.angle_deg)), sin(radians(self.angle_deg))
        x, y = x_mm - self.x_mm, y_mm - self.y_mm
        return self.scene.reflectance(c * x + s * y, c * y - s * x, sigma_mm)


class SumOfScenes:
    """Sum of reflectances: a background, and parts that each extend to a certain radius.

    Parameters
    ----------
    background
        Seen everywhere.
    parts
        Scenes, each with the radius in mm about its position beyond which it is 0 except for blur.
    """

    def __init__(self, background: Scene, parts: Sequence[tuple[Placed, float]]) -> None:
        self._background = background
        self._parts = [part for part, _ in parts]
        self._position_mm = np.array([(part.x_mm, part.y_mm) for part in self._parts]).reshape(
            -1, 2
        )
        self._radius_mm = np.array([radius_mm for _, radius_mm in parts])

    def reflectance(self, x_mm: Coordinates, y_mm: Coordinates, sigma_mm: float) -> Reflectance:
        """See `Scene.reflectance`."""
        total = np.array(self._background.reflectance(x_mm, y_mm, sigma_mm), dtype=np.float64)
        reach_mm = self._radius_mm + STEP_REACH * sigma_mm
        lowest = np.array([x_mm.min(), y_mm.min()]) - reach_mm[:, None]
        highest = np.array([x_mm.max(), y_mm.max()]) + reach_mm[:, None]
        touched = ((self._position_mm > lowest) & (self._position_mm < highest)).all(axis=1)
        for index in np.flatnonzero(touched):
            part, reach = self._parts[index], reach_mm[index]
            seen = (np.abs(x_mm - part.x_mm) < reach) & (np.abs(y_mm - part.y_mm) < reach)
            total[seen] += part.reflectance(x_mm[seen], y_mm[seen], sigma_mm)
        return total
