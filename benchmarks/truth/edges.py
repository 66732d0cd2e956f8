"""Scenes of straight edges in closed form, behind a Gaussian lens and square pixels.

A rectangle behind a Gaussian is a product of error functions along its sides, a wedge between two
lines a bivariate normal probability; pixels average them by Gauss-Legendre quadrature.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from importlib.resources import as_file, files
from io import BytesIO

import numpy as np
from PIL import Image
from scipy.optimize import brentq
from scipy.special import ndtr

from calibration.edges import EdgeImage, JpegCompression
from calibration.noise import LevelNoise
from hil_mocks import BenchTruth
from simulation.arrays import FloatArray
from tests.hil_mocks.benches import bench_config

NODES, WEIGHTS = np.polynomial.legendre.leggauss(4)  # a pixel's mean to 1e-6 at sigma 0.5
ANGLE_NODES, ANGLE_WEIGHTS = np.polynomial.legendre.leggauss(16)
TAIL_SIGMAS = 7.0

Scene = Callable[[FloatArray, FloatArray], FloatArray]


@dataclass(frozen=True, slots=True, kw_only=True)
class Side:
    """A straight edge that is there: its middle, the angle of its normal and its length."""

    x_px: float
    y_px: float
    normal_rad: float
    length_px: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Rectangle:
    """A patch of one level: its middle, half its sides and the angle of the first."""

    x_px: float
    y_px: float
    half_px: tuple[float, float]
    angle_rad: float
    level_dn: float

    def share(self, sigma_px: float, x: FloatArray, y: FloatArray) -> FloatArray:
        """Light of a patch of level 1, behind the Gaussian."""
        c, s = math.cos(self.angle_rad), math.sin(self.angle_rad)
        dx, dy = x - self.x_px, y - self.y_px
        light = np.ones_like(x)
        for away, half in ((c * dx + s * dy, self.half_px[0]), (c * dy - s * dx, self.half_px[1])):
            light *= ndtr((away + half) / sigma_px) - ndtr((away - half) / sigma_px)
        return light

    def sides(self) -> list[Side]:
        """Right and left, below and above where the angle is 0."""
        found = []
        for first, turn in ((0, 0.0), (0, math.pi), (1, math.pi / 2), (1, -math.pi / 2)):
            normal = self.angle_rad + turn
            found.append(
                Side(
                    x_px=self.x_px + self.half_px[first] * math.cos(normal),
                    y_px=self.y_px + self.half_px[first] * math.sin(normal),
                    normal_rad=normal,
                    length_px=2 * self.half_px[1 - first],
                )
            )
        return found


def pixel_means(scene: Scene, x: FloatArray, y: FloatArray) -> FloatArray:
    """Means of a scene over the unit squares about points."""
    total = np.zeros_like(x)
    for dx, wx in zip(NODES / 2, WEIGHTS / 2, strict=True):
        for dy, wy in zip(NODES / 2, WEIGHTS / 2, strict=True):
            total += wx * wy * scene(x + dx, y + dy)
    return total


def white_noise(noise_dn: float) -> LevelNoise:
    """White noise as it is known of a source."""
    return LevelNoise(offset_dn2=noise_dn**2, slope_dn=0.0, floor_dn2=noise_dn**2)


def _both(first: FloatArray, second: FloatArray, between_rad: float) -> FloatArray:
    """Light of a wedge: probability that two normals with a correlation are below two bounds.

    Drezner and Wesolowsky, On the computation of the bivariate normal integral, 1990, eq. 3.
    """
    light = ndtr(first) * ndtr(second)
    near = (np.abs(first) < TAIL_SIGMAS) & (np.abs(second) < TAIL_SIGMAS)
    h, k = first[near], second[near]
    reach = 0.5 * (math.pi / 2 - between_rad)  # half the arc sine of the correlation
    for node, weight in zip(ANGLE_NODES, ANGLE_WEIGHTS, strict=True):
        sine = math.sin(reach * (1 + node))
        exponent = (h * h + k * k - 2 * h * k * sine) / (2 * (1 - sine * sine))
        light[near] += reach * weight * np.exp(-exponent) / (2 * math.pi)
    return light


def patches(
    shape: tuple[int, int], rectangles: Sequence[Rectangle], ground_dn: float, sigma_px: float
) -> FloatArray:
    """Patches that do not meet, on a ground."""
    image = np.full(shape, ground_dn)
    for one in rectangles:
        c, s = abs(math.cos(one.angle_rad)), abs(math.sin(one.angle_rad))
        width, height = one.half_px
        reach_x = c * width + s * height + TAIL_SIGMAS * sigma_px + 1
        reach_y = s * width + c * height + TAIL_SIGMAS * sigma_px + 1
        left, right = max(int(one.x_px - reach_x), 0), min(int(one.x_px + reach_x) + 2, shape[1])
        top, bottom = max(int(one.y_px - reach_y), 0), min(int(one.y_px + reach_y) + 2, shape[0])
        y, x = np.mgrid[top:bottom, left:right].astype(np.float64)
        light = pixel_means(partial(one.share, sigma_px), x, y)
        image[top:bottom, left:right] += (one.level_dn - ground_dn) * light
    return image


@dataclass(frozen=True, slots=True, kw_only=True)
class Crossing:
    """An edge that a line crosses, or as on a chessboard another edge where there is no line.

    Either half is ``reach_px`` long, from the crossing on.
    """

    x_px: float
    y_px: float
    normal_rad: float
    between_rad: float
    reach_px: float
    levels_dn: tuple[float, float]
    half_line_px: float
    line_dn: float | None
    sigma_px: float

    def level(self, x: FloatArray, y: FloatArray) -> FloatArray:
        """Light at points, behind the Gaussian, in DN."""
        between, dark_dn = self.between_rad, self.levels_dn[0]
        contrast = self.levels_dn[1] - dark_dn
        first = self._across(x, y, self.normal_rad)
        second = self._across(x, y, self.normal_rad + between)
        if self.line_dn is None:
            light = ndtr(first) + ndtr(second) - 2 * _both(first, second, between)
            return np.asarray(dark_dn + contrast * light)
        above, below = (second + sign * self.half_line_px / self.sigma_px for sign in (1, -1))
        line = ndtr(above) - ndtr(below)
        light = ndtr(first) - _both(first, above, between) + _both(first, below, between)
        return np.asarray(dark_dn * (1 - line) + contrast * light + self.line_dn * line)

    def sides(self) -> list[Side]:
        """Either half of the edge, and of the other one."""
        sides = self._halves(self.normal_rad)
        if self.line_dn is None:
            sides += self._halves(self.normal_rad + self.between_rad)
        return sides

    def _across(self, x: FloatArray, y: FloatArray, normal_rad: float) -> FloatArray:
        away = math.cos(normal_rad) * (x - self.x_px) + math.sin(normal_rad) * (y - self.y_px)
        return away / self.sigma_px

    def _halves(self, normal_rad: float) -> list[Side]:
        return [
            Side(
                x_px=self.x_px - along * math.sin(normal_rad),
                y_px=self.y_px + along * math.cos(normal_rad),
                normal_rad=normal_rad,
                length_px=self.reach_px,
            )
            for along in (-0.5 * self.reach_px, 0.5 * self.reach_px)
        ]


def gaussian_mtf50(sigma_px: float, normal_rad: float) -> float:
    """Frequency across an edge at which the Gaussian and the pixel leave half the contrast."""
    c, s = math.cos(normal_rad), math.sin(normal_rad)

    def above_half(freq: float) -> float:
        lens = math.exp(-2 * (math.pi * sigma_px * freq) ** 2)
        return float(lens * np.sinc(freq * c) * np.sinc(freq * s) - 0.5)

    return float(brentq(above_half, 1e-6, 1.0))


def exact_edge(parameters: FloatArray, x: FloatArray, y: FloatArray) -> FloatArray:
    """Level of pixels at (x, y); angle, offset, curvature, log sigma, low, high."""
    angle, offset, curvature, log_sigma, low, high = parameters
    c, s, sigma = np.cos(angle), np.sin(angle), np.exp(log_sigma)
    d = c * x + s * y - offset - curvature * (-s * x + c * y) ** 2
    a, b = max(abs(c), 1e-3), max(abs(s), 1e-3)
    unit = np.zeros_like(d)
    for sign, shift in ((1, a + b), (-1, a - b), (-1, b - a), (1, -a - b)):
        u = d + shift / 2
        gauss = np.exp(-0.5 * (u / sigma) ** 2) / np.sqrt(2 * np.pi)
        unit += sign * ((u**2 + sigma**2) * ndtr(u / sigma) + u * sigma * gauss) / 2
    return np.asarray(low + (high - low) * unit / (a * b))


NOTHING_STRAIGHT = (
    "cell.png",
    "chelsea.png",
    "coins.png",
    "grass.png",
    "gravel.png",
    "hubble_deep_field.jpg",
    "ihc.png",
    "moon.png",
    "retina.jpg",
)
"""Photographs in scikit-image's wheel without a straight edge."""

