"""Regions with a straight edge and regions without one, none of them made by the measurement.

Without: photographs of scikit-image's wheel in which nothing is straight, as they are and as prints
under the simulated camera, its lesion and its bare paper, and arcs in closed form. With: edges in
closed form (``bench_edge_fit``), bent as a lens's distortion bends them, with vignetting, in noise,
in JPEG files; and the bench's edge and board with distortion and vignetting.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from importlib.resources import as_file, files
from io import BytesIO

import numpy as np
from PIL import Image
from scipy.special import ndtr

from benchmarks.bench_edge_fit import exact_edge
from calibration.edges import EdgeImage, JpegCompression
from hil_mocks import BenchTruth
from simulation.arrays import FloatArray
from tests.hil_mocks.benches import bench_config

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
class SceneRegion:
    """What is measured: its kind, and for a true edge its width with the pixel."""

    kind: str
    source: EdgeImage = field(repr=False)
    sigma_px: float | None = None


def without_edges(count: int, seed: int) -> Iterator[SceneRegion]:
    """Regions without a straight edge: a third photographs, a half prints, a sixth arcs."""
    rng = np.random.default_rng(seed)
    pictures = {name: _photograph(name) for name in NOTHING_STRAIGHT}
    made = 0
    while made < count:
        kind = rng.choice(3, p=[0.55, 0.3, 0.15])
        if kind == 0:
            name = str(rng.choice(NOTHING_STRAIGHT))
            source = _source(_region(pictures[name], rng), is_jpeg=name.endswith(".jpg"))
            yield SceneRegion(kind=name, source=source)
            made += 1
        elif kind == 1:
            yield SceneRegion(kind="arc", source=_source(arc(rng)))
            made += 1
        else:
            name = str(rng.choice(TEXTURES))
            for region in _of_bench(name, rng, min(_REGIONS_A_VIEW, count - made)):
                yield SceneRegion(kind=f"bench {name}", source=region)
                made += 1


def arc(rng: np.random.Generator) -> FloatArray:
    """The border of a disc of 12 to 150 px, its profile a Gaussian's, in noise."""
    side = int(rng.integers(_LEAST_SIDE_PX, _LARGEST_SIDE_PX))
    y, x = np.mgrid[:side, :side] - (side - 1) / 2
    radius, sigma = _log_uniform(rng, 12.0, 150.0), _log_uniform(rng, 0.4, 3.0)
    angle, offset = rng.uniform(0, 2 * np.pi), rng.uniform(-0.2, 0.2) * side
    away = np.hypot(x - (offset - radius) * np.cos(angle), y - (offset - radius) * np.sin(angle))
    low, contrast = 20.0, rng.uniform(40.0, 200.0)
    image = low + contrast * ndtr((radius - away) * rng.choice([-1.0, 1.0]) / sigma)
    return np.asarray(image + rng.normal(0, contrast / _log_uniform(rng, 30, 1000), image.shape))


def with_edges(count: int, seed: int) -> Iterator[SceneRegion]:
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
        yield SceneRegion(kind=kind, source=source, sigma_px=total)


def edges_of_bench(views: int, seed: int) -> Iterator[SceneRegion]:
    """Whole views of the bench's edge and board, with distortion, vignetting and noise."""
    rng = np.random.default_rng(seed)
    for _ in range(views):
        name = str(rng.choice(["edge", "edge", "board"]))
        sigma = rng.uniform(0.4, 2.0)
        frame = _frame(_bench(sigma, rng), name, rng, rng.uniform(0, 360), (120.0, 300.0))
        source = _source(frame, saturation_dn=4095.0)
        yield SceneRegion(
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


RegionMaker = Callable[[int, int], Iterator[SceneRegion]]
