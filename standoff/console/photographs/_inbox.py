"""Photographs of one's own: they arrive from any browser, wait, and are imported as sessions."""

import hashlib
import re
import shutil
import struct
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from threading import Lock
from unicodedata import category

from acquisition.choices import CaptureKind
from acquisition.errors import ImageFileError
from acquisition.files import make_results_folder, write_file
from acquisition.photographs import IMAGE_SUFFIXES
from acquisition.printable import on_one_line
from acquisition.regular_files import read_regular_file
from acquisition.session import CaptureRecord, SessionNotes
from standoff.console.jobs import Job
from standoff.console.photographs._jpeg import jpeg_size, without_location
from standoff.console.photographs._uploads import Received, TryAgainError, UploadError, Uploads
from standoff.errors import ApplicationError
from standoff.library import RESULTS_FOLDER, make_folder

PHOTOGRAPHS_FOLDER = "photographs"
"""Of what arrives, beside the sessions; and of the files as they were sent, in a session's results.

No session can have this name.
"""

MOST_ARRIVED = 200
"""Photographs that wait to be imported."""

MOST_PX = 64_000_000
"""Pixels of a photograph: the largest sensors of phones have 50 million in one picture."""

LONGEST_NAME_BYTES = 150
_JPEG_SUFFIXES = (".jpg", ".jpeg")
_HEIC_SUFFIXES = (".heic", ".heif", ".hif")
_PNG_START = b"\x89PNG\r\n\x1a\n"
_SHA256 = re.compile(r"[0-9a-f]{64}")
_MEDIA_TYPES = {".png": "png", ".webp": "webp", ".avif": "avif", ".gif": "gif", ".bmp": "bmp"}


@dataclass(frozen=True, slots=True, kw_only=True)
class ArrivedPhotograph:
    """A photograph that waits to be imported: hash as it was sent, its file, and when it came."""

    sha256: str
    path: Path
    size_bytes: int
    arrived_utc: str

    @property
    def media_type(self) -> str:
        """By which a browser shows it; empty for files that browsers do not show."""
        suffix = self.path.suffix.lower()
        kind = "jpeg" if suffix in _JPEG_SUFFIXES else _MEDIA_TYPES.get(suffix, "")
        return f"image/{kind}" if kind else ""