TEXTURES = ("coins", "grass", "gravel", "lesion", "coins", "lesion", "flat")
"""Targets of the simulated bench without one; coins and lesion have the plainest borders."""

_LUMA = np.array([0.299, 0.587, 0.114])
_LEAST_SIDE_PX, _LARGEST_SIDE_PX = 40, 160
_WIDTH_PX, _HEIGHT_PX = 480, 360
_REGIONS_A_VIEW = 6
_WHITE_DN = 255.0
_CORNER_PX = 390.0  # from the middle of a frame of 640 x 480: where distortion is the largest


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _SceneRegion:
    """What is measured: its kind, and for a true edge its width with the pixel."""

    kind: str
    source: EdgeImage = field(repr=False)
    sigma_px: float | None = None


def without_edges(count: int, seed: int) -> Iterator[_SceneRegion]:
    """Regions without a straight edge: a third photographs, a half prints, a sixth arcs."""
    rng = np.random.default_rng(seed)
    pictures = {name: _photograph(name) for name in NOTHING_STRAIGHT}
    made = 0
    while made < count:
        kind = rng.choice(3, p=[0.55, 0.3, 0.15])
        if kind == 0:
            name = str(rng.choice(NOTHING_STRAIGHT))
            source = _source(_region(pictures[name], rng), is_jpeg=name.endswith(".jpg"))
            yield _SceneRegion(kind=name, source=source)
            made += 1
        elif kind == 1:
            yield _SceneRegion(kind="arc", source=_source(_arc(rng)))
            made += 1
        else:
            name = str(rng.choice(TEXTURES))
            for region in _of_bench(name, rng, min(_REGIONS_A_VIEW, count - made)):
                yield _SceneRegion(kind=f"bench {name}", source=region)
                made += 1


