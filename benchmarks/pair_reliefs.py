"""Two photographs of a scene that is not flat, or of which a part moved, with everything known.

What stands out of the scene's plane is seen displaced by the follow-up: smoothly, as on a relief,
or as opaque layers with a texture of their own in front of the ground, which cover and uncover it.
A thing that moved over its background is such a layer too. Shares nothing with ``simulation``.
"""

from dataclasses import dataclass, field, replace
from math import cos, radians, sin

import numpy as np

from benchmarks.pair_photographs import DEFAULT_CAMERA, PairPose, photograph
from benchmarks.pair_scenes import FlatScene
from simulation.arrays import BoolArray, Float32Array, FloatArray


@dataclass(frozen=True, slots=True, kw_only=True)
class Bump:
    """A smooth displacement: a Gaussian; all in reference px, ``(x, y)``."""

    centre_px: tuple[float, float]
    width_px: float
    shift_px: tuple[float, float]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Layer:
    """An opaque rectangle or ellipse before the ground, displaced in the follow-up; reference px.

    ``half_px`` are half its sides, or axes.
    """

    scene: FlatScene = field(repr=False)
    centre_px: tuple[float, float]
    half_px: tuple[float, float]
    angle_deg: float
    is_round: bool
    shift_px: tuple[float, float]

    def covers(self, x_px: FloatArray, y_px: FloatArray) -> BoolArray:
        """Whether the layer, not displaced, is seen there."""
        x, y = x_px - self.centre_px[0], y_px - self.centre_px[1]
        c, s = cos(radians(self.angle_deg)), sin(radians(self.angle_deg))
        across, along = (c * x + s * y) / self.half_px[0], (c * y - s * x) / self.half_px[1]
        if self.is_round:
            return np.asarray(across * across + along * along < 1)
        return np.asarray((np.abs(across) < 1) & (np.abs(along) < 1))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ReliefScene:
    """A ground with what stands out of it, as one of the two photographs sees it.

    ``displaced`` is the part of every displacement that the photograph shows, 0 or 1; the last
    layer is in front.
    """

    ground: FlatScene = field(repr=False)
    bumps: tuple[Bump, ...] = ()
    layers: tuple[Layer, ...] = ()
    displaced: float = 0.0

    def shift_at(self, x_px: FloatArray, y_px: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Displacement ``(x, y)`` of what the follow-up shows at these reference positions."""
        x, y = np.zeros(np.shape(x_px)), np.zeros(np.shape(y_px))
        for bump in self.bumps:
            square = (x_px - bump.centre_px[0]) ** 2 + (y_px - bump.centre_px[1]) ** 2
            height = np.exp(-square / (2 * bump.width_px**2))
            x += bump.shift_px[0] * height
            y += bump.shift_px[1] * height
        for layer in self.layers:
            there = layer.covers(x_px - layer.shift_px[0], y_px - layer.shift_px[1])
            x[there], y[there] = layer.shift_px
        return x, y

    def at(self, x_px: FloatArray, y_px: FloatArray) -> Float32Array:
        """Levels at positions in reference pixels; both of one shape."""
        smooth = replace(self, layers=())
        x, y = smooth.shift_at(x_px, y_px)
        levels = self.ground.at(x_px - self.displaced * x, y_px - self.displaced * y)
        for layer in self.layers:
            x = x_px - self.displaced * layer.shift_px[0]
            y = y_px - self.displaced * layer.shift_px[1]
            there = layer.covers(x, y)
            levels[there] = layer.scene.at(x[there], y[there])
        return levels


def relief_pair(
    relief: ReliefScene, frame: tuple[int, int], pose: PairPose
) -> tuple[FloatArray, FloatArray]:
    """Levels behind the lens of the reference and of the follow-up, shape ``frame`` each."""
    still = PairPose(distortion_k1=pose.distortion_k1)
    before, after = replace(relief, displaced=0.0), replace(relief, displaced=1.0)
    return (
        photograph(before, frame, still, DEFAULT_CAMERA),
        photograph(after, frame, pose, DEFAULT_CAMERA),
    )
