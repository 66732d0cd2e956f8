"""Sorted lines that need not fit into memory."""

from collections.abc import Iterable, Iterator
from contextlib import ExitStack
from heapq import merge
from itertools import islice
from pathlib import Path
from tempfile import TemporaryFile

_LINES_AT_ONCE = 10_000
"""Held in memory: 2 MB of names of files."""


def sorted_lines(lines: Iterable[bytes], folder: Path) -> Iterator[bytes]:
    """Yield lines in the order of their bytes, each once, by way of nameless files in a folder.

    Parameters
    ----------
    lines
        Without a line break inside; each ends with one.
    folder
        Needs room for all of them, twice.

    Raises
    ------
    OSError
        If the folder cannot be written.
    """
    with ExitStack() as files:
        runs = []
        source = iter(lines)
        while some := sorted(islice(source, _LINES_AT_ONCE)):
            run = files.enter_context(TemporaryFile(dir=folder))
            run.writelines(some)
            run.seek(0)
            runs.append(run)
        before = None
        for line in merge(*runs):
            if line != before:
                yield line
            before = line
