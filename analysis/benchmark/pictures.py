"""Pictures of a known shape from elsewhere: grey TIFF files that a data set or a program wrote."""

from pathlib import Path

import numpy as np

from acquisition.regular_files import LARGEST_IMAGE_BYTES, read_regular_file
from acquisition.untrusted import TiffDamageError, read_tiff
from analysis.errors import ResultsFileError
from simulation.arrays import Float32Array

Shape = tuple[int, int]


def file_bytes(path: Path, most_bytes: int = LARGEST_IMAGE_BYTES) -> bytes:
    """Read a file.

    Raises
    ------
    ResultsFileError
        If it cannot be read.
    """
    try:
        return read_regular_file(path, most_bytes)
    except OSError as error:
        raise ResultsFileError(f"cannot read {path}: {error.strerror}", source=str(path)) from error


def grey_levels(data: bytes, path: Path, shape: Shape | None = None) -> Float32Array:
    """Return the levels of a grey TIFF; NaN are pixels without one.

    Parameters
    ----------
    data
        Content of the file.
    path
        Its name, for errors.
    shape
        The shape that it must have, (rows, cols); any if None.

    Raises
    ------
    ResultsFileError
        If it is damaged, in colour, of another shape, or holds infinite levels.
    """
    try:
        levels = read_tiff(data, first_alone=True, shape=shape).images[0]
    except TiffDamageError as error:
        raise ResultsFileError(
            f"{path}: {error}; write a grey TIFF of the follow-up's shape", source=str(path)
        ) from error
    if levels.ndim != 2 or levels.dtype.kind not in "fiu":
        raise ResultsFileError(
            f"{path}: shape {levels.shape} of {levels.dtype.name}, expected rows and columns of "
            "grey levels, float32 or integers",
            source=str(path),
        )
    with np.errstate(over="ignore"):  # is infinite then, and refused
        grey = levels.astype(np.float32)
    if np.isinf(grey).any():
        raise ResultsFileError(
            f"{path}: holds infinite levels; write NaN where there is none", source=str(path)
        )
    return grey
