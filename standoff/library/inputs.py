"""Arguments as a caller gives them: an array or a path, a PSF or its file."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from itertools import chain, islice
from numbers import Number
from os import PathLike
from pathlib import Path
from typing import Any, TypeAlias, cast

from numpy.typing import NDArray

from acquisition.photographs import (
    Photograph,
    ReadOptions,
    photograph_of,
    read_image,
    taken_as,
)
from acquisition.session import Session
from calibration.files import read_noise
from calibration.psf import PsfCalibration
from simulation import GaussianPsf, MeasuredPsf, SeparablePsf, TabulatedPsf
from simulation.arguments import (
    ArgumentError,
    ArgumentTypeError,
    FilePath as FilePath,
    is_array_like,
    kind_of,
    output_path as output_path,
    path_of as path_of,
)
from simulation.arrays import AnyArray, FloatArray
from simulation.capture_noise import CaptureNoise
from standoff.library.bench_capture import BenchCapture

ImageLike: TypeAlias = NDArray[Any] | Photograph | BenchCapture | FilePath
"""Levels linear in light, ``(rows, cols)`` or ``(rows, cols, channels)``, or an image file.

Whatever has ``__array__`` is an array.
"""

BarePsf: TypeAlias = GaussianPsf | MeasuredPsf | SeparablePsf | TabulatedPsf
PsfLike: TypeAlias = BarePsf | PsfCalibration | FilePath
"""A PSF, a calibration that holds one, or the path of a psf.json or of a PSF of one's own."""

NoiseLike: TypeAlias = CaptureNoise | FilePath
"""The noise of a capture, or the path of a noise.json."""


def listed_paths(files: FilePath | Iterable[FilePath], name: str) -> Iterator[Path]:
    """Yield one path or several, which need not fit into memory; refuse what is none."""
    given = iter([files] if isinstance(files, str | PathLike) else files)
    first = next(given, None)
    if first is None:
        raise ArgumentError("expected at least one path, got none", argument=name)
    return (path_of(one, name) for one in chain((first,), given))


def opened_session(session: Session | FilePath) -> Session:
    """Return a capture session, opened if its folder is given.

    Raises
    ------
    SessionError
        If it cannot be read.
    """
    return session if isinstance(session, Session) else Session(path_of(session, "session"))


def photograph(
    image: ImageLike, name: str = "image", options: ReadOptions | None = None
) -> Photograph:
    """Return an image with what its file, or the type of its array, says about its levels.

    The one way in for images, from wherever they come.

    Raises
    ------
    ArgumentTypeError
        If it is neither an array nor a path.
    ImageFileError
        If the file cannot be read, or the array is not a finite image.
    """
    options = options or ReadOptions()
    if isinstance(image, BenchCapture):
        image = image.photograph
    if isinstance(image, Photograph):
        return taken_as(image, options)
    if isinstance(image, str | PathLike):
        return read_image(path_of(image, name), options)
    if is_array_like(image) or isinstance(image, list | tuple):
        return photograph_of(image, name, options)
    raise ArgumentTypeError(
        f"expected an array or the path of an image, got {kind_of(image)}", argument=name
    )


def colour_planes(
    image: ImageLike, name: str = "image", options: ReadOptions | None = None
) -> AnyArray:
    """Return the levels of an image without an opacity plane, grey or in colour."""
    return photograph(image, name, options).colour_planes


def grey_image(
    image: ImageLike, name: str = "image", options: ReadOptions | None = None
) -> FloatArray:
    """Return the grey levels of an image, shape ``(rows, cols)``; of a colour image the luma."""
    return photograph(image, name, options).grey_dn


def listed_images(images: object, name: str = "images") -> list[ImageLike]:
    """Return one image or several as a list.

    A three-dimensional array is one colour image; pass several images as a list. A column of paths
    is several files, and a list of rows of numbers one image.
    """
    if isinstance(images, Photograph | BenchCapture | str | PathLike):
        return [images]
    if is_array_like(images) and not _holds_paths(images):
        return [cast("ImageLike", images)]
    if isinstance(images, Mapping) or not isinstance(images, Iterable):
        raise ArgumentTypeError(
            f"expected arrays or paths of images, got {kind_of(images)}", argument=name
        )
    listed = list(images)
    if not listed:
        raise ArgumentError("expected at least one image, got none", argument=name)
    row = listed[0]
    if isinstance(row, list | tuple) and row and isinstance(row[0], Number):
        return [cast("ImageLike", listed)]
    return listed


def _holds_paths(images: object) -> bool:
    """Whether it is a column of text or of other objects, and no numbers."""
    kind = getattr(getattr(images, "dtype", None), "kind", None)
    return (
        isinstance(images, Iterable)
        and (kind in tuple("OUST") or str(kind) == "None")
        and all(isinstance(one, str | PathLike) for one in islice(images, 1))
    )


def with_white_level(reading: ReadOptions | None, white_level: float | None) -> ReadOptions:
    """Return how photographs are read where the level at which they are clipped is stated."""
    options = reading or ReadOptions()
    return options if white_level is None else replace(options, white_level=white_level)


def camera_noise(noise: NoiseLike | None) -> CaptureNoise | None:
    """Return the noise of a capture, read from its noise.json if a path is given."""
    if noise is None or isinstance(noise, CaptureNoise):
        return noise
    return read_noise(path_of(noise, "noise")).capture_noise
