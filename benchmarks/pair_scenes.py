"""Flat scenes to photograph twice: textures, retina, skin lesion, rectangles, print, tiles.

A scene is the cubic B-spline of random coefficients on a fine grid, mirrored beyond its border, so
that it is known exactly everywhere and its copies are no copies for a camera. Shares nothing with
``simulation``.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from math import cos, pi, sin

import cv2
import numpy as np
import scipy.fft

from hil_mocks.benchmark_set.spline_scene import spline_at
from simulation.arrays import Float32Array, FloatArray

SAMPLES_PER_PX = 4
"""Coefficients along one pixel of the reference."""

_TILE_PX = 110
_LETTERS = np.array(list("abcdefghiklmnoprstuvwyzABDEGHKMRST0123456789"))


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class FlatScene:
    """A scene in DN; ``origin_px`` is where reference pixel (0, 0) lies, ``(x, y)`` in px.

    ``coefficients`` has ``SAMPLES_PER_PX`` to a pixel of the reference.
    """

    name: str
    coefficients: Float32Array = field(repr=False)
    origin_px: tuple[float, float]

    def at(self, x_px: FloatArray, y_px: FloatArray) -> Float32Array:
        """Levels at positions in reference pixels; both of one shape."""
        left, top = self.origin_px
        x = (np.ravel(x_px) + left) * SAMPLES_PER_PX
        y = (np.ravel(y_px) + top) * SAMPLES_PER_PX
        return spline_at(self.coefficients, x, y).reshape(np.shape(x_px)).astype(np.float32)


Painter = Callable[[np.random.Generator, tuple[int, int]], FloatArray]
"""Paints a scene of ``(rows, cols)`` fine cells, in any units."""


def scene(
    name: str, frame: tuple[int, int], seed: int, *, contrast_dn: float, mean_dn: float = 110.0
) -> FlatScene:
    """Scene of a kind (``SCENES``) around a reference of ``frame`` ``(rows, cols)``.

    Its standard deviation over the reference's frame is ``contrast_dn``, its mean ``mean_dn``.
    """
    rows, cols = frame
    margin = 0.45
    size = tuple(round(n * (1 + 2 * margin)) * SAMPLES_PER_PX for n in frame)
    painted = SCENES[name](np.random.default_rng(seed), (size[0], size[1]))
    top, left = margin * rows, margin * cols
    inner = painted[
        int(top * SAMPLES_PER_PX) : int((top + rows) * SAMPLES_PER_PX),
        int(left * SAMPLES_PER_PX) : int((left + cols) * SAMPLES_PER_PX),
    ]
    levels = mean_dn + (painted - inner.mean()) * (contrast_dn / inner.std())
    return FlatScene(name=name, coefficients=levels.astype(np.float32), origin_px=(left, top))


def _noise(
    rng: np.random.Generator, size: tuple[int, int], slope: float, coarsest_px: float = 1e9
) -> FloatArray:
    """Random field with a power-law amplitude, unit variance."""
    fy = scipy.fft.fftfreq(size[0], 1 / SAMPLES_PER_PX)[:, None]
    fx = scipy.fft.rfftfreq(size[1], 1 / SAMPLES_PER_PX)[None]
    radius = np.hypot(np.hypot(fy, fx), 1 / coarsest_px)
    radius[0, 0] = np.inf
    phase = rng.uniform(0, 2 * pi, radius.shape)
    made = scipy.fft.irfft2(radius**-slope * np.exp(1j * phase), s=size)
    return np.asarray(made / made.std())


def _texture(rng: np.random.Generator, size: tuple[int, int]) -> FloatArray:
    """Grains of several sizes with ridges, like plaster or grass from above."""
    return _noise(rng, size, 1.3, 60.0) + 0.8 * np.abs(_noise(rng, size, 1.6, 40.0))


def _retina(rng: np.random.Generator, size: tuple[int, int]) -> FloatArray:
    """Branching vessels on a ground that darkens outwards."""
    rows, cols = size
    made = np.zeros(size, dtype=np.float32)
    for _ in range(26):
        start = rng.uniform(0, 1, 2) * (cols, rows)
        _branch(rng, made, start, rng.uniform(0, 2 * pi), rng.uniform(4, 9) * SAMPLES_PER_PX, 0)
    vessels = cv2.GaussianBlur(made, (0, 0), 0.8 * SAMPLES_PER_PX)
    y, x = np.meshgrid(np.linspace(-1, 1, rows), np.linspace(-1, 1, cols), indexing="ij")
    return np.asarray(-0.5 * (x * x + y * y) - vessels + 0.12 * _noise(rng, size, 1.2, 30.0))


def _branch(
    rng: np.random.Generator,
    canvas: Float32Array,
    start: FloatArray,
    angle: float,
    width: float,
    depth: int,
) -> None:
    point = start
    for _ in range(int(rng.uniform(12, 30))):
        angle += rng.normal(0, 0.22)
        reach = 14 * SAMPLES_PER_PX
        ahead = point + reach * np.array([cos(angle), sin(angle)])
        ends = [tuple(np.round(end).astype(int).tolist()) for end in (point, ahead)]
        cv2.line(
            canvas, ends[0], ends[1], 0.4 + 0.06 * width / SAMPLES_PER_PX, max(round(width), 2)
        )
        point = ahead
        if depth < 3 and rng.uniform() < 0.12:
            _branch(rng, canvas, point, angle + rng.choice([-1, 1]) * 0.6, 0.7 * width, depth + 1)


def _lesion(rng: np.random.Generator, size: tuple[int, int]) -> FloatArray:
    """A pigmented spot with a soft ragged border and a network in it, skin lines and hairs."""
    rows, cols = size
    y, x = np.meshgrid(np.arange(rows) - rows / 2, np.arange(cols) - cols / 2, indexing="ij")
    radius = np.hypot(x, y) / (0.2 * cols) + 0.16 * _noise(rng, size, 2.0, 120.0)
    spot = 1 / (1 + np.exp((radius - 1) * 9))
    network = np.abs(_noise(rng, size, 1.5, 14.0))
    skin = 0.09 * _noise(rng, size, 1.3, 18.0)
    hairs = np.zeros(size, dtype=np.float32)
    for _ in range(14):
        at, angle = rng.uniform(0, 1, 2) * (cols, rows), rng.uniform(0, pi)
        reach = rng.uniform(60, 200) * SAMPLES_PER_PX * np.array([cos(angle), sin(angle)])
        ends = [tuple(np.round(at + sign * reach).astype(int).tolist()) for sign in (-1, 1)]
        cv2.line(hairs, ends[0], ends[1], 1.0, round(1.6 * SAMPLES_PER_PX))
    blurred = cv2.GaussianBlur(hairs, (0, 0), 0.5 * SAMPLES_PER_PX)
    return np.asarray(-spot * (1 + 0.35 * network) + skin - 0.5 * blurred)


def _mondrian(rng: np.random.Generator, size: tuple[int, int]) -> FloatArray:
    """Opaque slanted rectangles over one another, sides of 4 to 60 px."""
    rows, cols = size
    cells = np.full(size, 0.5, dtype=np.float32)
    for _ in range(round(0.006 * rows * cols / SAMPLES_PER_PX**2)):
        sides = np.exp(rng.uniform(np.log(4.0), np.log(60.0), 2)) * SAMPLES_PER_PX
        centre, turn = rng.uniform(0, 1, 2) * (cols, rows), rng.uniform(0, 180)
        box = cv2.boxPoints((tuple(centre.tolist()), tuple(sides.tolist()), float(turn)))
        cv2.fillConvexPoly(cells, np.round(box * 16).astype(np.int32), rng.uniform(), shift=4)
    return np.asarray(cells, dtype=np.float64)


def _text(rng: np.random.Generator, size: tuple[int, int]) -> FloatArray:
    """Lines of print of several sizes on paper."""
    rows, cols = size
    paper = np.full(size, 230, dtype=np.uint8)
    y = 0.0
    while y < rows:
        scale = rng.choice([0.35, 0.45, 0.6, 0.9]) * SAMPLES_PER_PX
        y += 30 * scale
        x = rng.uniform(0, 20) * SAMPLES_PER_PX
        while x < cols:
            word = "".join(rng.choice(_LETTERS, rng.integers(2, 10)))
            face = int(rng.choice([cv2.FONT_HERSHEY_SIMPLEX, cv2.FONT_HERSHEY_COMPLEX]))
            where = (round(x), round(y))
            thickness = max(round(1.6 * scale), 1)
            cv2.putText(paper, word, where, face, float(scale), 30, thickness, cv2.LINE_AA)
            x += cv2.getTextSize(word, face, float(scale), thickness)[0][0] + 14 * scale
    return np.asarray(paper / 255 + 0.02 * _noise(rng, size, 1.0, 30.0))


def _tiled(rng: np.random.Generator, size: tuple[int, int]) -> FloatArray:
    """One textured tile again and again, exactly."""
    side = _TILE_PX * SAMPLES_PER_PX
    tile = _texture(rng, (side, side))
    return np.asarray(np.tile(tile, [n // side + 1 for n in size])[: size[0], : size[1]])


SCENES: dict[str, Painter] = {
    "texture": _texture,
    "retina": _retina,
    "lesion": _lesion,
    "mondrian": _mondrian,
    "text": _text,
    "tiled": _tiled,
}
