"""Scenes of the benchmark: printed photographs, surfaces, print, tiles, rectangles, a skin lesion.

Each is painted on fine cells, made as soft as one cell, and taken as the coefficients of a cubic
B-spline. Shapes are drawn in whole numbers and blurred in float64, so that they are the same on
every processor.
"""

import hashlib
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from math import cos, hypot, pi, sin

import cv2
import numpy as np
import scipy.fft
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, spline_filter

from hil_mocks.truth import (
    SAMPLES_PER_PX,
    SplineScene,
    distort,
    leaning_rotation,
    luma,
    plane_rays,
    spline_at,
    undistort,
)


def stream(seed: int, *names: str) -> np.random.Generator:
    """Return the generator of a name, independent of those of all others."""
    digest = hashlib.sha256("/".join(names).encode("utf-8")).digest()
    words = np.frombuffer(digest, dtype="<u4").tolist()
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence([seed, *words])))


FloatArray = NDArray[np.float64]

EXTENT = 2.4
"""Height and width of a scene over those of the reference's frame; mirrored beyond."""

SOFTNESS_CELLS = 1.2
"""Gaussian blur of the painted cells, by which 8 samples a pixel are enough at every zoom."""

MEAN, DARKEST, LIGHTEST = 0.42, 0.03, 0.98
PRINTED = ("gravel", "brick", "grass", "camera", "coins", "astronaut")
"""Photographs in scikit-image's wheel that anybody may use for anything."""

_LETTERS = np.array(list("abcdefghiklmnoprstuvwyzABDEGHKMRST0123456789"))

Painter = Callable[[np.random.Generator, tuple[int, int]], FloatArray]
"""Paints ``(rows, cols)`` fine cells, in any units."""


@lru_cache(maxsize=2)
def scene(name: str, shape: tuple[int, int], seed: int) -> SplineScene:
    """Scene of a name such as ``gravel-2`` around a reference of ``shape`` ``(rows, cols)``."""
    kind = name.partition("-")[0]
    rng = stream(seed, "scene", name)
    rows, cols = (round(n * EXTENT) * SAMPLES_PER_PX for n in shape)
    painted = SCENES[kind](rng, (rows, cols))
    soft = gaussian_filter(painted, SOFTNESS_CELLS, mode="reflect")
    contrast = rng.uniform(0.13, 0.19)
    levels = MEAN + (soft - soft.mean()) * (contrast / soft.std())
    return SplineScene(name=name, shape=shape, coefficients=np.clip(levels, DARKEST, LIGHTEST))


def _noise(
    rng: np.random.Generator, size: tuple[int, int], slope: float, coarsest_px: float
) -> FloatArray:
    """Random field with a power-law amplitude below its coarsest period; unit variance."""
    fy = scipy.fft.fftfreq(size[0], 1 / SAMPLES_PER_PX)[:, None]
    fx = scipy.fft.rfftfreq(size[1], 1 / SAMPLES_PER_PX)[None]
    amplitude = (fy * fy + fx * fx + coarsest_px**-2) ** (-slope / 2)
    amplitude[0, 0] = 0.0
    turns = rng.uniform(0, 2 * pi, amplitude.shape)
    made = scipy.fft.irfft2(amplitude * np.exp(1j * turns), s=size, overwrite_x=True)
    return np.asarray(made / made.std())


def _printed(name: str) -> Painter:
    def painter(rng: np.random.Generator, size: tuple[int, int]) -> FloatArray:
        """A photograph over the scene, with grain beyond its own samples."""
        picture = luma(name)
        if rng.uniform() < 0.5:
            picture = picture.T
        picture = np.ascontiguousarray(picture[:: rng.choice([-1, 1]), :: rng.choice([-1, 1])])
        coefficients = spline_filter(picture, order=3, mode="reflect")
        pitch = max(n / count for n, count in zip(size, picture.shape, strict=True))
        finer = rng.uniform(0.75, 1.0) / pitch
        y, x = (np.arange(n) * finer for n in size)
        seen = spline_at(coefficients, *np.meshgrid(x, y))
        return np.asarray(seen / seen.std() + 0.22 * _noise(rng, size, 0.9, 6.0))

    return painter


