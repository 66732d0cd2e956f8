"""JSON, TOML and TIFF files from elsewhere: any fault in one is a ``ValueError``."""

import json
import re
import struct
import tomllib
import zlib
from dataclasses import dataclass
from io import BytesIO
from typing import Any

import tifffile
from numpy.typing import NDArray

_LARGEST_RATIO = 2000
"""No TIFF compression achieves more; a page that would be larger has a damaged size."""

MOST_BRACKETS = 3_000_000
"""Of one JSON document: an empty list takes two bytes of a file and 64 of memory."""

_SURROGATE = re.compile(r"\\u[dD][89a-fA-F]")
_TOO_DEEP = "its brackets are nested too deeply"
TIFF_DAMAGE = (
    tifffile.TiffFileError,
    ArithmeticError,
    AttributeError,
    LookupError,
    MemoryError,
    OSError,
    RuntimeError,
    TypeError,
    ValueError,
    struct.error,
    zlib.error,
)
"""What tifffile and its codecs raise on files with flipped bytes, found by fuzzing."""


class TiffDamageError(ValueError):
    """The bytes are not a TIFF file, or a damaged one; the message is one short line."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _TiffPages:
    """The images of a file in order, and ImageJ's Info where there is one."""

    images: tuple[NDArray[Any], ...]
    info: str | None


def parse_json(  # the reader checks what it needs
    text: str | bytes, *, has_single_keys: bool = False, has_file_names: bool = False
) -> Any:  # noqa: ANN401
    """Read one JSON document, any fault in which is a ValueError.

    Refused is also what is nested too deep, would fill the memory with empty lists, or escapes half
    a character; with ``has_single_keys`` a repeated key. With ``has_file_names`` a text may hold
    bytes that are no UTF-8, escaped as PEP 383 does.
    """
    hook = _without_repeats if has_single_keys else None
    decoded = text if isinstance(text, str) else text.decode("utf-8")
    if decoded.count("[") + decoded.count("{") > MOST_BRACKETS:
        raise ValueError(f"more than {MOST_BRACKETS} lists and objects")
    try:
        document = json.loads(decoded, object_pairs_hook=hook)
        if _SURROGATE.search(decoded):
            errors = "surrogateescape" if has_file_names else "strict"
            json.dumps(document, ensure_ascii=False).encode(errors=errors)
    except RecursionError as error:
        raise ValueError(_TOO_DEEP) from error
    except UnicodeEncodeError as error:
        raise ValueError("a text with half a character, a lone surrogate") from error
    return document


def _without_repeats(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    made = dict(pairs)
    if len(made) < len(pairs):
        keys = [key for key, _ in pairs]
        repeated = next(key for key in keys if keys.count(key) > 1)
        raise ValueError(f"the key {repeated!r} is repeated")
    return made


def parse_toml(text: str | bytes) -> dict[str, Any]:
    """Read one TOML document."""
    try:
        return tomllib.loads(text if isinstance(text, str) else text.decode("utf-8"))
    except RecursionError as error:
        raise ValueError(_TOO_DEEP) from error


def read_tiff(
    data: bytes, *, first_alone: bool = False, shape: tuple[int, int] | None = None
) -> _TiffPages:
    """Read the pages of a TIFF file, or the first one; with ``shape``, if they have that alone."""
    try:
        # The reader's objects refer to each other: without closing it, they would keep the file's
        # bytes until the next collection of garbage.
        with BytesIO(data) as file, tifffile.TiffFile(file) as tiff:
            info = (tiff.imagej_metadata or {}).get("Info")
            pages = [tiff.pages[0]] if first_alone else list(tiff.pages)
            images = tuple(_pixels(page, len(data), shape) for page in pages)
    except TiffDamageError:
        raise
    except TIFF_DAMAGE as error:
        text = str(error).splitlines()[0][:120] if str(error) else type(error).__name__
        raise TiffDamageError(text) from error
    return _TiffPages(images=images, info=info if isinstance(info, str) else None)


def _pixels(
    page: tifffile.TiffPage | tifffile.TiffFrame, file_bytes: int, shape: tuple[int, int] | None
) -> NDArray[Any]:
    if shape is not None and tuple(page.shape) != shape:
        raise TiffDamageError(f"its shape is {tuple(page.shape)}, expected {shape} (rows, columns)")
    if page.nbytes > _LARGEST_RATIO * file_bytes:
        raise TiffDamageError(
            f"a page of {page.shape} pixels cannot be in a file of {file_bytes} bytes"
        )
    pixels: NDArray[Any] = page.asarray()
    if pixels.shape != page.shape:
        raise TiffDamageError(f"cut short: {pixels.shape} of {page.shape} pixels")
    return pixels
