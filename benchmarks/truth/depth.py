"""Scenes with depth, photographed twice: hills, plates above a ground, and both.

Rays of every subpixel are followed to the surface that they meet first; where a pixel of one
photograph lies in the other, and whether it is seen there, is worked out from the same surfaces.
Shares nothing with ``simulation``, nor with what estimates parallax.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from math import cos, radians, sin, tan
from typing import Literal

import cv2
import numpy as np

from benchmarks.truth.pairs import FlatScene, scene
from simulation.arrays import BoolArray, Float32Array, FloatArray

DepthKind = Literal["hills", "plates", "both", "flat"]

_FRAME = (300, 400)
_SUBPIXELS = 3
"""Rays along a pixel."""

_PSF_PX = 0.7
_ROUNDS = 40
"""Of the fixed-point iteration that follows a ray to a hill: slopes times obliqueness stay below
.5, so that 1e-9 px is left."""

_SAME_PX = 1e-3
"""Difference of the heights of one point, seen by two cameras."""

_WITH_HILLS, _WITH_PLATES = ("hills", "both"), ("plates", "both")
_STEEPEST = 1.2
"""Height of a hill over its width."""

_TEXTURES = ("texture", "mondrian", "lesion", "retina")


@dataclass(frozen=True, slots=True, kw_only=True)
class Hill:
    """A Gaussian elevation: centre, width and height in reference pixels."""

    x_px: float
    y_px: float
    sigma_px: float
    height_px: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Plate:
    """A level disc or rectangle above the ground, with a texture of its own, in reference px."""

    x_px: float
    y_px: float
    half_width_px: float
    half_height_px: float
    is_round: bool
    height_px: float
    texture: FlatScene

    def covers(self, x: FloatArray, y: FloatArray) -> BoolArray:
        """Whether points of its plane lie on it."""
        u, v = (x - self.x_px) / self.half_width_px, (y - self.y_px) / self.half_height_px
        return u**2 + v**2 <= 1 if self.is_round else np.maximum(np.abs(u), np.abs(v)) <= 1


@dataclass(frozen=True, slots=True, kw_only=True)
class View:
    """A pinhole camera before the ground, whose reference looks straight at it.

    Lengths are in pixels of ground as the reference sees it. ``x_px, y_px``: where its axis meets
    the ground. ``tilt_deg, bearing_deg``: of the axis out of the ground's normal, and towards
    where; so it stands aside by the distance times the tangent of the tilt.
    """

    focal_px: float = 1200.0
    distance_px: float = 1200.0
    x_px: float = 0.0
    y_px: float = 0.0
    tilt_deg: float = 0.0
    bearing_deg: float = 0.0
    roll_deg: float = 0.0

    @property
    def rotation(self) -> FloatArray:
        """From the world's axes to the camera's, shape (3, 3)."""
        bearing, tilt, roll = map(radians, (self.bearing_deg, self.tilt_deg, self.roll_deg))
        axis = np.array([-sin(bearing), cos(bearing), 0.0])
        leaning, _ = cv2.Rodrigues(-axis * tilt)
        turned, _ = cv2.Rodrigues(np.array([0.0, 0.0, roll]))
        return np.asarray(turned @ leaning, dtype=np.float64)

    @property
    def centre(self) -> FloatArray:
        """Place of the camera, shape (3,)."""
        bearing = radians(self.bearing_deg)
        aside = self.distance_px * tan(radians(self.tilt_deg))
        return np.array(
            [self.x_px - aside * cos(bearing), self.y_px - aside * sin(bearing), self.distance_px]
        )

    def rays(self, x: FloatArray, y: FloatArray, frame: tuple[int, int]) -> FloatArray:
        """Directions of pixels, shape (3, ...); towards the ground, whose heights count up."""
        rows, cols = frame
        seen = np.stack(
            [(x - (cols - 1) / 2) / self.focal_px, (y - (rows - 1) / 2) / self.focal_px, 0 * x + 1]
        )
        ray = np.tensordot(self.rotation.T, seen, axes=1)
        return np.stack([ray[0], ray[1], -ray[2]])

    def pixels(self, points: FloatArray, frame: tuple[int, int]) -> tuple[FloatArray, FloatArray]:
        """Pixels ``(x, y)`` of points of the world, shape (3, ...)."""
        rows, cols = frame
        apart = points - self.centre.reshape((3,) + (1,) * (points.ndim - 1))
        seen = np.tensordot(self.rotation, np.stack([apart[0], apart[1], -apart[2]]), axes=1)
        x, y = (self.focal_px * one / seen[2] for one in seen[:2])
        return x + (cols - 1) / 2, y + (rows - 1) / 2


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DepthScene:
    """A textured ground with hills, and plates above it; the ground's plane has height 0."""

    ground: FlatScene
    hills: tuple[Hill, ...] = ()
    plates: tuple[Plate, ...] = ()
    frame: tuple[int, int] = _FRAME

    def points(self, view: View, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Points (3, ...) that pixels see first, and the number of their surface; 0: ground."""
        ray, centre = view.rays(x, y, self.frame), view.centre
        slope = ray[:2] / -ray[2]
        height = np.zeros(x.shape)
        for _ in range(_ROUNDS if self.hills else 0):
            at = [c + s * (centre[2] - height) for c, s in zip(centre, slope, strict=False)]
            height = self._hills_at(at[0], at[1])
        surface = np.zeros(x.shape)
        for number, plate in enumerate(sorted(self.plates, key=lambda one: one.height_px), 1):
            at = [
                c + s * (centre[2] - plate.height_px) for c, s in zip(centre, slope, strict=False)
            ]
            on = plate.covers(at[0], at[1]) & (plate.height_px > height)
            height, surface = np.where(on, plate.height_px, height), np.where(on, number, surface)
        at = [c + s * (centre[2] - height) for c, s in zip(centre, slope, strict=False)]
        return np.stack([at[0], at[1], height]), surface

    def _hills_at(self, x: FloatArray, y: FloatArray) -> FloatArray:
        total = np.zeros(np.shape(x))
        for hill in self.hills:
            square = ((x - hill.x_px) ** 2 + (y - hill.y_px) ** 2) / hill.sigma_px**2
            total += hill.height_px * np.exp(-square / 2)
        return total

    def photograph(self, view: View) -> Float32Array:
        """The scene in DN without noise, through the pixels' aperture and a Gaussian PSF."""
        rows, cols = self.frame
        margin = 6
        step = (np.arange(_SUBPIXELS) + 0.5) / _SUBPIXELS - 0.5
        y, x = np.meshgrid(
            (np.arange(-margin, rows + margin)[:, None] + step).ravel(),
            (np.arange(-margin, cols + margin)[:, None] + step).ravel(),
            indexing="ij",
        )
        points, surface = self.points(view, x, y)
        rows_mid, cols_mid = (rows - 1) / 2, (cols - 1) / 2
        at_x, at_y = points[0] + cols_mid, points[1] + rows_mid
        levels = self.ground.at(at_x, at_y)
        for number, plate in enumerate(sorted(self.plates, key=lambda one: one.height_px), 1):
            on = surface == number
            levels[on] = plate.texture.at(at_x[on], at_y[on])
        blurred = cv2.GaussianBlur(levels, (0, 0), _PSF_PX * _SUBPIXELS)
        binned = blurred.reshape(rows + 2 * margin, _SUBPIXELS, cols + 2 * margin, _SUBPIXELS)
        return np.asarray(binned.mean(axis=(1, 3))[margin:-margin, margin:-margin], np.float32)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DepthPair:
    """Two photographs of a scene with depth, in DN without noise, and what is true of them.

    ``places_px``: where the follow-up's pixels lie in the reference, ``(y, x)``, shape (2, rows,
    cols). ``is_seen``: whether the reference shows them. ``plane_px``: where they would lie if all
    were on the ground. ``height_px``: of what they see, above the ground.
    """

    reference_dn: Float32Array = field(repr=False)
    followup_dn: Float32Array = field(repr=False)
    places_px: FloatArray = field(repr=False)
    plane_px: FloatArray = field(repr=False)
    is_seen: BoolArray = field(repr=False)
    height_px: FloatArray = field(repr=False)

    def noisy(self, rng: np.random.Generator, sigma_dn: float) -> tuple[Float32Array, Float32Array]:
        """Both with white noise, rounded."""
        noisy = [
            np.rint(image + rng.normal(0, sigma_dn, image.shape))
            for image in (self.reference_dn, self.followup_dn)
        ]
        return noisy[0].astype(np.float32), noisy[1].astype(np.float32)


def depth_pair(made: DepthScene, reference: View, followup: View) -> DepthPair:
    """Photograph a scene twice."""
    rows, cols = made.frame
    y, x = np.meshgrid(np.arange(float(rows)), np.arange(float(cols)), indexing="ij")
    points, _ = made.points(followup, x, y)
    at_x, at_y = reference.pixels(points, made.frame)
    inside = (at_x > -0.5) & (at_x < cols - 0.5) & (at_y > -0.5) & (at_y < rows - 0.5)
    again, _ = made.points(reference, at_x, at_y)
    is_seen = inside & (np.abs(again[2] - points[2]) < _SAME_PX)
    on_plane, _ = replace(made, hills=(), plates=()).points(followup, x, y)
    plane_x, plane_y = reference.pixels(on_plane, made.frame)
    return DepthPair(
        reference_dn=made.photograph(reference),
        followup_dn=made.photograph(followup),
        places_px=np.stack([at_y, at_x]),
        plane_px=np.stack([plane_y, plane_x]),
        is_seen=is_seen,
        height_px=points[2],
    )


@lru_cache(maxsize=8)
def _texture(name: str, seed: int) -> FlatScene:
    return scene(name, _FRAME, seed, contrast_dn=28.0)


def depth_scene(kind: DepthKind, seed: int, parallax_px: float, baseline: float) -> DepthScene:
    """A scene whose highest point has so much parallax, seen from ``baseline`` of the distance."""
    rng = np.random.default_rng(seed)
    distance = View().distance_px
    # A height h at a distance D has the parallax f b / D * h / (D - h), with f = D in pixels.
    top = parallax_px / baseline
    top = top / (1 + top / distance)
    ground, *others = rng.permutation(_TEXTURES).tolist()
    textures = [_texture(name, seed + number) for number, name in enumerate(others[:2], 2)]
    return DepthScene(
        ground=_texture(ground, seed + 1),
        hills=_hills(rng, top if kind == "hills" else 0.4 * top) if kind in _WITH_HILLS else (),
        plates=_plates(rng, top, textures) if kind in _WITH_PLATES else (),
    )


def _hills(rng: np.random.Generator, top_px: float) -> tuple[Hill, ...]:
    """Five, of which the first is the highest; steeper ones would hide what is behind them."""
    widths = rng.uniform(35, 80, 5)
    shares = [1.0, *rng.uniform(-0.3, 1.0, 4)]
    return tuple(
        Hill(
            x_px=rng.uniform(-180, 180),
            y_px=rng.uniform(-130, 130),
            sigma_px=width,
            height_px=share * min(top_px, _STEEPEST * width),
        )
        for width, share in zip(widths.tolist(), shares, strict=True)
    )


def _plates(
    rng: np.random.Generator, top_px: float, textures: Sequence[FlatScene]
) -> tuple[Plate, ...]:
    """Six, of which the first is the highest."""
    return tuple(
        Plate(
            x_px=rng.uniform(-170, 170),
            y_px=rng.uniform(-120, 120),
            half_width_px=rng.uniform(18, 55),
            half_height_px=rng.uniform(18, 55),
            is_round=bool(rng.integers(2)),
            height_px=top_px * (1.0 if number == 0 else rng.uniform(0.2, 1.0)),
            texture=textures[number % 2],
        )
        for number in range(6)
    )