def _texture(rng: np.random.Generator, size: tuple[int, int]) -> FloatArray:
    """Grains of several sizes with ridges, like plaster."""
    ridges = np.abs(_noise(rng, size, 1.6, 35.0))
    return _noise(rng, size, 1.3, 50.0) + rng.uniform(0.5, 1.0) * ridges


def _lesion(rng: np.random.Generator, size: tuple[int, int]) -> FloatArray:
    """A pigmented spot with a soft ragged border and a network in it, skin lines and hairs."""
    rows, cols = size
    y, x = np.meshgrid(np.arange(rows) - rows / 2, np.arange(cols) - cols / 2, indexing="ij")
    radius = np.sqrt(x * x + y * y) / (0.11 * cols) + 0.16 * _noise(rng, size, 2.0, 120.0)
    spot = 1 / (1 + np.exp((radius - 1) * 9))
    network = np.abs(_noise(rng, size, 1.5, 14.0))
    skin = 0.12 * _noise(rng, size, 1.3, 18.0) - 0.1 * np.abs(_noise(rng, size, 1.4, 40.0))
    hairs = np.zeros(size, dtype=np.uint8)
    for _ in range(24):
        middle, angle = rng.uniform(0, 1, 2) * (cols, rows), rng.uniform(0, pi)
        reach = rng.uniform(40, 160) * SAMPLES_PER_PX * np.array([cos(angle), sin(angle)])
        ends = [tuple(np.rint(middle + sign * reach).astype(int).tolist()) for sign in (-1, 1)]
        cv2.line(hairs, ends[0], ends[1], 1, round(1.5 * SAMPLES_PER_PX))
    return np.asarray(-spot * (1 + 0.35 * network) + skin - 0.5 * hairs)


def _rectangles(rng: np.random.Generator, size: tuple[int, int]) -> FloatArray:
    """Opaque slanted rectangles over one another, sides of 4 to 60 px."""
    rows, cols = size
    cells = np.full(size, 128, dtype=np.uint8)
    for _ in range(round(0.006 * rows * cols / SAMPLES_PER_PX**2)):
        half = np.exp(rng.uniform(np.log(4.0), np.log(60.0), 2)) * SAMPLES_PER_PX / 2
        centre, turn = rng.uniform(0, 1, 2) * (cols, rows), rng.uniform(0, pi)
        c, s = cos(turn), sin(turn)
        corners = [
            (
                centre[0] + c * i * half[0] - s * j * half[1],
                centre[1] + s * i * half[0] + c * j * half[1],
            )
            for i, j in ((-1, -1), (1, -1), (1, 1), (-1, 1))
        ]
        outline = np.rint(np.array(corners) * 16).astype(np.int32)
        cv2.fillConvexPoly(cells, outline, int(rng.integers(0, 256)), shift=4)
    return cells / 255 + 0.02 * _noise(rng, size, 1.0, 30.0)


def _print(rng: np.random.Generator, size: tuple[int, int]) -> FloatArray:
    """Lines of print of several sizes on paper."""
    rows, cols = size
    paper = np.full(size, 230, dtype=np.uint8)
    y = 0.0
    while y < rows:
        scale = float(rng.choice([0.35, 0.45, 0.6, 0.9])) * SAMPLES_PER_PX
        y += 30 * scale
        x = rng.uniform(0, 20) * SAMPLES_PER_PX
        while x < cols:
            word = "".join(rng.choice(_LETTERS, rng.integers(2, 10)))
            face = int(rng.choice([cv2.FONT_HERSHEY_SIMPLEX, cv2.FONT_HERSHEY_COMPLEX]))
            thickness = max(round(1.6 * scale), 1)
            cv2.putText(paper, word, (round(x), round(y)), face, scale, 30, thickness, cv2.LINE_AA)
            x += cv2.getTextSize(word, face, scale, thickness)[0][0] + 14 * scale
    return paper / 255 + 0.03 * _noise(rng, size, 1.0, 30.0)


