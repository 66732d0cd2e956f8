"""Runs a sweep over photographs: finds what is done, does the rest, lists what was refused."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from functools import partial
from itertools import chain
from pathlib import Path
from tempfile import TemporaryFile
from typing import IO, Protocol

from acquisition.printable import on_one_line
from analysis.errors import ResultsFileError, SweepError
from analysis.sweep._items import Manifest, group_of, sorted_lines
from analysis.sweep._records import Records, merge_notes
from analysis.sweep._work import Batch, SweepWork, Written, do_batch
from simulation.arguments import ArgumentError, check_fields
from simulation.notebook import Shown

_LINES_SHOWN = 10

_Executor = Callable[[Iterator[Batch], SweepWork], Iterator[tuple[Batch, list[Written]]]]


@dataclass(frozen=True, slots=True, kw_only=True)
class SweepOptions:
    """Number of worker processes, and the part of the photographs that they do.

    Parameters
    ----------
    workers
        Number of processes on this machine; with 1, the calling process does the work.
    scheduler
        Address of a Dask scheduler, ``tcp://host:port``, to use instead of ``workers``.
    part
        ``(k, n)``: do only the k-th of n parts, k from 1, for several jobs that share their
        results.
    strict
        Whether the first photograph that cannot be used ends the sweep with an error; by default
        it is left out and listed.
    workers_gone_s
        Time in s without any worker after which the sweep ends with an error.

    Raises
    ------
    ArgumentError
        If ``part`` does not exist, or another value is out of range.

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
    """Counts of a sweep over photographs.

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
        What was found worth saying, each kind once.
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
    work: SweepWork,
    options: SweepOptions | None = None,
) -> tuple[SweepSummary, Records]:
    """Run a sweep as part of a call, which gets its notes; as `run_sweep` for the rest."""
    with call.bar(task, len(manifest)) as advance_to:
        summary, records = run_sweep(manifest, work, options, advance_to)
    for sentence in summary.notes:
        call.announce(sentence)
    return summary, records


def run_sweep(
    manifest: Manifest,
    work: SweepWork,
    options: SweepOptions | None = None,
    progress: Callable[[int], None] = lambda _: None,
) -> tuple[SweepSummary, Records]:
    """Do every photograph that no earlier run did; the same bits for any number of workers.

    Returns the counts, and the records while the manifest is open.

    Parameters
    ----------
    manifest
        The photographs.
    work
        Does one.
    options
        Who works; None for this process.
    progress
        Called with the number of photographs done.

    Raises
    ------
    SweepError
        If no usable worker is available, or, with ``strict``, a photograph cannot be used.
    ResultsFileError
        If the state cannot be written.
    """
    options = options or SweepOptions()
    try:
        records = Records(manifest, work)
        with TemporaryFile(dir=work.state) as refused_lines:
            sweep = _Sweep(records, options, progress, refused_lines)
            missing = sweep.missing()
            for first in missing:  # no workers are started for none
                with _executor(options) as executor:
                    for batch, written in executor(chain([first], missing), work):
                        sweep.take(batch, written)
            return sweep.summary(), records
    except OSError as error:
        raise ResultsFileError(
            f"cannot write {error.filename or work.state}: {error.strerror}",
            source=str(work.state),
        ) from error


@contextmanager
def _executor(options: SweepOptions) -> Iterator[_Executor]:
    """Choose who does the batches."""
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


def _done_here(batches: Iterator[Batch], work: SweepWork) -> Iterator[tuple[Batch, list[Written]]]:
    for batch in batches:
        yield batch, do_batch(work, batch)


class _Sweep:
    """What a running sweep counts, and on disk the refused."""

    def __init__(
        self,
        records: Records,
        options: SweepOptions,
        progress: Callable[[int], None],
        refused_lines: IO[bytes],
    ) -> None:
        self._records = records
        self._options = options
        self._progress = progress
        self._refused_lines = refused_lines
        self._notes: dict[str, str] = {}
        self._images = self._found_done = self._refused = 0
        self._group: int | None = None

    def missing(self) -> Iterator[Batch]:
        """Yield what is left to do, in the order of the hashes."""
        for notes in self._records.notes():
            merge_notes(self._notes, notes)
        for done, refused, batch in self._records.batches(self._options.part):
            self._found_done += done
            self._count(done, refused)
            if batch.items:
                yield batch

    def take(self, batch: Batch, written: Iterable[Written]) -> None:
        """Count a batch that was done."""
        taken = self._records.take(written)
        for _, notes in taken:
            merge_notes(self._notes, notes)
        self._count(len(taken), [line for line, _ in taken if line is not None])
        group = group_of(batch.items[0].hash)
        if self._group not in (None, group):
            self._records.merge(self._group)
        self._group = group

    def summary(self) -> SweepSummary:
        """List the refused in a file, and count."""
        part, parts = self._options.part
        state = self._records.work.state
        path = state / ("refused.txt" if parts == 1 else f"refused-{part}-{parts}.txt")
        shown: list[str] = []
        if self._refused:
            self._refused_lines.seek(0)
            with path.open("wb") as file:
                for line in sorted_lines(self._refused_lines, state):
                    file.write(line)
                    if len(shown) < _LINES_SHOWN:
                        shown.append(line.decode().rstrip("\n"))
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

    def _count(self, answers: int, refused: Sequence[str]) -> None:
        if refused and self._options.strict:
            raise SweepError(refused[0])
        self._refused_lines.writelines(f"{on_one_line(line)}\n".encode() for line in refused)
        self._images += answers - len(refused)
        self._refused += len(refused)
        if answers:
            self._progress(self._images + self._refused)
