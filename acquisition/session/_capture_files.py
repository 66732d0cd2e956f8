"""The capture files of a session: mean, variance, scale and record in one plain ImageJ TIFF each.

A file that no line of the journal names is evidence: of lines that were lost, or of a run that was
killed before it could write its line. It is never written over.
"""

import hashlib
import io
import json
import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, cast

import numpy as np
import tifffile
from numpy.typing import NDArray

from acquisition.devices import FrameImage
from acquisition.errors import SessionError
from acquisition.regular_files import LARGEST_IMAGE_BYTES, read_regular_file
from acquisition.session._files import CAPTURE_FOLDERS, PART_SUFFIX, FileParts, move_new
from acquisition.session._record import CaptureRecord
from acquisition.untrusted import parse_json, read_tiff

_SEALED = b"\nseal=sha256\n"
"""In the TIFF's description: the file ends in a seal."""

_SEAL = re.compile(rb"\nSHA-256 of this file before this line: ([0-9a-f]{64})\n")
_SEAL_BYTES = 105

_INFO_START, _INFO_END = ('{\n "index"'.encode("utf-16-le"), "\n}".encode("utf-16-le"))
"""Of the record in ImageJ's Info, which is UTF-16."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CaptureImages:
    """The pixels of a capture and its record; images are float32 of shape ``(rows, cols)``.

    ``variance_dn2`` is the unbiased temporal variance of one frame; that of the mean is
    ``variance_dn2 / record.frames_used``. It is None if a single frame was used. In a bracket, the
    mean is merged from several exposures, and its variance is again ``variance_dn2 /
    record.frames_used``; ``exposures_used`` is the number of exposures that a pixel's level is
    based on, 0 where it is not valid, and None without a bracket.
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

    Pages are the mean, the variance, and of a bracket the number of exposures used; float32. The
    record is in ImageJ's Info as JSON without its ``sha256``, the scale in the resolution. The file
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
    """Read the bytes of ``capture_parts``; an error message starts with ``source``."""
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
    """Whether the bytes of a capture file hold this record, as the journal has it."""
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
    """Read one capture file on its own, unverified; a session's ``load`` checks the hash too."""
    try:
        data = read_regular_file(path, LARGEST_IMAGE_BYTES)
    except OSError as error:
        raise SessionError(f"capture file {path}: {error.strerror}", path=path) from error
    return parse_capture(data, source=f"capture file {path}")


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


FileState = Literal["ok", "missing", "changed", "unjournaled", "unfinished"]

_SET_ASIDE_FOLDER = "set-aside"
"""Of a session, for files that an operator decided not to be captures of it."""

_MOST_NAMED = 3

_OF_FILE_MANAGERS = ("Thumbs.db", "desktop.ini")


def files_of(record: CaptureRecord) -> list[tuple[str, str | None]]:
    """Names of a capture's files, relative to the session, and their hashes."""
    files = [(record.file, record.sha256)]
    if record.frames_file is not None:
        files.append((record.frames_file, record.frames_sha256))
    return files