def _tiles(rng: np.random.Generator, size: tuple[int, int]) -> FloatArray:
    """Tiles with joints between them, each of its own shade, all with one pattern."""
    side = round(rng.uniform(36, 60)) * SAMPLES_PER_PX
    pattern = 0.3 * _noise(rng, (side, side), 1.3, 30.0)
    joint = 2 * SAMPLES_PER_PX
    pattern[:joint], pattern[:, :joint] = -1.6, -1.6
    counts = [n // side + 1 for n in size]
    shades = np.repeat(np.repeat(rng.normal(0, 0.5, counts), side, 0), side, 1)
    tiled = np.tile(pattern, counts)
    tiled[tiled > -1.6] += shades[tiled > -1.6]
    return np.asarray(tiled[: size[0], : size[1]] + 0.12 * _noise(rng, size, 1.1, 20.0))


SCENES: dict[str, Painter] = {
    "gravel": _printed("gravel"),
    "print": _print,
    "camera": _printed("camera"),
    "texture": _texture,
    "brick": _printed("brick"),
    "lesion": _lesion,
    "astronaut": _printed("astronaut"),
    "tiles": _tiles,
    "grass": _printed("grass"),
    "rectangles": _rectangles,
    "coins": _printed("coins"),
}


Positions = tuple[FloatArray, FloatArray]

FOCAL_LENGTH_PER_WIDTH = 1.24
"""Focal length in pixels, over the columns of the reference's frame."""

REFERENCE_DISTANCE_MM = 300.0
"""From the reference's pupil to the plane; heights of reliefs are in mm above the plane."""

_RELIEF_STEPS = 6


@dataclass(frozen=True, slots=True, kw_only=True)
class Bump:
    """A Gaussian elevation, its middle and width in reference px."""

    x_px: float
    y_px: float
    sigma_px: float
    height_mm: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Pose:
    """The follow-up's camera beside the reference's, which looks straight at the plane.

    Frames are ``(rows, cols)`` with the optical axis at their middles.
    """

    reference_shape: tuple[int, int]
    followup_shape: tuple[int, int]
    zoom: float = 1.0  # ratio of the distances along the optical axes, follow-up over reference
    tilt_deg: float = 0.0  # angle between the axes
    bearing_deg: float = 0.0  # direction that the follow-up's axis leans to
    roll_deg: float = 0.0  # turn about its own axis
    # Of its axis on the plane, from the reference's middle.
    shift_px: tuple[float, float] = (0.0, 0.0)
    k1: float = 0.0  # seen at r (1 + k1 r^2); r in halves of the reference's diagonal
    relief: tuple[Bump, ...] = ()  # elevations above the plane

    @property
    def focal_length_px(self) -> float:
        """Of both cameras, which are one."""
        return FOCAL_LENGTH_PER_WIDTH * self.reference_shape[1]

    @property
    def rotation(self) -> FloatArray:
        """Axes of the follow-up's camera in the reference's, shape (3, 3)."""
        return leaning_rotation(self.tilt_deg, self.bearing_deg, self.roll_deg)

    @property
    def pupil(self) -> FloatArray:
        """Position with the plane at depth 1 before the reference's pupil, the origin."""
        middle = [shift / self.focal_length_px for shift in self.shift_px]
        return np.asarray(np.array([*middle, 1.0]) - self.zoom * self.rotation[:, 2])

    @property
    def matrix(self) -> FloatArray:
        """Ideal follow-up pixels to ideal reference pixels, through the plane, shape (3, 3)."""
        rotation, pupil = self.rotation, self.pupil
        made = self._lens(self.reference_shape) @ plane_rays(rotation, pupil)
        made = made @ np.linalg.inv(self._lens(self.followup_shape))
        return np.asarray(made / made[2, 2])

    def rays(self, x_px: FloatArray, y_px: FloatArray) -> FloatArray:
        """Directions of ideal pixels in their own camera, of depth 1, shape (3, ...)."""
        middle_x, middle_y = self._lens(self.reference_shape)[:2, 2]
        across, down = x_px - middle_x, y_px - middle_y
        focal = self.focal_length_px
        return np.stack([across / focal, down / focal, np.ones_like(across)])

    def seen_by_reference_at(
        self, x: FloatArray, y: FloatArray, depth: float | FloatArray
    ) -> Positions:
        """Ideal reference pixels of points before its pupil, in units of the plane's depth."""
        middle_x, middle_y = self._lens(self.reference_shape)[:2, 2]
        scale = self.focal_length_px / depth
        return x * scale + middle_x, y * scale + middle_y

    def _lens(self, shape: tuple[int, int]) -> FloatArray:
        middle_x, middle_y = (shape[1] - 1) / 2, (shape[0] - 1) / 2
        focal = self.focal_length_px
        return np.array([[focal, 0, middle_x], [0, focal, middle_y], [0, 0, 1.0]])

    def on_plane(self, x_px: FloatArray, y_px: FloatArray) -> Positions:
        """Ideal reference positions of the plane's points that follow-up pixels look at."""
        x, y = self._ideal(x_px, y_px, self.followup_shape)
        h = self.matrix
        w = h[2, 0] * x + h[2, 1] * y + h[2, 2]
        u = (h[0, 0] * x + h[0, 1] * y + h[0, 2]) / w
        v = (h[1, 0] * x + h[1, 1] * y + h[1, 2]) / w
        return u, v

    def reference_points(self, x_px: FloatArray, y_px: FloatArray) -> Positions:
        """Positions in the reference, as photographed, of the plane's points."""
        u, v = self.on_plane(x_px, y_px)
        return self._scaled(u, v, self.reference_shape, is_inverse=False)

    def seen_by_reference(self, x_px: FloatArray, y_px: FloatArray) -> Positions:
        """Scene positions of reference pixels: the scene is painted as the reference sees it."""
        return self._ideal(x_px, y_px, self.reference_shape)

    def seen_by_followup(self, x_px: FloatArray, y_px: FloatArray) -> Positions:
        """Scene positions of follow-up pixels."""
        u, v = self.on_plane(x_px, y_px)
        if not self.relief:
            return u, v
        middle = self._lens(self.reference_shape)[:2, 2]
        x, y = ((at - m) / self.focal_length_px for at, m in zip((u, v), middle, strict=True))
        found_x, found_y = x, y
        for _ in range(_RELIEF_STEPS):  # a contraction by the parallax's slope
            there_x, there_y = self._through_relief(found_x, found_y, middle)
            found_x, found_y = found_x + x - there_x, found_y + y - there_y
        return (
            found_x * self.focal_length_px + middle[0],
            found_y * self.focal_length_px + middle[1],
        )

    def _through_relief(self, x: FloatArray, y: FloatArray, middle: FloatArray) -> Positions:
        """Where the follow-up's rays through the relief's points meet the plane, at depth 1."""
        height = np.zeros_like(x)
        for bump in self.relief:
            across = x * self.focal_length_px + middle[0] - bump.x_px
            down = y * self.focal_length_px + middle[1] - bump.y_px
            square = (across * across + down * down) / (2 * bump.sigma_px**2)
            height += bump.height_mm / REFERENCE_DISTANCE_MM * np.exp(-square)
        pupil = self.pupil
        depth = 1 - height
        beyond = (1 - pupil[2]) / (depth - pupil[2])
        return (
            pupil[0] + (x * depth - pupil[0]) * beyond,
            pupil[1] + (y * depth - pupil[1]) * beyond,
        )

    def _ideal(self, x_px: FloatArray, y_px: FloatArray, shape: tuple[int, int]) -> Positions:
        return self._scaled(x_px, y_px, shape, is_inverse=True) if self.k1 else (x_px, y_px)

    def _scaled(
        self, x_px: FloatArray, y_px: FloatArray, shape: tuple[int, int], *, is_inverse: bool
    ) -> Positions:
        if not self.k1:
            return x_px, y_px
        middle_x, middle_y = (shape[1] - 1) / 2, (shape[0] - 1) / 2
        unit_px = hypot(self.reference_shape[0] - 1, self.reference_shape[1] - 1) / 2
        x, y = x_px - middle_x, y_px - middle_y
        radius = np.sqrt(x * x + y * y) / unit_px + np.finfo(np.float64).tiny
        moved = undistort(radius, self.k1) if is_inverse else distort(radius, self.k1)
        factor = moved / radius
        return x * factor + middle_x, y * factor + middle_y
