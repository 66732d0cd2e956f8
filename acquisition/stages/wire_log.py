"""A log of every line on the wire, bounded in size."""

from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from types import TracebackType
from typing import Self

MAX_BYTES = 5_000_000
"""About 80 000 lines: some hours of a capture session."""


def _now() -> datetime:
    return datetime.now(UTC)


class WireLog:
    """Appends one line for every line sent (``>``) or received (``<``) and every remark (``#``).

    Bytes outside printable ASCII are escaped as in Python. At ``max_bytes`` the file becomes
    ``<name>.1``, replacing an earlier one, and a new file is started.

    Parameters
    ----------
    path
        The file; its folder must exist.
    max_bytes
        Size of one of the two files.
    utc_now
        Clock for the time stamps.

    Raises
    ------
    OSError
        If the file cannot be written.
    """

    def __init__(
        self,
        path: Path,
        *,
        max_bytes: int = MAX_BYTES,
        utc_now: Callable[[], datetime] = _now,
    ) -> None:
        self._path = path
        self._max_bytes = max_bytes
        self._utc_now = utc_now
        self._file = path.open("a", encoding="ascii")

    def sent(self, data: bytes) -> None:
        """Log what was written to the port."""
        self._write(">", _escaped(data))

    def received(self, data: bytes) -> None:
        """Log one line, or what there was of one, that came from the port."""
        self._write("<", _escaped(data))

    def remark(self, text: str) -> None:
        """Log what happened to the connection."""
        self._write("#", _escaped(text.encode("utf-8")))

    def close(self) -> None:
        """Close the file; closing twice is harmless."""
        self._file.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def _write(self, direction: str, text: str) -> None:
        if self._file.closed:
            return
        stamp = self._utc_now().isoformat(timespec="microseconds")
        self._file.write(f"{stamp} {direction} {text}\n")
        # The last lines matter most when the program or the machine dies.
        self._file.flush()
        if self._file.tell() >= self._max_bytes:
            self._file.close()
            self._path.replace(self._path.with_name(self._path.name + ".1"))
            self._file = self._path.open("a", encoding="ascii")


def _escaped(data: bytes) -> str:
    return repr(data)[2:-1]
