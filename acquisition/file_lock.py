"""One process at a time may write a file: a lock that ends with the process that holds it."""

import os

try:
    import fcntl
except ModuleNotFoundError:  # Windows
    fcntl = None  # type: ignore[assignment]

__all__ = ["lock_exclusively"]


def lock_exclusively(descriptor: int) -> None:
    """Take the lock of an open file; closing the descriptor, or death, gives it back.

    Raises
    ------
    BlockingIOError
        If another process holds it.
    """
    if fcntl is not None:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        return
    import msvcrt  # exists on Windows alone

    # A byte far behind the end: Windows bars even readers from a locked part of a file.
    place = os.lseek(descriptor, 0, os.SEEK_CUR)
    try:
        os.lseek(descriptor, 1 << 40, os.SEEK_SET)
        msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)
    except PermissionError as error:
        raise BlockingIOError(error.errno, "the file is locked") from error
    finally:
        os.lseek(descriptor, place, os.SEEK_SET)
