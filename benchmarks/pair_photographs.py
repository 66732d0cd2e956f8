"""Two photographs of a flat scene from two poses, with everything known.

The scene is sampled several times to a pixel where the pose puts it, multiplied by the camera's
transfer function and sampled again: the PSF is that of the camera in its own pixels. Then come
light, noise, tone curve, sharpening, bits and JPEG. Shares nothing with ``simulation``.
"""

from dataclasses import dataclass, field, replace
from math import cos, hypot, radians, sin, sqrt
from typing import Protocol

import cv2
import numpy as np
import scipy.fft

from benchmarks.lens_optics import Camera, gaussian
from benchmarks.pair_scenes import FlatScene
from simulation.arrays import Float32Array, FloatArray

_FOCAL_PER_WIDTH = 1.24
_MARGIN_PX = 8
_DISTORTION_STEPS = 30


@dataclass(frozen=True, slots=True, kw_only=True)
class PairPose:
    """Where the follow-up's camera stands, of the same focal length as the reference's.

    ``zoom`` is the ratio of the distances, follow-up over reference; ``shift`` the follow-up's
    centre in the reference in parts of the reference's frame ``(x, y)``; ``distortion_k1`` the
    relative distortion of both at the frame's corner.
    """

    zoom: float = 1.0
    tilt_deg: float = 0.0
    bearing_deg: float = 0.0
    turn_deg: float = 0.0
    shift: tuple[float, float] = (0.0, 0.0)
    distortion_k1: float = 0.0

    def matrix(self, frame: tuple[int, int]) -> FloatArray:
        """Ideal follow-up pixel ``(x, y, 1)`` to ideal reference pixel, shape (3, 3)."""
        rows, cols = frame
        tilt, bearing = radians(self.tilt_deg), radians(self.bearing_deg)
        towards = _about_axis(bearing)
        lean = np.array([[cos(tilt), 0, sin(tilt)], [0, 1, 0], [-sin(tilt), 0, cos(tilt)]])
        rotation = towards @ lean @ towards.T @ _about_axis(radians(self.turn_deg))
        pupil = np.array([0.0, 0.0, 1.0]) - self.zoom * rotation[:, 2]
        rays = (1 - pupil[2]) * rotation + np.outer(pupil, rotation[2])
        rays[2] = rotation[2]
        focal = _FOCAL_PER_WIDTH * cols
        x, y = (cols - 1) / 2, (rows - 1) / 2
        lens = np.array([[focal, 0, x], [0, focal, y], [0, 0, 1.0]])
        aside = np.eye(3)
        aside[:2, 2] = self.shift[0] * cols, self.shift[1] * rows
        made = aside @ lens @ rays @ np.linalg.inv(lens)
        return np.asarray(made / made[2, 2])

    def positions(
        self, x_px: FloatArray, y_px: FloatArray, frame: tuple[int, int]
    ) -> tuple[FloatArray, FloatArray]:
        """Reference positions (x, y) of follow-up positions, as photographed."""
        x, y = self.ideal_positions(x_px, y_px, frame)
        u, v, w = np.tensordot(self.matrix(frame), np.stack([x, y, np.ones_like(x)]), axes=1)
        return self._seen(u / w, v / w, frame)

    def ideal_positions(
        self, x_px: FloatArray, y_px: FloatArray, frame: tuple[int, int]
    ) -> tuple[FloatArray, FloatArray]:
        """Positions (x, y) that a lens without distortion would have shown."""
        if self.distortion_k1 == 0:
            return x_px, y_px
        middle_y, middle_x = ((n - 1) / 2 for n in frame)
        k1 = self.distortion_k1 / hypot(middle_x, middle_y) ** 2
        x, y = x_px - middle_x, y_px - middle_y
        ideal_x, ideal_y = x, y
        for _ in range(_DISTORTION_STEPS):  # a contraction by some 3 k1
            factor = 1 + k1 * (ideal_x * ideal_x + ideal_y * ideal_y)
            ideal_x, ideal_y = x / factor, y / factor
        return ideal_x + middle_x, ideal_y + middle_y

    def _seen(
        self, x_px: FloatArray, y_px: FloatArray, frame: tuple[int, int]
    ) -> tuple[FloatArray, FloatArray]:
        middle_y, middle_x = ((n - 1) / 2 for n in frame)
        x, y = x_px - middle_x, y_px - middle_y
        factor = 1 + self.distortion_k1 / hypot(middle_x, middle_y) ** 2 * (x * x + y * y)
        return x * factor + middle_x, y * factor + middle_y