def _arc(rng: np.random.Generator) -> FloatArray:
    """The border of a disc of 12 to 150 px, its profile a Gaussian's, in noise."""
    side = int(rng.integers(_LEAST_SIDE_PX, _LARGEST_SIDE_PX))
    y, x = np.mgrid[:side, :side] - (side - 1) / 2
    radius, sigma = _log_uniform(rng, 12.0, 150.0), _log_uniform(rng, 0.4, 3.0)
    angle, offset = rng.uniform(0, 2 * np.pi), rng.uniform(-0.2, 0.2) * side
    away = np.hypot(x - (offset - radius) * np.cos(angle), y - (offset - radius) * np.sin(angle))
    low, contrast = 20.0, rng.uniform(40.0, 200.0)
    image = low + contrast * ndtr((radius - away) * rng.choice([-1.0, 1.0]) / sigma)
    return np.asarray(image + rng.normal(0, contrast / _log_uniform(rng, 30, 1000), image.shape))


def with_edges(count: int, seed: int) -> Iterator[_SceneRegion]:
    """True edges in closed form, sigma .4 to 3 px, SNR 30 to 1000, half of them in JPEG files."""
    rng = np.random.default_rng(seed)
    for _ in range(count):
        sigma = _log_uniform(rng, 0.4, 3.0)
        image, contrast = _true_edge(sigma, rng)
        noise = contrast / _log_uniform(rng, 30.0, 1000.0)
        image = image + rng.normal(0, noise, image.shape)
        kind = str(rng.choice(["exact", "8 bit", "JPEG 90", "JPEG 95"], p=[0.4, 0.1, 0.25, 0.25]))
        total = math.sqrt(sigma**2 + 1 / 12)
        if kind == "exact":
            source = _source(image)
        elif kind == "8 bit":
            source = _source(np.clip(np.rint(image), 0, _WHITE_DN))
        else:
            source = _compressed(image, int(kind[-2:]), bool(rng.integers(2)))
        yield _SceneRegion(kind=kind, source=source, sigma_px=total)


def edges_of_bench(views: int, seed: int) -> Iterator[_SceneRegion]:
    """Whole views of the bench's edge and board, with distortion, vignetting and noise."""
    rng = np.random.default_rng(seed)
    for _ in range(views):
        name = str(rng.choice(["edge", "edge", "board"]))
        sigma = rng.uniform(0.4, 2.0)
        frame = _frame(_bench(sigma, rng), name, rng, rng.uniform(0, 360), (120.0, 300.0))
        source = _source(frame, saturation_dn=4095.0)
        yield _SceneRegion(
            kind=f"bench {name}", source=source, sigma_px=math.sqrt(sigma**2 + 1 / 12)
        )


