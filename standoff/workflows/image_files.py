"""Reads photographs and writes simulated ones, in the image formats that the commands know."""

import logging
import struct
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any, Self

import cv2
import numpy as np
import tifffile
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError

from acquisition.session import atomic_write
from acquisition.untrusted import TiffDamageError, read_tiff
from calibration.psf import luma_plane
from simulation.arrays import AnyArray, BoolArray, Float32Array, FloatArray
from standoff.errors import ApplicationError, ImageFileError

_TIFF_SUFFIXES = {".tif", ".tiff"}
_IMAGE_SUFFIXES = {".tif", ".tiff", ".png", ".jpg", ".jpeg", ".bmp"}
_PLATEAU_FRACTION = 0.002
_ADC_BITS = (10, 12, 14)


@dataclass(frozen=True, slots=True, kw_only=True)
class ImageFile:
    """A photograph: shape ``(rows, cols)`` or ``(rows, cols, channels)``, as stored.

    ``full_scale_dn`` is the largest level of its integer type, None for float files;
    ``saturation_dn`` the level at which the sensor clips, if the file shows it.
    """

    path: Path
    pixels: AnyArray
    full_scale_dn: float | None
    saturation_dn: float | None
    is_jpeg: bool

    @classmethod
    def of_pixels(cls, path: Path, pixels: NDArray[Any], *, is_jpeg: bool = False) -> Self:
        """Return the pixels of a file, with what their type and values say about clipping.

        Raises
        ------
        ImageFileError
            If they are not an image, or hold values that are not finite.
        """
        if pixels.ndim not in (2, 3) or 0 in pixels.shape:
            raise ImageFileError(f"{path}: expected one image, got an array of {pixels.shape}")
        if pixels.dtype.kind not in "uifb" or not np.all(np.isfinite(pixels)):
            raise ImageFileError(f"{path}: its pixels are not all finite numbers")
        if pixels.dtype.kind == "b":
            pixels = pixels.astype(np.uint8) * np.uint8(255)
        full_scale = float(np.iinfo(pixels.dtype).max) if pixels.dtype.kind in "ui" else None
        return cls(
            path=path,
            pixels=pixels,
            full_scale_dn=full_scale,
            saturation_dn=_saturation(pixels, full_scale),
            is_jpeg=is_jpeg,
        )

    @property
    def is_colour(self) -> bool:
        """Whether there are red, green and blue planes."""
        return self.pixels.ndim == 3 and self.pixels.shape[2] >= 3

    @property
    def colour_planes(self) -> AnyArray:
        """The pixels without an opacity plane, in a type that the capture model takes."""
        pixels = self.pixels
        if pixels.ndim == 3 and pixels.shape[2] in (2, 4):
            pixels = pixels[:, :, :-1]
        if pixels.ndim == 3 and pixels.shape[2] == 1:
            pixels = pixels[:, :, 0]
        if pixels.dtype.type in (np.uint8, np.uint16, np.float32, np.float64):
            return pixels
        return pixels.astype(np.float64)