class PhotographInbox:
    """Photographs that were sent and not imported yet, in a folder that survives a restart.

    Headers alone are read here: pixels are decoded by the process that imports them. ``revision``
    counts the changes to what waits.
    """

    def __init__(self, folder: Path) -> None:
        self.revision = 0
        self._folder = folder
        self._arrived = folder / "arrived"
        self._uploads = Uploads(folder / "incoming")
        self._lock = Lock()

    def begin(self, sha256: str, size: int, name: str) -> Received:
        """Say where a photograph goes on, 0 for a new one; one that is there is not sent again."""
        _plain_name(name)
        with self._lock:
            there = self._of(sha256)
            if there is not None:
                return Received(received=size, path=there.path)
            if len(self._all()) >= MOST_ARRIVED:
                raise TryAgainError(
                    f"{MOST_ARRIVED} photographs wait to be imported: import some, or throw some "
                    "away"
                )
        self._refuse_link()
        return self._uploads.begin(sha256, size)

    def add(self, sha256: str, offset: int, data: bytes, size: int) -> Received:
        """Add a part, as `Uploads.add`."""
        with self._lock:
            there = self._of(sha256)
        if there is not None:
            return Received(received=size, path=there.path)
        return self._uploads.add(sha256, offset, data, size)

    def receive(self, sha256: str, name: str, *, is_location_removed: bool) -> ArrivedPhotograph:
        """Take a photograph that has come whole; refuse what is none, whose file is gone then.

        Of one that is there already the location is removed as well, if that is asked for now.
        """
        with self._lock:
            there = self._of(sha256)
            if there is not None:
                if is_location_removed:
                    write_file(there.path, _without_place(read_regular_file(there.path), name))
                return there
            path = self._uploads.path_of(sha256)
            try:
                name = _plain_name(name)
                data = _checked(read_regular_file(path), name)
                kept = _without_place(data, name) if is_location_removed else data
            except (ImageFileError, UploadError):
                self._uploads.discard(path)
                raise
            folder = self._arrived / sha256
            make_folder(folder)
            if kept is not data:
                write_file(path, kept)  # whole or not at all: after a kill it passes for the whole
            path.replace(folder / self._free_name(name))
            self.revision += 1
            found = self._of(sha256)
            assert found is not None
            return found

    def arrived(self) -> list[ArrivedPhotograph]:
        """Return what waits, by name."""
        with self._lock:
            return self._all()

    def named(self, hashes: Sequence[str]) -> list[ArrivedPhotograph]:
        """Return those with these hashes."""
        with self._lock:
            found = [self._of(sha256) for sha256 in hashes]
        if None in found:
            raise ApplicationError("A photograph is not here any more: open the page again.")
        return [one for one in found if one is not None]

    def discard(self, sha256: str) -> None:
        """Forget a photograph, if it is there."""
        with self._lock:
            there = self._of(sha256)
            if there is not None:
                there.path.unlink(missing_ok=True)
                self._remove_folder(there.path.parent)
                self.revision += 1

    @contextmanager
    def importing(self, session: Path) -> Iterator[Path]:
        """Give a folder for a session that takes its place at the end, whole or not at all."""
        part = self._folder / "importing" / session.name
        try:
            shutil.rmtree(part.parent, ignore_errors=True)  # of a run that was killed
            make_folder(part.parent)
            yield part
            part.rename(session)
        finally:
            shutil.rmtree(part.parent, ignore_errors=True)

    def move(self, one: ArrivedPhotograph, folder: Path) -> bool:
        """Put a photograph, which was imported, into a folder; False if it was thrown away."""
        with self._lock:
            is_there = one.path.is_file()
            if is_there:
                one.path.replace(folder / one.path.name)
            self._remove_folder(one.path.parent)
            self.revision += 1
        return is_there

    @staticmethod
    def _remove_folder(folder: Path) -> None:
        with suppress(OSError):  # something else was put into it
            folder.rmdir()

    def _all(self) -> list[ArrivedPhotograph]:
        if self._folder.is_symlink() or not self._arrived.is_dir():
            return []
        found = (self._of(path.name) for path in self._arrived.iterdir())
        return sorted((one for one in found if one), key=lambda one: one.path.name)

    def _of(self, sha256: str) -> ArrivedPhotograph | None:
        folder = self._arrived / sha256
        if not _SHA256.fullmatch(sha256) or folder.is_symlink() or not folder.is_dir():
            return None
        path = next((each for each in folder.iterdir() if not each.is_symlink()), None)
        if path is None or not path.is_file():
            return None
        facts = path.stat()
        return ArrivedPhotograph(
            sha256=sha256,
            path=path,
            size_bytes=facts.st_size,
            arrived_utc=f"{datetime.fromtimestamp(facts.st_mtime, UTC):%Y-%m-%d %H:%M}",
        )

    def _free_name(self, name: str) -> str:
        """A name that no other has which waits: a session's photographs have different ones."""
        taken = {one.path.name.lower() for one in self._all()}
        path, number = Path(name), 1
        while name.lower() in taken:
            number += 1
            name = f"{path.stem} ({number}){path.suffix}"
        return name

    def _refuse_link(self) -> None:
        if self._folder.is_symlink():
            raise UploadError(f"{self._folder} is a link, which is not followed: remove it")


def _plain_name(name: str) -> str:
    """The name, with plain spaces: macOS puts narrow ones into those of screenshots."""
    name = "".join(" " if category(each) == "Zs" else each for each in name)
    if (
        not name.isprintable()
        or name.startswith((".", "-"))
        or any(mark in name for mark in "/\\:")
        or len(name.encode("utf-8", "replace")) > LONGEST_NAME_BYTES
        or on_one_line(name) != name
    ):
        raise UploadError(f"{on_one_line(name)[:60]}: this cannot be the name of a photograph")
    suffix = Path(name).suffix.lower()
    if suffix in _HEIC_SUFFIXES:
        raise UploadError(
            f"{name} is a HEIC photograph, which is not read; send it as JPEG or TIFF"
        )
    if suffix not in IMAGE_SUFFIXES:
        raise UploadError(
            f"{name} does not have the name of a photograph: it must end in .jpg, .png, .tif or "
            "that of another kind of image"
        )
    return name


