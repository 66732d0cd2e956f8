"""What is checked before a byte of a file is believed, and damage named by what it is.

Work on an image takes several copies in float64: what is too large is refused before decoding.
"""

import math
import re
import struct
import warnings
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageFile

from acquisition.errors import ImageFileError
from acquisition.printable import on_one_line
from acquisition.regular_files import LARGEST_IMAGE_BYTES, read_regular_file, size_text
from acquisition.session import JOURNAL_NAME

LARGEST_FILE_BYTES = LARGEST_IMAGE_BYTES
LARGEST_IMAGE_PX = 150_000_000
_LARGEST_LEVEL = 1e9
_SMALL_BYTES = 32 << 20  # what decodes to so little is no danger
_LARGEST_RATIO = 200.0
_MOST_CHANNELS = 4
_MOST_SCANS = 100
_JPEG_MARKER = re.compile(rb"\xff([^\x00\x01\xd0-\xd7\xff])", re.DOTALL)  # no stuffing, no restart
_START_OF_IMAGE, _END_OF_IMAGE, _START_OF_SCAN = b"\xd8", b"\xd9", b"\xda"
TOO_LARGE = (
    f"at most {LARGEST_IMAGE_PX / 1e6:g} million pixels are read; cut out the part that matters"
)


class DecodingError(ValueError):
    """A file is damaged or of a kind that is not read; the message lacks the file's name."""


class GiantImageError(DecodingError):
    """An image is too large to work with; the message says how large, without the file's name."""


_DAMAGE = (
    ArithmeticError,
    AssertionError,
    AttributeError,
    EOFError,
    LookupError,
    MemoryError,
    OSError,
    RuntimeError,
    SyntaxError,
    TypeError,
    ValueError,
    struct.error,
    zlib.error,
    Image.DecompressionBombError,
)
_OF_CODE = (AssertionError, AttributeError, LookupError, TypeError)
"""What a library's code stumbles over: its words are about arrays and names, not about a file."""


@contextmanager
def decoding(kind: str, *damage: type[Exception]) -> Iterator[None]:
    """Name the damage of a file, as a noun, whatever a library raises over it; found by fuzzing."""
    fills_what_is_missing = ImageFile.LOAD_TRUNCATED_IMAGES
    ImageFile.LOAD_TRUNCATED_IMAGES = False  # WeasyPrint sets it for the whole process
    try:
        with warnings.catch_warnings():
            # A library warns of damage that it can live with, and of sizes, which are checked here.
            warnings.simplefilter("ignore")
            yield
    except DecodingError:
        raise
    except _DAMAGE + damage as error:
        said = "" if isinstance(error, _OF_CODE) else _words(error)
        cause = f": {said.splitlines()[0][:120]}" if said else ""
        raise DecodingError(f"not a complete {kind}{cause}") from error
    finally:
        ImageFile.LOAD_TRUNCATED_IMAGES = fills_what_is_missing


def _words(error: Exception) -> str:
    """What an error says; LibRaw's speak in bytes."""
    first = error.args[0] if error.args else ""
    return first.decode("ascii", "replace") if isinstance(first, bytes) else str(error)


def read_file(path: Path, most_bytes: int = LARGEST_FILE_BYTES) -> bytes:
    """Read a regular file of at most ``most_bytes``."""
    shown = on_one_line(path)
    try:
        return read_regular_file(path, most_bytes)
    except OSError as error:
        if path.is_dir() and (path / JOURNAL_NAME).is_file():
            raise ImageFileError(
                f"{shown} is a capture session, not a photograph: give it as one (--session, or "
                "standoff.Session in Python), or name photographs in it"
            ) from error
        raise ImageFileError(f"cannot read {shown}: {error.strerror}") from error
    except ValueError as error:  # a name with a zero byte
        raise ImageFileError(f"cannot read {shown}: no name of a file") from error


def refuse_giant(shape: tuple[int, ...], bytes_per_sample: int, file_bytes: int) -> None:
    """Check the size that an image says it has, before it is decoded; ``shape`` is rows first."""
    rows, cols = shape[:2]
    if rows * cols > LARGEST_IMAGE_PX:
        raise GiantImageError(f"an image of {cols} x {rows} pixels: {TOO_LARGE}")
    if is_swollen(math.prod(shape) * bytes_per_sample, file_bytes):
        raise GiantImageError(
            f"an image of {cols} x {rows} pixels in {size_text(file_bytes)}, which is no "
            "photograph; if it is correct, save it without compression"
        )


def is_swollen(decoded_bytes: int, file_bytes: int) -> bool:
    """Whether pixels take more memory than any compression of photographs explains."""
    return decoded_bytes > max(_SMALL_BYTES, _LARGEST_RATIO * file_bytes)


def refuse_many_scans(jpeg: bytes) -> None:
    """Check that a progressive JPEG builds up in so many steps as one of a camera at most.

    Each scan takes the time of decoding the whole image (ITU-T T.81, B.1.1).
    """
    at = scans = 0
    while (marker := _JPEG_MARKER.search(jpeg, at)) and marker[1] != _END_OF_IMAGE:
        scans += marker[1] == _START_OF_SCAN
        if scans > _MOST_SCANS:
            raise GiantImageError(
                f"a JPEG of more than {_MOST_SCANS} scans, which is no photograph"
            )
        at = marker.end()
        if marker[1] != _START_OF_IMAGE:
            at += int.from_bytes(jpeg[at : at + 2], "big")


def refuse_unusable(pixels: NDArray[Any], shown: str) -> None:
    """Check that pixels are levels one can calculate with."""
    if pixels.ndim not in (2, 3) or 0 in pixels.shape:
        raise ImageFileError(f"{shown}: expected one image, got an array of {pixels.shape}")
    if pixels.ndim == 3 and pixels.shape[2] > _MOST_CHANNELS:
        meant = "select those that are"
        if pixels.shape[0] <= _MOST_CHANNELS:
            meant = (
                "if the first axis counts them, move it to the end: numpy.moveaxis(image, 0, -1)"
            )
        raise ImageFileError(
            f"{shown}: {pixels.shape[2]} channels are neither grey nor RGB; {meant}"
        )
    if pixels.dtype.kind not in "uifb":
        raise ImageFileError(f"{shown}: its pixels are of type {pixels.dtype}, not numbers")
    if pixels.dtype.kind != "f":
        return
    low, high = float(pixels.min()), float(pixels.max())
    if not (np.isfinite(low) and np.isfinite(high)):
        raise ImageFileError(
            f"{shown}: some pixels are NaN or infinite; fill them, or cut them off"
        )
    if max(-low, high) > _LARGEST_LEVEL:
        raise ImageFileError(
            f"{shown}: levels from {low:.3g} to {high:.3g} cannot be those of a photograph; "
            f"scale them to {_LARGEST_LEVEL:g} at most"
        )