def read_image(path: Path) -> ImageFile:
    """Read a TIFF, PNG, JPEG or any file that Pillow opens; of several pages the first.

    Raises
    ------
    ImageFileError
        If the file is missing, not an image, cut short, or holds values that are not finite.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise ImageFileError(f"cannot read {path}: {error.strerror}") from error
    is_tiff = path.suffix.lower() in _TIFF_SUFFIXES or data[:4] in (b"II*\0", b"MM\0*")
    pixels = _tiff_pixels(data, path) if is_tiff else _pillow_pixels(data, path)
    return ImageFile.of_pixels(path, pixels, is_jpeg=data[:3] == b"\xff\xd8\xff")


def read_grey(path: Path) -> FloatArray:
    """Read the grey levels of an image, a colour image as Rec. 601 luma.

    Raises
    ------
    ImageFileError
        As ``read_image``.
    """
    return luma_plane(read_image(path).colour_planes)


def expanded_images(paths: Sequence[Path]) -> list[Path]:
    """Replace each folder by the images in it, sorted by name.

    Raises
    ------
    ApplicationError
        If a folder holds no image, or cannot be read.
    """
    files: list[Path] = []
    for path in paths:
        if not path.is_dir():
            files.append(path)
            continue
        inside = image_files_in(path)
        if not inside:
            raise ApplicationError(f"{path}: the folder holds no image")
        files += inside
    return files


def image_files_in(folder: Path) -> list[Path]:
    """Return the images in a folder, sorted by name.

    Raises
    ------
    ApplicationError
        If the folder cannot be read: it may be removed while it is watched.
    """
    try:
        return sorted(path for path in folder.iterdir() if path.suffix.lower() in _IMAGE_SUFFIXES)
    except OSError as error:
        raise ApplicationError(f"cannot read the folder {folder}: {error.strerror}") from error


def write_float_tiff(path: Path, image: Float32Array, description: str) -> None:
    """Write a float32 TIFF, whole or not at all.

    Raises
    ------
    ImageFileError
        If the file cannot be written.
    """
    try:
        atomic_write(path, tiff_bytes(image, description))
    except OSError as error:
        raise ImageFileError(f"cannot write {path}: {error.strerror}") from error


def write_mask(path: Path, mask: BoolArray) -> None:
    """Write a mask as a PNG of 0 and 255, whole or not at all.

    Raises
    ------
    ImageFileError
        If the file cannot be written.
    """
    data = cv2.imencode(".png", mask.astype(np.uint8) * np.uint8(255))[1].tobytes()
    try:
        atomic_write(path, data)
    except OSError as error:
        raise ImageFileError(f"cannot write {path}: {error.strerror}") from error


def tiff_bytes(image: Float32Array, description: str) -> bytes:
    """Return a float32 TIFF, grey or RGB, as the bytes of its file."""
    buffer = BytesIO()
    tifffile.imwrite(
        buffer,
        np.ascontiguousarray(image, dtype=np.float32),
        photometric="rgb" if image.ndim == 3 else "minisblack",
        description=description,
        metadata=None,
    )
    return buffer.getvalue()


def _saturation(pixels: AnyArray, full_scale: float | None) -> float | None:
    """Clipping level: of the file's type, or of a narrower ADC whose plateau shows."""
    if full_scale is None:
        return None
    top = float(np.max(pixels.astype(np.float64)))
    adc_tops = {float(2**bits - 1) for bits in _ADC_BITS}
    if top in adc_tops and np.mean(pixels == pixels.dtype.type(top)) > _PLATEAU_FRACTION:
        return top
    return full_scale


def _tiff_pixels(data: bytes, path: Path) -> NDArray[Any]:
    logging.getLogger("tifffile").setLevel(logging.CRITICAL)
    try:
        pixels = read_tiff(data, first_alone=True).images[0]
    except TiffDamageError as error:
        raise ImageFileError(f"{path}: not a complete TIFF image: {error}") from error
    if pixels.ndim == 3 and pixels.shape[0] in (3, 4) and pixels.shape[2] > 4:
        pixels = np.moveaxis(pixels, 0, -1)  # planar configuration: colours come first
    return pixels


def _pillow_pixels(data: bytes, path: Path) -> NDArray[Any]:
    try:
        with Image.open(BytesIO(data)) as image:
            image.load()
            if image.format == "PNG" and image.mode in ("RGB", "RGBA"):
                # Pillow cuts 16-bit colours down to 8; OpenCV keeps them.
                wide = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
                if wide is not None and wide.dtype == np.uint16:
                    order = [2, 1, 0, 3][: wide.shape[2]]
                    return np.asarray(wide[:, :, order])
            if image.mode in ("P", "PA", "CMYK", "YCbCr", "HSV", "LAB"):
                return np.asarray(image.convert("RGB"))
            return np.asarray(image)
    except UnidentifiedImageError as error:
        raise ImageFileError(f"{path}: not an image (TIFF, PNG or JPEG expected)") from error
    except (
        Image.DecompressionBombError,
        OSError,
        ValueError,
        SyntaxError,
        struct.error,
        zlib.error,
    ) as error:
        raise ImageFileError(f"{path}: not a complete image: {_brief(error)}") from error


def _brief(error: BaseException) -> str:
    return str(error).splitlines()[0][:120] if str(error) else type(error).__name__
