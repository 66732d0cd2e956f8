"""Pictures that nobody of this project drew: what installed packages and ``tests/data`` hold.

Photographs, drawings, printed and shown text, textures, skin, stars, microscopy and flat labels, in
grey and in colour, all as 8-bit levels. What is not installed is left out, with the reason; where
``STANDOFF_REAL_DATA`` names a folder of real photographs, they come with it.
"""

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from importlib.util import find_spec
from io import BytesIO
from math import nan
from pathlib import Path
from shutil import copyfile
from typing import Literal
from zlib import crc32

import numpy as np
import tifffile
from numpy.typing import NDArray
from PIL import Image, ImageCms
from scipy.ndimage import gaussian_filter, map_coordinates

from simulation.arrays import FloatArray

Genre = Literal[
    "photograph", "drawing", "text", "texture", "skin", "stars", "microscopy", "flat", "other"
]
ByteImage = NDArray[np.uint8]
"""Shape ``(rows, cols)`` or ``(rows, cols, 3)``."""

LEAST_PX = 96
_REPOSITORY = Path(__file__).parents[2]
_STRETCH_PERCENT = (0.5, 99.8)


@dataclass(frozen=True, slots=True, kw_only=True)
class Picture:
    """A file that holds a picture; ``name`` is the same wherever its package is installed."""

    name: str
    genre: Genre
    path: Path

    def levels(self) -> ByteImage:
        """Levels as a person would see them: opacity before white, no palette, no stretch.

        What is no picture for the eye (stars, heights) is stretched by a square root between two
        percentiles.
        """
        if self.path.suffix == ".fits":
            return _stretched(_fits_plane(self.path))
        if self.path.suffix == ".npz":
            with np.load(self.path) as arrays:
                plane = max((arrays[name] for name in arrays.files), key=np.size)
            is_picture = plane.min() >= 0 and plane.max() <= 255
            return np.asarray(np.rint(plane), np.uint8) if is_picture else _stretched(plane)
        with Image.open(self.path) as image:
            return _seen(image)


@dataclass(frozen=True, slots=True)
class _Shelf:
    """Files of an installed package, by genre; ``distribution`` is what pip calls it."""

    package: str
    distribution: str
    folder: str
    genres: Mapping[Genre, str]

    @property
    def files(self) -> list[tuple[str, Genre]]:
        """Files below the folder in alphabetical order, with their genres."""
        pairs = [(name, genre) for genre, names in self.genres.items() for name in names.split()]
        return sorted(pairs, key=lambda pair: pair[0].lower())


SHELVES = (
    _Shelf("skimage", "scikit-image", "data", {
        "photograph": "astronaut.png camera.png chelsea.png clock_motion.png coffee.png coins.png "
        "moon.png motorcycle_left.png rocket.jpg",
        "texture": "brick.png grass.png gravel.png",
        "microscopy": "cell.png ihc.png microaneurysms.png retina.jpg",
        "flat": "chessboard_GRAY.png chessboard_RGB.png color.png horse.png phantom.png",
        "stars": "hubble_deep_field.jpg",
        "drawing": "logo.png",
        "text": "page.png text.png",
    }),
    _Shelf("matplotlib", "matplotlib", "mpl-data/sample_data", {
        "photograph": "grace_hopper.jpg",
        "texture": "jacksboro_fault_dem.npz",
        "drawing": "logo2.png Minduka_Present_Blue_Pack.png",
    }),
    _Shelf("astropy", "astropy", "", {
        "stars": "io/fits/hdu/compressed/tests/data/m13.fits io/fits/tests/data/comp.fits "
        "modeling/tests/data/1904-66_AZP.fits",
    }),
    _Shelf("nexusformat", "nexusformat", "definitions", {
        "drawing": "applications/canSAS/2012-minimum.png applications/canSAS/Q-geometry.jpg "
        "applications/stress/Beam_profile_sketch3.jpg applications/stress/gauge_volume.png "
        "applications/xps/xps_cs.png base_classes/aperture/aperture.png "
        "base_classes/mirror/mirror.png "
        "contributed_definitions/container/ComplexExampleContainer.png "
        "contributed_definitions/region/NXregion-example.png",
    }),
    _Shelf("networkx", "networkx", "drawing/tests/baseline", {
        "drawing": "test_display_complex.png test_display_labels_and_colors.png "
        "test_house_with_colors.png",
    }),
    _Shelf("distributed", "distributed", "http/static/images", {"drawing": "numpy.png"}),
    _Shelf("a11y_pygments", "accessible-pygments", "", {
        "text": "github_dark/images/github-dark.png github_light/images/github-light.png",
    }),
    _Shelf("sphinx", "sphinx", "themes/scrolls/static", {
        "texture": "darkmetal.png watermark.png",
    }),
    _Shelf("sklearn", "scikit-learn", "datasets/images", {"photograph": "china.jpg flower.jpg"}),
    _Shelf("pywt", "PyWavelets", "data", {"photograph": "aero.npz ascent.npz"}),
)  # fmt: skip
"""Different shots of one thing are different pictures; regions of one are not."""

