"""Files and folders of results: checked before long work, written whole or not at all.

Apart from figures, whose plots take half a second to load.
"""

import logging
import shutil
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from os.path import lexists
from pathlib import Path
from tempfile import TemporaryDirectory

from acquisition.errors import ApplicationError
from acquisition.files._names import require_place, require_reachable
from acquisition.remote_files import is_url, remote_status, url_of, write_remote
from acquisition.session import (
    MANIFEST_NAME,
    clear_parts,
    fsync_directory,
    part_of,
    refuse_capture,
    write_shared,
)

RESULTS_FOLDER = "results"
"""Folder of a session for the results obtained from it."""


def require_writable(paths: Iterable[Path | None]) -> None:
    """Check, before long work, that results have a folder and that PDF can be written."""
    for path in paths:
        if path is None:
            continue
        if is_url(path):
            is_there(path)
            continue
        require_reachable(path)
        if path.parent.name == RESULTS_FOLDER and (path.parent.parent / MANIFEST_NAME).is_file():
            make_results_folder(path.parent.parent)
        if not path.parent.is_dir():
            raise ApplicationError(f"cannot write {path}: {path.parent} is not a folder")
        if path.is_dir():
            raise ApplicationError(f"cannot write {path}: it is a folder")
        require_place(path)
        if path.suffix.lower() == ".pdf":
            _require_pdf()


def is_there(path: Path) -> bool:
    """Whether there is a file, or whatever else, at a path or URL."""
    if not is_url(path):
        return lexists(path)
    try:
        remote_status(path)
    except FileNotFoundError:
        return False
    except OSError as error:
        raise ApplicationError(f"cannot write {url_of(path)}: {error.strerror}") from error
    return True


def make_folder(path: Path) -> Path:
    """Make a folder for results, unless it exists."""
    try:
        refuse_capture(path)
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ApplicationError(f"cannot create the folder {path}: {error.strerror}") from error
    return path


def make_results_folder(session: Path) -> Path:
    """Make the folder for the results of a session, unless it exists."""
    path = session / RESULTS_FOLDER
    if path.is_symlink():
        raise ApplicationError(
            f"{path} is a link, but results are written only into the session's own folder; "
            "replace the link by the folder itself"
        )
    return make_folder(path)


def write_file(path: Path, data: bytes) -> None:
    """Write a result, whole or not at all."""
    try:
        if is_url(path):
            write_remote(path, data)
        else:
            write_shared(path, data)
    except OSError as error:
        raise ApplicationError(f"cannot write {url_of(path)}: {error.strerror}") from error


@contextmanager
def written_together(document: Path) -> Iterator[Path]:
    """Give a folder for the files of one result; at the end they take the place of an earlier one.

    They lie beside ``document``, which goes first and comes last: a kill in between leaves none,
    never one beside the files of another.
    """
    if is_url(document):
        with TemporaryDirectory() as folder:
            yield Path(folder)
            for file in _with_document_last(Path(folder), document):
                write_file(document.with_name(file.name), file.read_bytes())
        return
    part = part_of(document.with_name(f".{document.name}"))
    try:
        refuse_capture(document)
        clear_parts(document.parent, f".{document.name}")
        make_folder(part)
        yield part
        document.unlink(missing_ok=True)
        for file in _with_document_last(part, document):
            file.replace(document.with_name(file.name))
        fsync_directory(document.parent)
    except OSError as error:
        raise ApplicationError(f"cannot write {document}: {error.strerror}") from error
    finally:
        shutil.rmtree(part, ignore_errors=True)


def _with_document_last(folder: Path, document: Path) -> list[Path]:
    return sorted(folder.iterdir(), key=lambda file: (file.name == document.name, file))


def _require_pdf() -> None:
    """Check that PDF files can be written."""
    try:
        import weasyprint  # noqa: F401  # an optional dependency
    except (ImportError, OSError) as error:  # OSError: its system libraries are missing
        raise ApplicationError(
            f"a PDF report needs WeasyPrint ({error}): pip install standoff[pdf]"
        ) from error


def write_page(path: Path, page: str) -> None:
    """Write one page: as PDF if the file's suffix says so, else as HTML."""
    is_pdf = path.suffix.lower() == ".pdf"
    write_file(path, _pdf_bytes(page) if is_pdf else page.encode("utf-8"))


def _pdf_bytes(page: str) -> bytes:
    """Return a report page as the bytes of a PDF file."""
    _require_pdf()
    import weasyprint  # an optional dependency

    for name in ("weasyprint", "fontTools"):
        logging.getLogger(name).setLevel(logging.CRITICAL)
    return bytes(weasyprint.HTML(string=page).write_pdf())
