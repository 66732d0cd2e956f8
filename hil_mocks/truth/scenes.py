"""Flat scenes in millimetres whose Gaussian blur has a closed form.

Plane coordinates follow the image of an upright camera: x to the right, y down, the origin
where the unmoved optical axis meets the plane. Reflectance 1 is white paper.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from importlib.resources import as_file, files
from math import cos, radians, sin
from typing import Protocol, runtime_checkable

import numpy as np
import scipy.fft
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter
from scipy.special import expit, ndtr
from skimage.io import imread

from hil_mocks.truth._images import PeriodicImage

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
        """Reflectance after a Gaussian blur of at least 0 mm, exact rather than sampled.

        Of plane coordinates of any shape, the same for both; 1 is white paper.
        """
        ...


@runtime_checkable
class SceneWithRelief(Scene, Protocol):
    """A scene that looks different from elsewhere."""

    def seen_from(self, x_mm: float, y_mm: float, distance_mm: float) -> Scene:
        """What a pupil at that distance above the plane sees, as a picture on the plane."""
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
    """A print of square cells about the origin, shape ``(rows, cols)``, on a uniform ``margin``.

    Each transition between two columns or rows of cells is a Gaussian step of its own, so the
    blurred print is an exact sum over the cells within reach.
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
        return self.scene.reflectance(*self.own_mm(x_mm, y_mm), sigma_mm)

    def seen_from(self, x_mm: float, y_mm: float, distance_mm: float) -> "Placed":
        """See `SceneWithRelief`; a flat scene looks the same from everywhere."""
        if not isinstance(self.scene, SceneWithRelief):
            return self
        x, y = (float(at) for at in self.own_mm(np.asarray(x_mm), np.asarray(y_mm)))
        return replace(self, scene=self.scene.seen_from(x, y, distance_mm))

    def own_mm(
        self, x_mm: Coordinates, y_mm: Coordinates
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Places in the scene's own coordinates."""
        c, s = cos(radians(self.angle_deg)), sin(radians(self.angle_deg))
        x, y = x_mm - self.x_mm, y_mm - self.y_mm
        return c * x + s * y, c * y - s * x


class SumOfScenes:
    """Sum of reflectances: a background, and parts that each extend to a certain radius.

    Beyond that radius in mm about its position a part is 0, except for blur.
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


PHOTOGRAPHS = {
    "astronaut": "astronaut.png",
    "brick": "brick.png",
    "camera": "camera.png",
    "coins": "coins.png",
    "grass": "grass.png",
    "gravel": "gravel.png",
    "motorcycle": "motorcycle_left.png",
}
"""Photographs in scikit-image's wheel; the others of its catalogue would be downloaded."""

GRAIN = "gravel"
"""The photograph whose fine detail replaces what the samples of the others cannot hold."""

GRAIN_PITCH_MM = 0.1
"""Pitch of the finest print: 0.48 camera px at 200 mm with an 8 mm lens and 8.3 um pixels."""

PRINT_WIDTH_MM, PRINT_HEIGHT_MM = 164.0, 122.0
"""Field of view of the same camera from 200 mm, 162 mm x 120 mm: one photograph covers it."""

SPLIT_SIGMA = 0.7
"""Blur, in samples of the coarse layer, at which the grain replaces it."""

REC_601 = np.array([0.299, 0.587, 0.114])
"""Luma weights of ITU-R BT.601."""

DARKEST, LIGHTEST = 0.04, 0.96
LESION_SAMPLES = 2048
LESION_SEED = 20


class _LayeredPrint:
    """Sum of periodic layers, each with its own pitch in mm: ``offset + sum of layers``.

    The middle of each image is at the origin.
    """

    def __init__(self, layers: list[tuple[PeriodicImage, float]], offset: float = 0.0) -> None:
        self._layers = layers
        self._offset = offset

    def reflectance(self, x_mm: Coordinates, y_mm: Coordinates, sigma_mm: float) -> Reflectance:
        """See `Scene.reflectance`."""
        total = np.full(x_mm.shape, self._offset, dtype=np.float32)
        for image, pitch_mm in self._layers:
            rows, cols = image.shape
            total += image.blurred(
                x_mm / pitch_mm + (cols - 1) / 2,
                y_mm / pitch_mm + (rows - 1) / 2,
                sigma_mm / pitch_mm,
            )
        return total


@cache
def photograph(name: str) -> NDArray[np.float32]:
    """Luma in [0, 1] of a photograph in scikit-image's wheel, shape ``(rows, cols)``.

    KeyError if it is not one of `PHOTOGRAPHS`.
    """
    return luma(name).astype(np.float32)


def luma(name: str) -> NDArray[np.float64]:
    """See `photograph`; the same on every processor but for the last bits."""
    with as_file(files("skimage") / "data" / PHOTOGRAPHS[name]) as path:
        pixels = np.asarray(imread(path), dtype=np.float64) / 255
    return np.asarray(pixels @ REC_601 if pixels.ndim == 3 else pixels)


def print_photograph(name: str) -> _LayeredPrint:
    """A photograph as wide as the frame from 200 mm, with detail beyond its own samples.

    One tile at a pitch of half a camera pixel would cover a third of the frame, and a print
    that repeats inside the frame cannot be registered. So the photograph is printed once over
    the frame, and what its samples cannot hold, above about 0.2 cycles per sample, is taken from
    the photograph `GRAIN` at `GRAIN_PITCH_MM`: natural surfaces look alike at all scales. Both
    layers are tiled by reflection.
    """
    picture, grain = photograph(name), photograph(GRAIN)
    pitch_mm = max(PRINT_WIDTH_MM / picture.shape[1], PRINT_HEIGHT_MM / picture.shape[0])
    grain = grain - gaussian_filter(grain, SPLIT_SIGMA * pitch_mm / GRAIN_PITCH_MM, mode="reflect")
    lowest = float(picture.min() + grain.min())
    contrast = (LIGHTEST - DARKEST) / (float(picture.max() + grain.max()) - lowest)
    return _LayeredPrint(
        [
            (_reflected(picture * np.float32(contrast), SPLIT_SIGMA), pitch_mm),
            (_reflected(grain * np.float32(contrast)), GRAIN_PITCH_MM),
        ],
        DARKEST - contrast * lowest,
    )


def _reflected(tile: NDArray[np.float32], own_sigma: float = 0.0) -> PeriodicImage:
    """The tile with its mirror images all around it."""
    rows, cols = tile.shape
    around = ((rows // 2, rows - rows // 2), (cols // 2, cols - cols // 2))
    return PeriodicImage(np.pad(tile, around, mode="symmetric"), own_sigma)


def print_lesion() -> _LayeredPrint:
    """A pigmented skin lesion of about 45 mm x 35 mm: border, network, globules, skin lines."""
    rng = np.random.default_rng(LESION_SEED)
    size = LESION_SAMPLES
    axis_mm = ((np.arange(size) - (size - 1) / 2) * GRAIN_PITCH_MM).astype(np.float32)
    x, y = axis_mm[None, :], axis_mm[:, None]
    bearing = np.arctan2(y, x)
    border_mm = 20.0 + 3.5 * np.cos(2 * bearing + 0.4)
    for lobes in range(3, 9):
        border_mm += rng.normal(0, 3 / lobes) * np.cos(lobes * bearing + rng.uniform(0, 2 * np.pi))
    inside = expit((border_mm - np.hypot(x, y) + 0.8 * _noise(rng, size, 1.0)) / 0.7)
    network = expit(6 * (np.abs(_noise(rng, size, 0.45)) - 0.35))
    globules = expit(8 * (_noise(rng, size, 0.9) - 1.6))
    pigment = inside * (0.44 + 0.08 * _noise(rng, size, 5.0) - 0.14 * network + 0.14 * globules)
    lines = np.exp(-np.abs(_noise(rng, size, 1.6)) / 0.12)
    skin = 0.75 + 0.02 * _noise(rng, size, 15.0) - 0.05 * lines + 0.02 * _noise(rng, size, 0.12)
    reflectance = np.clip(skin - pigment - _hairs(rng, size), DARKEST, LIGHTEST)
    return _LayeredPrint([(PeriodicImage(reflectance.astype(np.float32)), GRAIN_PITCH_MM)])


def _noise(rng: np.random.Generator, size: int, grain_mm: float) -> NDArray[np.float32]:
    """Periodic Gaussian noise of unit variance, strongest at a period of ``4.4 grain_mm``."""
    freq_y = scipy.fft.fftfreq(size, GRAIN_PITCH_MM)[:, None].astype(np.float32)
    freq_x = scipy.fft.rfftfreq(size, GRAIN_PITCH_MM)[None, :].astype(np.float32)
    power = np.float32(2 * np.pi * grain_mm) ** 2 * (freq_y**2 + freq_x**2)
    spectrum = scipy.fft.rfft2(rng.standard_normal((size, size), dtype=np.float32))
    spectrum *= power * np.exp(-power / 2)
    field = scipy.fft.irfft2(spectrum, s=(size, size))
    return np.asarray(field / field.std())


def _hairs(rng: np.random.Generator, size: int) -> NDArray[np.float32]:
    """Depth of a few thin, bent hairs, drawn as a chain of Gaussian dots."""
    depth = np.zeros((size, size), dtype=np.float32)
    step_mm, radius = GRAIN_PITCH_MM / 2, 4
    around = np.arange(-radius, radius + 1)
    for _ in range(9):
        turn, bend = rng.uniform(0, np.pi), rng.normal(0, 0.006)
        middle_mm, half_mm = rng.normal(0, 14, size=2), rng.uniform(10, 30)
        along = np.arange(-half_mm, half_mm, step_mm)
        across = bend * along**2
        col = (middle_mm[0] + np.cos(turn) * along - np.sin(turn) * across) / GRAIN_PITCH_MM
        row = (middle_mm[1] + np.sin(turn) * along + np.cos(turn) * across) / GRAIN_PITCH_MM
        for x, y in zip(col + size / 2, row + size / 2, strict=True):
            cols, rows = int(x) + around, int(y) + around
            distance2 = (rows - y)[:, None] ** 2 + (cols - x)[None, :] ** 2
            depth[np.ix_(rows, cols)] += np.exp(-distance2 / 2)
    return np.asarray(0.12 * depth)
