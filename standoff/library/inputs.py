"""Arguments as a caller gives them: an array or a path, a PSF or its file."""

from collections.abc import Iterable, Iterator, Mapping
from os import PathLike
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from acquisition.session import Session
from calibration.files import read_noise
from calibration.psf import PsfCalibration
from simulation import GaussianPsf, MeasuredPsf, SeparablePsf, TabulatedPsf
from simulation.arrays import AnyArray, FloatArray
from simulation.capture_noise import CaptureNoise
from standoff.library.bench_capture import BenchCapture
from standoff.photographs import Photograph, read_image

FilePath: TypeAlias = str | PathLike[str]
ImageLike: TypeAlias = NDArray[Any] | Photograph | BenchCapture | FilePath
"""Levels linear in light, ``(rows, cols)`` or ``(rows, cols, channels)``, or an image file."""

BarePsf: TypeAlias = GaussianPsf | MeasuredPsf | SeparablePsf | TabulatedPsf
PsfLike: TypeAlias = BarePsf | PsfCalibration | FilePath
"""A PSF, a calibration that holds one, or the path of a psf.json or of a PSF of one's own."""

NoiseLike: TypeAlias = CaptureNoise | FilePath
"""The noise of a capture, or the path of a noise.json."""


def path_of(path: object, name: str) -> Path:
    """Return the argument as a path, or refuse it.

    Raises
    ------
    TypeError
        If it is not a path; the message gives ``name`` and the type of the argument.
    """
    if isinstance(path, str | PathLike):
        return Path(path)
    raise TypeError(f"{name}: expected a path, got {kind_of(path)}")


def listed_paths(files: FilePath | Iterable[FilePath], name: str) -> Iterator[Path]:
    """Yield one path or several, which need not fit into memory; refuse what is none."""
    listed = [files] if isinstance(files, str | PathLike) else files
    return (path_of(one, name) for one in listed)


def opened_session(session: Session | FilePath) -> Session:
    """Return a capture session, opened if its folder is given.

    Raises
    ------
    SessionError
        If it cannot be read.
    """
    return session if isinstance(session, Session) else Session(path_of(session, "session"))


def photograph(image: ImageLike, name: str = "image") -> Photograph:
    """Return an image with what its file, or the type of its array, says about its levels.

    Raises
    ------
    TypeError
        If it is neither an array nor a path.
    ImageFileError
        If the file cannot be read, or the array is not a finite image.
    """
    if isinstance(image, Photograph):
        return image
    if isinstance(image, BenchCapture):
        return image.photograph
    if isinstance(image, np.ndarray):
        return Photograph.of_array(name, image)
    if isinstance(image, str | PathLike):
        return read_image(Path(image))
    raise TypeError(f"{name}: expected an array or the path of an image, got {kind_of(image)}")


def colour_planes(image: ImageLike, name: str = "image") -> AnyArray:
    """Return the levels of an image without an opacity plane, grey or in colour."""
    return photograph(image, name).colour_planes


def grey_image(image: ImageLike, name: str = "image") -> FloatArray:
    """Return the grey levels of an image, shape ``(rows, cols)``; of a colour image the luma."""
    return photograph(image, name).grey_dn


def listed_images(images: object) -> list[ImageLike]:
    """Return one image or several as a list.

    A three-dimensional array is one colour image; pass several images as a list.
    """
    if isinstance(images, np.ndarray | Photograph | BenchCapture | str | PathLike):
        return [images]
    if isinstance(images, Mapping) or not isinstance(images, Iterable):
        raise TypeError(f"images: expected arrays or paths of images, got {kind_of(images)}")
    listed = list(images)
    if not listed:
        raise ValueError("images: expected at least one image, got none")
    return listed


def camera_noise(noise: NoiseLike | None) -> CaptureNoise | None:
    """Return the noise of a capture, read from its noise.json if a path is given."""
    if noise is None or isinstance(noise, CaptureNoise):
        return noise
    return read_noise(path_of(noise, "noise")).capture_noise


def kind_of(value: object) -> str:
    """Name the type of an argument, for a message."""
    return "None" if value is None else type(value).__name__
