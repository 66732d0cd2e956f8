"""Names of files: what they may end in, and those that the system refuses, with the remedy."""

import errno
import os
from collections.abc import Iterator
from pathlib import Path

from acquisition.errors import ApplicationError
from acquisition.remote_files import is_url

PAGES = frozenset({".html", ".htm", ".pdf"})
FIGURES = frozenset({".png", ".svg"})
FLOAT_IMAGES = frozenset({".tif", ".tiff"})
"""What the names of files end in that hold pages, figures and levels in floating point."""

_LONGEST_NAME_BYTES = 255
"""On the file systems in use: ext4, XFS, Btrfs, NFS, APFS; NTFS counts 255 letters."""

_LONGEST_SHOWN = 160
_ACCESS_IDS = {"effective_ids": True} if os.access in os.supports_effective_ids else {}


def require_reachable(path: Path) -> None:
    """Check that the system finds what is at a path, or finds that nothing is there."""
    if is_url(path):
        return
    try:
        path.stat()
    except FileNotFoundError:
        return
    except OSError as error:
        raise ApplicationError(refusal_text(path, error)) from error
    except ValueError as error:  # letters that the system's encoding lacks, or a zero byte
        raise ApplicationError(f"cannot use {path}: no file can have such a name") from error


def require_place(path: Path) -> None:
    """Check that a file can be written at a path, in its folder or one that is yet to be made."""
    if is_url(path):
        return
    require_reachable(path)
    folder = next((each for each in path.parents if each.is_dir()), None)
    if folder is not None and not os.access(folder, os.W_OK | os.X_OK, **_ACCESS_IDS):
        here = "this folder" if folder == Path() else f"the folder {_shown(folder)}"
        raise ApplicationError(
            f"cannot write {_shown(path)}: you may not write in {here}; ask its owner for "
            "permission, or name another place"
        )


def require_folder(path: Path, *, is_written: bool = False) -> None:
    """Check that a folder can be read, and written if asked, or made where nothing is yet."""
    require_reachable(path)
    mode, what = (os.W_OK, "write in") if is_written else (os.R_OK, "look into")
    if not path.exists():
        require_place(path)
    elif not path.is_dir():
        raise ApplicationError(f"{_shown(path)} is not a folder; name one")
    elif not os.access(path, mode | os.X_OK, **_ACCESS_IDS):
        raise ApplicationError(
            f"you may not {what} the folder {_shown(path)}; ask its owner for permission"
        )


def refusal_text(path: Path, error: OSError) -> str:
    """Say in a line why the system refuses a path, and what to do."""
    shown = _shown(path)
    if error.errno == errno.ENAMETOOLONG:
        longest = max((len(os.fsencode(part)) for part in path.parts), default=0)
        if longest > _LONGEST_NAME_BYTES:
            return (
                f"cannot use {shown}: a name of {longest} bytes is too long, as file systems take "
                f"{_LONGEST_NAME_BYTES} at most; choose a shorter one"
            )
        return f"cannot use {shown}: the path is too long; name it from a folder nearer to it"
    if error.errno == errno.ENOTDIR:
        above = next((one for one in _above(path) if not one.is_dir()), None)
        if above is not None:
            return f"cannot use {shown}: {_shown(above)} is not a folder; name another place"
    if error.errno == errno.ELOOP:
        return f"cannot use {shown}: its symbolic links form a loop; name the file itself"
    if error.errno in (errno.EACCES, errno.EPERM):
        shut = next((one for one in _above(path) if _is_shut(one)), None)
        if shut is not None:
            return (
                f"cannot use {shown}: you may not enter the folder {_shown(shut)}; ask its owner "
                "for permission"
            )
        return f"cannot use {shown}: you have no permission; ask its owner for it"
    return f"cannot use {shown}: {error.strerror or error}"


def _above(path: Path) -> Iterator[Path]:
    """The folders above a path, from the top, as far as the system lets us look."""
    for one in reversed(path.parents):
        yield one
        if _is_shut(one):
            return


def _is_shut(folder: Path) -> bool:
    try:
        return folder.is_dir() and not os.access(folder, os.X_OK, **_ACCESS_IDS)
    except OSError:
        return True


def _shown(path: Path) -> str:
    text = str(path)
    if len(text) <= _LONGEST_SHOWN:
        return text
    half = _LONGEST_SHOWN // 2
    return f"{text[:half]}[...]{text[-half:]}"