@dataclass(frozen=True, slots=True, kw_only=True)
class Spot:
    """A Gaussian spot that one photograph's scene has; place and width in reference px."""

    x_px: float
    y_px: float
    sigma_px: float
    amplitude_dn: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Development:
    """What a camera makes of the levels behind its lens; applied in this order.

    Parameters
    ----------
    gain, slope
        Light, and its change from the left to the right edge, relative.
    noise_dn
        Standard deviation, independent from pixel to pixel.
    gamma
        Exponent of the tone curve (0.45: a common photograph), full scale stays.
    sharpening
        Amount and width in px of an unsharp mask.
    bits
        Levels are rounded and clipped to so many bits, each DN here being one of 8; None: float.
    jpeg_quality
        8-bit JPEG of this quality; None for none.
    """

    gain: float = 1.0
    slope: float = 0.0
    noise_dn: float = 0.0
    gamma: float = 1.0
    sharpening: tuple[float, float] | None = None
    bits: int | None = None
    jpeg_quality: int | None = None

    def of(self, levels_dn: FloatArray, seed: int) -> FloatArray:
        """Return the photograph: 0 to 255 as float, or 0 to 2^bits - 1."""
        rng = np.random.default_rng(seed)
        light = self.gain + self.slope * np.linspace(-0.5, 0.5, levels_dn.shape[1])
        made = levels_dn * light + self.noise_dn * rng.standard_normal(levels_dn.shape)
        if self.gamma != 1:
            made = 255 * np.clip(made / 255, 0, 1) ** self.gamma
        if self.sharpening is not None:
            amount, sigma_px = self.sharpening
            made = made + amount * (made - cv2.GaussianBlur(made, (0, 0), sigma_px))
        if self.jpeg_quality is not None:
            quality = [cv2.IMWRITE_JPEG_QUALITY, self.jpeg_quality]
            _, packed = cv2.imencode(
                ".jpg", np.clip(np.rint(made), 0, 255).astype(np.uint8), quality
            )
            return np.asarray(cv2.imdecode(packed, cv2.IMREAD_GRAYSCALE), dtype=np.float64)
        if self.bits is not None:
            top = 2**self.bits - 1
            made = np.clip(np.rint(made * ((top + 1) / 256)), 0, top)
        return np.asarray(made)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Pair:
    """Levels behind the lens of both cameras, without noise; ``developed`` makes photographs."""

    scene: FlatScene = field(repr=False)
    pose: PairPose
    reference_dn: FloatArray = field(repr=False)
    followup_dn: FloatArray = field(repr=False)

    @property
    def frame(self) -> tuple[int, int]:
        """``(rows, cols)`` of both."""
        return self.reference_dn.shape[0], self.reference_dn.shape[1]

    @property
    def matrix(self) -> FloatArray:
        """Ideal follow-up pixels to ideal reference pixels."""
        return self.pose.matrix(self.frame)

    def developed(
        self, before: Development, after: Development, seed: int
    ) -> tuple[FloatArray, FloatArray]:
        """Reference and follow-up, each with noise of its own."""
        return before.of(self.reference_dn, 2 * seed), after.of(self.followup_dn, 2 * seed + 1)

    def error_px(self, x_px: FloatArray, y_px: FloatArray) -> float:
        """Rms error, over the overlap, of reference positions of all follow-up pixels.

        ``x_px`` and ``y_px`` have the frame's shape.
        """
        rows, cols = self.frame
        y, x = np.mgrid[:rows, :cols].astype(np.float64)
        true_x, true_y = self.pose.positions(x, y, self.frame)
        inside = (true_x >= 0) & (true_x <= cols - 1) & (true_y >= 0) & (true_y <= rows - 1)
        square = (x_px - true_x) ** 2 + (y_px - true_y) ** 2
        return float(np.sqrt(np.mean(square[inside])))

    def overlap(self) -> float:
        """Share of the follow-up that the reference shows."""
        rows, cols = self.frame
        y, x = np.mgrid[:rows:8, :cols:8].astype(np.float64)
        u, v = self.pose.positions(x, y, self.frame)
        return float(np.mean((u >= 0) & (u <= cols - 1) & (v >= 0) & (v <= rows - 1)))


