"""Finds the images of a folder, and writes simulated images and masks."""

import os
from collections.abc import Iterable, Iterator
from pathlib import Path

import cv2
import numpy as np

from acquisition.photographs import IMAGE_SUFFIXES
from acquisition.remote_files import is_url, remote_files_in, remote_status, url_of
from acquisition.session import write_shared
from analysis.float_tiff import tiff_bytes
from simulation.arrays import BoolArray, Float32Array
from standoff.errors import ApplicationError, ImageFileError


def each_image(paths: Iterable[Path]) -> Iterator[Path]:
    """Yield the images of files and folders, for very many: in any order, one by one.

    Raises
    ------
    ApplicationError
        If a folder holds no image, or cannot be read.
    """
    for path in paths:
        if is_url(path):
            yield from _images_of_url(path)
            continue
        if not is_folder(path):
            yield path
            continue
        is_empty = True
        try:
            with os.scandir(path) as entries:
                for entry in entries:
                    if Path(entry.name).suffix.lower() in IMAGE_SUFFIXES:
                        is_empty = False
                        yield path / entry.name
        except OSError as error:
            raise ApplicationError(f"cannot read the folder {path}: {error.strerror}") from error
        if is_empty:
            raise ApplicationError(f"{path}: the folder holds no image")


def is_folder(path: Path) -> bool:
    """Whether a folder is there; what cannot be reached is left to whoever reads it as a file."""
    try:
        return path.is_dir()
    except OSError:
        return False


def _images_of_url(path: Path) -> Iterator[Path]:
    url = url_of(path)
    try:
        if not remote_status(path).is_folder:
            yield path
            return
        is_empty = True
        for file in remote_files_in(path):
            if file.suffix.lower() in IMAGE_SUFFIXES:
                is_empty = False
                yield file
    except OSError as error:
        raise ApplicationError(f"cannot read {url}: {error.strerror}") from error
    if is_empty:
        raise ApplicationError(f"{url}: the folder holds no image")


def image_files_in(folder: Path) -> list[Path]:
    """Return the images in a folder, sorted by name.

    Raises
    ------
    ApplicationError
        If the folder cannot be read: it may be removed while it is watched.
    """
    try:
        return sorted(path for path in folder.iterdir() if path.suffix.lower() in IMAGE_SUFFIXES)
    except OSError as error:
        raise ApplicationError(f"cannot read the folder {folder}: {error.strerror}") from error


def write_float_tiff(path: Path, image: Float32Array, description: str) -> None:
    """Write a float32 TIFF, whole or not at all.

    Raises
    ------
    ImageFileError
        If the file cannot be written.
    """
    _write(path, tiff_bytes(image, description))


def write_mask(path: Path, mask: BoolArray) -> None:
    """Write a mask as a PNG of 0 and 255, whole or not at all.

    Raises
    ------
    ImageFileError
        If the file cannot be written.
    """
    _write(path, cv2.imencode(".png", mask.astype(np.uint8) * np.uint8(255))[1].tobytes())


def _write(path: Path, data: bytes) -> None:
    try:
        write_shared(path, data)
    except OSError as error:
        raise ImageFileError(f"cannot write {path}: {error.strerror}") from error