def _checked(data: bytes, name: str) -> bytes:
    """Refuse a file that is not what its name says, or is too large, by its headers alone."""
    suffix = Path(name).suffix.lower()
    try:
        if suffix in _JPEG_SUFFIXES:
            size = jpeg_size(data)
        elif suffix == ".png":
            size = _png_size(data)
        else:
            return data  # the reader checks the size that it states before it decodes a pixel
    except ImageFileError as error:
        raise ImageFileError(f"{name}: {error}") from error
    if size[0] * size[1] > MOST_PX:
        raise ImageFileError(
            f"{name} has {size[0]} x {size[1]} px; at most {MOST_PX / 1e6:.0f} million are taken"
        )
    return data


def _png_size(data: bytes) -> tuple[int, int]:
    """``(width, height)`` that a PNG file's header states (W3C PNG, third edition, 11.2.1)."""
    if not data.startswith(_PNG_START) or data[12:16] != b"IHDR" or len(data) < 24:
        raise ImageFileError("it is not a PNG file")
    width, height = struct.unpack_from(">II", data, 16)
    return width, height


def _without_place(data: bytes, name: str) -> bytes:
    if Path(name).suffix.lower() not in _JPEG_SUFFIXES:
        raise ImageFileError(
            f"{name}: the location can be removed only from JPEG files; send it as one, or with "
            "its location"
        )
    try:
        return without_location(data)
    except ImageFileError as error:
        raise ImageFileError(f"{name}: {error}") from error


def photograph_file(session: Path, record: CaptureRecord) -> Path:
    """Path of a capture's file; of a photograph that was sent, the file as it was sent."""
    kept = session / RESULTS_FOLDER / PHOTOGRAPHS_FOLDER
    sent = kept / record.target
    is_name = Path(record.target).name == record.target
    is_link = any(path.is_symlink() for path in (kept.parent, kept, sent))
    if is_name and not is_link and sent.is_file():
        return sent
    return session / record.file


@dataclass(frozen=True, slots=True, kw_only=True)
class ImportRequest:
    """Photographs that become a new session, and what they are."""

    session: Path
    photographs: tuple[ArrivedPhotograph, ...]
    kind: CaptureKind
    height_mm: float
    operator: str

    def words(self, out: Path) -> list[str]:
        """The command line, without the program, that makes the session at a path."""
        return [
            "import",
            f"--kind={self.kind}",
            f"--height-mm={self.height_mm}",
            f"--operator={self.operator}",
            f"--out={out}",
            "--",
            *(str(one.path) for one in self.photographs),
        ]


def import_arrived(
    inbox: PhotographInbox,
    request: ImportRequest,
    job: Job,
    run: Callable[[Sequence[str], Job], object],
) -> str:
    """Import photographs by ``standoff import``, keep the files as they were sent; say how many.

    ``run`` runs a command.
    """
    session = request.session
    try:
        with inbox.importing(session) as part:
            try:
                run(request.words(part), job)
            except ApplicationError as error:
                raise ApplicationError(_without_folders(str(error), request, part)) from error
        kept = make_results_folder(session) / PHOTOGRAPHS_FOLDER
        make_folder(kept)
        notes = SessionNotes(session, operator=request.operator)
        for one in request.photographs:
            if inbox.move(one, kept):
                notes.note(_kept_words(one, kept / one.path.name))
    except OSError as error:
        raise ApplicationError(f"{session} cannot be written: {error.strerror}") from error
    count = len(request.photographs)
    return f"{count} photograph{'s' * (count > 1)} imported."


def _without_folders(said: str, request: ImportRequest, part: Path) -> str:
    """What the command says, with the names alone of what a page knows by name."""
    for path in (part, *(one.path for one in request.photographs)):
        said = said.replace(f"{path.parent}/", "")
    return said


def _kept_words(one: ArrivedPhotograph, path: Path) -> str:
    """What the journal says of a photograph: how it was sent, and what is kept of it."""
    found = hashlib.sha256(path.read_bytes()).hexdigest()
    changed = "" if found == one.sha256 else f" without its location as SHA-256 {found}"
    return (
        f"{one.path.name} was sent to the console as SHA-256 {one.sha256}, and is kept{changed} in "
        f"{RESULTS_FOLDER}/{PHOTOGRAPHS_FOLDER}"
    )
