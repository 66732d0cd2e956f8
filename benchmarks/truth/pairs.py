"""Flat scenes to photograph twice: textures, retina, skin lesion, rectangles, print, tiles.

A scene is the cubic B-spline of random coefficients on a fine grid, mirrored beyond its border, so
that it is known exactly everywhere and its copies are no copies for a camera. Shares nothing with
``simulation``.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from math import cos, hypot, pi, radians, sin, sqrt
from typing import Protocol

import cv2
import numpy as np
import scipy.fft

from benchmarks.truth.lenses import Camera, gaussian
from calibration.registration import DistortedPose
from hil_mocks.truth import distort, leaning_rotation, plane_rays, spline_at, undistort
from simulation.arrays import BoolArray, Float32Array, FloatArray

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


def _power_law_noise(
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
    return _power_law_noise(rng, size, 1.3, 60.0) + 0.8 * np.abs(
        _power_law_noise(rng, size, 1.6, 40.0)
    )


def _retina(rng: np.random.Generator, size: tuple[int, int]) -> FloatArray:
    """Branching vessels on a ground that darkens outwards."""
    rows, cols = size
    made = np.zeros(size, dtype=np.float32)
    for _ in range(26):
        start = rng.uniform(0, 1, 2) * (cols, rows)
        _branch(rng, made, start, rng.uniform(0, 2 * pi), rng.uniform(4, 9) * SAMPLES_PER_PX, 0)
    vessels = cv2.GaussianBlur(made, (0, 0), 0.8 * SAMPLES_PER_PX)
    y, x = np.meshgrid(np.linspace(-1, 1, rows), np.linspace(-1, 1, cols), indexing="ij")
    return np.asarray(
        -0.5 * (x * x + y * y) - vessels + 0.12 * _power_law_noise(rng, size, 1.2, 30.0)
    )


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
    radius = np.hypot(x, y) / (0.2 * cols) + 0.16 * _power_law_noise(rng, size, 2.0, 120.0)
    spot = 1 / (1 + np.exp((radius - 1) * 9))
    network = np.abs(_power_law_noise(rng, size, 1.5, 14.0))
    skin = 0.09 * _power_law_noise(rng, size, 1.3, 18.0)
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
    return np.asarray(paper / 255 + 0.02 * _power_law_noise(rng, size, 1.0, 30.0))


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


_FOCAL_PER_WIDTH = 1.24
_MARGIN_PX = 8


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

    @property
    def rays(self) -> FloatArray:
        """Rays that meet the plane, which is 1 from the reference's camera, shape (3, 3)."""
        rotation = leaning_rotation(self.tilt_deg, self.bearing_deg, self.turn_deg)
        return plane_rays(rotation, np.array([0.0, 0.0, 1.0]) - self.zoom * rotation[:, 2])

    def shown(self, x_px: FloatArray, y_px: FloatArray, frame: tuple[int, int]) -> BoolArray:
        """Whether the reference shows what lies at follow-up positions."""
        (rows, cols), (x, y) = frame, self.positions(x_px, y_px, frame)
        return np.asarray((x >= 0) & (x <= cols - 1) & (y >= 0) & (y <= rows - 1))

    def matrix(self, frame: tuple[int, int]) -> FloatArray:
        """Ideal follow-up pixel ``(x, y, 1)`` to ideal reference pixel, shape (3, 3)."""
        rows, cols = frame
        rays = self.rays
        focal = _FOCAL_PER_WIDTH * cols
        x, y = (cols - 1) / 2, (rows - 1) / 2
        lens = np.array([[focal, 0, x], [0, focal, y], [0, 0, 1.0]])
        aside = np.eye(3)
        aside[:2, 2] = self.shift[0] * cols, self.shift[1] * rows
        made = aside @ lens @ rays @ np.linalg.inv(lens)
        return np.asarray(made / made[2, 2])

    def known(self, frame: tuple[int, int]) -> DistortedPose:
        """The true pose, as a comparison can be told it."""
        return DistortedPose(
            matrix=self.matrix(frame),
            k1=self.distortion_k1,
            reference_shape=frame,
            followup_shape=frame,
        )

    def positions(
        self, x_px: FloatArray, y_px: FloatArray, frame: tuple[int, int]
    ) -> tuple[FloatArray, FloatArray]:
        """Reference positions (x, y) of follow-up positions, as photographed."""
        x, y = self.ideal_positions(x_px, y_px, frame)
        u, v, w = np.tensordot(self.matrix(frame), np.stack([x, y, np.ones_like(x)]), axes=1)
        return self._moved(u / w, v / w, frame, distort)

    def ideal_positions(
        self, x_px: FloatArray, y_px: FloatArray, frame: tuple[int, int]
    ) -> tuple[FloatArray, FloatArray]:
        """Positions (x, y) that a lens without distortion would have shown."""
        if self.distortion_k1 == 0:
            return x_px, y_px
        return self._moved(x_px, y_px, frame, undistort)

    def _moved(
        self,
        x_px: FloatArray,
        y_px: FloatArray,
        frame: tuple[int, int],
        move: Callable[[FloatArray, float], FloatArray],
    ) -> tuple[FloatArray, FloatArray]:
        """Positions whose radius, 1 at the frame's corner, is distorted or not."""
        middle_y, middle_x = ((n - 1) / 2 for n in frame)
        x, y = x_px - middle_x, y_px - middle_y
        radius = np.hypot(x, y) / hypot(middle_x, middle_y) + np.finfo(np.float64).tiny
        factor = move(radius, self.distortion_k1) / radius
        return x * factor + middle_x, y * factor + middle_y


@dataclass(frozen=True, slots=True, kw_only=True)
class Spot:
    """A Gaussian spot that one photograph's scene has; place and width in reference px."""

    x_px: float
    y_px: float
    sigma_px: float
    amplitude_dn: float


def spot_image(frame: tuple[int, int], x_px: float, y_px: float, sigma_px: float) -> FloatArray:
    """A Gaussian of peak 1 on the pixels of a frame."""
    x, y = np.arange(frame[1]) - x_px, np.arange(frame[0])[:, None] - y_px
    return np.asarray(np.exp(-(x**2 + y**2) / (2 * sigma_px**2)))


@dataclass(frozen=True, slots=True, kw_only=True)
class Development:
    """What a camera makes of the levels behind its lens; applied in this order.

    ``slope`` is the relative change of light from left to right, ``gamma`` the exponent of a tone
    curve that keeps full scale (0.45: a common photograph), ``sharpening`` amount and width in px
    of an unsharp mask. Levels are rounded and clipped to ``bits``, each DN here being one of 8.
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
        square = (x_px - true_x) ** 2 + (y_px - true_y) ** 2
        return float(np.sqrt(np.mean(square[self.pose.shown(x, y, self.frame)])))

    def overlap(self) -> float:
        """Share of the follow-up that the reference shows."""
        rows, cols = self.frame
        y, x = np.mgrid[:rows:8, :cols:8].astype(np.float64)
        return float(np.mean(self.pose.shown(x, y, self.frame)))


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


class _Scene(Protocol):
    """What can be photographed."""

    def at(self, x_px: FloatArray, y_px: FloatArray) -> Float32Array:
        """Levels at positions in reference pixels; both of one shape."""
        ...


def photograph(
    scene: _Scene,
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