def file_sha256(path: Path) -> str:
    """SHA-256 of a file in hexadecimal, as ``sha256sum`` prints it."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def file_state(path: Path, sha256: str | None) -> FileState:
    """Whether a file is there and has the hash."""
    try:
        if not path.is_file():
            return "missing"
        return "ok" if file_sha256(path) == sha256 else "changed"
    except OSError as error:
        raise SessionError(f"{path}: {error.strerror}", path=path) from error


def is_intact(path: Path, record: CaptureRecord) -> bool:
    """Whether every file of a capture in the session at ``path`` matches the journal."""
    return all(file_state(path / file, sha256) == "ok" for file, sha256 in files_of(record))


def found_files(path: Path) -> list[str]:
    """Names of the files where captures lie, but for those that file managers leave, sorted."""
    return sorted(
        file.relative_to(path).as_posix()
        for folder in CAPTURE_FOLDERS
        for file in (path / folder).glob("*")
        if not file.name.startswith(".") and file.name not in _OF_FILE_MANAGERS
    )


def unknown_files(path: Path, records: Iterable[CaptureRecord]) -> list[str]:
    """Names of the finished files where captures lie that none of the records names."""
    known = {file for record in records for file, _ in files_of(record)}
    return [
        file
        for file in found_files(path)
        if file not in known and not (file.endswith(PART_SUFFIX) and (path / file).is_file())
    ]


@dataclass(frozen=True, slots=True, kw_only=True)
class FoundCapture:
    """What a file of a session that the journal does not name holds.

    ``record`` has the hash that the file has now; None if it is no capture of this session, and
    ``refusal`` says why. Files of older versions are not sealed.
    """

    file: str
    record: CaptureRecord | None = None
    is_sealed: bool = False
    refusal: str = ""


def found_capture(
    path: Path, file: str, *, indices: Collection[int], known_uids: Collection[str]
) -> FoundCapture:
    """Read a file that the journal does not name: a capture by its metadata and seal, or not."""
    try:
        data = read_regular_file(path / file, LARGEST_IMAGE_BYTES)
        sealed = is_sealed(data)
        if sealed is False:
            return FoundCapture(file=file, refusal="is damaged: it is not as it was written")
        record = parse_capture(data, source=file).record
    except OSError as error:
        return FoundCapture(file=file, refusal=f"cannot be read ({error.strerror})")
    except SessionError:
        return FoundCapture(file=file, refusal="is not a capture of this session")
    if record.uid in known_uids:
        return FoundCapture(
            file=file, refusal=f"is a copy of capture {record.index}, which the journal has"
        )
    if record.file != file or record.index not in indices:
        return FoundCapture(file=file, refusal="is not a capture of this session")
    record = replace(record, sha256=hashlib.sha256(data).hexdigest())
    return FoundCapture(file=file, record=record, is_sealed=sealed is True)


@dataclass(frozen=True, slots=True, kw_only=True)
class KilledRun:
    """What a run left that was killed before it could journal its capture: that, or remains."""

    capture: FoundCapture | None = None
    remains: tuple[str, ...] = ()


def left_by_killed_run(
    path: Path,
    unknown: Collection[str],
    next_files: Iterable[tuple[str, str]],
    uids: Collection[str],
) -> KilledRun | None:
    """Explain files that the journal does not name by a kill; None if that explains them not.

    A run writes raw frames, then the capture, then its line: there is at most one of each, of the
    name in ``next_files`` by entry, and whole.
    """
    if not unknown:
        return KilledRun()
    for index, (capture, frames) in enumerate(next_files):
        if not set(unknown) <= {capture, frames}:
            continue
        if capture not in unknown or (path / capture).stat().st_size == 0:
            return KilledRun(remains=tuple(unknown))
        found = found_capture(path, capture, indices=(index,), known_uids=uids)
        if found.record is None or not found.is_sealed or not is_intact(path, found.record):
            return None
        if frames in unknown and found.record.frames_file != frames:
            return None
        return KilledRun(capture=found)
    return None


def set_aside(path: Path, files: Iterable[str]) -> list[dict[str, str]]:
    """Move files out of the folders of captures; returns their old and new names and hashes."""
    moved = []
    for file in files:
        name = Path(file).name
        folder = path / _SET_ASIDE_FOLDER
        folder.mkdir(exist_ok=True)
        target, number = folder / name, 1
        while target.exists() or target.is_symlink():
            number += 1
            target = folder / f"{Path(name).stem}_{number}{Path(name).suffix}"
        facts = {"file": file, "to": target.relative_to(path).as_posix()}
        if (path / file).is_file() and not (path / file).is_symlink():
            facts["sha256"] = file_sha256(path / file)
        if (path / file).is_dir():
            (path / file).rename(target)
        else:
            move_new(path / file, target)
        moved.append(facts)
    return moved


def unknown_files_text(files: Collection[str]) -> str:
    """Say which files no line of the journal names, and what can become of them."""
    named = ", ".join(sorted(files)[:_MOST_NAMED])
    more = f" and {len(files) - _MOST_NAMED} more" if len(files) > _MOST_NAMED else ""
    return (
        f"no line of the journal names {named}{more}; `standoff verify --repair` adds to the "
        "journal the files that are captures of this session, and `standoff session set-aside` "
        "moves the others away"
    )
