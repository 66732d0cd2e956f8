"""Pictures that nobody of this project drew: what installed packages and ``tests/data`` hold.

Photographs, drawings, printed and shown text, textures, skin, stars, microscopy and flat labels, in
grey and in colour, all as 8-bit levels. What is not installed is left out, with the reason; where
``STANDOFF_REAL_DATA`` names a folder of real photographs, they come with it.
"""

import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from simulation.arrays import FloatArray

Genre = Literal[
    "photograph", "drawing", "text", "texture", "skin", "stars", "microscopy", "flat", "other"
]
ByteImage = NDArray[np.uint8]
"""Shape ``(rows, cols)`` or ``(rows, cols, 3)``."""

LEAST_PX = 96
_REPOSITORY = Path(__file__).parents[1]
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


@dataclass(frozen=True, slots=True, kw_only=True)
class Shelf:
    """Files of an installed package, or below a folder; ``distribution`` is what pip calls it."""

    package: str
    distribution: str
    folder: str
    files: Mapping[str, Genre]


_NEXUS: dict[str, Genre] = {
    "applications/canSAS/2012-minimum.png": "drawing",
    "applications/canSAS/Q-geometry.jpg": "drawing",
    "applications/stress/Beam_profile_sketch3.jpg": "drawing",
    "applications/stress/gauge_volume.png": "drawing",
    "applications/xps/xps_cs.png": "drawing",
    "base_classes/aperture/aperture.png": "drawing",
    "base_classes/mirror/mirror.png": "drawing",
    "contributed_definitions/container/ComplexExampleContainer.png": "drawing",
    "contributed_definitions/region/NXregion-example.png": "drawing",
}
SHELVES = (
    Shelf(
        package="skimage",
        distribution="scikit-image",
        folder="data",
        files={
            "astronaut.png": "photograph",
            "brick.png": "texture",
            "camera.png": "photograph",
            "cell.png": "microscopy",
            "chelsea.png": "photograph",
            "chessboard_GRAY.png": "flat",
            "chessboard_RGB.png": "flat",
            "clock_motion.png": "photograph",
            "coffee.png": "photograph",
            "coins.png": "photograph",
            "color.png": "flat",
            "grass.png": "texture",
            "gravel.png": "texture",
            "horse.png": "flat",
            "hubble_deep_field.jpg": "stars",
            "ihc.png": "microscopy",
            "logo.png": "drawing",
            "microaneurysms.png": "microscopy",
            "moon.png": "photograph",
            "motorcycle_left.png": "photograph",
            "page.png": "text",
            "phantom.png": "flat",
            "retina.jpg": "microscopy",
            "rocket.jpg": "photograph",
            "text.png": "text",
        },
    ),
    Shelf(
        package="matplotlib",
        distribution="matplotlib",
        folder="mpl-data/sample_data",
        files={
            "grace_hopper.jpg": "photograph",
            "jacksboro_fault_dem.npz": "texture",
            "logo2.png": "drawing",
            "Minduka_Present_Blue_Pack.png": "drawing",
        },
    ),
    Shelf(
        package="astropy",
        distribution="astropy",
        folder="",
        files={
            "io/fits/hdu/compressed/tests/data/m13.fits": "stars",
            "io/fits/tests/data/comp.fits": "stars",
            "modeling/tests/data/1904-66_AZP.fits": "stars",
        },
    ),
    Shelf(
        package="nexusformat",
        distribution="nexusformat",
        folder="definitions",
        files=_NEXUS,
    ),
    Shelf(
        package="networkx",
        distribution="networkx",
        folder="drawing/tests/baseline",
        files={
            "test_display_complex.png": "drawing",
            "test_display_labels_and_colors.png": "drawing",
            "test_house_with_colors.png": "drawing",
        },
    ),
    Shelf(
        package="distributed",
        distribution="distributed",
        folder="http/static/images",
        files={"numpy.png": "drawing"},
    ),
    Shelf(
        package="a11y_pygments",
        distribution="accessible-pygments",
        folder="",
        files={
            "github_dark/images/github-dark.png": "text",
            "github_light/images/github-light.png": "text",
        },
    ),
    Shelf(
        package="sphinx",
        distribution="sphinx",
        folder="themes/scrolls/static",
        files={"darkmetal.png": "texture", "watermark.png": "texture"},
    ),
    Shelf(
        package="sklearn",
        distribution="scikit-learn",
        folder="datasets/images",
        files={"china.jpg": "photograph", "flower.jpg": "photograph"},
    ),
    Shelf(
        package="pywt",
        distribution="PyWavelets",
        folder="data",
        files={"aero.npz": "photograph", "ascent.npz": "photograph"},
    ),
)
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
class Catalogue:
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


def catalogue(folder: Path | None = None) -> Catalogue:
    """Find the pictures that are installed, those of ``STANDOFF_REAL_DATA``, and of a folder."""
    pictures, left_out = list[Picture](), list[str]()
    for shelf in SHELVES:
        spec = find_spec(shelf.package)
        if spec is None or not spec.submodule_search_locations:
            left_out.append(f"{len(shelf.files)} of {shelf.distribution}: not installed")
            continue
        root = Path(spec.submodule_search_locations[0]) / shelf.folder
        missing = list[str]()
        for file, genre in shelf.files.items():
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
    return Catalogue(pictures=tuple(pictures), left_out=tuple(left_out))


def _below(root: Path, label: str, files: Mapping[str, Genre]) -> Iterator[Picture]:
    for file, genre in files.items():
        if (path := root / file).is_file():
            yield Picture(name=f"{label}/{path.stem}", genre=genre, path=path)


def region_of(
    levels: ByteImage, most: tuple[int, int], rng: np.random.Generator
) -> tuple[ByteImage, tuple[int, int]]:
    """At most ``(rows, cols)`` of a picture, anywhere in it, and where: its first row and column.

    Raises
    ------
    ValueError
        If the picture is smaller than ``LEAST_PX`` along a side.
    """
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
