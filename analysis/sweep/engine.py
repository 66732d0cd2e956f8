"""Runs a sweep: finds what is done, has the rest done, lists what was refused."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from functools import partial
from itertools import chain
from pathlib import Path
from tempfile import TemporaryFile
from typing import IO, Protocol

from acquisition.printable import on_one_line
from analysis.errors import ResultsFileError, SweepError
from analysis.sweep.manifest import Manifest
from analysis.sweep.shards import Shard, ShardDone, ShardWork, blocks_of
from analysis.sweep.sorting import sorted_lines
from simulation.arguments import ArgumentError, check_fields
from simulation.notebook import Shown

_LINES_SHOWN = 10

Executor = Callable[[Iterator[Shard], ShardWork], Iterator[tuple[Shard, ShardDone]]]


@dataclass(frozen=True, slots=True, kw_only=True)
class SweepOptions:
    """Who works, and on what part.

    Parameters
    ----------
    workers
        Processes on this machine; 1 works in this one.
    scheduler
        Address of a Dask scheduler, ``tcp://host:port``, in place of ``workers``.
    part
        ``(k, n)``: only the k-th of n parts, for queues of jobs that share the state.
    strict
        Whether the first refused photograph ends the sweep.
    workers_gone_s
        Longest time without any worker.

    Raises
    ------
    ArgumentError
        If there is no such part, or no worker.

    Examples
    --------
    >>> half = standoff.SweepOptions(part=(1, 2))
    >>> found = standoff.find_changes_of_series("before.tif", "after", "changes", sweep=half)
    >>> found.document is None
    True
    """

    workers: int = 1
    scheduler: str | None = None
    part: tuple[int, int] = (1, 1)
    strict: bool = False
    workers_gone_s: float = 300.0

    def __post_init__(self) -> None:
        check_fields(self)
        if self.part[0] > self.part[1]:
            raise ArgumentError(
                f"expected one from 1 to {self.part[1]}, got {self.part[0]}", argument="part"
            )


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class SweepSummary(Shown):
    """What a sweep gave.

    Parameters
    ----------
    images
        Photographs that gave something, in this run or an earlier one.
    found_done
        Photographs that an earlier run had done, refused ones among them.
    refused
        Photographs that gave nothing.
    refused_lines
        The first ten of them by name, a line each.
    refused_list
        File that lists them all; None if there are none.
    notes
        What the shards found worth saying, each kind once.
    """

    images: int
    found_done: int
    refused: int
    refused_lines: tuple[str, ...]
    refused_list: Path | None
    notes: tuple[str, ...]


class SweepCall(Protocol):
    """The call that a sweep is part of: it shows how far the sweep is, and takes remarks."""

    def bar(self, task: str, total: int) -> AbstractContextManager[Callable[[int], None]]:
        """Give a block a function that is called with the number of pieces done, of ``total``."""
        ...

    def note(self, text: str) -> None:
        """Take a remark that is shown at once."""
        ...

    def announce(self, text: str) -> None:
        """Take a remark for the end."""
        ...


def announced_sweep(
    call: SweepCall,
    task: str,
    manifest: Manifest,
    work: ShardWork,
    options: SweepOptions | None = None,
) -> SweepSummary:
    """Run a sweep as part of a call, which gets its notes; as `run_sweep` for the rest."""
    with call.bar(task, len(manifest)) as advance_to:
        summary = run_sweep(manifest, work, options, advance_to)
    for sentence in summary.notes:
        call.announce(sentence)
    return summary


def run_sweep(
    manifest: Manifest,
    work: ShardWork,
    options: SweepOptions | None = None,
    progress: Callable[[int], None] = lambda _: None,
) -> SweepSummary:
    """Do every shard that no earlier run committed; the same bits for any number of workers.

    Parameters
    ----------
    manifest
        The photographs.
    work
        Does a shard.
    options
        Who works; None for this process.
    progress
        Called with the number of photographs done.

    Raises
    ------
    SweepError
        If no worker is fit, or, when strict, a photograph is refused.
    ResultsFileError
        If the state cannot be written.
    """
    options = options or SweepOptions()
    try:
        with TemporaryFile(dir=work.state) as refused_lines:
            sweep = _Sweep(manifest, work, options, progress, refused_lines)
            missing = sweep.missing()
            for first in missing:  # no workers are started for none
                with _executor(options) as executor:
                    for shard, done in executor(chain([first], missing), work):
                        sweep.take(shard, done)
            return sweep.summary()
    except OSError as error:
        raise ResultsFileError(
            f"cannot write {error.filename or work.state}: {error.strerror}",
            source=str(work.state),
        ) from error


@contextmanager
def _executor(options: SweepOptions) -> Iterator[Executor]:
    """Choose who does the shards."""
    if options.scheduler is None and options.workers == 1:
        yield _done_here
        return
    # Takes a second; one process needs none of it.
    from analysis.sweep.cluster import done_by_workers, local_workers

    if options.scheduler is not None:
        yield partial(done_by_workers, scheduler=options.scheduler, gone_s=options.workers_gone_s)
        return
    with local_workers(options.workers) as scheduler:
        yield partial(done_by_workers, scheduler=scheduler, gone_s=options.workers_gone_s)


def _done_here(shards: Iterator[Shard], work: ShardWork) -> Iterator[tuple[Shard, ShardDone]]:
    for shard in shards:
        yield shard, work(shard)


@dataclass(slots=True)
class _OpenBlock:
    """A block of shards, what was left of it to do, and the numbers of what still is."""

    shards: Sequence[Shard]
    fresh: Sequence[Shard]
    under_way: set[int]


class _Sweep:
    """What a running sweep remembers: counts, open blocks, and on disk the refused."""

    def __init__(
        self,
        manifest: Manifest,
        work: ShardWork,
        options: SweepOptions,
        progress: Callable[[int], None],
        refused_lines: IO[bytes],
    ) -> None:
        self._refused_lines = refused_lines
        self._manifest = manifest
        self._work = work
        self._options = options
        self._progress = progress
        self._open_blocks: dict[str, _OpenBlock] = {}
        self._notes: dict[str, str] = {}
        self._images = self._found_done = self._refused = 0

    def missing(self) -> Iterator[Shard]:
        """Yield the shards that are left to do, in the order of their numbers."""
        find = self._work.finder(self._manifest)
        for block in blocks_of(self._manifest, self._work.key, self._options.part):
            left = []
            for shard in block:
                done, rest = find(shard)
                if done is not None:
                    self._found_done += done.images + len(done.refused)
                    self._count(done)
                if rest is not None:
                    left.append(rest)
            if left:
                numbers = {shard.number for shard in left}
                self._open_blocks[block[0].block_key] = _OpenBlock(block, left, numbers)
                yield from left
            else:
                self._work.commit_block(block, ())

    def take(self, shard: Shard, done: ShardDone) -> None:
        """Count a shard that was done."""
        self._found_done += done.found_done
        self._count(done)
        block = self._open_blocks[shard.block_key]
        block.under_way.discard(shard.number)
        if not block.under_way:
            del self._open_blocks[shard.block_key]
            self._work.commit_block(block.shards, block.fresh)

    def summary(self) -> SweepSummary:
        """List the refused in a file, and count."""
        part, parts = self._options.part
        path = self._work.state / ("refused.txt" if parts == 1 else f"refused-{part}-{parts}.txt")
        shown: list[str] = []
        if self._refused:
            shown = self._list_refused(path)
        else:
            path.unlink(missing_ok=True)
        return SweepSummary(
            images=self._images,
            found_done=self._found_done,
            refused=self._refused,
            refused_lines=tuple(shown),
            refused_list=path if shown else None,
            notes=tuple(sorted(self._notes.values())),
        )

    def _count(self, done: ShardDone) -> None:
        if done.refused and self._options.strict:
            raise SweepError(done.refused[0])
        self._refused_lines.writelines(f"{on_one_line(line)}\n".encode() for line in done.refused)
        for kind, sentence in done.notes.items():
            self._notes[kind] = min(self._notes.get(kind, sentence), sentence)
        self._images += done.images
        self._refused += len(done.refused)
        self._progress(self._images + self._refused)

    def _list_refused(self, path: Path) -> list[str]:
        self._refused_lines.seek(0)
        shown: list[str] = []
        with path.open("wb") as file:
            for line in sorted_lines(self._refused_lines, self._work.state):
                file.write(line)
                if len(shown) < _LINES_SHOWN:
                    shown.append(line.decode().rstrip("\n"))
        return shown
