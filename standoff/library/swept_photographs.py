"""Photographs as a sweep reads them, in any process: one that cannot be used is refused."""

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Protocol

import numpy as np

from acquisition.photographs import Inputs, Photograph, ReadOptions, read_photograph
from acquisition.printable import on_one_line
from acquisition.session import file_sha256
from analysis.detectability import SceneImage
from analysis.errors import RefusedPhotographError
from calibration.errors import CalibrationError
from calibration.scene_depth import depth_of_file
from simulation.arrays import FloatArray
from standoff.errors import HintError, ImageFileError

_MOST_INPUTS = 10_000
"""Of more photographs, provenance names the list alone."""

_LIST_NAME = "photographs.sha256"


class _SweptPhotograph(Protocol):
    """What a sweep keeps of a photograph: its path as printed, content hash and encoding."""

    @property
    def path(self) -> str: ...
    @property
    def sha256(self) -> str: ...
    @property
    def encoding(self) -> str: ...


@contextmanager
def refusing() -> Iterator[None]:
    """Refuse the photograph that the block reads if it cannot be used; the sweep then goes on."""
    try:
        yield
    except (HintError, ImageFileError) as error:
        is_unread = isinstance(error.__cause__, OSError)
        raise RefusedPhotographError(str(error), is_unread=is_unread) from error


def scene_image(options: ReadOptions, path: Path) -> SceneImage:
    """Read a photograph of a scene."""
    return replace(colour_scene_image(options, path), colours=None)


def colour_scene_image(options: ReadOptions, path: Path) -> SceneImage:
    """Read a photograph of a scene with its colours, if it has any."""
    with refusing():
        photograph = read_photograph(path, options)
        return SceneImage(
            grey_dn=photograph.grey_dn,
            sha256=photograph.sha256 or "",
            encoding=photograph.encoding.name,
            notes=photograph.remarks,
            colours=partial(_colours_dn, photograph) if photograph.is_colour else None,
        )


def _colours_dn(photograph: Photograph) -> FloatArray:
    return np.asarray(photograph.colour_planes, dtype=np.float64)


def list_inputs(
    inputs: Inputs, count: int, photographs: Iterable[_SweptPhotograph], state: Path
) -> None:
    """List photographs among the inputs; very many as one file of hashes in ``state``."""
    listed = state / _LIST_NAME
    if count <= _MOST_INPUTS:
        listed.unlink(missing_ok=True)
        for one in photographs:
            inputs.add_known(one.path, one.sha256, one.encoding)
        return
    encodings = set()
    with listed.open("w", encoding="utf-8") as file:
        for one in photographs:
            encodings.add(one.encoding)
            file.write(f"{one.sha256}  {one.path}\n")
    for encoding in sorted(encodings):
        inputs.add_known(str(listed), file_sha256(listed), encoding)


_SAME_NAME = (".tif", ".tiff", ".png", ".jpg", ".jpeg", ".bmp", ".exr", ".dng")


def photograph_depth(folder: Path, photograph: Path) -> FloatArray:
    """Read the depth of a photograph's scene, from the folder's file of its name."""
    path = named_as(photograph, folder, "depth", ".json")
    try:
        return depth_of_file(path)
    except (CalibrationError, ImageFileError) as error:
        raise RefusedPhotographError(str(error)) from error


def named_as(photograph: Path, folder: Path, kind: str, *suffixes: str) -> Path:
    """The file of a photograph's name in a folder, with an image's suffix or one of those named."""
    same = Path(folder) / photograph.name
    if same.is_file():
        return same
    for suffix in (*_SAME_NAME, *suffixes):
        if same.with_suffix(suffix).is_file():
            return same.with_suffix(suffix)
    raise RefusedPhotographError(
        f"there is no {kind} of its name, {photograph.stem}, in {on_one_line(folder)}"
    )
