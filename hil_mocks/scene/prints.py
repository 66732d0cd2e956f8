"""Printed targets: photographs with detail finer than the camera resolves, and a skin lesion."""

from functools import cache
from importlib.resources import as_file, files

import numpy as np
import scipy.fft
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter
from scipy.special import expit
from skimage.io import imread

from hil_mocks.scene.scenes import Coordinates, Reflectance
from hil_mocks.scene.spline import PeriodicImage

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


class LayeredPrint:
    """Sum of periodic layers, each with its own pitch: ``offset + sum of layers``.

    Parameters
    ----------
    layers
        Image and pitch in mm; the middle of each image is at the origin.
    offset
        Reflectance added everywhere.
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

    Raises
    ------
    KeyError
        If it is not one of `PHOTOGRAPHS`.
    """
    return luma(name).astype(np.float32)


def luma(name: str) -> NDArray[np.float64]:
    """See `photograph`; the same on every processor but for the last bits."""
    with as_file(files("skimage") / "data" / PHOTOGRAPHS[name]) as path:
        pixels = np.asarray(imread(path), dtype=np.float64) / 255
    return np.asarray(pixels @ REC_601 if pixels.ndim == 3 else pixels)


def print_photograph(name: str) -> LayeredPrint:
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
    return LayeredPrint(
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


def print_lesion() -> LayeredPrint:
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
    return LayeredPrint([(PeriodicImage(reflectance.astype(np.float32)), GRAIN_PITCH_MM)])


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