def _true_edge(sigma_px: float, rng: np.random.Generator) -> tuple[FloatArray, float]:
    """A frame that an edge crosses anywhere, and its contrast."""
    shape = rng.integers(_LEAST_SIDE_PX, _LARGEST_SIDE_PX, 2)
    y, x = (
        at - (size - 1) / 2
        for at, size in zip(np.mgrid[: shape[0], : shape[1]], shape, strict=True)
    )
    angle = math.radians(rng.uniform(0, 45)) + 0.5 * math.pi * rng.integers(4)
    offset = rng.uniform(-0.25, 0.25) * min(shape)
    # A line at a distance h from the middle is bent by 2 k h / r^2 where its ends move by k.
    bend = rng.uniform(-0.01, 0.01) / _CORNER_PX
    low, contrast = rng.uniform(10, 40), rng.uniform(40, 200)
    truth = np.array([angle, offset, bend, math.log(sigma_px), low, low + contrast])
    image = exact_edge(truth, x, y)
    middle = rng.uniform(-200, 200, 2)  # of the frame, from the region
    fall = rng.uniform(0, 0.3) * ((x - middle[0]) ** 2 + (y - middle[1]) ** 2) / _CORNER_PX**2
    return image * (1 - np.minimum(fall, 0.5)), contrast


def _compressed(image: FloatArray, quality: int, is_known: bool) -> EdgeImage:
    """As a JPEG gives it back; with what is known of its compression, or without."""
    data = BytesIO()
    codes = np.clip(np.rint(image), 0, _WHITE_DN).astype(np.uint8)
    Image.fromarray(codes).save(data, "JPEG", quality=quality)
    with Image.open(data) as opened:
        steps = np.array(opened.quantization[0], dtype=np.float64).reshape(8, 8)  # type: ignore[attr-defined]  # JPEG's own
        decoded = np.asarray(opened, dtype=np.float64)
    known = JpegCompression(steps=steps, code_levels_dn=np.arange(256.0)) if is_known else None
    return EdgeImage(
        name="jpeg",
        image_dn=decoded,
        saturation_dn=_WHITE_DN,
        is_jpeg=True,
        compression=known,
    )


def _bench(sigma_px: float, rng: np.random.Generator) -> BenchTruth:
    simulated = {
        "width_px": _WIDTH_PX,
        "height_px": _HEIGHT_PX,
        "full_well_e": 30000.0,
        "optical_sigma_x_px": sigma_px,
        "optical_sigma_y_px": sigma_px,
        "k1": rng.uniform(-0.01, 0.01),
        "vignetting": rng.uniform(0.0, 0.3),
    }
    return BenchTruth(
        bench_config(
            stage__limits_mm=[10.0, 500.0],
            **{f"simulated__{key}": value for key, value in simulated.items()},
        )
    )


def _frame(
    truth: BenchTruth,
    target: str,
    rng: np.random.Generator,
    orientation_deg: float,
    heights_mm: tuple[float, float],
) -> FloatArray:
    """The mean of one to sixteen frames of a target, less the black level."""
    exposure_us, height_mm = rng.uniform(3000.0, 8000.0), rng.uniform(*heights_mm)
    mean = truth.expected_image_dn(target, orientation_deg, height_mm, exposure_us=exposure_us)
    light = np.maximum(mean - truth.black_level_dn, 0.0)
    gain = truth.gain_e_per_dn()
    variance = light / gain + (truth.read_noise_e / gain) ** 2 + 1 / 12
    frames = 2 ** rng.integers(0, 5)
    return np.asarray(light + rng.standard_normal(mean.shape) * np.sqrt(variance / frames))


def _of_bench(name: str, rng: np.random.Generator, count: int) -> Iterator[EdgeImage]:
    truth = _bench(rng.uniform(0.4, 1.0), rng)
    frame = _frame(truth, name, rng, rng.uniform(0, 360), (100.0, 300.0))
    for _ in range(count):
        yield _source(_region(frame, rng), saturation_dn=4095.0 - truth.black_level_dn)


def _photograph(name: str) -> FloatArray:
    with as_file(files("skimage") / "data" / name) as path, Image.open(path) as opened:
        pixels = np.asarray(opened, dtype=np.float64)
    return pixels[..., :3] @ _LUMA if pixels.ndim == 3 else pixels


def _region(image: FloatArray, rng: np.random.Generator) -> FloatArray:
    height, width = rng.integers(_LEAST_SIDE_PX, _LARGEST_SIDE_PX, 2)
    top = int(rng.integers(0, image.shape[0] - height + 1))
    left = int(rng.integers(0, image.shape[1] - width + 1))
    return image[top : top + height, left : left + width]


def _source(
    image: FloatArray, saturation_dn: float | None = _WHITE_DN, *, is_jpeg: bool = False
) -> EdgeImage:
    return EdgeImage(name="region", image_dn=image, saturation_dn=saturation_dn, is_jpeg=is_jpeg)


def _log_uniform(rng: np.random.Generator, least: float, most: float) -> float:
    return float(math.exp(rng.uniform(math.log(least), math.log(most))))


RegionMaker = Callable[[int, int], Iterator[_SceneRegion]]
