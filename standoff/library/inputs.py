"""Arguments as a caller gives them: an array or a path, a PSF or its file."""

from collections.abc import Iterable, Mapping
from os import PathLike
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from calibration.files import read_noise, read_psf
from calibration.psf import PsfCalibration
from simulation import GaussianPsf, MeasuredPsf, Model, Psf, PsfField, SeparablePsf
from simulation.arrays import AnyArray, FloatArray
from simulation.capture_noise import CaptureNoise
from simulation.choices import POSE_MODELS
from standoff.library.bench_capture import BenchCapture
from standoff.photographs import Photograph, read_image

FilePath: TypeAlias = str | PathLike[str]
ImageLike: TypeAlias = NDArray[Any] | Photograph | BenchCapture | FilePath
"""Levels linear in light, ``(rows, cols)`` or ``(rows, cols, channels)``, or an image file."""

PsfLike: TypeAlias = GaussianPsf | MeasuredPsf | SeparablePsf | PsfCalibration | FilePath
"""A PSF, a calibration that holds one, or the path of a psf.json."""

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
    raise TypeError(f"{name}: expected a path, got {_kind(path)}")


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
    raise TypeError(f"{name}: expected an array or the path of an image, got {_kind(image)}")


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
        raise TypeError(f"images: expected arrays or paths of images, got {_kind(images)}")
    listed = list(images)
    if not listed:
        raise ValueError("images: expected at least one image, got none")
    return listed


def whole_frame_psf(psf: PsfLike) -> Psf:
    """Return the total PSF (optics and pixel), the best that is known, for the whole frame.

    Raises
    ------
    TypeError
        If it is not a PSF, calibration or path.
    PsfFileError
        If the file cannot be read, or a width is not determined.
    """
    if isinstance(psf, GaussianPsf | MeasuredPsf | SeparablePsf):
        return psf
    calibration, source = _calibration(psf)
    return calibration.best_psf(source)


def camera_psf(psf: PsfLike, frame: tuple[int, int] | None, model: Model) -> Psf | PsfField:
    """Return the best PSF that is known and that a model takes: a field if it can.

    Parameters
    ----------
    psf
        The camera's PSF.
    frame
        Columns and rows of the image; None if it is not a whole frame of the camera.
    model
        Those of ``POSE_MODELS`` take a PSF that varies over the frame; ``paper`` a Gaussian only.
    """
    if isinstance(psf, GaussianPsf | MeasuredPsf | SeparablePsf):
        return psf
    calibration, source = _calibration(psf)
    field = calibration.total_field(source) if model in POSE_MODELS else None
    if field is not None and frame == (field.width_px, field.height_px):
        return field
    return calibration.total_psf(source) if model == "paper" else calibration.best_psf(source)


def camera_noise(noise: NoiseLike | None) -> CaptureNoise | None:
    """Return the noise of a capture, read from its noise.json if a path is given."""
    if noise is None or isinstance(noise, CaptureNoise):
        return noise
    return read_noise(path_of(noise, "noise")).capture_noise


def _calibration(psf: PsfLike) -> tuple[PsfCalibration, str]:
    if isinstance(psf, PsfCalibration):
        return psf, "psf"
    if isinstance(psf, str | PathLike):
        return read_psf(Path(psf)), str(psf)
    raise TypeError(
        f"psf: expected a PSF, a PSF calibration or the path of a psf.json, got {_kind(psf)}"
    )


def _kind(value: object) -> str:
    return "None" if value is None else type(value).__name__