OWN_DATA: dict[str, Genre] = {
    "chessboards/left01.jpg": "photograph",
    "chessboards/left05.jpg": "photograph",
    "chessboards/right02.jpg": "photograph",
    "chessboards/right06.jpg": "photograph",
    "edges/v_edge.tif": "flat",
}
REAL_DATA: dict[str, Genre] = {
    "lesions/OISIC_0024306.jpg": "skin",
    "lesions/OISIC_0024320.jpg": "skin",
    "null_pairs/00041000_temp.jpg": "flat",
    "null_pairs/00041018_temp.jpg": "flat",
    "planar_pairs/BruggeSquareA.jpg": "photograph",
    "planar_pairs/BrusselsA.jpg": "photograph",
    "planar_pairs/CapitalRegionA.jpg": "photograph",
    "planar_pairs/EiffelA.png": "photograph",
    "planar_pairs/LePoint1A.png": "photograph",
    "planar_pairs/WhiteBoardA.jpg": "photograph",
    "planar_pairs/adamA.png": "photograph",
    "planar_pairs/boatA.png": "photograph",
    "zoom_pairs/iphone_011H.png": "photograph",
    "zoom_pairs/iphone_031H.png": "photograph",
    "zoom_pairs/nikon_001H.png": "photograph",
    "zoom_pairs/nikon_021H.png": "photograph",
    "zoom_pairs/nikon_041H.png": "photograph",
}
_SUFFIXES = {".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".webp"}


@dataclass(frozen=True, slots=True, kw_only=True)
class _Catalogue:
    """Pictures that are here, and why others are not, a sentence each."""

    pictures: tuple[Picture, ...]
    left_out: tuple[str, ...]

    def named(self, parts: list[str]) -> tuple[Picture, ...]:
        """Pictures of these names, or else those whose names contain one; all if none is given."""
        if not parts:
            return self.pictures
        exact = tuple(one for one in self.pictures if one.name in parts)
        return exact or tuple(
            one for one in self.pictures if any(part in one.name for part in parts)
        )


def catalogue(folder: Path | None = None) -> _Catalogue:
    """Find the pictures that are installed, those of ``STANDOFF_REAL_DATA``, and of a folder."""
    pictures, left_out = list[Picture](), list[str]()
    for shelf in SHELVES:
        spec = find_spec(shelf.package)
        if spec is None or not spec.submodule_search_locations:
            left_out.append(f"{len(shelf.files)} of {shelf.distribution}: not installed")
            continue
        root = Path(spec.submodule_search_locations[0]) / shelf.folder
        missing = list[str]()
        for file, genre in shelf.files:
            path = root / file
            if path.is_file():
                name = f"{shelf.package}/{path.stem}"
                pictures.append(Picture(name=name, genre=genre, path=path))
            else:
                missing.append(path.name)
        if missing:
            left_out.append(f"{len(missing)} of {shelf.distribution}: no {', '.join(missing)}")
    pictures += _below(_REPOSITORY / "tests" / "data", "tests", OWN_DATA)
    real = os.environ.get("STANDOFF_REAL_DATA")
    if real is None:
        left_out.append(f"{len(REAL_DATA)} real photographs: STANDOFF_REAL_DATA is not set")
    else:
        found = list(_below(Path(real), "real", REAL_DATA))
        pictures += found
        if len(found) < len(REAL_DATA):
            missing_count = len(REAL_DATA) - len(found)
            left_out.append(f"{missing_count} real photographs: not in STANDOFF_REAL_DATA")
    if folder is not None:
        pictures += [
            Picture(name=f"{folder.name}/{path.stem}", genre="other", path=path)
            for path in sorted(folder.rglob("*"))
            if path.suffix.lower() in _SUFFIXES
        ]
    return _Catalogue(pictures=tuple(pictures), left_out=tuple(left_out))


def _below(root: Path, label: str, files: Mapping[str, Genre]) -> Iterator[Picture]:
    for file, genre in files.items():
        if (path := root / file).is_file():
            yield Picture(name=f"{label}/{path.stem}", genre=genre, path=path)


def region_of(
    levels: ByteImage, most: tuple[int, int], rng: np.random.Generator
) -> tuple[ByteImage, tuple[int, int]]:
    """At most ``(rows, cols)`` of a picture, anywhere in it, and its first row and column."""
    rows, cols = levels.shape[:2]
    if min(rows, cols) < LEAST_PX:
        raise ValueError(f"a picture of {rows} x {cols} pixels is too small")
    top = int(rng.integers(max(rows - most[0], 0) + 1))
    left = int(rng.integers(max(cols - most[1], 0) + 1))
    part = levels[top : top + most[0], left : left + most[1]]
    return np.ascontiguousarray(part), (top, left)


def _fits_plane(path: Path) -> FloatArray:
    from astropy.io import fits  # optional

    with fits.open(path) as units:
        planes = (unit.data for unit in units if unit.data is not None and unit.data.ndim == 2)
        return np.asarray(next(planes), dtype=np.float64)


def _stretched(plane: NDArray[np.generic]) -> ByteImage:
    values = np.asarray(plane, dtype=np.float64)
    low, high = np.nanpercentile(values, _STRETCH_PERCENT)
    share = np.clip((np.nan_to_num(values, nan=low) - low) / (high - low), 0, 1)
    return np.asarray(np.rint(255 * np.sqrt(share)), dtype=np.uint8)


def _seen(image: Image.Image) -> ByteImage:
    if image.mode in ("1", "L"):
        return np.asarray(image.convert("L"), dtype=np.uint8)
    if image.mode.startswith("I;16"):
        return np.rint(np.asarray(image) / 257).astype(np.uint8)
    opaque = image.convert("RGBA")
    paper = Image.new("RGBA", image.size, "white")
    paper.alpha_composite(opaque)
    levels = np.asarray(paper.convert("RGB"), dtype=np.uint8)
    is_grey = np.all(levels == levels[..., :1])
    return np.ascontiguousarray(levels[..., 0]) if is_grey else levels


MOST_PX = (400, 480)
"""Rows and columns of a region of a larger picture."""

QUALITIES = (75, 85, 90, 95, 98, 100)
SNR = (5.0, 1000.0)
"""Mean level of a picture over the standard deviation of its noise: the smallest, the largest."""

ZOOM = (0.7, 1.0)
UNEQUAL = (2.0, 6.0)
HEADROOM = (20.0, 235.0)
"""Levels that 0 and 255 become where noise must not be clipped."""

_GREY_SHARE = 0.3
_SRGB = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()
_LUMA = np.array([0.299, 0.587, 0.114])

Level = NDArray[np.uint8] | NDArray[np.uint16]
Container = Literal["png", "jpg", "tif"]


@dataclass(frozen=True, slots=True, kw_only=True)
class _MadePair:
    """Two files, in what way they differ, and what is true of them.

    ``gain`` is that of the stored levels, after over before, NaN where one follows no gain of the
    other; ``is_as_sharp`` whether their equal sharpness is the truth.
    """

    before: Path
    after: Path
    recipe: str
    gain: float = 1.0
    is_as_sharp: bool = True


@dataclass(frozen=True, slots=True, kw_only=True)
class _Draft:
    """Two files in no order; ``gain`` is the second's over the first's."""

    files: tuple[Path, Path]
    recipe: str
    gain: float = 1.0
    is_as_sharp: bool = True


@dataclass(frozen=True, slots=True, kw_only=True)
class NullPair:
    """A pair that can be made, and made again."""

    number: int
    seed: int
    kind: str
    picture: Picture = field(repr=False)

    def make(self, folder: Path) -> _MadePair:
        """Write the two files into a folder: ``before.*`` and ``after.*``."""
        keys = (self.seed, self.number, *(crc32(one.encode()) for one in self.words))
        rng = np.random.default_rng(keys)
        part, (top, left) = region_of(self.picture.levels(), MOST_PX, rng)
        grey = ""
        if part.ndim == 3 and rng.uniform() < _GREY_SHARE:
            part, grey = np.rint(part @ _LUMA).astype(np.uint8), " in grey"
        draft = MAKERS[self.kind](part, rng, folder)
        is_turned = rng.uniform() < 0.5
        files = draft.files[::-1] if is_turned else draft.files
        names = [
            file.replace(folder / f"{name}{file.suffix}")
            for name, file in zip(("before", "after"), files, strict=True)
        ]
        order = ", the second first" if is_turned else ""
        rows, cols = part.shape[:2]
        return _MadePair(
            before=names[0],
            after=names[1],
            recipe=f"{draft.recipe}{order}; {cols} x {rows} px{grey} at ({left}, {top})",
            gain=1 / draft.gain if is_turned else draft.gain,
            is_as_sharp=draft.is_as_sharp,
        )

    @property
    def words(self) -> tuple[str, str]:
        """What the randomness of a pair comes from, beside its numbers."""
        return self.kind, self.picture.name

    @property
    def command(self) -> str:
        """Options of the benchmark that make it again, and nothing else."""
        return (
            f"--seed {self.seed} --only {self.number} --kind {self.kind} "
            f"--picture {self.picture.name}"
        )


def null_pairs(
    pictures: Sequence[Picture], kinds: Sequence[str], count: int, seed: int
) -> Iterator[NullPair]:
    """Kinds in turn, pictures in an order that is drawn anew after each round."""
    for number in range(count):
        turn, place = divmod(number, len(pictures))
        order = np.random.default_rng((seed, turn)).permutation(len(pictures))
        yield NullPair(
            number=number,
            seed=seed,
            kind=kinds[number % len(kinds)],
            picture=pictures[order[place]],
        )


def with_noise(
    levels: FloatArray, snr: float, rng: np.random.Generator, *, is_shot: bool, is_srgb: bool
) -> FloatArray:
    """Levels of 0 to 255 with noise; neither rounded nor clipped.

    The SNR is the mean of the levels over the noise there. Shot noise is that of a number of
    electrons that is proportional to the light, which sRGB levels are first converted to.
    """
    if not is_shot:
        noise_sd = float(levels.mean()) / snr
        return np.asarray(levels + noise_sd * rng.standard_normal(levels.shape))
    light = light_of(levels / 255) if is_srgb else levels / 255
    electrons = snr**2 / max(float(light.mean()), 1e-6)
    seen = rng.poisson(light * electrons) / electrons
    return np.asarray(255 * (srgb_of(seen) if is_srgb else seen))


def smaller(levels: FloatArray, zoom: float, way: str) -> FloatArray:
    """A plane of ``zoom`` times the size, less what does not fill its last pixel.

    ``way`` is the area's exact mean (``area``), a Pillow filter by name, or a Gaussian and a cubic
    spline (``spline``).
    """
    rows, cols = (int(n * zoom) for n in levels.shape)
    if way == "area":
        return _area_mean(_area_mean(levels, zoom, rows).T, zoom, cols).T
    if way == "spline":
        soft = gaussian_filter(levels, 0.5 * np.sqrt(1 / zoom**2 - 1))
        y, x = ((np.arange(n) + 0.5) / zoom - 0.5 for n in (rows, cols))
        places = np.meshgrid(y, x, indexing="ij")
        return np.asarray(map_coordinates(soft, places, order=3, mode="mirror"))
    image = Image.fromarray(levels.astype(np.float32))
    box = (0.0, 0.0, cols / zoom, rows / zoom)
    made = image.resize((cols, rows), Image.Resampling[way.upper()], box=box)
    return np.asarray(made, dtype=np.float64)


def _area_mean(levels: FloatArray, zoom: float, rows: int) -> FloatArray:
    """Mean over each of ``rows`` equal strips, pixels being squares of one level."""
    total = np.concatenate([np.zeros((1, levels.shape[1])), np.cumsum(levels, axis=0)])
    ends = np.arange(rows + 1) / zoom
    whole = np.minimum(ends.astype(int), levels.shape[0] - 1)
    share = (ends - whole)[:, None]
    reached = total[whole] * (1 - share) + total[whole + 1] * share
    return np.asarray(np.diff(reached, axis=0) * zoom)


def light_of(levels: FloatArray | NDArray[np.float32]) -> FloatArray:
    """Light of sRGB levels, both from 0 to 1 (IEC 61966-2-1:1999, section 5.2)."""
    return np.where(levels <= 0.04045, levels / 12.92, ((levels + 0.055) / 1.055) ** 2.4)


def srgb_of(light: FloatArray) -> FloatArray:
    """Levels of sRGB, given light."""
    root = np.maximum(light, 0.0031308) ** (1 / 2.4)
    return np.where(light <= 0.0031308, 12.92 * light, 1.055 * root - 0.055)


def _png(levels: Level, path: Path) -> Path:
    if levels.dtype == np.uint16:
        raise ValueError("16-bit levels are written as TIFF")
    Image.fromarray(levels).save(path)
    return path


def _tiff(levels: Level, path: Path, *, is_marked: bool) -> Path:
    """TIFF, marked as sRGB or not: then its levels are taken as light."""
    tags = [(34675, "B", len(_SRGB), _SRGB, True)] if is_marked else []
    tifffile.imwrite(
        path, levels, photometric="rgb" if levels.ndim == 3 else "minisblack", extratags=tags
    )
    return path


def _jpeg(levels: ByteImage, path: Path, quality: int, subsampling: str) -> Path:
    buffer = BytesIO()
    Image.fromarray(levels).save(buffer, "JPEG", quality=quality, subsampling=subsampling)
    path.write_bytes(buffer.getvalue())
    return path


def _jpeg_choice(rng: np.random.Generator) -> tuple[int, str]:
    return int(rng.choice(QUALITIES)), str(rng.choice(["4:4:4", "4:2:0"]))


def _itself(part: ByteImage, rng: np.random.Generator, folder: Path) -> _Draft:
    container: Container = ("png", "jpg", "tif")[rng.integers(3)]
    quality, sampling = _jpeg_choice(rng)
    first, said = folder / f"one.{container}", container.upper()
    if container == "png":
        _png(part, first)
    elif container == "tif":
        _tiff(part, first, is_marked=False)
    else:
        _jpeg(part, first, quality, sampling)
        said = f"JPEG {quality} {sampling}"
    second = Path(copyfile(first, folder / f"two.{container}"))
    return _Draft(files=(first, second), recipe=f"{said} and itself")


def _png_jpeg(part: ByteImage, rng: np.random.Generator, folder: Path) -> _Draft:
    quality, sampling = _jpeg_choice(rng)
    files = _png(part, folder / "one.png"), _jpeg(part, folder / "two.jpg", quality, sampling)
    return _Draft(files=files, recipe=f"PNG and JPEG {quality} {sampling}")


def _jpeg_jpeg(part: ByteImage, rng: np.random.Generator, folder: Path) -> _Draft:
    """The same levels at two qualities, or a JPEG opened and written again."""
    first, second = (int(one) for one in rng.choice(QUALITIES, 2, replace=False))
    sampling = _jpeg_choice(rng)[1]
    one = _jpeg(part, folder / "one.jpg", first, sampling)
    is_again = rng.uniform() < 0.5
    if is_again:
        with Image.open(one) as image:
            part = np.asarray(image)
    two = _jpeg(part, folder / "two.jpg", second, sampling)
    word = "written again as" if is_again else "and"
    return _Draft(files=(one, two), recipe=f"JPEG {first} {word} {second}, {sampling}")


def _png_tiff8(part: ByteImage, rng: np.random.Generator, folder: Path) -> _Draft:
    del rng
    files = _png(part, folder / "one.png"), _tiff(part, folder / "two.tif", is_marked=True)
    return _Draft(files=files, recipe="PNG and 8-bit TIFF marked as sRGB")


def _png_tiff16(part: ByteImage, rng: np.random.Generator, folder: Path) -> _Draft:
    del rng
    deep = part.astype(np.uint16) * np.uint16(257)
    files = _png(part, folder / "one.png"), _tiff(deep, folder / "two.tif", is_marked=True)
    return _Draft(files=files, recipe="PNG and 16-bit TIFF marked as sRGB", gain=257.0)


def _png_tiff_unmarked(part: ByteImage, rng: np.random.Generator, folder: Path) -> _Draft:
    is_deep = rng.uniform() < 0.5
    stored: Level = part.astype(np.uint16) * np.uint16(257) if is_deep else part
    files = _png(part, folder / "one.png"), _tiff(stored, folder / "two.tif", is_marked=False)
    recipe = f"PNG and {16 if is_deep else 8}-bit TIFF without a mark"
    return _Draft(files=files, recipe=recipe, gain=nan)


def _crop(part: ByteImage, rng: np.random.Generator, folder: Path) -> _Draft:
    rows, cols = part.shape[:2]
    most = rows // 5, cols // 5
    top, left = (int(rng.integers(n + 1)) for n in most)
    below, right = (int(rng.integers(n + 1)) for n in most)
    inner = part[top : rows - below, left : cols - right]
    files = _png(part, folder / "one.png"), _png(np.ascontiguousarray(inner), folder / "two.png")
    size = f"{inner.shape[1]} x {inner.shape[0]}"
    return _Draft(files=files, recipe=f"PNG and its part of {size} px at ({left}, {top})")


def _zoom(part: ByteImage, rng: np.random.Generator, folder: Path) -> _Draft:
    zoom = float(rng.uniform(*ZOOM))
    way = str(rng.choice(["area", "lanczos", "bicubic", "hamming", "spline"]))
    is_light = rng.uniform() < 0.5
    levels = np.atleast_3d(part).astype(np.float64) / 255
    planes = light_of(levels) if is_light else levels
    made = np.stack([smaller(planes[..., n], zoom, way) for n in range(planes.shape[2])], axis=2)
    seen = srgb_of(made) if is_light else made
    small = np.clip(np.rint(255 * seen), 0, 255).astype(np.uint8)
    small = np.ascontiguousarray(small if part.ndim == 3 else small[..., 0])
    files = _png(part, folder / "one.png"), _png(small, folder / "two.png")
    where = "light" if is_light else "levels"
    # How sharp a smaller picture is in its own pixels depends on the filter.
    return _Draft(
        files=files, recipe=f"PNG and {zoom:.4f} of it, {way} in {where}", is_as_sharp=False
    )


Maker = Callable[[ByteImage, np.random.Generator, Path], _Draft]


def _twice(*, is_shot: bool, bits: int, is_equal: bool = True, is_jpeg: bool = False) -> Maker:
    """Maker of a picture with noise, twice; of 8 bits as PNG, or as JPEG of two qualities."""

    def make(part: ByteImage, rng: np.random.Generator, folder: Path) -> _Draft:
        first = float(np.exp(rng.uniform(*np.log(SNR))))
        ratios = np.array([1.0, 1.0 if is_equal else rng.uniform(*UNEQUAL)])
        levels = part.astype(np.float64)
        has_headroom = rng.uniform() < 0.5
        if has_headroom:
            low, high = HEADROOM
            levels = low + levels * ((high - low) / 255)
        is_srgb = bits == 8
        files, coded = list[Path](), list[str]()
        for name, snr in zip(("one", "two"), first * ratios, strict=True):
            noisy = with_noise(levels, float(snr), rng, is_shot=is_shot, is_srgb=is_srgb)
            top = 2**bits - 1
            stored = np.clip(np.rint(noisy * (top / 255)), 0, top)
            if is_jpeg:
                quality, sampling = _jpeg_choice(rng)
                path = folder / f"{name}.jpg"
                files.append(_jpeg(stored.astype(np.uint8), path, quality, sampling))
                coded.append(f"JPEG {quality} {sampling}")
            elif is_srgb:
                files.append(_png(stored.astype(np.uint8), folder / f"{name}.png"))
            else:
                deep = stored.astype(np.uint16)
                files.append(_tiff(deep, folder / f"{name}.tif", is_marked=False))
        said = " and ".join(f"{first * ratio:.1f}" for ratio in sorted(set(ratios.tolist())))
        room = ", nothing clipped" if has_headroom else ""
        noise = "shot" if is_shot else "white"
        kept = " and ".join(coded) or f"{bits} bits"
        recipe = f"{noise} noise twice, SNR {said}, {kept}{room}"
        return _Draft(files=(files[0], files[1]), recipe=recipe)

    return make


MAKERS: dict[str, Maker] = {
    "itself": _itself,
    "png-jpeg": _png_jpeg,
    "jpeg-jpeg": _jpeg_jpeg,
    "png-tiff8": _png_tiff8,
    "png-tiff16": _png_tiff16,
    "png-tiff-unmarked": _png_tiff_unmarked,
    "crop": _crop,
    "zoom": _zoom,
    "white-8": _twice(is_shot=False, bits=8),
    "white-16": _twice(is_shot=False, bits=16),
    "shot-8": _twice(is_shot=True, bits=8),
    "shot-16": _twice(is_shot=True, bits=16),
    "unequal-8": _twice(is_shot=False, bits=8, is_equal=False),
    "unequal-16": _twice(is_shot=False, bits=16, is_equal=False),
    "shot-jpeg": _twice(is_shot=True, bits=8, is_jpeg=True),
}
KINDS = tuple(MAKERS)
