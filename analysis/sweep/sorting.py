"""Sorted lines that need not fit into memory."""

from collections.abc import Iterable, Iterator
from contextlib import ExitStack
from heapq import merge
from itertools import islice
from pathlib import Path
from tempfile import TemporaryFile
from typing import IO

_LINES_AT_ONCE = 1000
"""Held in memory: 0.2 MB of names of files."""

_RUNS_AT_ONCE = 32
"""Sorted files that are read at once, each through a buffer of 8 kB."""


def sorted_lines(lines: Iterable[bytes], folder: Path) -> Iterator[bytes]:
    """Yield lines in the order of their bytes, each once, by way of nameless files in a folder.

    Memory does not grow with the number of lines.

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

        def run_of(some: Iterable[bytes]) -> IO[bytes]:
            run = files.enter_context(TemporaryFile(dir=folder))
            run.writelines(some)
            run.seek(0)
            return run

        # Level k holds runs that were merged k times; full, it becomes one run of the next.
        levels: list[list[IO[bytes]]] = [[]]
        source = iter(lines)
        while some := sorted(islice(source, _LINES_AT_ONCE)):
            levels[0].append(run_of(some))
            for level, runs in enumerate(levels):
                if len(runs) == _RUNS_AT_ONCE:
                    if level + 1 == len(levels):
                        levels.append([])
                    levels[level + 1].append(run_of(merge(*runs)))
                    for run in runs:
                        run.close()
                    runs.clear()
        before = None
        for line in merge(*(run for runs in levels for run in runs)):
            if line != before:
                yield line
            before = line
