"""A capture as an ImageJ TIFF: mean, temporal variance, scale and record, in one plain file."""

import hashlib
import io
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, cast

import numpy as np
import tifffile
from numpy.typing import NDArray

from acquisition.devices import FrameImage
from acquisition.errors import SessionError
from acquisition.regular_files import LARGEST_IMAGE_BYTES, read_regular_file
from acquisition.session.durable_write import FileParts
from acquisition.session.record import CaptureRecord
from acquisition.untrusted import parse_json, read_tiff

_SEALED = b"\nseal=sha256\n"
"""In the TIFF's description: the file ends in a seal."""

_SEAL = re.compile(rb"\nSHA-256 of this file before this line: ([0-9a-f]{64})\n")
_SEAL_BYTES = 105

_INFO_START, _INFO_END = ('{\n "index"'.encode("utf-16-le"), "\n}".encode("utf-16-le"))
"""Of the record in ImageJ's Info, which is UTF-16."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CaptureImages:
    """The pixels of a capture with its record; images float32, shape ``(rows, cols)``.

    ``variance_dn2`` is the unbiased temporal variance of one frame, so that the mean has
    ``variance_dn2 / record.frames_used``. It is None where a single frame was used. In a bracket
    the mean is merged from several exposures, and ``variance_dn2 / record.frames_used`` is the
    variance of that; ``exposures_used`` counts those on which a pixel's level rests, 0 where it is
    not valid. It is None where there is no bracket.
    """

    mean_dn: NDArray[np.float32]
    variance_dn2: NDArray[np.float32] | None
    record: CaptureRecord
    exposures_used: NDArray[np.float32] | None = None

    def __post_init__(self) -> None:
        if self.mean_dn.ndim != 2:
            raise ValueError(f"mean_dn must have two axes, got shape {self.mean_dn.shape}")
        if (self.variance_dn2 is None) != (self.record.frames_used == 1):
            raise ValueError(
                f"a capture of {self.record.frames_used} frame(s) must "
                f"{'' if self.variance_dn2 is None else 'not '}have a variance"
            )
        if self.variance_dn2 is not None and self.variance_dn2.shape != self.mean_dn.shape:
            raise ValueError(
                f"the variance has shape {self.variance_dn2.shape}, the mean {self.mean_dn.shape}"
            )
        if (self.exposures_used is None) != (self.record.bracket is None):
            raise ValueError(
                f"a capture {'without' if self.record.bracket is None else 'with'} a bracket must "
                f"{'not ' if self.record.bracket is None else ''}say which exposures were used"
            )
        if self.exposures_used is not None and self.exposures_used.shape != self.mean_dn.shape:
            raise ValueError(
                f"exposures_used has shape {self.exposures_used.shape}, the mean "
                f"{self.mean_dn.shape}"
            )


def capture_parts(images: CaptureImages) -> FileParts:
    """Make the bytes of a capture's TIFF file; the same capture gives the same bytes.

    Page 1 is the mean, page 2 the variance, page 3 of a bracket the number of exposures used, 0
    where the pixel is not valid; uncompressed float32. The record is in ImageJ's
    Info as JSON without its ``sha256``, the scale in the resolution where it is known. The file
    ends in a `capture_seal`.
    """
    pages = [images.mean_dn]
    labels = ["mean"]
    if images.variance_dn2 is not None:
        pages.append(images.variance_dn2)
        labels.append("variance")
    if images.exposures_used is not None:
        pages.append(images.exposures_used)
        labels.append("exposures used")
    return _imagej_parts(
        [np.ascontiguousarray(page, dtype="<f4") for page in pages],
        {"axes": "ZYX", "seal": "sha256", "Labels": labels, "Info": _info(images.record)},
        images.record.scale_px_per_mm,
    )


def capture_seal(sha256: str) -> bytes:
    """The last line of a capture file, by which it vouches for itself where no journal does."""
    return f"\nSHA-256 of this file before this line: {sha256}\n".encode()


def is_sealed(data: bytes) -> bool | None:
    """Whether a capture file is as it was written; None if an older version wrote it unsealed."""
    if data.find(_SEALED, 0, 1 << 16) < 0:
        return None
    seal = _SEAL.fullmatch(data[-_SEAL_BYTES:])
    if seal is None:
        return False
    return hashlib.sha256(memoryview(data)[:-_SEAL_BYTES]).hexdigest() == seal[1].decode()


def _info(record: CaptureRecord) -> str:
    # ASCII only: ImageJ 1.52 garbles most characters beyond it ("本" becomes a comma).
    document = replace(record, sha256=None).to_json()
    return json.dumps(document, ensure_ascii=True, allow_nan=False, indent=1)


def frames_parts(frames_dn: Sequence[FrameImage]) -> FileParts:
    """Make the bytes of one multi-page uint16 TIFF file of raw frames, one a page, in order."""
    pages = [np.ascontiguousarray(frame, dtype="<u2") for frame in frames_dn]
    return _imagej_parts(pages, {"axes": "TYX"}, None)


def parse_capture(data: bytes, *, source: str) -> CaptureImages:
    """Read the bytes of ``capture_parts``; an error message starts with ``source``.

    Raises
    ------
    SessionError
        If the bytes are not such a file. The pixels are checked elsewhere, by the journal's hash.
    """
    try:
        tiff = read_tiff(data)
        document = parse_json(tiff.info) if tiff.info is not None else None
    except ValueError as error:
        raise SessionError(
            f"{source}: not a readable TIFF file: {error}", fault="damaged"
        ) from error
    if not isinstance(document, dict) or len(tiff.images) not in (1, 2, 3):
        raise SessionError(
            f"{source}: a TIFF file, but not a capture of a session", fault="not a session"
        )
    record = CaptureRecord.from_json(document, source=source)
    pages = [np.asarray(page, dtype=np.float32) for page in tiff.images]
    try:
        return CaptureImages(
            mean_dn=pages[0],
            variance_dn2=pages[1] if len(pages) > 1 else None,
            exposures_used=pages[2] if len(pages) > 2 else None,
            record=record,
        )
    except ValueError as error:
        raise SessionError(f"{source}: {error}", fault="damaged") from error


def has_record(data: bytes, document: Mapping[str, Any], *, source: str) -> bool:
    """Whether the bytes of a capture file hold this record, as the journal has it.

    Raises
    ------
    SessionError
        If they are not those of a capture.
    """
    expected = {**document, "sha256": None}
    start = data.find(_INFO_START)
    end = data.find(_INFO_END, start)
    if 0 <= start < end:
        text = data[start : end + len(_INFO_END)].decode("utf-16-le", errors="replace")
        try:
            if parse_json(text) == expected:
                return True
        except ValueError:
            pass  # an older version wrote it otherwise
    return parse_capture(data, source=source).record == CaptureRecord.from_json(expected)


def read_capture(path: Path) -> CaptureImages:
    """Read one capture file on its own, unverified; a session's ``load`` checks the hash too.

    Raises
    ------
    SessionError
        If the file cannot be read or is not a capture.
    """
    return parse_capture(_read(path), source=f"capture file {path}")


def _read(path: Path) -> bytes:
    try:
        return read_regular_file(path, LARGEST_IMAGE_BYTES)
    except OSError as error:
        raise SessionError(f"capture file {path}: {error.strerror}", path=path) from error


def _imagej_parts(
    pages: Sequence[NDArray[np.float32] | NDArray[np.uint16]],
    metadata: dict[str, object],
    scale_px_per_mm: float | None,
) -> FileParts:
    if scale_px_per_mm is not None:
        metadata = {**metadata, "unit": "mm"}
    file = io.BytesIO()
    # Without pixels, which are written from where they are: two copies of them take longer than
    # all the rest.
    written = tifffile.imwrite(
        file,
        None,
        shape=(len(pages), *pages[0].shape),
        dtype=pages[0].dtype,
        imagej=True,
        byteorder="<",
        photometric="minisblack",
        resolution=None if scale_px_per_mm is None else (scale_px_per_mm, scale_px_per_mm),
        metadata=metadata,
        returnoffset=True,
    )
    offset, _ = cast("tuple[int, int]", written)
    frame = file.getbuffer()
    pixels = [page.reshape(-1).data.cast("B") for page in pages]
    return (frame[:offset], *pixels, frame[offset + sum(map(len, pixels)) :])