DEFAULT_CAMERA = gaussian(0.9, has_pixel=False)


def pair_of(
    scene: FlatScene,
    frame: tuple[int, int],
    pose: PairPose,
    cameras: tuple[Camera, Camera] = (DEFAULT_CAMERA, DEFAULT_CAMERA),
    spots: tuple[Spot, ...] = (),
) -> Pair:
    """Photograph a scene with the reference's camera and with the follow-up's.

    ``spots`` are in the scene of the follow-up only.
    """
    still = replace(pose, zoom=1.0, tilt_deg=0.0, bearing_deg=0.0, turn_deg=0.0, shift=(0.0, 0.0))
    return Pair(
        scene=scene,
        pose=pose,
        reference_dn=photograph(scene, frame, still, cameras[0]),
        followup_dn=photograph(scene, frame, pose, cameras[1], spots),
    )


class Scene(Protocol):
    """What can be photographed."""

    def at(self, x_px: FloatArray, y_px: FloatArray) -> Float32Array:
        """Levels at positions in reference pixels; both of one shape."""
        ...


def photograph(
    scene: Scene,
    frame: tuple[int, int],
    pose: PairPose,
    camera: Camera,
    spots: tuple[Spot, ...] = (),
) -> FloatArray:
    """Levels behind the lens, shape ``frame``."""
    # What the scene has beyond half the samples' frequency must not fold into the camera's band.
    samples = 4 if pose.zoom <= 1.5 else 6
    y, x = ((np.arange(-_MARGIN_PX * samples, (n + _MARGIN_PX) * samples) / samples) for n in frame)
    # Ideal reference positions, which is where the scene is flat.
    ideal_x, ideal_y = pose.ideal_positions(*np.meshgrid(x, y), frame)
    row = pose.matrix(frame)
    scale = row[2, 0] * ideal_x + row[2, 1] * ideal_y + row[2, 2]
    u = (row[0, 0] * ideal_x + row[0, 1] * ideal_y + row[0, 2]) / scale
    v = (row[1, 0] * ideal_x + row[1, 1] * ideal_y + row[1, 2]) / scale
    levels = scene.at(u, v)
    for spot in spots:
        square = (u - spot.x_px) ** 2 + (v - spot.y_px) ** 2
        levels += (spot.amplitude_dn * np.exp(-square / (2 * spot.sigma_px**2))).astype(np.float32)
    # Mirrored, so that the frame's left has not its right for a neighbour.
    fy = scipy.fft.fftfreq(levels.shape[0], 1 / samples)[:, None]
    fx = scipy.fft.rfftfreq(levels.shape[1], 1 / samples)[None]
    series = scipy.fft.rfft2(levels) * camera.otf(fx, fy).astype(np.float32)
    fine = scipy.fft.irfft2(series, s=levels.shape)
    inner = slice(_MARGIN_PX * samples, -_MARGIN_PX * samples, samples)
    return np.ascontiguousarray(fine[inner, inner], dtype=np.float64)


def seen_spot(
    pose: PairPose,
    frame: tuple[int, int],
    position_px: tuple[float, float],
    *,
    sigma_px: float,
    amplitude_dn: float,
    blur_px: float,
) -> Spot:
    """Spot that the follow-up shows at a position ``(x, y)`` of its own with this width and height.

    ``sigma_px`` includes the camera's blur of ``blur_px``; all in follow-up pixels.
    """
    x, y = pose.positions(np.array([position_px[0]]), np.array([position_px[1]]), frame)
    own_px2 = sigma_px**2 - blur_px**2
    return Spot(
        x_px=float(x[0]),
        y_px=float(y[0]),
        sigma_px=pose.zoom * sqrt(own_px2),
        amplitude_dn=amplitude_dn * sigma_px**2 / own_px2,
    )


def _about_axis(angle_rad: float) -> FloatArray:
    c, s = cos(angle_rad), sin(angle_rad)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
