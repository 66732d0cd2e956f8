"""The lines of a summary, read again and again from a nameless file."""

import json
import os
from collections.abc import Callable, Iterator
from pathlib import Path
from tempfile import TemporaryFile
from types import TracebackType
from typing import Any, Self

from analysis.errors import ResultsFileError
from analysis.followup_series.work import FollowupWork
from analysis.sweep import Manifest, sorted_lines

Row = dict[str, Any]


def is_refused(row: Row) -> bool:
    """Whether a follow-up gave nothing."""
    return row["refused"] is not None


class CommittedRows:
    """What follow-ups gave, in the order of their paths.

    Parameters
    ----------
    work
        Reads the commits.
    manifest
        The follow-ups.

    Raises
    ------
    ResultsFileError
        If the folder of the commits cannot be written.
    """

    def __init__(self, work: FollowupWork[Any, Any], manifest: Manifest) -> None:
        self.is_whole = True
        """Whether every follow-up has been done, in this run or another one."""
        try:
            self._file = TemporaryFile(dir=work.state)  # noqa: SIM115  closed by __exit__
            for line in sorted_lines(self._committed(work, manifest), work.state):
                self._file.write(line.split(b"\t", 1)[1])
            self._file.flush()
        except OSError as error:
            raise ResultsFileError(
                f"cannot write in {work.state}: {error.strerror}", source=str(work.state)
            ) from error

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._file.close()

    def __iter__(self) -> Iterator[Row]:
        """Read the lines from the first; one reader at a time."""
        self._file.seek(0)
        for line in self._file:
            yield json.loads(line)

    def count(self, is_counted: Callable[[Row], bool]) -> int:
        """Return the number of lines of some kind."""
        return sum(map(is_counted, self))

    def _committed(self, work: FollowupWork[Any, Any], manifest: Manifest) -> Iterator[bytes]:
        for item in manifest:
            record = work.record(item)
            if record is None:
                self.is_whole = False
                return
            # As JSON, neither holds a tab or a line break.
            path: Path = item.path
            yield f"{json.dumps(os.fspath(path))}\t{json.dumps(record.row)}\n".encode("ascii")
