"""Files and folders of results: checked before long work, written whole or not at all.

Apart from the reports, whose plots and templates take half a second to load.
"""

import shutil
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from os.path import lexists
from pathlib import Path
from tempfile import TemporaryDirectory

from acquisition.remote_files import is_url, remote_status, url_of, write_remote
from acquisition.session import (
    MANIFEST_NAME,
    clear_parts,
    fsync_directory,
    part_of,
    refuse_capture,
    write_shared,
)
from standoff.errors import ApplicationError
from standoff.library.files.reachable import require_place, require_reachable

RESULTS_FOLDER = "results"
"""Folder of a session for the results obtained from it."""


def require_writable(paths: Iterable[Path | None]) -> None:
    """Check, before long work, that results have a folder and that PDF can be written.

    Raises
    ------
    ApplicationError
        If a result cannot be written; the message names it.
    """
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
            require_pdf()


def is_there(path: Path) -> bool:
    """Whether there is a file, or whatever else, at a path or URL.

    Raises
    ------
    ApplicationError
        If nobody can say: of a URL of an unknown kind, or whose server does not answer.
    """
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
    """Make a folder for results, unless it exists.

    Raises
    ------
    ApplicationError
        If it cannot be created.
    """
    try:
        refuse_capture(path)
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ApplicationError(f"cannot create the folder {path}: {error.strerror}") from error
    return path


def make_results_folder(session: Path) -> Path:
    """Make the folder for the results of a session, unless it exists.

    Raises
    ------
    ApplicationError
        If it cannot be created, or is a link: a session may have been received from someone else.
    """
    path = session / RESULTS_FOLDER
    if path.is_symlink():
        raise ApplicationError(
            f"{path} is a link, and results are written in the session's own folder alone; put the "
            "folder itself there"
        )
    return make_folder(path)


def write_file(path: Path, data: bytes) -> None:
    """Write a result, whole or not at all.

    Raises
    ------
    ApplicationError
        If the file cannot be written.
    """
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

    What fails before the end leaves the earlier result as it was. The document goes first and
    comes last: a kill in between leaves none, never one beside the files of another.

    Parameters
    ----------
    document
        The file that names the others of the result. They lie beside it, under the names that they
        have in the folder given.

    Raises
    ------
    ApplicationError
        If a file cannot be moved to its place.
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


def require_pdf() -> None:
    """Check that PDF files can be written.

    Raises
    ------
    ApplicationError
        If the extra is missing; the message says how to install it.
    """
    try:
        import weasyprint  # noqa: F401  # an optional dependency
    except (ImportError, OSError) as error:  # OSError: its system libraries are missing
        raise ApplicationError(
            f"a PDF report needs WeasyPrint ({error}): pip install standoff[pdf]"
        ) from error
